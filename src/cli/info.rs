//! `twopass info`.

use super::args::InfoArgs;
use super::render::{element_size, of_element_size};
use super::{length, print, say};
use crate::Result;
use crate::embree::Device;
use crate::mesh::{Mesh, default_element_size};
use crate::pipeline;
use crate::scene::{Features, Scene, load};
use crate::visibility::Visibility;

pub fn run(args: &InfoArgs) -> Result<()> {
    let scene = load(&args.scene)?;
    for w in &scene.warnings {
        say(format_args!("warning: {w}"));
    }
    let device = Device::new(rayon::current_num_threads())?;
    let visibility = Visibility::new(&device, &scene)?;
    let reached = pipeline::reached(&visibility, &scene.view_points(), args.common.seed, &|_| {});
    let size = element_size(&args.elements, &scene).unwrap_or_else(|| default_element_size(&scene, false));
    let mesh =
        Mesh::new(&scene, &reached, size, false).map_err(|e| of_element_size(&args.elements, &scene, e))?;
    let mut lines = describe_scene(&scene);
    let sides = 2 * scene.faces.len();
    lines.push(format!("  sides         {} of {sides} can be reached by light or a camera", reached.count()));
    lines.push(format!("  elements      {} of at most {} m", mesh.len(), length(size)));
    lines.push("  materials".into());
    lines.extend(scene.materials.iter().map(|m| format!("    {:12} {}", m.name, describe(m))));
    let features = Features::of(&scene).list();
    lines.push("  modelled".into());
    lines.extend(features.iter().filter(|f| f.1).map(|(name, _, what)| format!("    {name}: {what}")));
    lines.push("  not needed, not modelled".into());
    lines.extend(features.iter().filter(|f| !f.1).map(|(name, _, _)| format!("    {name}")));
    lines.push(format!("  Embree {}, OpenImageIO {}", device.version(), crate::image::version()));
    print(&lines.join("\n"))
}

fn describe_scene(scene: &Scene) -> Vec<String> {
    let quads = scene.faces.len() - scene.triangle_count;
    let mut lines = vec![
        scene.path.display().to_string(),
        format!("  polygons      {}", scene.polygon_count),
        format!("  faces         {} ({} triangles, {quads} quads)", scene.faces.len(), scene.triangle_count),
        format!("  objects       {}", scene.objects.join(", ")),
        format!("  centre        {} m, radius {} m", scene.center, length(scene.radius)),
    ];
    for camera in &scene.cameras {
        let [width, height] = camera.size;
        let path = scene.paths.iter().find(|p| p.name() == camera.name);
        let frames = path.map_or(String::new(), |p| {
            format!(", keyframes from frame {} to {}", p.frames().start(), p.frames().end())
        });
        lines.push(format!("  camera        {} ({width} x {height}){frames}", camera.name));
    }
    lines
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
        let kind = if m.thin { "thin glass" } else { "glass" };
        // Of silvered glass the roughness is told with the silver's.
        let rough = m.specular == crate::color::Rgb::ZERO && m.is_glossy();
        let rough = if rough { format!(" roughness {:.4}", m.roughness) } else { String::new() };
        parts.push(format!("{kind} {} ior {}{rough}", rgb(m.specular_transmission), m.ior));
    }
    if m.is_emitter() {
        let sides = if m.emit_both_sides { " from both sides" } else { "" };
        parts.push(format!("emits {} W m^-2 sr^-1{sides}", rgb(m.emission)));
    }
    if parts.is_empty() {
        parts.push("black".into());
    }
    if !m.two_sided {
        parts.push("one-sided".into());
    }
    parts.join(", ")
}
