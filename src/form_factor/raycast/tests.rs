//! What ray casting finds does not depend on the processor.

use super::*;
use crate::embree::Device;
use crate::scene::load;
use std::path::Path;

/// Every processor finds the same.
#[test]
fn wide_registers_change_nothing() {
    let device = Device::new(1).expect("Embree");
    for name in ["cornell", "glass_ball"] {
        let path = format!("{}/scenes/{name}/{name}.toml", env!("CARGO_MANIFEST_DIR"));
        let scene = load(Path::new(&path)).expect("a scene of the project");
        let visibility = Visibility::new(&device, &scene).expect("a tree");
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), 0.2, true).expect("a mesh");
        let casting = Casting {
            rays: 96,
            batches: 2,
            seed: 1,
            specular: AtSpecular::End,
            reached: None,
            emitters: None,
            progress: &|_| (),
        };
        for specular in [AtSpecular::End, AtSpecular::GoOn, AtSpecular::GoOnByShare] {
            let mut caster = Caster::new(&visibility, &mesh, &Casting { specular, ..casting });
            let rows = |caster: &Caster| {
                let row = |block: &Block, k| {
                    let row = block.row(k, caster.batches(), caster.channels());
                    row.entries().map(|(j, f)| (j, f.to_array().map(f64::to_bits))).collect::<Vec<_>>()
                };
                caster.visit(|range, block| (0..range.len()).map(|k| row(block, k)).collect::<Vec<_>>()).0
            };
            let wide = rows(&caster);
            caster.arch = Arch::Scalar;
            assert!(wide.iter().flatten().flatten().count() > mesh.len());
            assert!(rows(&caster) == wide, "{name}, {specular:?}");
        }
    }
}
