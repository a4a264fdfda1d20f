//! The description of scene files for their users, held to what the program reads.

use super::{camera, load, mtl, path};
use std::collections::BTreeSet;

const TEXT: &str = include_str!("../../docs/scene-file.md");

/// The text below a heading, up to the next.
fn below(heading: &str) -> &'static str {
    let start = TEXT.find(&format!("\n## {heading}\n")).unwrap_or_else(|| panic!("no heading {heading}"));
    let text = &TEXT[start + 4..];
    &text[..text.find("\n## ").unwrap_or(text.len())]
}

/// What the rows of a section's table are about.
fn rows(heading: &str) -> BTreeSet<&'static str> {
    below(heading).lines().filter_map(|line| line.strip_prefix("| `")?.split('`').next()).collect()
}

#[test]
fn every_key_is_described_and_no_other() {
    for (heading, keys) in [
        ("The file", &load::TOP_KEYS[..]),
        ("`[camera]`", &camera::KEYS),
        ("`[[camera.keyframe]]`", &path::KEYS),
        ("`[materials.NAME]`", &load::MATERIAL_KEYS),
        ("`[environment]`", &load::ENVIRONMENT_KEYS),
        ("`[radiosity]`", &load::RADIOSITY_KEYS),
        ("`[render]`", &load::RENDER_KEYS),
    ] {
        assert_eq!(rows(heading), keys.iter().copied().collect(), "{heading}");
    }
    for quality in load::QUALITIES {
        assert!(below("`[render]`").contains(&format!("`\"{quality}\"`")), "{quality}");
    }
    let mtl = below("What is read of MTL");
    for key in mtl::COLORS.iter().chain(&mtl::SCALARS).chain(&mtl::NOT_MODELLED) {
        assert!(mtl.contains(&format!("`{key}`")), "{key}");
    }
}

#[test]
fn the_example_is_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let start = TEXT.find("```toml\n").unwrap() + 8;
    let example = &TEXT[start..start + TEXT[start..].find("```").unwrap()];
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, example).unwrap();
    let obj = "usemtl lamp\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
    std::fs::write(folder.path().join("room.obj"), obj).unwrap();
    let scene = load(&path).unwrap();
    assert_eq!((scene.cameras[0].size, scene.radiosity.element_size), ([640, 480], Some(0.05)));
    assert!(scene.materials[0].is_emitter() && scene.warnings.is_empty(), "{:?}", scene.warnings);
}
