//! Reads a scene: a TOML scene file, or an OBJ file alone.

use super::camera::Camera;
use super::document::{Document, Section};
use super::faces::{self, Numbering};
use super::material::Material;
use super::obj::{self, ObjFile};
use super::path::CameraPath;
use super::{RadiosityDefaults, RenderDefaults, Scene, idle, mtl};
use crate::color::Rgb;
use crate::error::{Error, Result};
use crate::sampling::MOST_SAMPLES;
use std::collections::{BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

/// Name of the material of faces without `usemtl`.
const DEFAULT_MATERIAL: &str = "default";

pub(super) const TOP_KEYS: [&str; 7] =
    ["geometry", "unit", "camera", "materials", "environment", "radiosity", "render"];
pub(super) const MATERIAL_KEYS: [&str; 10] = [
    "diffuse",
    "diffuse_transmission",
    "specular",
    "roughness",
    "specular_transmission",
    "ior",
    "thin",
    "emission",
    "emit_both_sides",
    "two_sided",
];
pub(super) const ENVIRONMENT_KEYS: [&str; 1] = ["radiance"];
pub(super) const RADIOSITY_KEYS: [&str; 3] = ["element_size", "rays", "adaptive"];
pub(super) const RENDER_KEYS: [&str; 2] = ["spp", "quality"];
pub(super) const QUALITIES: [&str; 3] = ["mesh", "direct", "gather"];

/// Reads a scene from a `.toml` scene file, or from an `.obj` file (then there is no camera and the
/// unit is the metre).
///
/// # Errors
/// A file cannot be read, is malformed, or holds a value out of range; nothing in it has an area.
/// What can be worked around becomes one of [`Scene::warnings`] instead.
pub fn load(path: &Path) -> Result<Scene> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
    match extension.as_deref() {
        Some("obj") => {
            let plan = Plan::new(path);
            assemble(plan, vec![obj::read(path, 1.0)?], Vec::new())
        }
        Some("toml") => {
            let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
            let text = String::from_utf8(bytes).map_err(|e| {
                let valid = &e.as_bytes()[..e.utf8_error().valid_up_to()];
                let line = 1 + valid.iter().filter(|&&b| b == b'\n').count();
                Error::parse(path, Some(line), "is not UTF-8 text")
            })?;
            load_toml(&Document::new(path, &text))
        }
        _ => Err(Error::parse(path, None, "not a scene: expected a .toml scene file or an .obj file")),
    }
}

/// What the scene file says, apart from geometry and materials.
struct Plan {
    path: PathBuf,
    unit: f64,
    cameras: Vec<Camera>,
    paths: Vec<CameraPath>,
    environment: Rgb,
    radiosity: RadiosityDefaults,
    render: RenderDefaults,
    warnings: Vec<String>,
}

impl Plan {
    fn new(path: &Path) -> Plan {
        Plan {
            path: path.into(),
            unit: 1.0,
            cameras: Vec::new(),
            paths: Vec::new(),
            environment: Rgb::ZERO,
            radiosity: RadiosityDefaults::default(),
            render: RenderDefaults::default(),
            warnings: Vec::new(),
        }
    }
}

fn load_toml(doc: &Document<'_>) -> Result<Scene> {
    let table = doc.parse()?;
    let top = Section { doc, table: &table, label: String::new(), line: 1 };
    let mut plan = Plan::new(doc.path);
    top.warn_unknown(&TOP_KEYS, &mut plan.warnings);
    if let Some(unit) = top.get("unit") {
        plan.unit = unit.positive()?;
    }
    read_settings(&top, &mut plan)?;
    read_cameras(&top, &mut plan)?;
    let overrides = read_overrides(&top, &mut plan.warnings)?;

    let geometry = top.get("geometry");
    let geometry =
        geometry.ok_or_else(|| top.missing("geometry", &TOP_KEYS, "add geometry = [\"FILE.obj\"]"))?;
    let names = geometry.texts()?;
    if names.is_empty() {
        return Err(geometry.error("names no file"));
    }
    let directory = doc.path.parent().unwrap_or(Path::new(""));
    let mut files = Vec::new();
    for (name, line) in names {
        files.push(obj::read(&directory.join(name), plan.unit).map_err(|e| match e {
            Error::Io { path, source } => {
                doc.error(line, format!("geometry \"{name}\" ({}): {source}", path.display()))
            }
            other => other,
        })?);
    }
    assemble(plan, files, overrides)
}

fn read_settings(top: &Section<'_>, plan: &mut Plan) -> Result<()> {
    let section = |name: &str| top.get(name).map(|e| e.section(name.to_string())).transpose();
    if let Some(environment) = section("environment")? {
        environment.warn_unknown(&ENVIRONMENT_KEYS, &mut plan.warnings);
        if let Some(entry) = environment.get("radiance") {
            plan.environment = entry.color()?;
        }
    }
    if let Some(radiosity) = section("radiosity")? {
        radiosity.warn_unknown(&RADIOSITY_KEYS, &mut plan.warnings);
        let size = radiosity.get("element_size").map(|e| e.positive()).transpose()?;
        plan.radiosity.element_size = size.map(|s| s * plan.unit);
        plan.radiosity.adaptive = radiosity.get("adaptive").map_or(Ok(false), |e| e.flag())?;
        plan.radiosity.rays = radiosity.get("rays").map(|e| e.count(MOST_SAMPLES)).transpose()?;
    }
    if let Some(render) = section("render")? {
        render.warn_unknown(&RENDER_KEYS, &mut plan.warnings);
        plan.render.spp = render.get("spp").map(|e| e.count(MOST_SAMPLES)).transpose()?;
        if let Some(entry) = render.get("quality") {
            let quality = entry.text()?;
            if !QUALITIES.contains(&quality) {
                return Err(entry.error(format!("must be one of {}, is \"{quality}\"", QUALITIES.join(", "))));
            }
            plan.render.quality = Some(quality.to_string());
        }
    }
    Ok(())
}

fn read_cameras(top: &Section<'_>, plan: &mut Plan) -> Result<()> {
    let Some(entry) = top.get("camera") else { return Ok(()) };
    let sections = entry.sections()?;
    let several = sections.len() > 1;
    for (index, section) in sections.into_iter().enumerate() {
        let line = section.line;
        let (camera, path) = Camera::read(section, several.then_some(index), &mut plan.warnings)?;
        if plan.cameras.iter().any(|c| c.name == camera.name) {
            return Err(top.doc.error(line, format!("a second camera \"{}\"", camera.name)));
        }
        plan.cameras.push(camera);
        plan.paths.extend(path);
    }
    Ok(())
}

/// What the scene file says about a material: only what is set replaces the MTL's value.
#[derive(Debug, Default)]
struct Override {
    name: String,
    /// Where, for messages: file and line.
    place: String,
    /// Where each key is.
    keys: Vec<(String, String)>,
    diffuse: Option<Rgb>,
    diffuse_transmission: Option<Rgb>,
    specular: Option<Rgb>,
    roughness: Option<f64>,
    specular_transmission: Option<Rgb>,
    ior: Option<f64>,
    thin: Option<bool>,
    emission: Option<Rgb>,
    emit_both_sides: Option<bool>,
    two_sided: Option<bool>,
}

impl Override {
    fn read(name: &str, section: &Section<'_>, warnings: &mut Vec<String>) -> Result<Override> {
        section.warn_unknown(&MATERIAL_KEYS, warnings);
        let color = |key: &str| section.get(key).map(|e| e.color()).transpose();
        let flag = |key: &str| section.get(key).map(|e| e.flag()).transpose();
        let roughness = section.get("roughness").map(|e| match e.number()? {
            r if (0.0..=1.0).contains(&r) => Ok(r),
            r => Err(e.error(format!("must lie within [0, 1], is {r}"))),
        });
        Ok(Override {
            name: name.to_string(),
            place: format!("{}:{}", section.doc.path.display(), section.line),
            keys: section.entries().map(|e| (e.key.to_string(), e.place())).collect(),
            diffuse: color("diffuse")?,
            diffuse_transmission: color("diffuse_transmission")?,
            specular: color("specular")?,
            roughness: roughness.transpose()?,
            specular_transmission: color("specular_transmission")?,
            ior: section.get("ior").map(|e| e.positive()).transpose()?,
            thin: flag("thin")?,
            emission: color("emission")?,
            emit_both_sides: flag("emit_both_sides")?,
            two_sided: flag("two_sided")?,
        })
    }

    /// A warning for each key that does nothing for any of the `materials`, which have its name.
    fn idle(&self, materials: &[&Material]) -> Vec<String> {
        let idle = |(key, place): &(String, String)| {
            let reasons: Option<Vec<_>> = materials.iter().map(|m| idle::of_key(key, m)).collect();
            let reason = *reasons?.first()?;
            Some(format!("{place}: material \"{}\": {key} has no effect: {reason}", self.name))
        };
        self.keys.iter().filter_map(idle).collect()
    }

    fn apply(&self, m: &mut Material) {
        set(&mut m.diffuse, self.diffuse);
        set(&mut m.diffuse_transmission, self.diffuse_transmission);
        set(&mut m.specular, self.specular);
        set(&mut m.roughness, self.roughness);
        set(&mut m.specular_transmission, self.specular_transmission);
        set(&mut m.ior, self.ior);
        set(&mut m.thin, self.thin);
        set(&mut m.emission, self.emission);
        set(&mut m.emit_both_sides, self.emit_both_sides);
        set(&mut m.two_sided, self.two_sided);
    }
}

fn set<T: Copy>(place: &mut T, value: Option<T>) {
    *place = value.unwrap_or(*place);
}

fn read_overrides(top: &Section<'_>, warnings: &mut Vec<String>) -> Result<Vec<Override>> {
    let Some(entry) = top.get("materials") else { return Ok(Vec::new()) };
    let materials = entry.section("materials".into())?;
    let read = |entry: super::document::Entry<'_>| {
        let section = entry.section(format!("material \"{}\"", entry.key))?;
        Override::read(entry.key, &section, warnings)
    };
    materials.entries().map(read).collect()
}

fn assemble(mut plan: Plan, mut files: Vec<ObjFile>, overrides: Vec<Override>) -> Result<Scene> {
    for file in &mut files {
        plan.warnings.append(&mut file.warnings);
    }
    if let (true, Some(file)) = (files.iter().all(|f| f.polygons.is_empty()), files.first()) {
        let message = format!("no faces: {}", file.advice);
        return Err(Error::parse(&file.path, None, faces::with_warnings(&message, &plan.warnings)));
    }
    for file in files.iter().filter(|f| f.polygons.is_empty()) {
        plan.warnings.push(format!("{}: no faces: {}", file.path.display(), file.advice));
    }
    let mut read = vec![plan.path.clone()];
    read.extend(files.iter().map(|f| f.path.clone()));
    let mut numbering: Vec<_> = files.iter().map(|_| Numbering::default()).collect();
    let mut objects = number_objects(&files, &mut numbering);
    let told = (&mut read, &mut plan.warnings);
    let mut materials = number_materials(&files, &overrides, &mut numbering, told)?;
    let mut geometry = faces::build(&files, &numbering, plan.unit, &mut materials)?;

    // A name without faces is no object.
    let mut used = vec![false; objects.len()];
    geometry.faces.iter().for_each(|f| used[f.object as usize] = true);
    let mut next = 0;
    let number = |&is_used: &bool| {
        next += u32::from(is_used);
        next.saturating_sub(1)
    };
    let renumbered: Vec<u32> = used.iter().map(number).collect();
    geometry.faces.iter_mut().for_each(|f| f.object = renumbered[f.object as usize]);
    let mut keep = used.iter();
    objects.retain(|_| keep.next() == Some(&true));

    plan.warnings.append(&mut geometry.warnings);
    // Files that share an MTL would say the same twice.
    let mut said = HashSet::new();
    plan.warnings.retain(|w| said.insert(w.clone()));
    Ok(Scene {
        path: plan.path,
        files: read,
        objects,
        materials,
        vertices: geometry.vertices,
        normals: geometry.normals,
        faces: geometry.faces,
        triangle_count: geometry.triangle_count,
        polygon_count: geometry.polygon_count,
        center: geometry.center,
        radius: geometry.radius,
        unit: plan.unit,
        cameras: plan.cameras,
        paths: plan.paths,
        environment: plan.environment,
        radiosity: plan.radiosity,
        render: plan.render,
        warnings: plan.warnings,
    })
}

/// Names of all objects. A name that occurs in several files gets the file's stem behind it.
fn number_objects(files: &[ObjFile], numbering: &mut [Numbering]) -> Vec<String> {
    let mut names: Vec<String> = Vec::new();
    let mut taken: HashSet<String> = HashSet::new();
    let mut files_with: HashMap<&str, usize> = HashMap::new();
    for name in files.iter().flat_map(|f| &f.objects) {
        *files_with.entry(name).or_default() += 1;
    }
    for (file, numbers) in files.iter().zip(numbering) {
        let stem = file.path.file_stem().map(|s| s.to_string_lossy()).unwrap_or_default();
        for name in &file.objects {
            let shared = files_with.get(name.as_str()).is_some_and(|&n| n > 1);
            let mut unique = if shared { format!("{name}@{stem}") } else { name.clone() };
            // Files in different directories may share their stem.
            let mut copy = 2;
            while !taken.insert(unique.clone()) {
                unique = format!("{name}@{stem}-{copy}");
                copy += 1;
            }
            numbers.objects.push(names.len() as u32);
            names.push(unique);
        }
    }
    names
}

/// The materials that faces use, with overrides applied and energy conserved; adds the libraries to the files that were `read`.
fn number_materials(
    files: &[ObjFile],
    overrides: &[Override],
    numbering: &mut [Numbering],
    (read, warnings): (&mut Vec<PathBuf>, &mut Vec<String>),
) -> Result<Vec<Material>> {
    let mut materials: Vec<Material> = Vec::new();
    for (file, numbers) in files.iter().zip(numbering) {
        let (library, paths) = read_libraries(file, warnings)?;
        read.extend(paths);
        let mut resolve = |name: &str, warning: String| {
            let over = overrides.iter().find(|o| o.name == name);
            // The last definition counts.
            let material = match (library.iter().rev().find(|m| m.name == name), over) {
                (Some(defined), _) => defined.clone(),
                (None, Some(_)) => Material::new(name),
                (None, None) => {
                    warnings.push(warning);
                    Material::grey(name)
                }
            };
            number_material(material, over, &mut materials, warnings)
        };
        let path = file.path.display();
        let used: HashSet<_> = file.polygons.iter().map(|p| p.material).collect();
        for (index, name) in file.materials.iter().enumerate() {
            let is_used = used.contains(&Some(index as u32));
            let missing =
                format!("{path}: material \"{name}\" is defined nowhere; it is diffuse grey of 0.5");
            numbers.materials.push(if is_used { resolve(name, missing) } else { 0 });
        }
        let without = file.polygons.iter().filter(|p| p.material.is_none()).count();
        if without > 0 {
            let missing = format!(
                "{path}: {without} faces have no material; they get \"{DEFAULT_MATERIAL}\", diffuse grey of 0.5"
            );
            numbers.no_material = resolve(DEFAULT_MATERIAL, missing);
        }
    }
    for over in overrides {
        let of_name: Vec<_> = materials.iter().filter(|m| m.name == over.name).collect();
        warnings.extend(over.idle(&of_name));
    }
    for over in overrides.iter().filter(|o| materials.iter().all(|m| m.name != o.name)) {
        let near = super::document::nearest(&over.name, materials.iter().map(|m| m.name.as_str()));
        let hint = near.map(|n| format!("; did you mean \"{n}\"?")).unwrap_or_default();
        warnings.push(format!("{}: no face has material \"{}\"{hint}", over.place, over.name));
    }
    Ok(materials)
}

/// Number of a material in the scene; equal ones of several files are one.
fn number_material(
    mut material: Material,
    over: Option<&Override>,
    materials: &mut Vec<Material>,
    warnings: &mut Vec<String>,
) -> u32 {
    if let Some(over) = over {
        over.apply(&mut material);
    }
    let one_sided = material.lets_through() && !material.two_sided;
    // Light that goes through comes out on the other side: a black back would have to end it on one way and not on the other.
    material.two_sided |= one_sided;
    let fresnel = material.leave_reflection_to_fresnel();
    let excess = material.conserve_energy();
    if let Some(known) = materials.iter().position(|m| *m == material) {
        return known as u32;
    }
    if one_sided {
        let place = over.map_or(String::new(), |o| format!("{}: ", o.place));
        warnings.push(format!(
            "{place}material \"{}\": lets light through, so both its sides take part: two_sided = false is ignored",
            material.name
        ));
    }
    if fresnel {
        warnings.push(format!(
            "material \"{}\": specular and specular_transmission sum to more than 1; its specular is left out, since glass \
             reflects by Fresnel's equations",
            material.name
        ));
    }
    if let Some(sum) = excess {
        warnings.push(format!(
            "material \"{}\": its albedos sum to {sum:.6}; all were divided by that to conserve energy",
            material.name
        ));
    }
    materials.push(material);
    (materials.len() - 1) as u32
}

/// The materials of a file's MTL libraries, and the libraries.
fn read_libraries(file: &ObjFile, warnings: &mut Vec<String>) -> Result<(Vec<Material>, BTreeSet<PathBuf>)> {
    let directory = file.path.parent().unwrap_or(Path::new(""));
    let mut materials = Vec::new();
    // Some exporters name the library again with each object.
    let mut read: BTreeSet<PathBuf> = BTreeSet::new();
    for (line, whole) in &file.libraries {
        // One name with spaces, or several names.
        let names: Vec<&str> = if directory.join(whole).is_file() {
            vec![whole.as_str()]
        } else {
            whole.split_whitespace().collect()
        };
        if names.len() > 1 && names.iter().all(|name| !directory.join(name).exists()) {
            // Whether these are several names or one is not known: they are told together.
            let paths: Vec<PathBuf> = names.iter().map(|name| directory.join(name)).collect();
            if paths.into_iter().filter(|path| read.insert(path.clone())).count() > 0 {
                let message = format!("material library \"{whole}\" not found");
                warnings.push(Error::parse(&file.path, Some(*line), message).to_string());
            }
            continue;
        }
        for name in names {
            let path = directory.join(name);
            if !read.insert(path.clone()) {
                continue;
            }
            if !path.is_file() {
                let what = if path.exists() { "is no file" } else { "not found" };
                let message = format!("material library \"{name}\" {what}");
                warnings.push(Error::parse(&file.path, Some(*line), message).to_string());
                continue;
            }
            let (mut found, mut said) = mtl::read(&path)?;
            materials.append(&mut found);
            warnings.append(&mut said);
        }
    }
    Ok((materials, read))
}
