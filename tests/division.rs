//! Cells of several sizes: each is found where it is, they are one surface without cracks, and their levels tell them.

mod common;

use common::noise;
use glam::{DVec2, DVec3};
use twopass::color::Rgb;
use twopass::mesh::{Division, Levels, Mesh, Nodes, Siblings, Sides};
use twopass::radiosity::Field;
use twopass::scene::{Scene, load};

fn scene_of(obj: &str) -> Scene {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.obj");
    std::fs::write(&path, obj).unwrap();
    load(&path).unwrap()
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
