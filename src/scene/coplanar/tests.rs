use super::*;
use crate::color::Rgb;

fn square(points: &mut Vec<DVec3>, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], z: f64, polygon: u32) -> Face {
    let first = points.len() as u32;
    points.extend([(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| DVec3::new(x, y, z)));
    Face {
        vertices: [0, 1, 2, 3].map(|k| first + k),
        normals: None,
        object: polygon,
        material: polygon,
        polygon,
        normal: DVec3::Z,
        area: (x1 - x0) * (y1 - y0),
        skew: DVec2::ZERO,
    }
}

fn total(faces: &[Face], points: &[DVec3], object: u32) -> f64 {
    faces.iter().filter(|f| f.object == object).map(|f| polygon::area_vector(&corners(f, points)).z).sum()
}

/// `kinds`: `d`iffuse, `e`mitting, `g`lass, `t`ranslucent.
fn materials(kinds: &str) -> Vec<Material> {
    let make = |kind: char| match kind {
        'e' => Material { emission: Rgb::ONE, ..Material::grey("e") },
        't' => Material { diffuse_transmission: Rgb::splat(0.4), ..Material::grey("t") },
        'g' => Material { specular_transmission: Rgb::ONE, ..Material::new("g") },
        _ => Material::grey("d"),
    };
    kinds.chars().map(make).collect()
}

#[test]
fn the_smaller_keeps_its_part_but_emitters_come_first_and_glass_last() {
    for (kinds, areas) in [("dd", [0.84, 0.16]), ("ed", [1.0, 0.0]), ("dg", [1.0, 0.0]), ("gg", [0.84, 0.16])]
    {
        let mut points = Vec::new();
        let mut faces = vec![
            square(&mut points, [0.0, 1.0], [0.0, 1.0], 0.5, 0),
            square(&mut points, [0.3, 0.7], [0.2, 0.6], 0.5, 1),
        ];
        let cut = cut(&mut faces, &mut points, &mut materials(kinds));
        assert_eq!(cut.objects.len(), 1);
        for (k, a) in areas.iter().enumerate() {
            assert!((total(&faces, &points, k as u32) - a).abs() < 1e-12, "{kinds} {k}");
        }
    }
}

/// Two sheets, one partly on the other, on a floor with a small tile in it: what both hide goes by the sheets' names, in as many
/// materials as there are contacts.
#[test]
fn translucent_faces_are_one_with_what_they_lie_on() {
    let mut points = Vec::new();
    let mut faces = vec![
        square(&mut points, [0.0, 1.0], [0.0, 1.0], 0.0, 0),
        square(&mut points, [0.2, 0.6], [0.2, 0.6], 0.0, 1),
        square(&mut points, [0.5, 1.2], [0.5, 1.0], 0.0, 2),
        square(&mut points, [0.2, 0.3], [0.2, 0.4], 0.0, 3),
    ];
    let mut materials = materials("dttd");
    let cut = cut(&mut faces, &mut points, &mut materials);
    // The larger sheet is cut by the smaller one, the floor by the tile.
    assert_eq!((cut.objects, cut.joined), (vec![0, 2], vec![1, 2]));
    let objects = [0, 1, 2, 3].map(|k| total(&faces, &points, k));
    let sheets = objects[1] + objects[2];
    assert!((objects[0] - 0.6).abs() < 1e-12 && (sheets - 0.5).abs() < 1e-12 && objects[3] == 0.0);
    let area = |albedo: f64| -> f64 {
        let same = |f: &&Face| (materials[f.material as usize].diffuse.x - albedo).abs() < 1e-12;
        faces.iter().filter(same).map(|f| polygon::area_vector(&corners(f, &points)).z).sum()
    };
    let once = 0.5 + 0.16 * 0.5 / (1.0 - 0.5 * 0.5);
    let twice = 0.5 + 0.16 * once / (1.0 - 0.5 * once);
    // Both sheets on the floor: 0.01; one of them: 0.16 - 0.01 on the floor and the tile, and 0.25 - 0.01.
    assert!((area(twice) - 0.01).abs() < 1e-12);
    assert!((area(once) - (0.15 + 0.24)).abs() < 1e-12);
}

/// Under glass that stands partly on a floor the floor is a face of its own: of the same object, and alike but in name.
#[test]
fn what_glass_stands_on_is_divided_along_its_outline() {
    let mut points = Vec::new();
    let mut faces = vec![
        square(&mut points, [0.0, 1.0], [0.0, 1.0], 0.0, 0),
        square(&mut points, [0.6, 1.2], [0.2, 0.7], 0.0, 1),
    ];
    let mut materials = materials("dg");
    let cut = cut(&mut faces, &mut points, &mut materials);
    assert_eq!((cut.objects, cut.joined.len()), (vec![1], 0));
    let area = |object: u32, material: u32| -> f64 {
        let same = |f: &&Face| (f.object, f.material) == (object, material);
        faces.iter().filter(same).map(|f| polygon::area_vector(&corners(f, &points)).z).sum()
    };
    assert_eq!(materials[2].name, "d under g");
    assert_eq!(Material { name: "d".into(), ..materials[2].clone() }, materials[0]);
    for (object, material, expected) in [(0, 0, 0.8), (0, 2, 0.2), (1, 1, 0.1)] {
        let found = area(object, material);
        assert!((found - expected).abs() < 1e-12, "object {object}, material {material}: {found}");
    }
}

/// A gap that rays from a small plate resolve but not those from a large floor below.
#[test]
fn gaps_that_are_too_narrow_are_named() {
    for (gap, narrow) in [(1e-6, vec![1]), (1e-5, vec![])] {
        let mut points = Vec::new();
        let mut faces = vec![
            square(&mut points, [0.0, 10.0], [0.0, 1.0], 0.0, 0),
            square(&mut points, [4.0, 4.2], [0.5, 0.7], gap, 1),
            square(&mut points, [9.0, 10.0], [0.0, 1.0], 1.0, 2),
        ];
        let cut = cut(&mut faces, &mut points, &mut materials("ddd"));
        assert_eq!((cut.objects, cut.narrow), (vec![], narrow), "gap {gap}");
    }
}

#[test]
fn partial_overlaps_are_cut_and_neighbours_are_not() {
    let mut points = Vec::new();
    let mut faces = vec![
        square(&mut points, [0.0, 1.0], [0.0, 1.0], 0.0, 0),
        square(&mut points, [0.75, 1.5], [0.5, 1.25], 0.0, 1),
        square(&mut points, [-1.0, 0.0], [0.0, 1.0], 0.0, 2),
        square(&mut points, [0.0, 1.0], [0.0, 1.0], 1e-3, 3),
    ];
    let cut = cut(&mut faces, &mut points, &mut materials("dddd"));
    assert_eq!(cut.objects, [0]);
    for (k, a) in [1.0 - 0.125, 0.5625, 1.0, 1.0].iter().enumerate() {
        assert!((total(&faces, &points, k as u32) - a).abs() < 1e-12, "{k}");
    }
}

/// A town on its ground: so many cut it that it is halved first.
#[test]
fn what_very_many_cover_is_what_they_leave() {
    let mut points = Vec::new();
    let mut faces = vec![square(&mut points, [0.0, 30.0], [0.0, 20.0], 0.0, 0)];
    for k in 0..600u32 {
        let (x, y) = (f64::from(k % 30), f64::from(k / 30));
        let w = 0.2 + 0.7 * f64::from(k * 37 % 101) / 101.0;
        faces.push(square(&mut points, [x, x + w], [y + 0.05, y + 0.95 * w + 0.05], 0.0, k + 1));
    }
    let covered: f64 = faces[1..].iter().map(|f| f.area).sum();
    let mut materials = materials(&"d".repeat(601));
    let cut = cut(&mut faces, &mut points, &mut materials);
    assert_eq!(cut.objects, [0]);
    assert!((total(&faces, &points, 0) - (600.0 - covered)).abs() < 1e-9, "{}", total(&faces, &points, 0));
    assert!((1..=600).all(|k| faces.iter().filter(|f| f.object == k).count() == 1));
    let parts = faces.len() - 600;
    assert!(parts < 2400, "{parts} parts");
}
