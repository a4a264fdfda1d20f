//! What scene files say of materials that has no effect: told, so that nobody looks for it in the picture.

use super::material::Material;
use std::path::Path;

/// Indices of refraction that exporters write for every material, whatever it is.
const USUAL_INDICES: [f64; 4] = [0.0, 1.0, 1.45, 1.5];
/// From this exponent on a lobe is a mirror's to the eye: exporters write it for those.
const MIRROR_EXPONENT: f64 = 900.0;
/// Statements named in one warning.
const NAMED: usize = 3;

/// Why a key of the scene file does nothing for a material that it states something for; none where it does something.
pub(super) fn of_key(key: &str, m: &Material) -> Option<&'static str> {
    let straight = m.is_glass() && m.ior == 1.0;
    match key {
        "roughness" if m.roughness > 0.0 && !m.is_specular() => {
            Some("without specular or specular_transmission there is nothing to be rough")
        }
        "roughness" if m.roughness > 0.0 && straight && !m.is_glossy() => {
            Some("with ior = 1 light goes straight on, however rough the surface is")
        }
        "ior" if !m.is_glass() => Some(
            "it is of glass, and there is no specular_transmission; specular reflects alike at all angles",
        ),
        "thin" if m.thin && !m.is_glass() => Some("it is for glass, and there is no specular_transmission"),
        "thin" if m.thin && straight => Some("with ior = 1 light goes straight on anyway"),
        "emit_both_sides" if m.emit_both_sides && !m.is_emitter() => Some("there is no emission"),
        _ => None,
    }
}

/// A value of an MTL file.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stated {
    pub line: usize,
    pub key: String,
    /// Three alike of what is one number.
    pub value: [f64; 3],
}

/// Materials of an MTL file, and what is stated about each.
pub(super) type Statements = [(String, Vec<Stated>)];

/// One warning for all that an MTL file states without effect, where that is more than what exporters write for every
/// material.
pub(super) fn of_mtl(path: &Path, materials: &Statements) -> Option<String> {
    let idle: Vec<(&str, &Stated, String)> = materials
        .iter()
        .flat_map(|(name, stated)| stated.iter().map(move |s| (name, stated, s)))
        .filter_map(|(name, all, s)| reason(s, all).map(|why| (name.as_str(), s, why)))
        .collect();
    let ((name, first, why), others) = idle.split_first()?;
    let mut also: Vec<String> = others
        .iter()
        .take(NAMED)
        .map(|(name, s, _)| format!("{} of \"{name}\" (line {})", s.key, s.line))
        .collect();
    if others.len() > also.len() {
        also.push(format!("{} more", others.len() - also.len()));
    }
    let also = if also.is_empty() { String::new() } else { format!("; nor have {}", also.join(", ")) };
    Some(format!(
        "{}:{}: material \"{name}\": {} has no effect {why}{also}",
        path.display(),
        first.line,
        first.key
    ))
}

/// Why a statement does nothing beside the others of its material.
fn reason(s: &Stated, all: &[Stated]) -> Option<String> {
    // The last of several counts.
    let value = |key: &str| all.iter().rev().find(|s| s.key == key).map(|s| s.value);
    let number = |key: &str| value(key).map(|v| v[0]);
    let illum = number("illum").unwrap_or(2.0);
    let is_glass = [4.0, 6.0, 7.0, 9.0].contains(&illum);
    let stated = s.value[0];
    match s.key.as_str() {
        // Neither what lets all light through nor what lets none says that this is glass.
        "Tf" if !is_glass && s.value != [1.0; 3] && s.value != [0.0; 3] => {
            Some(format!("with illum {illum}: it is the tint of glass (illum 4, 6, 7 or 9)"))
        }
        "Ni" if !is_glass && !USUAL_INDICES.contains(&stated) => {
            Some(format!("with illum {illum}: it is the index of glass (illum 4, 6, 7 or 9)"))
        }
        // All of glass is there, and `d 0` agrees with that.
        "d" if is_glass && stated > 0.0 && stated < 1.0 => {
            Some(format!("with illum {illum}: glass lets through what Tf says"))
        }
        "Tr" if is_glass && stated > 0.0 && stated < 1.0 => {
            Some(format!("with illum {illum}: glass lets through what Tf says"))
        }
        "Tr" if !is_glass && stated > 0.0 && number("d").is_some_and(|d| (1.0 - d - stated).abs() > 1e-3) => {
            Some("beside d, which says otherwise and counts".into())
        }
        "Ns" if [3.0, 5.0, 8.0].contains(&illum) && stated > 0.0 && stated < MIRROR_EXPONENT => {
            let lobe = number("Pr").is_none() && value("Ks").is_some_and(|ks| ks != [0.0; 3]);
            lobe.then(|| format!("with illum {illum}, which is a perfect mirror: give Pr, or illum 2"))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::color::Rgb;

    #[test]
    fn keys_do_nothing_without_what_they_describe() {
        let plain = Material { roughness: 0.5, thin: true, emit_both_sides: true, ..Material::grey("m") };
        let mirror = Material { specular: Rgb::ONE, ..plain.clone() };
        let glass = Material { specular_transmission: Rgb::ONE, ..plain.clone() };
        let straight = Material { ior: 1.0, ..glass.clone() };
        let silvered = Material { specular: Rgb::splat(0.5), ..straight.clone() };
        let lamp = Material { emission: Rgb::ONE, ..plain.clone() };
        let idle = |m: &Material| {
            ["roughness", "ior", "thin", "emit_both_sides", "diffuse"].map(|key| of_key(key, m).is_some())
        };
        assert_eq!(idle(&plain), [true, true, true, true, false]);
        assert_eq!(idle(&mirror), [false, true, true, true, false]);
        assert_eq!(idle(&glass), [false, false, false, true, false]);
        assert_eq!(idle(&straight), [true, false, true, true, false]);
        assert_eq!(idle(&silvered), [false, false, true, true, false]);
        assert_eq!(idle(&lamp), [true, true, true, false, false]);
        // What a key says that is so without it is no mistake.
        let off = Material { roughness: 0.0, thin: false, emit_both_sides: false, ..plain };
        assert_eq!(idle(&off), [false, true, false, false, false]);
    }
}
