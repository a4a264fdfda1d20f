//! Scenes to measure: the repository's own, held in the program so that it can be run anywhere, and made ones.

use crate::scene::{Scene, load};
use crate::{Error, Result};
use std::fmt::Write;
use std::path::Path;

macro_rules! scene {
    ($name:literal) => {
        (
            $name,
            [
                (concat!($name, ".toml"), include_str!(concat!("../../scenes/", $name, "/", $name, ".toml"))),
                (concat!($name, ".obj"), include_str!(concat!("../../scenes/", $name, "/", $name, ".obj"))),
                (concat!($name, ".mtl"), include_str!(concat!("../../scenes/", $name, "/", $name, ".mtl"))),
            ],
        )
    };
}

/// Scenes of the folder `scenes/` by name, with their files.
pub const SCENES: [(&str, [(&str, &str); 3]); 4] =
    [scene!("cornell"), scene!("corridor"), scene!("gallery"), scene!("music_lesson")];

/// A scene of [`SCENES`].
pub fn embedded(name: &str) -> Result<Scene> {
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    write_embedded(name, folder.path())?;
    load(&folder.path().join(format!("{name}.toml")))
}

/// What the glossy Cornell box holds beside its floor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Glossy {
    /// A tall box that mirrors.
    Mirror,
    /// A ceiling that glows as a whole.
    Ceiling,
}

/// The Cornell box with a glossy floor of this roughness, which is diffuse too unless the ceiling glows.
pub fn glossy_cornell(roughness: f64, with: Glossy) -> Result<Scene> {
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    write_embedded("cornell", folder.path())?;
    let (object, material, entries, diffuse) = match with {
        Glossy::Mirror => ("tall_box", "mirror", "diffuse = 0.0\nspecular = 0.9\nroughness = 0", 0.3),
        Glossy::Ceiling => ("ceiling", "glow", "diffuse = 0.5\nemission = 1.0", 0.0),
    };
    let change = |file: &str, change: &dyn Fn(&str) -> String| {
        let path = folder.path().join(file);
        let text = std::fs::read_to_string(&path).map_err(|e| Error::io(&path, e))?;
        std::fs::write(&path, change(&text)).map_err(|e| Error::io(&path, e))
    };
    change("cornell.obj", &|obj| {
        let glossy = obj.replace("o floor\nusemtl white", "o floor\nusemtl gloss");
        glossy.replace(&format!("o {object}\nusemtl white"), &format!("o {object}\nusemtl {material}"))
    })?;
    change("cornell.toml", &|toml| {
        format!(
            "{toml}\n[materials.gloss]\ndiffuse = {diffuse:?}\nspecular = 0.5\nroughness = {roughness:?}\n\
             [materials.{material}]\n{entries}\n"
        )
    })?;
    load(&folder.path().join("cornell.toml"))
}

/// Writes the files of a scene of [`SCENES`] into a folder.
pub fn write_embedded(name: &str, folder: &Path) -> Result<()> {
    let Some((_, files)) = SCENES.iter().find(|s| s.0 == name) else {
        return Err(Error::scene(name, "the program holds no scene of that name"));
    };
    write_to(folder, files.iter().copied())
}

fn write_to<'a>(folder: &Path, files: impl Iterator<Item = (&'a str, &'a str)>) -> Result<()> {
    for (name, text) in files {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|e| Error::io(&path, e))?;
    }
    Ok(())
}

/// A made scene, as the files that it would be loaded from.
#[derive(Debug, Clone, Default)]
pub struct Files {
    vertices: usize,
    obj: String,
    toml: String,
}

impl Files {
    /// A diffuse material of reflectance `rho` that emits `e` [W m^-2] from its front.
    pub fn diffuse(&mut self, name: &str, rho: f64, e: f64) -> &mut Files {
        let l = e / std::f64::consts::PI;
        let _ = writeln!(
            self.toml,
            "[materials.\"{name}\"]\ndiffuse = [{rho:?}, {rho:?}, {rho:?}]\nemission = [{l:?}, {l:?}, {l:?}]"
        );
        self
    }

    /// A polygon of an object; counter-clockwise seen from its front.
    pub fn polygon(&mut self, object: &str, material: &str, points: &[[f64; 3]]) -> &mut Files {
        let _ = writeln!(self.obj, "o {object}\nusemtl {material}");
        for [x, y, z] in points {
            let _ = writeln!(self.obj, "v {x:?} {y:?} {z:?}");
        }
        let ids: Vec<String> = (1..=points.len()).map(|k| (self.vertices + k).to_string()).collect();
        let _ = writeln!(self.obj, "f {}", ids.join(" "));
        self.vertices += points.len();
        self
    }

    /// The faces x0, x1, y0, y1, z0, z1 of the unit cube seen from within, object and material by these names.
    pub fn room(&mut self) -> &mut Files {
        for (k, name) in ["x0", "x1", "y0", "y1", "z0", "z1"].iter().enumerate() {
            let (axis, high) = (k / 2, k % 2 == 1);
            let corner = |s: f64, t: f64| {
                let mut p = [0.0; 3];
                p[axis] = if high { 1.0 } else { 0.0 };
                p[(axis + 1) % 3] = s;
                p[(axis + 2) % 3] = t;
                p
            };
            // Counter-clockwise seen from +axis.
            let mut points = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
            if high {
                points.reverse();
            }
            self.polygon(name, name, &points);
        }
        self
    }

    /// Writes the scene as `made.toml` and `made.obj` into a folder.
    pub fn write(&self, folder: &Path) -> Result<()> {
        let toml = format!("geometry = [\"made.obj\"]\n{}", self.toml);
        write_to(folder, [("made.toml", toml.as_str()), ("made.obj", &self.obj)].into_iter())
    }

    /// The scene.
    pub fn load(&self) -> Result<Scene> {
        let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
        self.write(folder.path())?;
        load(&folder.path().join("made.toml"))
    }
}
