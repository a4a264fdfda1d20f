//! Extended form factors of flat mirrors: chains against images in a mirrored scene, and both against exact values.
//!
//! Both have 16 independent randomisations: standard errors with 15 degrees of freedom, four of which a right
//! program exceeds in 0.12 % of comparisons; of a difference of two, with 30, in 0.04 %.

mod common;

use common::*;
use twopass::form_factor::{AtSpecular, Casting, ExchangeMatrix, ObjectTable, cast, cast_images, pass_on};
use twopass::mesh::{Mesh, Sides};
use twopass::scene::Scene;
use twopass::visibility::Visibility;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Mirror {
    Chain,
    Image,
}

fn matrix(scene: &Scene, mirror: Mirror, rays: u32) -> twopass::Result<(Mesh, ExchangeMatrix)> {
    let device = device();
    let visibility = Visibility::new(&device, scene)?;
    let sides = Sides::fronts(scene).without_purely_specular(scene);
    let mesh = Mesh::new(scene, &sides, 1e3, true)?;
    let matrix = match mirror {
        Mirror::Image => cast_images(&visibility, &mesh, (rays, 16), 3, &|_| {})?,
        Mirror::Chain => {
            let casting = Casting {
                rays,
                batches: 16,
                seed: 5,
                specular: AtSpecular::GoOn,
                reached: None,
                emitters: None,
                progress: &|_| {},
            };
            cast(&visibility, &mesh, &casting).0
        }
    };
    let keep = |e: u32| pass_on(scene.material(&scene.faces[mesh.place(e).0 as usize]));
    assert!(matrix.closure_residual(keep) < 1e-5, "{mirror:?}: closure");
    Ok((mesh, matrix))
}

fn table(scene: &Scene, mirror: Mirror, rays: u32) -> twopass::Result<ObjectTable> {
    matrix(scene, mirror, rays).map(|(mesh, matrix)| ObjectTable::new(scene, &mesh, &matrix, 0.0))
}

const MIRROR: &str = "diffuse = 0\nroughness = 0\nspecular = ";

fn number(table: &ObjectTable, name: &str) -> usize {
    table.objects.iter().position(|o| o == name).expect("object")
}

/// Entries of the oracle, the mirror whole or clipped: within four standard errors and 1 % of the exact factor.
#[test]
fn oracle_extended_factors() {
    let Some(entries) = oracle("public_radiosity.json") else { return };
    for e in of_kind(&entries, "planar_mirror") {
        let mut files = Files::default();
        let patches = e["patches"].as_array().expect("patches");
        for (k, p) in patches.iter().enumerate() {
            files.diffuse(&format!("m{k}"), &[0.5], &[0.0]);
            files.polygon(&format!("p{k}"), &format!("m{k}"), &polygon(p));
        }
        files.material("mirror", &format!("{MIRROR}{}\ntwo_sided = false", e["mirror"]["k"]));
        files.polygon("mirror", "mirror", &polygon(&e["mirror"]["poly"]));
        let scene = files.load();
        for mirror in [Mirror::Chain, Mirror::Image] {
            let t = table(&scene, mirror, 1 << 19).expect("factors");
            for (i, row) in e["F_extended"].as_array().expect("rows").iter().enumerate() {
                for (j, exact) in numbers(row).into_iter().enumerate() {
                    let (a, b) = (number(&t, &format!("p{i}")), number(&t, &format!("p{j}")));
                    let (f, error) = (t.form_factors[a][b], t.standard_errors[a][b]);
                    eprintln!("{} {mirror:?} F{i}{j} = {f:.6} +- {error:.6}, exact {exact:.6}", e["id"]);
                    assert!((f - exact).abs() <= T15 * error + 1e-6 * exact, "{} {mirror:?}", e["id"]);
                    assert!((f - exact).abs() <= 0.01 * exact, "{} {mirror:?}: {f} {exact}", e["id"]);
                }
            }
        }
    }
}

/// Mirrors that see each other (two at a right angle, a third that closes a corner), coloured, one of them part
/// diffuse, with a screen that hides a part of them: images of images. All factors agree.
#[test]
fn images_of_images_agree_with_chains() {
    let mut files = Files::default();
    files.material("mx", &format!("{MIRROR}[0.9, 0.8, 0.7]"));
    files.material("my", "diffuse = 0.15\nroughness = 0\nspecular = 0.8");
    files.material("mz", &format!("{MIRROR}0.95"));
    files.diffuse("grey", &[0.5], &[0.0]);
    for (name, points) in box_faces([0.0; 3], [1.0, 1.25, 0.75], true) {
        let material = match name {
            "x0" => "mx",
            "y0" => "my",
            "z0" => "mz",
            _ => "grey",
        };
        files.polygon(name, material, &points);
    }
    files.polygon("screen", "grey", &[[0.3, 0.2, 0.2], [0.6, 0.2, 0.2], [0.6, 0.5, 0.5], [0.3, 0.5, 0.5]]);
    let scene = files.load();
    let tables = [Mirror::Chain, Mirror::Image].map(|m| table(&scene, m, 16_384).expect("factors"));
    let [c, i] = &tables;
    let (mut worst, mut compared): (f64, u32) = (0.0, 0);
    for a in 0..c.objects.len() {
        for b in 0..c.objects.len() {
            let error = c.standard_errors[a][b].hypot(i.standard_errors[a][b]);
            let off = (c.form_factors[a][b] - i.form_factors[a][b]).abs();
            if c.form_factors[a][b] > 0.0 {
                compared += 1;
                worst = worst.max(off / (error + 1e-6));
            }
            assert!(off <= T15 * error + 1e-6, "{} to {}: {c:?} {i:?}", c.objects[a], c.objects[b]);
        }
    }
    eprintln!("{compared} factors, chains and images at most {worst:.1} standard errors apart");
    assert!(compared >= 20);
}

#[test]
fn images_refuse_what_is_no_flat_mirror() {
    let with = |entries: &str| {
        let mut files = Files::default();
        files.material("odd", entries).diffuse("grey", &[0.5], &[0.0]);
        files.polygon("odd", "odd", &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
        files.polygon("g", "grey", &[[0.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 0.0, 1.0]]);
        table(&files.load(), Mirror::Image, 64).map(|_| ()).map_err(|e| e.to_string())
    };
    assert_eq!(with("diffuse = 0\nspecular = 0.9\nroughness = 0"), Ok(()));
    let glossy = with("diffuse = 0\nspecular = 0.9\nroughness = 0.3").unwrap_err();
    assert!(glossy.contains("\"odd\"") && glossy.contains("glossy") && glossy.contains("chain"), "{glossy}");
    let glass = with("diffuse = 0\nspecular_transmission = 1").unwrap_err();
    assert!(glass.contains("glass"), "{glass}");
}
