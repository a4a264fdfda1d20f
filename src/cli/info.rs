//! `twopass info`.

use super::args::InfoArgs;
use super::render::pass1;
use crate::Result;
use crate::embree::Device;
use crate::mesh::{Mesh, default_element_size};
use crate::scene::{Features, load};
use crate::visibility::{Visibility, reachable_sides};

pub fn run(args: &InfoArgs) -> Result<()> {
    let scene = load(&args.scene)?;
    for w in &scene.warnings {
        eprintln!("warning: {w}");
    }
    let device = Device::new(rayon::current_num_threads())?;
    let visibility = Visibility::new(&device, &scene)?;
    let settings = pass1(&args.pass1, &scene, args.common.seed);
    let frames: Vec<_> = scene.cameras.iter().map(|c| (c.frame(&scene), c.size)).collect();
    let reached = reachable_sides(&visibility, &frames, settings.seed);
    let size = settings.element_size.unwrap_or_else(|| default_element_size(&scene));
    let mesh = Mesh::new(&scene, &reached, size, false)?;
    println!("{}", scene.path.display());
    println!("  polygons      {}", scene.polygon_count);
    println!(
        "  faces         {} ({} triangles, {} parallelograms)",
        scene.faces.len(),
        scene.triangle_count,
        scene.faces.len() - scene.triangle_count
    );
    println!("  objects       {}", scene.objects.join(", "));
    println!("  centre        {} m, radius {:.6} m", scene.center, scene.radius);
    for camera in &scene.cameras {
        println!("  camera        {} ({} x {})", camera.name, camera.size[0], camera.size[1]);
    }
    println!(
        "  sides         {} of {} can be reached by light or a camera",
        reached.count(),
        2 * scene.faces.len()
    );
    println!("  elements      {} of at most {size:.6} m", mesh.len());
    println!("  materials");
    for m in &scene.materials {
        println!("    {:12} {}", m.name, describe(m));
    }
    println!("  modelled");
    let features = Features::of(&scene).list();
    for (name, _, what) in features.iter().filter(|f| f.1) {
        println!("    {name}: {what}");
    }
    println!("  not needed, not modelled");
    for (name, _, _) in features.iter().filter(|f| !f.1) {
        println!("    {name}");
    }
    println!("  Embree {}, OpenImageIO {}", device.version(), crate::image::version());
    Ok(())
}

fn describe(m: &crate::scene::Material) -> String {
    let mut parts = Vec::new();
    let rgb = |c: crate::color::Rgb| format!("({:.4} {:.4} {:.4})", c.x, c.y, c.z);
    if m.diffuse != crate::color::Rgb::ZERO {
        parts.push(format!("diffuse {}", rgb(m.diffuse)));
    }
    if m.is_translucent() {
        parts.push(format!("diffuse transmission {}", rgb(m.diffuse_transmission)));
    }
    if m.specular != crate::color::Rgb::ZERO {
        parts.push(format!("specular {} roughness {:.4}", rgb(m.specular), m.roughness));
    }
    if m.is_glass() {
        parts.push(format!("glass {} ior {}", rgb(m.specular_transmission), m.ior));
    }
    if m.is_emitter() {
        parts.push(format!("emits {} W m^-2 sr^-1", rgb(m.emission)));
    }
    if parts.is_empty() { "black".into() } else { parts.join(", ") }
}
