//! Wavefront MTL files.
//!
//! As with OBJ, each line is judged here, where its number is known, and `tobj` reads the rewritten
//! rest: left to itself it panics on a colour of fewer than three values.

use super::document::nearest;
use super::idle::{self, Stated};
use super::material::{MOST_RADIANCE, Material};
use super::obj_text::with_line_feeds;
use crate::color::Rgb;
use crate::error::{Error, Result};
use std::path::Path;

/// Index of refraction of glass whose MTL states none.
const GLASS_IOR: f64 = 1.5;

pub(super) const COLORS: [&str; 5] = ["Ka", "Kd", "Ks", "Ke", "Tf"];
pub(super) const SCALARS: [&str; 6] = ["Ns", "Ni", "d", "Tr", "Pr", "illum"];
/// Parts of the physically based extension that the renderer does not model.
pub(super) const NOT_MODELLED: [&str; 6] = ["Pm", "Ps", "Pc", "Pcr", "aniso", "anisor"];
const TEXTURES: [&str; 5] = ["norm", "bump", "disp", "decal", "refl"];

/// Reads an MTL file: its materials, not yet scaled to conserve energy, and what the user should
/// know.
///
/// # Errors
/// The file cannot be read, or a value is malformed or out of range; the error names the line.
pub(super) fn read(path: &Path) -> Result<(Vec<Material>, Vec<String>)> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    parse(path, &String::from_utf8_lossy(&bytes))
}

/// Reads MTL text; see [`read`].
pub(super) fn parse(path: &Path, text: &str) -> Result<(Vec<Material>, Vec<String>)> {
    let mut scan = Scan {
        path,
        line: 0,
        canonical: String::new(),
        names: Vec::new(),
        stated: Vec::new(),
        said: Vec::new(),
        warnings: Vec::new(),
    };
    let text = with_line_feeds(text.trim_start_matches('\u{feff}'));
    for (index, line) in text.lines().enumerate() {
        scan.line = index + 1;
        scan.statement(line)?;
    }
    let loaded = tobj::load_mtl_buf(&mut scan.canonical.as_bytes());
    let (materials, _) = loaded.map_err(|e| Error::parse(path, None, e.to_string()))?;
    let stated: Vec<_> = scan.names.into_iter().zip(scan.stated).collect();
    scan.warnings.extend(idle::of_mtl(path, &stated));
    Ok((materials.iter().map(convert).collect(), scan.warnings))
}

struct Scan<'a> {
    path: &'a Path,
    line: usize,
    /// What `tobj` gets to read.
    canonical: String,
    names: Vec<String>,
    /// By material, the values that are read.
    stated: Vec<Vec<Stated>>,
    /// Keys that were warned about.
    said: Vec<String>,
    warnings: Vec<String>,
}

impl Scan<'_> {
    fn error(&self, message: impl std::fmt::Display) -> Error {
        let material = self.names.last().map(|n| format!("material \"{n}\": ")).unwrap_or_default();
        Error::parse(self.path, Some(self.line), format!("{material}{message}"))
    }

    fn warn(&mut self, message: impl std::fmt::Display) {
        self.warnings.push(self.error(message).to_string());
    }

    /// Warns about a key, but not a second time.
    fn warn_once(&mut self, key: &str, message: String) {
        if !self.said.iter().any(|k| k == key) {
            self.said.push(key.to_string());
            self.warn(message);
        }
    }

    fn statement(&mut self, line: &str) -> Result<()> {
        let line = without_comment(line);
        let (key, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        if key.is_empty() {
            return Ok(());
        }
        if key == "newmtl" {
            return self.start(rest);
        }
        if self.names.is_empty() {
            return Err(self.error(format!("{key} before any newmtl")));
        }
        if COLORS.contains(&key) {
            let [r, g, b] = self.color(key, rest)?;
            self.state(key, [r, g, b]);
            self.canonical.push_str(&format!("{key} {r:e} {g:e} {b:e}\n"));
        } else if SCALARS.contains(&key) {
            let value = self.scalar(key, rest)?;
            self.state(key, [value.parse().unwrap_or_default(); 3]);
            self.canonical.push_str(&format!("{key} {value}\n"));
        } else if NOT_MODELLED.contains(&key) {
            if self.number(key, rest)? != 0.0 {
                self.warn_once(key, format!("{key} is not modelled and was ignored"));
            }
        } else if key == "map_Kd" {
            self.warn("textures are not modelled: Kd is used in place of map_Kd");
        } else if key.starts_with("map_") || TEXTURES.contains(&key) {
            self.warn_once(key, format!("textures are not modelled: {key} was ignored"));
        } else if key != "sharpness" {
            let known = COLORS.into_iter().chain(SCALARS).chain(["map_Kd", "newmtl"]);
            let hint = nearest(key, known).map(|k| format!("; did you mean {k}?")).unwrap_or_default();
            self.warn_once(key, format!("unknown key \"{key}\" was ignored{hint}"));
        }
        Ok(())
    }

    fn state(&mut self, key: &str, value: [f64; 3]) {
        let stated = Stated { line: self.line, key: key.into(), value };
        self.stated.last_mut().into_iter().for_each(|s| s.push(stated.clone()));
    }

    fn start(&mut self, name: &str) -> Result<()> {
        if name.is_empty() {
            return Err(Error::parse(self.path, Some(self.line), "newmtl without a name"));
        }
        let again = self.names.iter().any(|n| n == name);
        self.names.push(name.to_string());
        self.stated.push(Vec::new());
        if again {
            self.warn("is defined again; the last definition counts");
        }
        self.canonical.push_str(&format!("newmtl {name}\n"));
        Ok(())
    }

    fn number(&self, key: &str, word: &str) -> Result<f64> {
        match word.parse::<f64>() {
            Ok(n) if n.is_finite() => Ok(n),
            Ok(_) => Err(self.error(format!("{key} must be finite, is {word}"))),
            Err(_) if word.is_empty() => Err(self.error(format!("{key} has no value"))),
            Err(_) => Err(self.error(format!("{key}: \"{word}\" is not a number"))),
        }
    }

    fn color(&self, key: &str, rest: &str) -> Result<[f64; 3]> {
        let words: Vec<_> = rest.split_whitespace().collect();
        if let Some(kind) = words.first().filter(|w| matches!(**w, "spectral" | "xyz")) {
            return Err(self.error(format!("{key} {kind} is not supported; give red, green and blue")));
        }
        let values = words.iter().map(|w| self.number(key, w)).collect::<Result<Vec<_>>>()?;
        if let Some(v) = values.iter().find(|v| **v < 0.0) {
            return Err(self.error(format!("{key} must not be negative, is {v}")));
        }
        if let Some(v) = values.iter().find(|v| **v > MOST_RADIANCE) {
            return Err(self.error(format!("{key} must be at most {MOST_RADIANCE:e}, is {v:e}")));
        }
        match values[..] {
            // The format lets one value stand for all three.
            [all] => Ok([all; 3]),
            [r, g, b] => Ok([r, g, b]),
            _ => Err(self.error(format!("{key} needs 3 numbers, found {}", values.len()))),
        }
    }

    /// The value as `tobj` and [`convert`] will parse it.
    fn scalar(&self, key: &str, rest: &str) -> Result<String> {
        let word = rest.strip_prefix("-halo").unwrap_or(rest).split_whitespace().next().unwrap_or("");
        let value = self.number(key, word)?;
        let (low, high) = match key {
            "d" | "Tr" | "Pr" => (0.0, 1.0),
            "illum" => (0.0, 10.0),
            _ => (0.0, f64::MAX),
        };
        if !(low..=high).contains(&value) {
            let range = if high == f64::MAX {
                "not be negative".into()
            } else {
                format!("lie within [{low}, {high}]")
            };
            return Err(self.error(format!("{key} must {range}, is {word}")));
        }
        if key == "illum" {
            return match value.fract() {
                0.0 => Ok(format!("{value:.0}")),
                _ => Err(self.error(format!("illum must be a whole number, is {word}"))),
            };
        }
        Ok(format!("{value:e}"))
    }
}

/// Our material from MTL's. Values are in range.
fn convert(mtl: &tobj::Material) -> Material {
    let extra = |key: &str| mtl.unknown_param.get(key).map(String::as_str);
    let number = |key: &str| extra(key).and_then(|v| v.parse::<f64>().ok());
    let color = |c: Option<[f64; 3]>| c.map_or(Rgb::ZERO, Rgb::from_array);

    let mut material = Material::new(&mtl.name);
    material.diffuse = color(mtl.diffuse);
    material.emission = color(mtl.emissive);
    let illum = mtl.illumination_model.unwrap_or(2);
    // Models 0 and 1 have no specular term. Glass needs none: Fresnel's equations split the
    // transmittance into what is refracted and what is reflected.
    let is_glass = matches!(illum, 4 | 6 | 7 | 9);
    if illum > 1 && !is_glass {
        material.specular = color(mtl.specular);
    }
    material.roughness = match number("Pr") {
        Some(roughness) => roughness,
        // Without a lobe there is nothing to be rough.
        None if matches!(illum, 3 | 5 | 8) || material.specular == Rgb::ZERO => 0.0,
        None => (2.0 / (mtl.shininess.unwrap_or(0.0) + 2.0)).powf(0.25),
    };
    let opaque = mtl.dissolve.or(number("Tr").map(|t| 1.0 - t)).unwrap_or(1.0);
    if is_glass {
        let filter = extra("Tf").and_then(|v| {
            let v: Vec<f64> = v.split_whitespace().filter_map(|w| w.parse().ok()).collect();
            <[f64; 3]>::try_from(v).ok()
        });
        material.specular_transmission = filter.map_or(Rgb::ONE, Rgb::from_array);
        material.ior = mtl.optical_density.filter(|&ior| ior >= 1e-3).unwrap_or(GLASS_IOR);
    } else if opaque < 1.0 {
        // A surface that is partly there: the rest lets light pass straight on.
        material.diffuse *= opaque;
        material.specular *= opaque;
        material.specular_transmission = Rgb::splat(1.0 - opaque);
        material.ior = 1.0;
    }
    material
}

/// A comment starts the line or follows white space: names may hold a `#`.
fn without_comment(line: &str) -> &str {
    let line = line.trim();
    let starts = |&(at, _): &(usize, &str)| line[..at].chars().next_back().is_none_or(char::is_whitespace);
    line.match_indices('#').find(starts).map_or(line, |(at, _)| line[..at].trim_end())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse_all(text: &str) -> (Vec<Material>, Vec<String>) {
        parse(Path::new("x.mtl"), text).unwrap()
    }

    fn material(text: &str) -> Material {
        parse_all(&format!("newmtl m\n{text}")).0.remove(0)
    }

    #[test]
    fn diffuse_and_emission() {
        let m = material(
            "Ka 1 1 1\n\tKd 0.1 0.2 0.3 # red\n  Ke 17 12 4\nKs 1 1 1\nillum 1\nd 1\nTr 0\nTf 1 1 1\n",
        );
        assert_eq!((m.diffuse, m.emission), (Rgb::new(0.1, 0.2, 0.3), Rgb::new(17.0, 12.0, 4.0)));
        assert!(!m.is_specular(), "illumination model 1 has no specular term");
        assert_eq!(material("Kd 0.4\n").diffuse, Rgb::splat(0.4));
        assert_eq!(material("Kd 0.4").diffuse, Rgb::splat(0.4));
    }

    #[test]
    fn roughness_from_exponent_or_stated() {
        let m = material("Ks 0.5 0.5 0.5\nNs 48\nillum 2\n");
        assert!((m.alpha() - 0.2).abs() < 1e-15, "alpha = sqrt(2 / 50)");
        assert_eq!(material("Ks 1 1 1\nNs 48\nPr 0.3\n").roughness, 0.3);
        assert_eq!(material("Ks 1 1 1\nNs 48\nPr 0\n").roughness, 0.0);
        assert_eq!(material("Ks 1 1 1\n").roughness, 1.0);
        for mirror in ["illum 3", "illum 5"] {
            assert_eq!(material(&format!("Ks 1 1 1\nNs 48\n{mirror}\n")).roughness, 0.0);
        }
    }

    #[test]
    fn glass_and_transparency() {
        let glass = material("Kd 0 0 0\nKs 0.3 0.3 0.3\nTf 0.9 0.8 0.7\nNi 2.5\nillum 7\n");
        assert_eq!((glass.specular_transmission, glass.ior), (Rgb::new(0.9, 0.8, 0.7), 2.5));
        assert_eq!(glass.specular, Rgb::ZERO);
        let plain = material("Ni 0\nillum 4\n");
        assert_eq!((plain.specular_transmission, plain.ior), (Rgb::ONE, 1.5));
        for half in ["d 0.25", "Tr 0.75", "d 0.25\nTr 0", "d -halo 0.25"] {
            let m = material(&format!("Kd 0.8 0.8 0.8\nKs 0.2 0.2 0.2\nNi 1.5\nillum 2\n{half}\n"));
            assert_eq!((m.specular_transmission, m.ior), (Rgb::splat(0.75), 1.0), "{half}");
            assert_eq!((m.diffuse, m.specular), (Rgb::splat(0.2), Rgb::splat(0.05)), "{half}");
        }
    }

    #[test]
    fn what_is_not_modelled_is_said_once() {
        let text = "newmtl a\nmap_Kd a.png\nmap_Ks a.png\nPm 0\nsharpness 3\nNZ 1\nKD 1 1 1\n\
                    newmtl b\nmap_Kd b.png\nmap_Ks b.png\nPm 0.5\nPm 0.5\nNZ 1\n";
        let (_, warnings) = parse_all(text);
        for (line, key) in
            [(2, "map_Kd"), (3, "map_Ks"), (6, "NZ"), (7, "did you mean Kd"), (9, "map_Kd"), (11, "Pm")]
        {
            let place = format!("x.mtl:{line}: ");
            assert!(warnings.iter().any(|w| w.starts_with(&place) && w.contains(key)), "{key}: {warnings:?}");
        }
        assert_eq!(warnings.len(), 6, "{warnings:?}");
    }

    /// What exporters write for every material is no news; what says that a surface is something that it is not is.
    #[test]
    fn statements_without_effect_are_told_once_a_file() {
        let said = |text: &str| parse_all(&format!("newmtl m\nKs 0.5 0.5 0.5\n{text}\n")).1;
        for usual in [
            "Ns 10\nNi 1.5\nTf 1 1 1\nd 1\nTr 0\nillum 2",
            "Ns 225\nNi 1.45\nTf 0 0 0\nillum 1",
            "Ns 1000\nillum 3",
            "Ns 20\nPr 0.2\nillum 3",
            "Ns 20\nKs 0 0 0\nillum 5",
            "Ns 200\nNi 2.5\nTf 0.1\nd 0\nillum 7",
            "d 0.5\nTr 0.5",
            "d 0.5\nTr 0\nNi 1",
        ] {
            assert_eq!(said(usual), [""; 0], "{usual}");
        }
        for (idle, line, parts) in [
            ("Tf 0.9 0.9 1", 3, ["Tf", "illum 2"]),
            ("Ni 1.33\nillum 2", 3, ["Ni", "illum 2"]),
            ("illum 0\nNi 2", 4, ["Ni", "illum 0"]),
            ("illum 7\nd 0.3", 4, ["d has no effect", "illum 7"]),
            ("Tr 0.3\nillum 4", 3, ["Tr has no effect", "illum 4"]),
            ("d 1\nTr 0.5", 4, ["Tr has no effect", "beside d"]),
            ("Ns 20\nillum 5", 3, ["Ns", "perfect mirror"]),
        ] {
            let said = said(idle);
            assert!(said.len() == 1 && parts.iter().all(|p| said[0].contains(p)), "{idle}: {said:?}");
            assert!(said[0].starts_with(&format!("x.mtl:{line}: material \"m\": ")), "{said:?}");
        }
        let many: String = (0..9).map(|k| format!("newmtl {k}\nNi 1.3\n")).collect();
        let (_, said) = parse_all(&many);
        assert_eq!(said.len(), 1);
        for part in ["x.mtl:2: material \"0\": Ni", "Ni of \"1\" (line 4)", "5 more"] {
            assert!(said[0].contains(part), "{said:?}");
        }
    }

    #[test]
    fn the_last_of_equal_names_is_said_to_count() {
        let (materials, warnings) = parse_all("newmtl a b\nKd 0\nnewmtl a b\nKd 1\n");
        assert_eq!((materials.len(), materials[1].name.as_str()), (2, "a b"));
        assert!(warnings.len() == 1 && warnings[0].starts_with("x.mtl:3: material \"a b\""), "{warnings:?}");
    }
}
