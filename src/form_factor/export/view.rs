//! What an element sees, as a picture.

use crate::form_factor::{DeltaFactors, item_image};
use crate::geometry::Frame;
use crate::image::Image;
use crate::image::canvas::{BLACK, Canvas, LETTER, Srgb, WHITE, category, shortened, width};
use crate::mesh::{Mesh, NONE};
use crate::scene::Scene;
use crate::visibility::Visibility;
use glam::DVec3;
use rayon::prelude::*;

/// How the hemisphere over an element is laid flat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum View {
    /// Orthographic fisheye, by one ray a pixel: equal areas of the disc are equal form factors (Nusselt 1928).
    Fisheye,
    /// Unfolded hemi-cube at this resolution, as the hemi-cube method sees it: the top in the middle, the sides about it.
    Hemicube(u32),
}

/// Pixels across the picture, without the legend.
const SIZE: usize = 720;
/// Nothing is there.
const OUTSIDE: Srgb = BLACK;
/// A side of a face that takes no part.
const BLOCKED: Srgb = [90; 3];
/// Lines of the legend, at most.
const LINES: usize = 40;
/// Longest name in letters.
const LETTERS: usize = 28;

/// What an element sees from its centroid, coloured by object (neighbouring elements in two shades), with a legend of the
/// objects' form factors from that point. Black: nothing; grey: backs of faces, without `--two-sided`.
///
/// Up in the picture is the first tangent of the element's frame turned by a right angle; the element's normal comes out of the picture.
pub fn view(visibility: &Visibility, mesh: &Mesh, element: u32, how: View) -> Image {
    let scene = visibility.scene();
    let (size, pixels) = match how {
        View::Fisheye => fisheye(visibility, mesh, element),
        View::Hemicube(n) => unfolded(scene, mesh, element, n),
    };
    let sides = super::sides(scene, mesh);
    let mut shares = vec![0.0; sides.names.len() + 2];
    let place = |seen: Seen| match seen {
        Seen::Element(e) => sides.of_element[e as usize] as usize,
        Seen::Blocked => sides.names.len(),
        Seen::Outside => sides.names.len() + 1,
    };
    for (seen, weight) in pixels.iter().flatten() {
        shares[place(*seen)] += weight;
    }
    let mut order: Vec<usize> = (0..shares.len()).filter(|k| shares[*k] > 0.0).collect();
    order.sort_by(|a, b| shares[*b].total_cmp(&shares[*a]));
    // The most seen have the clearest colours.
    let mut colors = vec![BLOCKED, OUTSIDE];
    colors.splice(0..0, vec![BLACK; sides.names.len()]);
    for (rank, k) in order.iter().filter(|k| **k < sides.names.len()).enumerate() {
        colors[*k] = category(rank);
    }
    let name = |k: usize| match sides.names.get(k) {
        Some(name) => shortened(name, LETTERS),
        None if k == sides.names.len() => "(backs of faces)".into(),
        None => "(nothing)".into(),
    };

    let zoom = (SIZE / size).max(1);
    let across = size * zoom;
    let legend = across + 30;
    let title =
        format!("element {element} of \"{}\"", sides.names[sides.of_element[element as usize] as usize]);
    let title = shortened(&title, 60);
    let top = LETTER[1] + 12;
    let wide = (legend + 12 + width(&"x".repeat(LETTERS + 12))).max(width(&title) + 20);
    let mut canvas = Canvas::new(wide, top + across + 10, WHITE);
    canvas.text(&title, [8, 5], BLACK);
    for (k, pixel) in pixels.iter().enumerate() {
        let Some((seen, _)) = pixel else { continue };
        let mut color = colors[place(*seen)];
        if let Seen::Element(e) = seen {
            color = shade(color, checker(mesh, *e));
        }
        canvas.fill([10 + k % size * zoom, top + k / size * zoom], [zoom; 2], color);
    }
    for (line, k) in order.iter().take(LINES).enumerate() {
        let y = top + line * (LETTER[1] + 4);
        canvas.fill([legend, y], [14, LETTER[1]], colors[*k]);
        canvas.text(&format!("{:8.5} {}", shares[*k], name(*k)), [legend + 20, y], BLACK);
    }
    if order.len() > LINES {
        let rest: f64 = order[LINES..].iter().map(|k| shares[*k]).sum();
        let y = top + LINES * (LETTER[1] + 4);
        canvas.text(&format!("{rest:8.5} {} more", order.len() - LINES), [legend + 20, y], BLACK);
    }
    canvas.into_image()
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Seen {
    Element(u32),
    Blocked,
    Outside,
}

/// What each pixel of a square sees, and its form factor; none where the hemisphere is not. Rows from the top.
type Pixels = (usize, Vec<Option<(Seen, f64)>>);

fn fisheye(visibility: &Visibility, mesh: &Mesh, element: u32) -> Pixels {
    let scene = visibility.scene();
    let (own, _, _) = mesh.place(element);
    let normal = mesh.normal(scene, element);
    let frame = Frame::new(normal);
    let origin = visibility.leave(mesh.place(element).0, mesh.centroid(scene, element), normal);
    let trace = |k: usize| {
        let place = |i: usize| (2 * i + 1) as f64 / SIZE as f64 - 1.0;
        let (x, y) = (place(k % SIZE), -place(k / SIZE));
        let r = x * x + y * y;
        if r >= 1.0 {
            return None;
        }
        let direction = frame.to_scene(DVec3::new(x, y, (1.0 - r).sqrt())).as_vec3();
        Some(match visibility.closest(origin, direction, own) {
            None => Seen::Outside,
            Some(hit) => match mesh.element(hit.face, hit.front, hit.u, hit.v) {
                NONE => Seen::Blocked,
                e => Seen::Element(e),
            },
        })
    };
    let seen: Vec<Option<Seen>> = (0..SIZE * SIZE).into_par_iter().with_min_len(SIZE).map(trace).collect();
    let weight = 1.0 / seen.iter().flatten().count().max(1) as f64;
    (SIZE, seen.into_iter().map(|s| s.map(|s| (s, weight))).collect())
}

fn unfolded(scene: &Scene, mesh: &Mesh, element: u32, resolution: u32) -> Pixels {
    let image = item_image(scene, mesh, element, resolution);
    let deltas = DeltaFactors::new(resolution as usize);
    let n = resolution as usize;
    let m = image[1].len();
    let size = n + 2 * m;
    let mut pixels = vec![None; size * size];
    for (side, rows) in image.iter().enumerate() {
        for (row, items) in rows.iter().enumerate() {
            for (column, item) in items.iter().enumerate() {
                // From the left and from the top; a side's highest row lies against the top, and its columns run as the
                // directions of the rasteriser's bases do.
                let (x, y) = match side {
                    0 => (m + column, m + n - 1 - row),
                    1 => (2 * m + n - 1 - row, m + column),
                    2 => (row, m + n - 1 - column),
                    3 => (m + column, row),
                    _ => (m + n - 1 - column, 2 * m + n - 1 - row),
                };
                let seen = match item {
                    Some(Some(e)) => Seen::Element(*e),
                    Some(None) => Seen::Blocked,
                    None => Seen::Outside,
                };
                pixels[y * size + x] = Some((seen, deltas.span(side, row, column, column + 1)));
            }
        }
    }
    (size, pixels)
}

/// Whether an element is drawn in the darker shade.
fn checker(mesh: &Mesh, element: u32) -> bool {
    let (face, _, cell) = mesh.place(element);
    let grid = mesh.grid(face);
    let nu = grid.lattice.nu;
    if grid.is_triangle() || grid.is_adaptive() { cell % 2 == 1 } else { (cell % nu + cell / nu) % 2 == 1 }
}

fn shade(color: Srgb, darker: bool) -> Srgb {
    if darker { color.map(|c| (f64::from(c) * 0.82) as u8) } else { color }
}
