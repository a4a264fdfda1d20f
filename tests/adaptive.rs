//! Adaptive meshes: cells of several levels are one surface without cracks, and fewer elements show the same light.

mod common;

use common::{Files, box_faces, device};
use glam::{DVec2, DVec3};
use twopass::adaptive::{self, Adapted};
use twopass::color::Rgb;
use twopass::emitters::Emitters;
use twopass::mesh::{Division, Levels, Mesh, Nodes, Siblings, Sides};
use twopass::pipeline::{Pass1, Pass1Result};
use twopass::radiosity::{Field, Reads, Solution};
use twopass::scene::{Scene, load};
use twopass::visibility::Visibility;

fn scene_of(obj: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    std::fs::write(&path, obj).unwrap();
    load(&path).unwrap()
}

/// A number in [0, 1) that looks random (SplitMix64).
fn noise(k: u64) -> f64 {
    let mut z = (k + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0.3 0.8 0\nf 1 2 3\n";
/// Two triangles.
const HALVES: &str = "v 0 0 0\nv 2 0 0\nv 1.5 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n";
/// A quad that is no parallelogram, and one beside it.
const TRAPEZIUM: &str = "v 0 0 0\nv 2 0 0\nv 1.5 1 0\nv 0 1 0\nv 2.5 0 0\nv 2.5 1 0\nf 1 2 3 4\nf 2 5 6 3\n";
/// Parallelograms, a triangle beside one, and a triangle of twice the size beside that.
const MIXED: &str = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\nv 3 0.4 0\nv 5 3 0\n\
                     f 1 2 5 4\nf 2 3 6 5\nf 3 7 6\nf 7 8 6\n";
/// Long cells beside square ones.
const STRIPS: &str = "v 0 0 0\nv 1 0 0\nv 1 0.1 0\nv 0 0.1 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 4 3 5 6\n";
const ALL: [&str; 6] = [SQUARE, TRIANGLE, HALVES, TRAPEZIUM, MIXED, STRIPS];

/// Cells divided at random along either edge, up to `rounds` times.
struct Setup {
    scene: Scene,
    division: Division,
    mesh: Mesh,
    nodes: Nodes,
}

impl Setup {
    fn new(obj: &str, size: f64, rounds: u64, balanced: bool) -> Setup {
        let scene = scene_of(obj);
        let sides = Sides::all(&scene);
        let mut division = Division::new(&scene, &sides, size).unwrap();
        for round in 0..rounds {
            let chosen = |face: u32, cell: u32, edge: u64| {
                noise(edge << 60 | round << 40 | u64::from(face) << 20 | u64::from(cell)) < 0.4
            };
            division.split(|face, cell| [chosen(face, cell, 0), chosen(face, cell, 1)]);
            if balanced {
                division.balance(&scene, &sides).unwrap();
            }
        }
        let mesh = Mesh::divided(&scene, &sides, &division, false).unwrap();
        let nodes = Nodes::new(&scene, &mesh);
        Setup { scene, division, mesh, nodes }
    }

    fn field(&self, value: impl Fn(u32) -> f64) -> Field {
        let values: Vec<Rgb> = (0..self.mesh.len() as u32).map(|e| Rgb::splat(value(e))).collect();
        Field::new(&self.mesh, &self.nodes, &vec![1.0; self.mesh.len()], &values)
    }

    fn at(&self, field: &Field, side: (u32, bool), uv: DVec2) -> f64 {
        field.at(&self.mesh, &self.nodes, side, uv.x as f32, uv.y as f32).unwrap().x
    }

    /// Every face whose closure holds a point of the plane, with its (u, v) there.
    fn faces_at(&self, point: DVec3) -> Vec<(u32, DVec2)> {
        let faces = 0..self.scene.faces.len() as u32;
        let place =
            |face: u32| (face, self.scene.face_frame(&self.scene.faces[face as usize]).coordinates(point));
        let inside = |(face, uv): &(u32, DVec2)| {
            let far = if self.mesh.grid(*face).is_triangle() { uv.x + uv.y } else { uv.max_element() };
            uv.min_element() > -1e-9 && far < 1.0 + 1e-9
        };
        faces.map(place).filter(inside).collect()
    }
}

/// Points of every cell name it, areas and shares add up, corners are where interpolation puts all weight on one node.
#[test]
fn lookup_agrees_with_geometry_on_every_cell() {
    for obj in ALL {
        let s = Setup::new(obj, 0.04, 4, false);
        let levels: Vec<Levels> = (0..s.mesh.len() as u32).map(|e| s.mesh.levels(e)).collect();
        assert!(levels.iter().any(|l| l[0] >= 3) && levels.iter().any(|l| l[1] >= 3), "{obj}");
        let square = levels.iter().all(|l| l[0] == l[1]);
        assert_eq!(square, (0..s.scene.faces.len() as u32).all(|f| s.mesh.grid(f).is_triangle()), "{obj}");
        for face in 0..s.scene.faces.len() as u32 {
            let grid = s.mesh.grid(face);
            let points = grid.node_points();
            assert_eq!(points.len(), grid.node_count() as usize);
            let mut whole = 0.0;
            for cell in 0..grid.len() as u32 {
                whole += grid.share(cell);
                let frame = grid.cell_frame(cell);
                for (a, b) in [(0.5, 0.5), (0.01, 0.02), (0.98, 0.99), (0.02, 0.97), (0.97, 0.02)] {
                    let p = grid.cell_point(&frame, a, b);
                    assert_eq!(grid.cell(p.x as f32, p.y as f32), cell, "{obj} {cell} {p}");
                    let (local, weights) = grid.interpolation(p.x as f32, p.y as f32);
                    assert_eq!(local, grid.cell_nodes(cell));
                    let sum: DVec2 =
                        local.iter().zip(weights).map(|(n, w)| f64::from(w) * points[*n as usize]).sum();
                    assert!(sum.distance(p) < 1e-6, "{obj} {cell}: {sum} {p}");
                }
                let c = grid.centroid(cell);
                assert_eq!(grid.cell(c.x as f32, c.y as f32), cell);
            }
            assert!((whole - 1.0).abs() < 1e-12, "{obj}: {whole}");
        }
        let area: f64 = (0..s.mesh.len() as u32).map(|e| s.mesh.area(e)).sum();
        let faces: f64 = s.scene.faces.iter().map(|f| f.area).sum();
        assert!((area - 2.0 * faces).abs() < 1e-9);
    }
}

/// The light shown from both sides of every edge of every cell, within faces and between them, balanced or not.
#[test]
fn no_edge_of_any_cell_is_a_crack() {
    const STEP: f64 = 2e-7;
    for obj in ALL {
        for balanced in [false, true] {
            let s = Setup::new(obj, 0.04, 4, balanced);
            let field = s.field(|e| noise(u64::from(e)));
            let (mut edges, mut largest, mut range) = (0, 0.0f64, (f64::MAX, f64::MIN));
            for face in 0..s.scene.faces.len() as u32 {
                let grid = s.mesh.grid(face);
                let frame = s.scene.face_frame(&s.scene.faces[face as usize]);
                for cell in 0..grid.len() as u32 {
                    let (o, a, b) = grid.cell_frame(cell);
                    let mut around = vec![(o, a), (o, b)];
                    around.extend(if grid.is_triangle() {
                        vec![(o + a, b - a)]
                    } else {
                        vec![(o + a, b), (o + b, a)]
                    });
                    for (start, edge) in around {
                        edges += 1;
                        for k in 0..=32 {
                            let uv = start + f64::from(k) / 32.0 * edge;
                            let point = frame.at(uv);
                            let mut shown = Vec::new();
                            for (other, at) in s.faces_at(point) {
                                let across = STEP * edge.perp().normalize();
                                shown.extend([at, at + across, at - across].map(|p| {
                                    let p = p.clamp(DVec2::ZERO, DVec2::ONE);
                                    s.at(&field, (other, true), p)
                                }));
                            }
                            let (low, high) =
                                shown.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
                            largest = largest.max(high - low);
                            range = (range.0.min(low), range.1.max(high));
                        }
                    }
                }
            }
            println!("{obj:?}: {} elements, {edges} edges, {largest:.1e}", s.mesh.len());
            assert!(largest < 1e-4, "{obj}, balanced {balanced}: {largest}");
            assert!(range.1 - range.0 > 0.5, "the test needs values that vary: {range:?}");
        }
    }
}

/// Balanced meshes have no neighbours of less than half the common edge, as far as faces may be divided.
#[test]
fn balance_grades_the_cells() {
    let scene = scene_of(SQUARE);
    let sides = Sides::all(&scene);
    let mut division = Division::new(&scene, &sides, 1.0 / 64.0).unwrap();
    // The cells beside the middle alone, on one side of it, ever finer.
    let mut coarse = 0;
    loop {
        let mesh = Mesh::divided(&scene, &sides, &division, false).unwrap();
        coarse = coarse.max(mesh.len());
        let beside = mesh.grid(0).cell(0.499, 0.499);
        if division.split(|_, cell| [cell == beside; 2]) == 0 {
            break;
        }
    }
    division.balance(&scene, &sides).unwrap();
    let mesh = Mesh::divided(&scene, &sides, &division, false).unwrap();
    assert!(mesh.len() > coarse);
    for e in (0..mesh.len() as u32).filter(|e| mesh.place(*e).1) {
        let (face, front, cell) = mesh.place(e);
        let (o, a, b) = mesh.grid(face).cell_frame(cell);
        for (p, edge) in [
            (o - 0.01 * a + 0.5 * b, 1),
            (o + 1.01 * a + 0.5 * b, 1),
            (o - 0.01 * b + 0.5 * a, 0),
            (o + 1.01 * b + 0.5 * a, 0),
        ] {
            if p.min_element() > 0.0 && p.max_element() < 1.0 {
                let [own, beside] =
                    [e, mesh.element(face, front, p.x as f32, p.y as f32)].map(|e| mesh.levels(e)[edge]);
                assert!(own.abs_diff(beside) <= 1, "{o}: {own} beside {beside}");
            }
        }
    }
}

/// Light that changes linearly is brought to the nodes as it is, however the cells about them are divided, where all of these, and of
/// those that hang between them, are inside a face.
#[test]
fn linear_light_comes_back_exactly_inside_a_face() {
    let scene = scene_of(SQUARE);
    let sides = Sides::all(&scene);
    let mut division = Division::new(&scene, &sides, 1.0 / 128.0).unwrap();
    division.split(|_, _| [true; 2]);
    for round in 0..4 {
        let chosen = |cell: u32, edge: u64| noise(edge << 60 | round << 40 | u64::from(cell)) < 0.4;
        division.split(|_, cell| [chosen(cell, 0), chosen(cell, 1)]);
        division.balance(&scene, &sides).unwrap();
    }
    let mesh = Mesh::divided(&scene, &sides, &division, false).unwrap();
    let nodes = Nodes::new(&scene, &mesh);
    let light = |uv: DVec2| 2.0 + uv.x - 0.7 * uv.y;
    let values: Vec<Rgb> =
        (0..mesh.len() as u32).map(|e| Rgb::splat(light(mesh.grid(0).centroid(mesh.place(e).2)))).collect();
    let field = Field::smooth(&mesh, &nodes, &vec![1.0; mesh.len()], &values);
    let mut largest = 0.0f64;
    for k in 0..5000 {
        let uv = DVec2::splat(0.3) + 0.4 * DVec2::new(noise(2 * k), noise(2 * k + 1));
        let shown = field.at(&mesh, &nodes, (0, true), uv.x as f32, uv.y as f32).unwrap().x;
        largest = largest.max((shown - light(uv)).abs());
    }
    println!("{} elements, {largest:.1e} off", mesh.len());
    assert!(largest < 1e-6, "{largest}");
}

/// Cells that are joined again are those that were there, along one edge and both, and what remains divided is still told by its levels.
#[test]
fn joining_undoes_dividing() {
    for obj in ALL {
        let scene = scene_of(obj);
        let sides = Sides::all(&scene);
        let first = Division::new(&scene, &sides, 0.02).unwrap();
        let mut divided = first.clone();
        divided.split(|_, cell| [[true, false], [false, true], [true, true]][cell as usize % 3]);
        assert_ne!(divided, first);
        let deeper = |d: &Division, s: &Siblings| {
            let mesh = Mesh::divided(&scene, &sides, d, false).unwrap();
            (0..2).any(|edge| s.along[edge] && mesh.grid(s.face).levels(s.cells[0])[edge] > 2)
        };
        while let Some(one) = divided.siblings().into_iter().find(|s| deeper(&divided, s)) {
            divided.change(|_, _| [false; 2], &[one]);
        }
        assert_eq!(divided, first, "{obj}");
        // No cell is joined to one of level 0.
        let siblings = first.siblings();
        let mut joined = first.clone();
        joined
            .change(|_, _| [false; 2], &siblings.iter().filter(|s| s.along[0]).cloned().collect::<Vec<_>>());
        assert!(siblings.is_empty() || joined != first);
        assert!(joined.siblings().iter().all(|s| !s.along[0]), "{obj}");
    }
}

#[test]
fn constants_come_back_exactly_everywhere() {
    for obj in ALL {
        let s = Setup::new(obj, 0.04, 4, false);
        let field = s.field(|_| 0.7);
        for k in 0..500 {
            let uv = DVec2::new(noise(2 * k), noise(2 * k + 1));
            let uv = if uv.x + uv.y > 1.0 { DVec2::ONE - uv } else { uv };
            for face in 0..s.scene.faces.len() as u32 {
                assert!((s.at(&field, (face, true), uv) - 0.7).abs() < 1e-6);
            }
        }
    }
}

/// Levels alone tell the mesh; levels that fit none are refused.
#[test]
fn levels_tell_the_division() {
    for obj in ALL {
        let s = Setup::new(obj, 0.04, 4, true);
        let sides = s.mesh.sides();
        let levels: Vec<Levels> = (0..s.mesh.len() as u32).map(|e| s.mesh.levels(e)).collect();
        let again = Division::of_levels(&s.scene, &sides, 0.04, &levels);
        assert_eq!(again.as_ref(), Some(&s.division));
        let refused = |levels: &[Levels]| {
            Division::of_levels(&s.scene, &sides, 0.04, levels)
                .is_none_or(|d| Mesh::divided(&s.scene, &sides, &d, false).is_err())
        };
        assert!(refused(&levels[1..]) && refused(&[]) && refused(&[levels.clone(), vec![[1; 2]]].concat()));
        assert!(refused(&vec![[255; 2]; levels.len()]) && refused(&vec![[12; 2]; levels.len()]));
        let mut finer = levels.clone();
        finer[0][1] += 1;
        assert!(refused(&finer), "{obj}");
    }
}

/// A room with a lamp and a block on its floor.
fn room() -> Scene {
    let mut files = Files::default();
    files.diffuse("white", &[0.7], &[0.0]).diffuse("lamp", &[0.0], &[40.0]);
    for (name, points) in box_faces([0.0; 3], [2.0, 1.5, 1.0], true) {
        files.polygon(name, "white", &points);
    }
    for (name, points) in box_faces([0.6, 0.5, 0.0], [0.4, 0.4, 0.5], false) {
        files.polygon(&format!("block {name}"), "white", &points);
    }
    files.polygon("lamp", "lamp", &[[0.2, 0.3, 0.99], [0.2, 0.6, 0.99], [0.5, 0.6, 0.99], [0.5, 0.3, 0.99]]);
    files.load()
}

fn solve(scene: &Scene, size: f64, rays: u32, reads: Reads) -> (Pass1Result, Adapted) {
    let device = device();
    let visibility = Visibility::new(&device, scene).unwrap();
    let emitters = Emitters::new(&visibility);
    let settings = Pass1 { rays, element_size: Some(size), seed: 0 };
    let what = (&settings, reads);
    adaptive::solve(None, &visibility, &emitters, &scene.cameras, what, &|_| {}, &mut Vec::new()).unwrap()
}

/// The uniform mesh that an adaptive one is compared with is counted as it would be made.
#[test]
fn uniform_elements_are_counted_without_making_them() {
    let scene = room();
    for (sides, size) in [(Sides::all(&scene), 0.07), (Sides::fronts(&scene), 0.013)] {
        let mesh = Mesh::new(&scene, &sides, size, false).unwrap();
        assert_eq!(Mesh::uniform_len(&scene, &sides, size), mesh.len() as u64);
    }
}

/// Elements gather about the block's foot and its shadow's edge, and power is in balance on the graded mesh.
#[test]
fn elements_gather_where_the_light_changes() {
    let scene = room();
    let (result, adapted) = solve(&scene, 0.02, 1024, Reads::Reflected);
    let s = &result.solution;
    println!("{adapted:?}, residual {}", s.ledger.residual);
    assert_eq!(adapted.elements.last(), Some(&s.mesh.len()));
    assert!(s.mesh.len() as u64 * 4 < adapted.uniform_elements, "{adapted:?}");
    assert!(s.ledger.residual.abs().max_element() < 0.01, "{}", s.ledger.residual);
    // Mean area of the floor's elements within 3 cm of the block, and of those in the far corner.
    let mean = |near: &dyn Fn(DVec3) -> bool| {
        let floor = |e: &u32| {
            s.mesh.normal(&scene, *e).z > 0.9
                && (s.mesh.centroid(&scene, *e) + scene.center).z < 1e-6
                && near(s.mesh.centroid(&scene, *e) + scene.center)
        };
        let areas: Vec<f64> = (0..s.mesh.len() as u32).filter(floor).map(|e| s.mesh.area(e)).collect();
        areas.iter().sum::<f64>() / areas.len() as f64
    };
    let distance = |p: DVec3| {
        let d = (DVec3::new(0.8, 0.7, 0.0) - p).abs() - DVec3::splat(0.2);
        d.x.max(d.y)
    };
    let (foot, open) = (mean(&|p| (0.0..0.03).contains(&distance(p))), mean(&|p| p.x > 1.6 && p.y > 1.1));
    println!("area at the foot {foot:.1e}, in the open {open:.1e}");
    assert!(open > 8.0 * foot, "{open} {foot}");
}

/// A floor under a lamp that stands on its edge, as good as without end: light changes along one edge of the floor alone, and its cells
/// are divided along that one alone. What they show is the closed form for a strip at a right angle, `(1 - y / (y^2 + h^2)^(1/2)) / 2`.
#[test]
fn cells_are_divided_along_the_edge_that_light_changes_along() {
    const HEIGHT: f64 = 0.2;
    let mut files = Files::default();
    files.diffuse("grey", &[0.5], &[0.0]).diffuse("lamp", &[0.0], &[1.0]);
    files.polygon("floor", "grey", &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]);
    let (far, near) = ([-20.0, 0.0, 0.0], [21.0, 0.0, 0.0]);
    let scene =
        files.polygon("lamp", "lamp", &[far, [far[0], 0.0, HEIGHT], [near[0], 0.0, HEIGHT], near]).load();
    let (result, adapted) = solve(&scene, 0.01, 16_384, Reads::Reflected);
    let s = &result.solution;
    let floor = scene.objects.iter().position(|o| o == "floor").unwrap();
    let face = scene.faces.iter().position(|f| f.object as usize == floor).unwrap() as u32;
    let elements: Vec<u32> = (0..s.mesh.len() as u32).filter(|e| s.mesh.place(*e).0 == face).collect();
    let levels = |edge: usize| elements.iter().map(move |e| s.mesh.levels(*e)[edge]);
    let mean = levels(0).map(f64::from).sum::<f64>() / elements.len() as f64;
    let most = [0, 1].map(|edge| levels(edge).max().unwrap());
    println!(
        "{adapted:?}: {} on the floor, levels up to {most:?}, {mean:.2} on average along x",
        elements.len()
    );
    // Level 2 is that of the first mesh; noise may divide some further.
    assert!(mean < 2.3 && most[0] <= 3 && most[1] >= 5, "{mean} {most:?}");
    assert!(elements.len() < 200, "of 100 x 100 of the finest");
    let exact = |y: f64| 0.5 * 0.5 * (1.0 - y / y.hypot(HEIGHT));
    let (mut square, mut sum) = (0.0, 0.0);
    for k in 0..4000 {
        let uv = DVec2::new(noise(2 * k), noise(2 * k + 1));
        let shown = s.reflected.at(&s.mesh, &s.nodes, (face, true), uv.x as f32, uv.y as f32).unwrap().x;
        square += (shown - exact(uv.y)).powi(2) / 4000.0;
        sum += exact(uv.y) / 4000.0;
    }
    println!("{:.2} % off", 100.0 * square.sqrt() / sum);
    assert!(square.sqrt() < 0.01 * sum);
}

/// An adaptive solution comes back from its file to the bit.
#[test]
fn files_keep_adaptive_solutions() {
    let scene = room();
    let (result, _) = solve(&scene, 0.05, 256, Reads::Indirect);
    assert!(result.solution.mesh.is_adaptive());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.npz");
    let bytes = result.solution.to_npz(&scene, serde_json::Map::new()).unwrap();
    std::fs::write(&path, &bytes).unwrap();
    let kept = Solution::read_npz(&scene, &path).unwrap();
    assert!(kept.solution.to_npz(&scene, serde_json::Map::new()).unwrap() == bytes);
    for k in 0..2000 {
        let (face, uv) =
            (k % scene.faces.len() as u32, DVec2::new(noise(2 * u64::from(k)), noise(2 * u64::from(k) + 1)));
        for front in [true, false] {
            let [a, b] = [&result.solution, &kept.solution]
                .map(|s| s.indirect.at(&s.mesh, &s.nodes, (face, front), uv.x as f32, uv.y as f32));
            assert_eq!(a, b);
        }
    }
}

/// The same mesh and light on one thread and on several.
#[test]
fn threads_change_nothing() {
    let scene = room();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| solve(&scene, 0.05, 256, Reads::Reflected).0.solution)
    };
    let (one, three) = (run(1), run(3));
    assert_eq!(one.mesh.len(), three.mesh.len());
    assert!(one.radiosity == three.radiosity && one.standard_error == three.standard_error);
}

/// Light shown at points spread over all faces of a solution, front sides, in turn.
fn shown(scene: &Scene, s: &Solution) -> Vec<(f64, Rgb)> {
    const POINTS: u64 = 400;
    let mut found = Vec::new();
    for (k, face) in scene.faces.iter().enumerate() {
        for p in 0..POINTS {
            let [u, v] = [0, 1].map(|c| noise(((k as u64) << 32) + 2 * p + c));
            let value = s.reflected.at(&s.mesh, &s.nodes, (k as u32, true), u as f32, v as f32);
            found.push((face.area / POINTS as f64, value.unwrap_or_default()));
        }
    }
    found
}

/// Mean square of the error of two independent solutions against two independent references: free of the noise of either.
fn square_error(found: &[Vec<(f64, Rgb)>; 2], reference: &[Vec<(f64, Rgb)>; 2]) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for k in 0..found[0].len() {
        let off = |i: usize, j: usize| found[i][k].1 - reference[j][k].1;
        sum += found[0][k].0 * 0.5 * (off(0, 0) * off(1, 1) + off(0, 1) * off(1, 0)).element_sum() / 3.0;
        area += found[0][k].0;
    }
    sum / area
}

/// The adaptive mesh of N elements is no more wrong than the uniform one of 8 N.
#[test]
fn fewer_elements_show_the_same_light() {
    let scene = room();
    let device = device();
    let visibility = Visibility::new(&device, &scene).unwrap();
    let emitters = Emitters::new(&visibility);
    let run = |size: f64, seed: u32, adapt: bool| {
        let settings = Pass1 { rays: 512, element_size: Some(size), seed };
        let stages = &mut Vec::new();
        let result = if adapt {
            let what = (&settings, Reads::Reflected);
            adaptive::solve(None, &visibility, &emitters, &[], what, &|_| {}, stages).unwrap().0
        } else {
            twopass::pipeline::solve(&visibility, &emitters, &[], &settings, &|_| {}, stages).unwrap()
        };
        (result.solution.mesh.len(), shown(&scene, &result.solution))
    };
    let reference = [run(0.02, 11, false).1, run(0.02, 12, false).1];
    let error = |size: f64, adapt: bool| {
        let found = [run(size, 1, adapt), run(size, 2, adapt)];
        let n = found[0].0;
        let e = square_error(&found.map(|f| f.1), &reference).max(0.0).sqrt();
        println!("{n} elements, adaptive {adapt}, edges from {size} m: {e:.4} W m^-2");
        (n, e)
    };
    let adaptive = error(0.02, true);
    let uniform = [0.1, 0.05, 0.033].map(|size| error(size, false));
    // Between meshes, errors fall as a power of the number of elements.
    let many = 8.0 * adaptive.0 as f64;
    let pair = uniform.windows(2).find(|w| w[0].0 as f64 <= many && many <= w[1].0 as f64);
    let [coarse, fine] = pair.unwrap_or_else(|| panic!("{adaptive:?} {uniform:?}")) else { unreachable!() };
    let share = (many / coarse.0 as f64).ln() / (fine.0 as f64 / coarse.0 as f64).ln();
    let eightfold = coarse.1 * (fine.1 / coarse.1).powf(share);
    assert!(adaptive.1 < eightfold, "{adaptive:?} {uniform:?}");
}

/// A room whose walls all emit and reflect alike. With albedo r and all light B A, importance is r / (1 - r) / (B A) everywhere, and an
/// error of the light shown counts by area: A_i / (A B^2). Where there are pictures, these count 1, for what they see, and all light a
/// tenth.
#[test]
fn importance_has_its_closed_form_in_a_furnace() {
    let mut files = Files::default();
    files.diffuse("white", &[0.6], &[1.0]);
    for (name, points) in box_faces([0.0; 3], [1.0; 3], true) {
        files.polygon(name, "white", &points);
    }
    let camera = "[camera]\norigin = [0.5, 0.5, 0.9]\ntarget = [0.5, 0.5, 0]\nup = [0, 1, 0]\nfov = 40\nsize = [8, 8]\n";
    let scene = files.toml(camera).load();
    let device = device();
    let visibility = Visibility::new(&device, &scene).unwrap();
    let emitters = Emitters::new(&visibility);
    let settings = Pass1 { rays: 4096, element_size: Some(0.2), seed: 0 };
    let light = 0.6 / 0.4;
    for cameras in [&scene.cameras[..0], &scene.cameras[..]] {
        let what = (&settings, Reads::Reflected);
        let result =
            adaptive::solve(None, &visibility, &emitters, cameras, what, &|_| {}, &mut Vec::new()).unwrap().0;
        let (mesh, importance) = (&result.solution.mesh, result.importance.unwrap());
        let mut shown = 0.0;
        let surfaces = if cameras.is_empty() { 1.0 } else { 0.1 };
        for e in 0..mesh.len() {
            let all = surfaces / (6.0 * light);
            let seen = importance.shown[e] - importance.area[e] * all / light;
            assert!((importance.area[e] - mesh.area(e as u32)).abs() < 1e-12 && seen > -1e-9);
            shown += seen;
            if cameras.is_empty() {
                assert!((importance.sent[e] / (all * 1.5) - 1.0).abs().max_element() < 1e-3);
                assert!(seen < 1e-9);
            } else if mesh.normal(&scene, e as u32).z < 0.9 {
                assert!(seen < 1e-9, "the camera sees one wall alone");
            }
        }
        let pictures = if cameras.is_empty() { 0.0 } else { 1.0 / (light * light) };
        assert!((shown - pictures).abs() < 1e-6, "{shown}");
        // A closed room keeps the share r of all importance at each bounce.
        let uses = if cameras.is_empty() { 1.0 } else { 1.1 };
        let sum: f64 = (0..mesh.len()).map(|e| importance.area[e] * importance.sent[e].x).sum();
        assert!((sum * light / (uses * 1.5) - 1.0).abs() < 0.02, "{sum}");
    }
}

/// A lamp close under the middle of a ceiling: the four quarters of the ceiling see it all alike, and what lies behind it is dark.
/// Mean radiosities of adaptive elements and of uniform ones agree within 1 % (at an albedo of 0.8 they were 3 % apart when the first
/// mesh was one of quarters, at 0.95 1.3 % when errors counted where they are shown alone; standard errors are below 0.1 %). Where
/// nearly all light is kept, elements of this size are too large (the uniform ones: 1.2 % too dark), and both say so.
#[test]
fn what_the_quarters_of_a_face_see_alike_is_seen() {
    for (albedo, too_large) in [(0.8, false), (0.95, false), (0.999, true)] {
        let mut files = Files::default();
        files.diffuse("white", &[albedo], &[0.0]).diffuse("lamp", &[0.0], &[40.0]);
        for (name, points) in box_faces([0.0; 3], [1.0; 3], true) {
            files.polygon(name, "white", &points);
        }
        let lamp = [[0.35, 0.35, 0.98], [0.35, 0.65, 0.98], [0.65, 0.65, 0.98], [0.65, 0.35, 0.98]];
        let scene = files.polygon("lamp", "lamp", &lamp).load();
        let device = device();
        let visibility = Visibility::new(&device, &scene).unwrap();
        let emitters = Emitters::new(&visibility);
        let settings = Pass1 { rays: 1024, element_size: Some(0.045), seed: 1 };
        let stages = &mut Vec::new();
        let what = (&settings, Reads::Indirect);
        let adapted = adaptive::solve(None, &visibility, &emitters, &[], what, &|_| {}, stages).unwrap().0;
        let uniform =
            twopass::pipeline::solve(&visibility, &emitters, &[], &settings, &|_| {}, stages).unwrap();
        for warnings in [&adapted.warnings, &uniform.warnings] {
            let said = warnings.iter().filter(|w| w.contains("too large")).count();
            assert_eq!(said, usize::from(too_large), "{warnings:?}");
        }
        if too_large {
            continue;
        }
        let mean = |s: &Solution| -> f64 {
            let power: f64 =
                (0..s.mesh.len()).map(|e| s.mesh.area(e as u32) * s.reflected_radiosity(e).x).sum();
            power / scene.faces.iter().map(|f| f.area).sum::<f64>()
        };
        let (a, u) = (mean(&adapted.solution), mean(&uniform.solution));
        let counts = (adapted.solution.mesh.len(), uniform.solution.mesh.len());
        println!("albedo {albedo}, {counts:?} elements: {a:.5} and {u:.5} W m^-2");
        assert!((a / u - 1.0).abs() < 0.01 && 4 * counts.0 < counts.1);
    }
}
