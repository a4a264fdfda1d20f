//! What in a solution cannot be trusted, by name.

use super::Solution;
use crate::color;
use crate::form_factor::Rows;
use crate::mesh::NONE;
use crate::scene::{Face, Scene};
use std::collections::HashSet;

/// How the warning about standard errors begins.
pub const UNCERTAIN: &str = "radiosity is uncertain";
/// Relative standard error of an object's reflected light above which a warning names it.
const TOLERATED: f64 = 0.05;
/// Share of rays below which what escapes does so through cracks, not openings.
const CRACK: f64 = 1e-3;
/// Departure of the power balance that needs no explanation.
const BALANCED: f64 = 1e-3;
/// Relative error of all light from elements that are too large that is said. As the coarser level lets expect it, it is three times
/// what it is in rooms with a lamp close under the ceiling.
pub(super) const MUCH: f64 = 0.03;
/// Objects named in one warning.
const NAMED: usize = 5;

/// Warnings about a solution, each naming its objects.
pub fn warnings(scene: &Scene, solution: &Solution, rows: Rows) -> Vec<String> {
    let mut warnings = Vec::new();
    if solution.mesh.is_empty() {
        return warnings;
    }
    if rows.batches() < 2 {
        warnings.push(format!(
            "{} ray an element gives no standard errors: cast at least 2 (--rays)",
            rows.rays_per_row()
        ));
    }
    uncertain(solution, &mut warnings);
    dark(scene, solution, &mut warnings);
    let l = &solution.ledger;
    for c in 0..3 {
        let (off, error) = (l.residual[c].abs(), l.residual_error[c]);
        // Without standard errors nothing says how large a departure is by chance.
        if off > BALANCED + 4.0 * error {
            warnings.push(format!(
                "power balance misses {:.2} % of the light (standard error {:.2} %): results are not to be trusted{}",
                100.0 * off,
                100.0 * error,
                bending(scene)
            ));
            break;
        }
    }
    covered_sheets(scene, solution, rows, &mut warnings);
    cracks(scene, solution, rows, &mut warnings);
    warnings
}

/// Warns where elements that are too large send much light to wrong places; `sent` is what each makes wrong of the light elsewhere, in
/// relation to that light, and `views` whether the light of pictures was counted beside that of all surfaces.
pub fn too_large(scene: &Scene, solution: &Solution, sent: &[f64], views: bool) -> Option<String> {
    let sum: f64 = sent.iter().sum();
    let mut by_object = vec![0.0; scene.objects.len()];
    for (e, sent) in sent.iter().enumerate() {
        by_object[scene.faces[solution.mesh.place(e as u32).0 as usize].object as usize] += sent;
    }
    let worst = (0..by_object.len()).max_by(|a, b| by_object[*a].total_cmp(&by_object[*b]))?;
    (sum > MUCH).then(|| {
        format!(
            "elements are too large for light that changes within them: {} may be off by up to some {:.0} %, most of it by \
             object \"{}\"; choose a smaller --element-size",
            if views { "the pictures" } else { "all light" },
            100.0 * sum,
            scene.objects[worst]
        )
    })
}

/// What to look at where the balance fails and a scene has glass: of a surface that bends light and does not close a body, or that is
/// turned outside in, light leaves as if it were still inside.
fn bending(scene: &Scene) -> String {
    let mut bends = vec![false; scene.objects.len()];
    scene.faces.iter().for_each(|f| bends[f.object as usize] |= scene.material(f).bends());
    let objects: Vec<usize> = (0..bends.len()).filter(|k| bends[*k]).collect();
    if objects.is_empty() {
        return String::new();
    }
    let names = named(objects.iter().map(|k| &scene.objects[*k]));
    format!("; glass must close a body, with normals that point out of it, or say `thin = true` ({names})")
}

/// Names translucent objects that lie on others: what they let through there ends between the two.
fn covered_sheets(scene: &Scene, solution: &Solution, rows: Rows, warnings: &mut Vec<String>) {
    let (mesh, summary) = (&solution.mesh, rows.summary());
    let mut lost = vec![0.0; scene.objects.len()];
    for e in 0..mesh.len() as u32 {
        let face = &scene.faces[mesh.place(e).0 as usize];
        let material = scene.material(face);
        if !material.is_translucent() {
            continue;
        }
        let behind = match mesh.opposite(e) {
            NONE => 0.0,
            o => summary[o as usize].exposed,
        };
        let covered = (summary[e as usize].exposed - behind).max(0.0) * mesh.area(e);
        lost[face.object as usize] +=
            covered * color::mean(material.diffuse_transmission * solution.irradiance[e as usize]);
    }
    let l = &solution.ledger;
    let (total, all) = (lost.iter().sum::<f64>(), color::mean(l.emitted + l.environment));
    if total > BALANCED * all {
        let mut objects: Vec<usize> = (0..lost.len()).filter(|k| lost[*k] > 0.0).collect();
        objects.sort_by(|a, b| lost[*b].total_cmp(&lost[*a]));
        warnings.push(format!(
            "translucent surfaces touch or cut others: {:.2} % of the light passes through them into what covers them and is \
             lost; leave a gap ({})",
            100.0 * total / all,
            named(objects.iter().map(|k| &scene.objects[*k]))
        ));
    }
}

/// Objects in a warning.
fn named<'a>(objects: impl ExactSizeIterator<Item = &'a String>) -> String {
    let more = objects.len() > NAMED;
    let names = objects.take(NAMED).map(|n| format!("object \"{n}\""));
    names.chain(more.then(|| "...".into())).collect::<Vec<_>>().join(", ")
}

fn uncertain(solution: &Solution, warnings: &mut Vec<String>) {
    let brightest = solution.objects.iter().map(|o| color::mean(o.radiosity)).fold(0.0, f64::max);
    let mut worst: Vec<(f64, &str)> = Vec::new();
    for o in &solution.objects {
        let (error, value) = (color::mean(o.standard_error), color::mean(o.radiosity));
        // What is dark beside the rest of the scene need not be known as well.
        let relative = error / value.max(1e-6 * brightest);
        // A side on which no ray found any light, such as the outside of a room, is mostly as dark as it looks; `dark` names
        // objects of which that is so on all sides.
        if value > 0.0 && relative > TOLERATED {
            worst.push((relative, &o.name));
        }
    }
    worst.sort_by(|a, b| b.0.total_cmp(&a.0));
    if !worst.is_empty() {
        let names: Vec<String> = worst
            .iter()
            .take(NAMED)
            .map(|(e, n)| format!("object \"{n}\": {:.0} %", 100.0 * e))
            .chain((worst.len() > NAMED).then(|| "...".into()))
            .collect();
        warnings.push(format!(
            "{UNCERTAIN}: cast more rays (--rays); standard errors of means ({})",
            names.join(", ")
        ));
    }
}

/// Names objects that would reflect light but got none, and those that nothing was found to reach.
fn dark(scene: &Scene, solution: &Solution, warnings: &mut Vec<String>) {
    let n = scene.objects.len();
    let found = |k: usize| [true, false].iter().any(|front| solution.mesh.first(k as u32, *front) != NONE);
    let (mut reflects, mut reached, mut lit) = (vec![false; n], vec![false; n], vec![false; n]);
    for (k, face) in scene.faces.iter().enumerate() {
        let (object, material) = (face.object as usize, scene.material(face));
        let diffuse = material.diffuse + material.diffuse_transmission;
        reflects[object] |= diffuse.max_element() > 0.0;
        // Emitters are seen whatever falls on them.
        lit[object] |= material.is_emitter();
        reached[object] |= found(k);
    }
    solution.objects.iter().for_each(|o| lit[o.object as usize] |= o.radiosity.max_element() > 0.0);
    let those = |of: &dyn Fn(usize) -> bool| -> Option<String> {
        let objects: Vec<usize> = (0..n).filter(|o| reflects[*o] && !lit[*o] && of(*o)).collect();
        (!objects.is_empty()).then(|| named(objects.iter().map(|o| &scene.objects[*o])))
    };
    if let Some(names) = those(&|o| reached[o]) {
        warnings.push(format!(
            "no ray found any light on what can be reached: it is shown black ({names}); cast more rays (--rays)"
        ));
    }
    if (0..n).all(|o| reached[o] || !reflects[o]) {
        return;
    }
    // What continues a surface that was found, such as the bottom of a box, is closed off by it.
    let faces = || scene.faces.iter().enumerate();
    let beside: HashSet<Edge> =
        faces().filter(|(k, _)| found(*k)).flat_map(|(_, f)| edges(scene, f)).collect();
    let mut alone = vec![false; n];
    for (_, face) in faces().filter(|(_, f)| !reached[f.object as usize]) {
        alone[face.object as usize] |= !edges(scene, face).iter().any(|e| beside.contains(e));
    }
    if let Some(names) = those(&|o| !reached[o] && alone[o]) {
        warnings.push(format!(
            "nothing was found to reach any side of some objects: they are shown black, as if enclosed ({names})"
        ));
    }
}

/// Ends of an edge in single precision, bit by bit, the smaller first.
type Edge = [[u32; 3]; 2];

fn edges(scene: &Scene, face: &Face) -> Vec<Edge> {
    let n = if face.is_triangle() { 3 } else { 4 };
    // Adding zero makes -0 and 0 one point.
    let at = |k: usize| (scene.corner(face, k % n).as_vec3() + glam::Vec3::ZERO).to_array().map(f32::to_bits);
    (0..n).map(|k| if at(k) < at(k + 1) { [at(k), at(k + 1)] } else { [at(k + 1), at(k)] }).collect()
}

fn cracks(scene: &Scene, solution: &Solution, rows: Rows, warnings: &mut Vec<String>) {
    let mesh = &solution.mesh;
    let (mut total, mut escaped) = (0.0, 0.0);
    let mut by_object = vec![0.0; scene.objects.len()];
    for e in 0..mesh.len() {
        let area = mesh.area(e as u32) * rows.summary()[e].exposed;
        let lost = area * color::mean(rows.summary()[e].escaped);
        total += area;
        escaped += lost;
        by_object[scene.faces[mesh.place(e as u32).0 as usize].object as usize] += lost;
    }
    let share = if total > 0.0 { escaped / total } else { 0.0 };
    if share > 0.0 && share < CRACK {
        let worst = by_object.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).map_or(0, |w| w.0);
        warnings.push(format!(
            "a share of {share:.1e} of the rays leaves the scene, most from object \"{}\": its faces may not quite meet",
            scene.objects[worst]
        ));
    }
}
