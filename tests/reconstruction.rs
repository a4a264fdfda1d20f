//! From elements to points: where reconstructed radiosity must be continuous, where it must not
//! mix, and which element a point belongs to.

use glam::{DVec2, DVec3};
use std::path::Path;
use twopass::color::Rgb;
use twopass::embree::Device;
use twopass::mesh::{Mesh, NONE, Nodes, Sides};
use twopass::radiosity::Field;
use twopass::scene::{Scene, load};
use twopass::visibility::Visibility;

fn scene(obj: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    std::fs::write(&path, obj).unwrap();
    let pane = "newmtl pane\nKd 0 0 0\nKs 0 0 0\nNi 1\nTf 1 1 1\nd 0.1\nillum 9\n";
    std::fs::write(folder.path().join("s.mtl"), pane).unwrap();
    load(&path).unwrap()
}

/// Elements of both sides, their nodes, and every element open.
struct Setup {
    scene: Scene,
    mesh: Mesh,
    nodes: Nodes,
    open: Vec<f64>,
}

impl Setup {
    fn new(obj: &str, size: f64) -> Setup {
        let scene = scene(obj);
        let mesh = Mesh::new(&scene, &Sides::all(&scene), size, true).unwrap();
        let nodes = Nodes::new(&scene, &mesh);
        let open = vec![1.0; mesh.len()];
        Setup { scene, mesh, nodes, open }
    }

    fn field(&self, value: impl Fn(u32) -> f64) -> Field {
        let values: Vec<Rgb> = (0..self.mesh.len() as u32).map(|e| Rgb::splat(value(e))).collect();
        Field::new(&self.mesh, &self.nodes, &self.open, &values)
    }

    fn at(&self, field: &Field, side: (u32, bool), uv: DVec2) -> f64 {
        field.at(&self.mesh, &self.nodes, side, uv.x as f32, uv.y as f32).unwrap().x
    }

    /// The value at a point of a face.
    fn at_point(&self, field: &Field, side: (u32, bool), point: DVec3) -> f64 {
        self.at(field, side, self.uv(side.0, point))
    }

    /// (u, v) of a point on the plane of a face.
    fn uv(&self, face: u32, point: DVec3) -> DVec2 {
        self.scene.face_frame(&self.scene.faces[face as usize]).coordinates(point)
    }

    /// The largest difference between the two sides of any border between cells of a face.
    fn largest_jump(&self, field: &Field, face: u32) -> f64 {
        const STEP: f64 = 2e-7;
        let grid = self.mesh.grid(face);
        let inside = |p: DVec2| {
            p.min_element() >= 0.0
                && if grid.is_triangle() { p.x + p.y <= 1.0 } else { p.max_element() <= 1.0 }
        };
        let mut largest = 0.0f64;
        for cell in 0..grid.len() as u32 {
            let (o, a, b) = grid.cell_frame(cell);
            let edges =
                if grid.is_triangle() { vec![(o, a), (o, b), (o + a, b - a)] } else { vec![(o, a), (o, b)] };
            for (start, edge) in edges {
                let across = STEP * edge.perp().normalize();
                for k in 0..=16 {
                    let p = start + f64::from(k) / 16.0 * edge;
                    if inside(p + across) && inside(p - across) {
                        let [x, y] = [p + across, p - across].map(|p| self.at(field, (face, true), p));
                        largest = largest.max((x - y).abs());
                    }
                }
            }
        }
        largest
    }
}

/// A number in [0, 1) that looks random (SplitMix64).
fn noise(k: u32) -> f64 {
    let mut z = (u64::from(k) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
/// Two triangles.
const HALVES: &str = "v 0 0 0\nv 2 0 0\nv 1.5 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n";
/// A quad that is no parallelogram.
const TRAPEZIUM: &str = "v 0 0 0\nv 2 0 0\nv 1.5 1 0\nv 0 1 0\nf 1 2 3 4\n";

#[test]
fn flat_faces_are_continuous_across_every_cell() {
    for obj in [SQUARE, "v 0 0 0\nv 1 0 0\nv 0.3 0.8 0\nf 1 2 3\n", HALVES, TRAPEZIUM] {
        let s = Setup::new(obj, 0.21);
        let field = s.field(noise);
        for face in 0..s.scene.faces.len() as u32 {
            assert!(s.mesh.grid(face).len() >= 25);
            let jump = s.largest_jump(&field, face);
            assert!(jump < 1e-5, "{obj}: {jump}");
        }
    }
}

/// Light that changes over few cells keeps its contrast as far as it is more than noise: here a wave of 3 cells.
#[test]
fn waves_keep_their_contrast_where_noise_allows() {
    use std::f64::consts::TAU;
    let s = Setup::new(SQUARE, 0.05);
    let wave = |x: f64| 2.0 + (TAU * x / 0.15).sin();
    // Means over the cells, whose contrast is 0.827 of the wave's.
    let mean = |x: f64| {
        let ends = [x - 0.025, x + 0.025].map(|x| (TAU * x / 0.15).cos());
        2.0 + (ends[0] - ends[1]) * 0.15 / (TAU * 0.05)
    };
    let values: Vec<Rgb> = (0..s.mesh.len() as u32)
        .map(|e| Rgb::splat(mean((s.mesh.centroid(&s.scene, e) + s.scene.center).x)))
        .collect();
    let contrast = |noise: f64| {
        let field = Field::noisy(&s.mesh, &s.nodes, &s.open, &values, &|_| noise);
        let (mut product, mut square) = (0.0, 0.0);
        for k in 0..1000 {
            let x = 0.25 + 0.5 * (f64::from(k) + 0.5) / 1000.0;
            let found = s.at_point(&field, (0, true), DVec3::new(x, 0.5, 0.0) - s.scene.center);
            (product, square) = (product + (found - 2.0) * (wave(x) - 2.0), square + (wave(x) - 2.0).powi(2));
        }
        product / square
    };
    let [clear, noisy] = [0.0, 1.0].map(contrast);
    println!("contrast kept: {clear:.3}, of as much noise {noisy:.3}");
    assert!(clear > 0.9 && noisy < clear - 0.2, "{clear}, {noisy}");
}

/// Light that changes towards a border, and is alike along it, goes on to the border. Were it that of the cells there, it would be
/// off by half of what neighbours differ by, 0.2. Noise of that size does not go on.
#[test]
fn light_goes_on_to_the_border() {
    for (obj, noise, off) in
        [(SQUARE, 0.0, 0.0..0.01), (TRAPEZIUM, 0.0, 0.0..0.02), (SQUARE, 1.0, 0.15..0.21)]
    {
        let s = Setup::new(obj, 0.21);
        let light = |p: DVec3| 3.0 + 2.0 * (p + s.scene.center).y;
        let values: Vec<Rgb> =
            (0..s.mesh.len() as u32).map(|e| Rgb::splat(light(s.mesh.centroid(&s.scene, e)))).collect();
        let field = Field::noisy(&s.mesh, &s.nodes, &s.open, &values, &|_| noise);
        for y in [0.0, 1.0] {
            let p = DVec3::new(0.7, y, 0.0) - s.scene.center;
            let holds = |face: &u32| {
                let uv = s.uv(*face, p);
                uv.min_element() > -1e-9
                    && (!s.mesh.grid(*face).is_triangle() || uv.element_sum() < 1.0 + 1e-9)
            };
            let face = (0..s.scene.faces.len() as u32).find(holds).expect("a face at the point");
            let found = (s.at_point(&field, (face, true), p) - light(p)).abs();
            assert!(off.contains(&found), "{obj}{y}, noise {noise}: {found}");
        }
    }
}

#[test]
fn two_halves_of_a_quad_meet_without_a_seam() {
    let s = Setup::new(HALVES, 0.21);
    assert_eq!(s.scene.faces.len(), 2);
    let field = s.field(noise);
    let diagonal = (DVec3::ZERO - s.scene.center, DVec3::new(1.5, 1.0, 0.0));
    let mut values = Vec::new();
    for k in 0..=200 {
        let p = diagonal.0 + f64::from(k) / 200.0 * diagonal.1;
        let [a, b] = [0, 1].map(|face| s.at_point(&field, (face, true), p));
        assert!((a - b).abs() < 1e-5, "{k}: {a} {b}");
        values.push(a);
    }
    let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(l, h), &v| (l.min(v), h.max(v)));
    assert!(high - low > 0.05, "the test needs values that vary: {low} {high}");
}

#[test]
fn neighbouring_polygons_of_one_plane_and_material_meet_without_a_seam() {
    let s = Setup::new("v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\nf 1 2 5 4\nf 2 3 6 5\n", 0.3);
    let field = s.field(noise);
    for k in 0..=50 {
        let p = DVec3::new(1.0, f64::from(k) / 50.0, 0.0) - s.scene.center;
        let [a, b] = [0, 1].map(|face| s.at_point(&field, (face, true), p));
        assert!((a - b).abs() < 1e-5, "{k}: {a} {b}");
    }
}

/// Triangles of different polygons divide a common edge into different numbers of cells: the finer
/// one's nodes hang on the coarser one's.
#[test]
fn grids_of_different_fineness_meet_without_a_seam() {
    for (top, different) in [("3 3 0", true), ("1.2 0.9 0", false), ("9 9 0", true)] {
        let s = Setup::new(&format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nv {top}\nf 1 2 3\nf 2 4 3\n"), 0.21);
        assert_eq!(s.mesh.grid(0).lattice.nu != s.mesh.grid(1).lattice.nu, different, "{top}");
        let field = s.field(noise);
        for k in 0..=100 {
            let t = f64::from(k) / 100.0;
            let p = DVec3::new(1.0 - t, t, 0.0) - s.scene.center;
            let [a, b] = [0, 1].map(|face| s.at_point(&field, (face, true), p));
            assert!((a - b).abs() < 1e-5, "{top} {k}: {a} {b}");
        }
    }
}

/// Beyond the reach of the borders' corrections a linear function comes back but for single precision, three cells from the borders
/// but for a thousandth of a cell's step, and at them within a part of it.
#[test]
fn linear_functions_are_reproduced() {
    let f = |p: DVec3| 1.0 + 0.5 * p.x - 0.25 * p.y;
    for (obj, size) in [(SQUARE, 0.04), (HALVES, 0.04), (TRAPEZIUM, 0.04)] {
        let s = Setup::new(obj, size);
        let field = s.field(|e| f(s.mesh.centroid(&s.scene, e) + s.scene.center));
        let (mut far, mut inner, mut outer) = (0.0f64, 0.0f64, 0.0f64);
        for face in 0..s.scene.faces.len() as u32 {
            let frame = s.scene.face_frame(&s.scene.faces[face as usize]);
            for k in 0..4096 {
                let mut uv = DVec2::new(noise(2 * k), noise(2 * k + 1));
                if s.mesh.grid(face).is_triangle() && uv.x + uv.y > 1.0 {
                    uv = DVec2::ONE - uv;
                }
                let p = frame.at(uv) + s.scene.center;
                let error = (s.at(&field, (face, true), uv) - f(p)).abs();
                // Distance to the outline, in cells.
                let right = (2.0 - 0.5 * p.y - p.x) / 1.25f64.sqrt();
                let right = if obj == SQUARE { 1.0 - p.x } else { right };
                let border = p.x.min(p.y).min(1.0 - p.y).min(right);
                let most = match border / size {
                    9.0.. => &mut far,
                    3.0.. => &mut inner,
                    _ => &mut outer,
                };
                *most = most.max(error);
            }
        }
        // What the function changes by over a cell.
        let step = (0.5 + 0.25) * size;
        let parts = [inner, outer].map(|e| e / step);
        println!(
            "{obj:?}: interior {far:.1e}, further out {:.1e} of a cell's step, border {:.2}",
            parts[0], parts[1]
        );
        // Where two lattices of triangles meet, a node's cells do not lie evenly about it.
        let (exact, near) = if obj == SQUARE { (1e-6, 1e-3) } else { (0.02 * step, 0.02) };
        assert!(far < exact, "{obj}: {far}");
        assert!(parts[0] < near && parts[1] < 0.15, "{obj}: {parts:?} of {step}");
    }
}

#[test]
fn constants_come_back_exactly_everywhere() {
    for obj in [SQUARE, TRAPEZIUM] {
        let s = Setup::new(obj, 0.1);
        let field = s.field(|_| 0.7);
        for k in 0..500 {
            let uv = DVec2::new(noise(2 * k), noise(2 * k + 1));
            let uv = if uv.x + uv.y > 1.0 { DVec2::ONE - uv } else { uv };
            assert!((s.at(&field, (0, true), uv) - 0.7).abs() < 1e-6);
        }
    }
}

/// Two faces that share an edge, the first with value 1 and the second with 0, do not mix.
#[track_caller]
fn assert_apart(obj: &str) {
    let s = Setup::new(obj, 0.17);
    let field = s.field(|e| if s.mesh.place(e).0 == 0 { 1.0 } else { 0.0 });
    for k in 0..=100 {
        for uv in [0.0, 0.5, 1.0].map(|v| DVec2::new(v, f64::from(k) / 100.0)) {
            for front in [true, false] {
                let [a, b] = [0, 1].map(|face| s.at(&field, (face, front), uv));
                assert!((a - 1.0).abs() < 1e-6 && b.abs() < 1e-6, "{uv}: {a} {b}");
            }
        }
    }
}

#[test]
fn nothing_bleeds_over_a_crease() {
    // Perpendicular, and folded by 20 degrees only.
    assert_apart("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 1 0 1\nv 1 1 1\nf 1 2 3 4\nf 2 5 6 3\n");
    assert_apart("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 1.94 0 0.34\nv 1.94 1 0.34\nf 1 2 3 4\nf 2 5 6 3\n");
}

#[test]
fn nothing_bleeds_between_materials() {
    let plane = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\n";
    assert_apart(&format!("{plane}usemtl a\nf 1 2 5 4\nusemtl b\nf 2 3 6 5\n"));
    // A face turned over shows its back where its neighbour shows its front.
    assert_apart(&format!("{plane}f 1 2 5 4\nf 2 5 6 3\n"));
}

#[test]
fn nothing_bleeds_to_the_other_side() {
    for obj in [HALVES, TRAPEZIUM] {
        let s = Setup::new(obj, 0.2);
        let field = s.field(|e| f64::from(u8::from(s.mesh.place(e).1)));
        for k in 0..500 {
            let uv = DVec2::new(noise(2 * k), noise(2 * k + 1));
            let uv = if uv.x + uv.y > 1.0 { DVec2::ONE - uv } else { uv };
            for face in 0..s.scene.faces.len() as u32 {
                assert!((s.at(&field, (face, true), uv) - 1.0).abs() < 1e-6);
                assert!(s.at(&field, (face, false), uv).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn smooth_neighbours_mix_and_nothing_else_does() {
    // Folded by 20 degrees, but with one shading normal along the common edge.
    let folded = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 1.94 0 0.34\nv 1.94 1 0.34\n\
                  vn 0 0 1\nvn -0.17365 0 0.98481\nvn -0.34202 0 0.93969\n";
    let value = |obj: &str| {
        let s = Setup::new(obj, 0.25);
        let field = s.field(|e| if s.mesh.place(e).0 == 0 { 1.0 } else { 0.0 });
        let p = DVec3::new(1.0, 0.5, 0.0) - s.scene.center;
        [0, 1].map(|face| s.at_point(&field, (face, true), p))
    };
    let [a, b] = value(&format!("{folded}f 1//1 2//2 3//2 4//1\nf 2//2 5//3 6//3 3//2\n"));
    assert!((a - b).abs() < 1e-5 && (a - 0.5).abs() < 0.3, "{a} {b}");
    let [a, b] = value(&format!("{folded}f 1//1 2//1 3//1 4//1\nf 2//3 5//3 6//3 3//3\n"));
    assert!((a - 1.0).abs() < 1e-6 && b.abs() < 1e-6, "{a} {b}");
}

#[test]
fn covered_elements_have_no_influence() {
    let mut s = Setup::new(SQUARE, 0.1);
    let covered: Vec<bool> = (0..s.mesh.len() as u32)
        .map(|e| {
            let c = s.mesh.centroid(&s.scene, e) + s.scene.center;
            c.x > 0.3 && c.x < 0.6 && c.y > 0.3 && c.y < 0.6
        })
        .collect();
    assert_eq!(covered.iter().filter(|c| **c).count(), 2 * 9);
    for (open, covered) in s.open.iter_mut().zip(&covered) {
        *open = if *covered { 0.0 } else { 1.0 };
    }
    let fields = [0.0, 1e6].map(|v| s.field(|e| if covered[e as usize] { v } else { 0.8 }));
    for k in 0..4000 {
        let uv = DVec2::new(noise(2 * k), noise(2 * k + 1));
        let values = fields.each_ref().map(|f| s.at(f, (0, true), uv));
        assert_eq!(values[0], values[1], "{uv}");
        // Under what covers it the value is nobody's concern.
        let seen = uv.min_element() <= 0.3 || uv.max_element() >= 0.6;
        assert!(!seen || (values[0] - 0.8).abs() < 1e-6, "{uv}: {}", values[0]);
    }
}

/// Rays to known points find the element whose cell holds the point, on either side of every face.
#[test]
fn rays_find_the_element_that_they_hit() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell/cornell.toml");
    let scene = load(&path).unwrap();
    assert!(scene.triangle_count > 0 && scene.triangle_count < scene.faces.len());
    let device = Device::new(1).unwrap();
    let visibility = Visibility::new(&device, &scene).unwrap();
    let mesh = Mesh::new(&scene, &Sides::all(&scene), 0.05, true).unwrap();
    for element in 0..mesh.len() as u32 {
        let (face, front, cell) = mesh.place(element);
        let place = scene.face_frame(&scene.faces[face as usize]);
        let grid = mesh.grid(face);
        let frame = grid.cell_frame(cell);
        let normal = mesh.normal(&scene, element);
        // The centroid and points near the cell's corners.
        for (s, t) in [(0.5, 0.5), (0.02, 0.03), (0.97, 0.02), (0.03, 0.96), (0.96, 0.97)] {
            let uv = grid.cell_point(&frame, s, t);
            let point = place.at(uv);
            // From close above the point, aslant: nothing else is in between.
            let slant = 0.3 * (place.e1.normalize() * (noise(element) - 0.5) + place.e2.normalize() * 0.2);
            let origin = point + 1e-3 * (normal + slant);
            let direction = (point - origin).normalize();
            let hit = visibility.closest(origin.as_vec3(), direction.as_vec3(), u32::MAX).unwrap();
            assert_eq!((hit.face, hit.front), (face, front), "element {element}");
            assert_eq!(mesh.element(hit.face, hit.front, hit.u, hit.v), element, "{uv}");
            assert!(visibility.point(&hit).point.distance(point) < 1e-5);
        }
        let centroid = mesh.centroid(&scene, element);
        let uv = frame.0 + (frame.1 + frame.2) / if grid.is_triangle() { 3.0 } else { 2.0 };
        assert_eq!(mesh.element(face, front, uv.x as f32, uv.y as f32), element);
        assert!(centroid.distance(place.at(uv)) < 1e-12);
    }
    let fronts = Mesh::new(&scene, &Sides::fronts(&scene), 0.05, true).unwrap();
    assert!((0..scene.faces.len() as u32).all(|f| fronts.element(f, false, 0.3, 0.3) == NONE));
}

/// Two floors that meet at x = 2, bright beyond it, and a wall over that line from one y to another and from one z to 1; triangles on demand.
fn floors(wall: Option<[f64; 3]>, triangles: bool) -> Setup {
    let mut obj = "o floor\nv 0 0 0\nv 2 0 0\nv 4 0 0\nv 4 2 0\nv 2 2 0\nv 0 2 0\n".to_string();
    obj += if triangles { "f 1 2 5\nf 1 5 6\nf 2 3 4\nf 2 4 5\n" } else { "f 1 2 5 6\nf 2 3 4 5\n" };
    if let Some([from, to, foot]) = wall {
        obj += &format!("o wall\nv 2 {from} {foot}\nv 2 {to} {foot}\nv 2 {to} 1\nv 2 {from} 1\nf 7 8 9 10\n");
    }
    Setup::new(&obj, 0.5)
}

/// Light ends at a wall that stands on the edge between two faces, or passes through it, and goes on past its end and behind a doorway.
#[test]
fn light_does_not_leak_under_walls() {
    for triangles in [false, true] {
        for (wall, walled, open) in [
            (None, 0.0..=0.0, 0.0..=2.0),
            (Some([0.0, 2.0, 0.0]), 0.0..=2.0, 9.0..=9.0),
            (Some([-1.0, 3.0, 0.0]), 0.0..=2.0, 9.0..=9.0),
            (Some([0.0, 2.0, -1.0]), 0.0..=2.0, 9.0..=9.0),
            (Some([0.0, 1.0, 0.0]), 0.0..=0.5, 1.0..=2.0),
            (Some([0.0, 1.25, 0.0]), 0.0..=1.0, 1.5..=2.0),
            (Some([0.6, 1.9, 0.0]), 1.0..=1.5, 2.0..=2.0),
        ] {
            let setup = floors(wall, triangles);
            let bright = |e: u32| {
                let (face, _, cell) = setup.mesh.place(e);
                let frame = setup.scene.face_frame(&setup.scene.faces[face as usize]);
                f64::from(u8::from(frame.at(setup.mesh.grid(face).centroid(cell)).x > 2.0))
            };
            let field = setup.field(bright);
            for k in 0..=32 {
                let point = DVec3::new(2.0, f64::from(k) / 16.0, 0.0);
                let mut meeting = Vec::new();
                let on_floor = |f: &u32| setup.scene.faces[*f as usize].normal.z.abs() > 0.5;
                for face in (0..setup.scene.faces.len() as u32).filter(on_floor) {
                    let uv = setup.uv(face, point);
                    let far = if setup.scene.faces[face as usize].is_triangle() { uv.x + uv.y } else { 0.0 };
                    if uv.min_element() < -1e-9 || far > 1.0 + 1e-9 {
                        continue;
                    }
                    let beyond = bright(setup.mesh.first(face, true));
                    let value = setup.at(&field, (face, true), uv.clamp(DVec2::ZERO, DVec2::ONE));
                    let what =
                        format!("wall {wall:?}, triangles {triangles}, face {face}, y {}: {value}", point.y);
                    if walled.contains(&point.y) && wall.is_some() {
                        assert!((value - beyond).abs() < 1e-6, "{what}, not {beyond}");
                    }
                    meeting.push(value);
                }
                let least = meeting.iter().copied().fold(f64::INFINITY, f64::min);
                let most = meeting.iter().copied().fold(0.0, f64::max);
                let apart = most - least;
                if open.contains(&point.y) {
                    assert!(apart < 1e-6, "wall {wall:?}, y {}: {meeting:?} apart", point.y);
                }
            }
        }
    }
}

/// A slab, 4 m by 2, on which a wall 2 m long and 1 m high stands, a box of 0.8 m without a bottom, and a plate 0.1 m high.
#[test]
fn faces_are_divided_where_walls_stand() {
    let slab = "o slab\nv 0 0 0\nv 4 0 0\nv 4 2 0\nv 0 2 0\nf 1 2 3 4\n";
    let wall = "o wall\nv 1.5 0 0\nv 1.5 2 0\nv 1.5 2 1\nv 1.5 0 1\nf -4 -3 -2 -1\n";
    let low = wall.replace(" 1\nv", " 0.1\nv").replace(" 1\nf", " 0.1\nf");
    let closed = "o box\nv 2 0.5 0\nv 2.8 0.5 0\nv 2.8 1.3 0\nv 2 1.3 0\nv 2 0.5 1\nv 2.8 0.5 1\nv 2.8 1.3 1\nv 2 1.3 1\n\
        f -8 -7 -3 -4\nf -7 -6 -2 -3\nf -6 -5 -1 -2\nf -5 -8 -4 -1\nf -4 -3 -2 -1\n";
    // Half of it below the slab.
    let sunk = wall.replace(" 0\n", " -1\n");
    let lidless = closed.replace("f -4 -3 -2 -1\n", "");
    let glazed = closed.replace("f -4 -3 -2 -1\n", "mtllib s.mtl\nusemtl pane\nf -4 -3 -2 -1\n");
    for (what, things, parts) in [
        ("nothing", String::new(), 1),
        ("a wall", wall.into(), 2),
        ("a wall that passes through", sunk, 2),
        ("a low sheet", low, 1),
        ("a closed box", closed.into(), 1),
        ("a box without a lid", lidless, 9),
        ("a box with a window for a lid", glazed, 9),
    ] {
        let scene = scene(&format!("{slab}{things}"));
        let of_slab: Vec<_> =
            scene.faces.iter().filter(|f| scene.objects[f.object as usize] == "slab").collect();
        let area: f64 = of_slab.iter().map(|f| f.area).sum();
        assert_eq!(of_slab.len(), parts, "{what}");
        assert!((area - 8.0).abs() < 1e-9, "{what}: {area}");
    }
}
