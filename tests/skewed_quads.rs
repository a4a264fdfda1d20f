//! Quads that are no parallelograms: their elements differ in area, and rays start and land all over them evenly.
//!
//! Points are Owen-scrambled with fixed seeds. Their errors are below those of independent ones, whose variance bounds them: four
//! standard errors of independent points are left in 6e-5 of comparisons.

mod common;

use common::*;
use glam::DVec3;
use twopass::emitters::Emitters;
use twopass::form_factor::analytic::{EXACT, Polygon, exchange};
use twopass::form_factor::{
    AtSpecular, Casting, ExchangeMatrix, HemicubeSettings, cast, cast_images, hemicube,
};
use twopass::mesh::{Mesh, Sides};
use twopass::sampling::sobol;
use twopass::scene::Scene;
use twopass::visibility::Visibility;

/// So many that points uniform in (u, v), not in area, would be found out.
const RAYS: u32 = 1 << 20;
const LOWER: [Point; 4] = [[0.0, 0.0, 0.0], [1.2, 0.1, 0.0], [0.9, 1.0, 0.0], [-0.1, 0.6, 0.0]];
const UPPER: [Point; 4] = [[0.1, 0.9, 0.5], [0.8, 1.1, 0.6], [1.0, 0.0, 0.6], [0.0, 0.1, 0.5]];

/// The upper quad leans; its fourth corner is where a plane through the others has it.
fn upper() -> Vec<Point> {
    let [a, b, c, d] = UPPER.map(DVec3::from_array);
    let normal = (b - a).cross(c - a).normalize();
    vec![a, b, c, d - (d - a).dot(normal) * normal].into_iter().map(|p| p.to_array()).collect()
}

fn scene(upper_entries: &str, back: Option<[Point; 4]>) -> Scene {
    let mut files = Files::default();
    files.material("m", "diffuse = 0.5").material("u", upper_entries);
    files.polygon("lower", "m", &LOWER).polygon("upper", "u", &upper());
    if let Some(quad) = back {
        files.polygon("back", "m", &quad);
    }
    let scene = files.load();
    assert_eq!(scene.triangle_count, 0);
    scene
}

fn casting(batches: u32, specular: AtSpecular) -> Casting<'static> {
    Casting { rays: RAYS, batches, seed: 3, specular, reached: None, emitters: None, progress: &|_| {} }
}

#[test]
fn elements_cover_their_quad() {
    let scene = scene("diffuse = 0.5", None);
    assert!(scene.faces.iter().all(|f| f.skew.length() > 0.1));
    for size in [10.0, 0.3, 0.07] {
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), size, true).expect("mesh");
        let mut areas = vec![0.0; 2];
        for e in 0..mesh.len() as u32 {
            let cell = Polygon::of_element(&scene, &mesh, e);
            assert!((mesh.area(e) / cell.area() - 1.0).abs() < 1e-12, "{size}: element {e}");
            let longest = cell.edges().map(|(a, b)| a.distance(b)).fold(0.0, f64::max);
            assert!(longest <= size * (1.0 + 1e-9), "{size}: element {e} has an edge of {longest}");
            areas[mesh.place(e).0 as usize] += mesh.area(e);
        }
        for (face, area) in scene.faces.iter().zip(areas) {
            assert!((area / face.area - 1.0).abs() < 1e-12);
        }
    }
}

/// Rays to points that are known by their (u, v) land there, one by one and in packets.
#[test]
fn rays_land_where_they_are_sent() {
    use twopass::embree::{Ray, RayPacket};
    let scene = scene("diffuse = 0.5", None);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    for (k, face) in scene.faces.iter().enumerate() {
        let frame = scene.face_frame(face);
        for i in 0..1024 {
            let [u, v, ..] = sobol(i, 0, 5);
            let target = frame.at((u, v).into());
            let origin = (target + 0.1 * face.normal + 0.02 * frame.e1).as_vec3();
            let direction = (target.as_vec3() - origin).normalize();
            let mut packet = RayPacket::new();
            packet.set(3, &Ray::new(origin, direction));
            visibility.closest16(&mut packet, false);
            let lane = visibility.lane(&packet, 3, origin, direction, u32::MAX).expect("a hit");
            let one = visibility.closest(origin, direction, u32::MAX).expect("a hit");
            for hit in [one, lane] {
                let off = (f64::from(hit.u) - u).abs().max((f64::from(hit.v) - v).abs());
                assert!(hit.face == k as u32 && off < 2e-6, "{u} {v}: {hit:?}");
            }
        }
    }
}

/// A row with all its zeros.
fn dense(matrix: &ExchangeMatrix, row: usize) -> Vec<f64> {
    let mut dense = vec![0.0; matrix.len()];
    matrix.row(row).for_each(|(j, f)| dense[j] += f.x);
    dense
}

/// Largest error of a row's entries over what independent rays would have.
fn worst(scene: &Scene, mesh: &Mesh, matrix: &ExchangeMatrix, rays: u32) -> f64 {
    let cell = |e: usize| Polygon::of_element(scene, mesh, e as u32);
    let mut worst = 0.0f64;
    for i in 0..mesh.len() {
        let found = dense(matrix, i);
        for (j, found) in
            found.iter().enumerate().filter(|(j, _)| mesh.place(*j as u32).0 != mesh.place(i as u32).0)
        {
            let exact = exchange(&cell(i), &cell(j), EXACT) / mesh.area(i as u32);
            worst = worst.max((found - exact).abs() / (exact * (1.0 - exact) / f64::from(rays)).sqrt());
        }
    }
    worst
}

#[test]
fn form_factors_are_those_of_their_polygons() {
    let scene = scene("diffuse = 0.5", None);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    for size in [10.0, 0.4] {
        let mesh = Mesh::new(&scene, &Sides::fronts(&scene), size, true).expect("mesh");
        let (matrix, _) = cast(&visibility, &mesh, &casting(16, AtSpecular::End));
        let ratio = worst(&scene, &mesh, &matrix, RAYS);
        assert!(ratio < 4.0, "{} elements by rays: {ratio} standard errors", mesh.len());
        let images = cast_images(&visibility, &mesh, (RAYS, 16), 3, &|_| {}).expect("images");
        let ratio = worst(&scene, &mesh, &images, RAYS);
        assert!(ratio < 4.0, "{} elements by images: {ratio} standard errors", mesh.len());
        // Of 16 x 16 views each, from points that a rotation moves.
        let settings = HemicubeSettings { resolution: 256, grid: 16, rotations: 1, seed: 1 };
        let views = hemicube(&scene, &mesh, &settings, None, &|_| {});
        let ratio = worst(&scene, &mesh, &views, 16 * 16 * 16);
        assert!(ratio < 4.0, "{} elements by hemi-cubes: {ratio}", mesh.len());
    }
}

/// Points of an emitter lie about its centroid.
#[test]
fn emitters_shine_evenly() {
    let scene = scene("emission = 1", None);
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let emitters = Emitters::new(&visibility);
    let side = emitters.sides().position(|(_, front, _)| front).expect("the front shines");
    let n = 4096;
    let mean =
        (0..n).map(|k| sobol(k, 0, 9)).map(|p| emitters.on_side(side, [p[0], p[1]]).point).sum::<DVec3>()
            / f64::from(n);
    let c: Vec<DVec3> = upper().into_iter().map(|p| DVec3::from_array(p) - scene.center).collect();
    let part = |a: DVec3, b: DVec3, c: DVec3| ((b - a).cross(c - a).length(), (a + b + c) / 3.0);
    let (first, second) = (part(c[0], c[1], c[2]), part(c[0], c[2], c[3]));
    let centroid = (first.0 * first.1 + second.0 * second.1) / (first.0 + second.0);
    assert!(mean.distance(centroid) < 1e-4, "{mean} {centroid}");
}

/// A lamp that is seen whole between a wall through its slanted edge and the floor gives exactly its light: no sample of it lies
/// where a parallelogram of its first corner would go on, behind the wall.
#[test]
fn lamps_shine_from_their_quad_alone() {
    let mut files = Files::default();
    files.material("floor", "diffuse = 0.5").material("wall", "diffuse = 0");
    files.material("lamp", "diffuse = 0\nemission = 1");
    files.polygon("floor", "floor", &[[0.0, 0.0, 0.0], [0.4, 0.0, 0.0], [0.4, 0.8, 0.0], [0.0, 0.8, 0.0]]);
    files.polygon("lamp", "lamp", &[[0.0, 0.0, 2.0], [0.0, 0.8, 2.0], [0.5, 0.8, 2.0], [1.2, 0.0, 2.0]]);
    files.polygon("wall", "wall", &[[0.5, 0.8, -0.1], [1.2, 0.0, -0.1], [1.2, 0.0, 2.1], [0.5, 0.8, 2.1]]);
    let scene = files.load();
    let lamp = Polygon::of_face(&scene, &scene.faces[1]);
    assert!(scene.faces[1].skew.length() > 0.1 && scene.faces[1].normal.z < 0.0);
    let s = solve(&scene, 256, 0.2, 1).expect("solution").solution;
    let mut found = 0;
    for (e, radiosity) in s.radiosity.iter().enumerate() {
        if !matches!(s.mesh.place(e as u32), (0, true, _)) {
            continue;
        }
        let cell = Polygon::of_element(&scene, &s.mesh, e as u32);
        let irradiance = std::f64::consts::PI * exchange(&cell, &lamp, EXACT) / s.mesh.area(e as u32);
        let off = radiosity.x / (0.5 * irradiance) - 1.0;
        assert!(off.abs() < 1e-6, "element {e}: off by {:.2e}", off);
        found += 1;
    }
    assert_eq!(found, 8);
}

/// What a mirror shows of a quad, by its images and by chains of rays.
#[test]
fn mirrors_end_at_their_edges() {
    let back = [[-0.2, 1.2, -0.1], [1.4, 1.2, -0.2], [1.1, 1.2, 0.8], [0.0, 1.2, 0.5]];
    let scene = scene("diffuse = 0\nroughness = 0\nspecular = 0.8", Some(back));
    let device = device();
    let visibility = Visibility::new(&device, &scene).expect("tree");
    let mesh =
        Mesh::new(&scene, &Sides::all(&scene).without_purely_specular(&scene), 10.0, true).expect("mesh");
    let images = cast_images(&visibility, &mesh, (RAYS, 16), 3, &|_| {}).expect("images");
    let chains = cast(&visibility, &mesh, &casting(16, AtSpecular::GoOn)).0;
    for i in 0..mesh.len() {
        for (j, (f, g)) in dense(&images, i).into_iter().zip(dense(&chains, i)).enumerate() {
            assert!((f - g).abs() <= 4.0 * (2.0 * f / f64::from(RAYS)).sqrt(), "{i} {j}: {f} {g}");
        }
    }
}
