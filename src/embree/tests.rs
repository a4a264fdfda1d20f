use super::*;
use glam::Vec3;

/// Vertices, triangles and quads.
type Faces = (Vec<[f32; 3]>, Vec<[u32; 3]>, Vec<[u32; 4]>);

/// A triangle at z = 0 and a skew parallelogram at z = 1, both over [0, 1] x [0, 1] and more.
fn two_faces() -> Faces {
    let vertices = vec![
        [0.0, 0.0, 0.0],
        [2.0, 0.0, 0.0],
        [0.0, 4.0, 0.0],
        [3.0, 0.0, 1.0],
        [5.0, 1.0, 1.0],
        [6.0, 4.0, 1.0],
        [4.0, 3.0, 1.0],
    ];
    (vertices, vec![[0, 1, 2]], vec![[3, 4, 5, 6]])
}

/// splitmix64, so that a failing ray is the same ray everywhere.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let d = 2.0 * Vec3::new(self.next(), self.next(), self.next()) - Vec3::ONE;
            if (0.01..1.0).contains(&d.length_squared()) {
                return d.normalize();
            }
        }
    }
}

/// A closed box of quads around the origin with floating triangles in it.
fn room(triangles: usize, numbers: &mut Numbers) -> Faces {
    let corner = |i: u32| [0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 4.0 } else { -4.0 });
    let mut vertices: Vec<[f32; 3]> = (0..8).map(corner).collect();
    let quads = vec![[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
    let mut faces = Vec::new();
    for _ in 0..triangles {
        let first = vertices.len() as u32;
        let p = 3.0 * numbers.direction();
        for _ in 0..3 {
            vertices.push((p + numbers.direction()).to_array());
        }
        faces.push([first, first + 1, first + 2]);
    }
    (vertices, faces, quads)
}

fn down(x: f32, y: f32) -> Ray {
    Ray::new(Vec3::new(x, y, 5.0), -Vec3::Z)
}

#[test]
fn the_version_that_runs() {
    let version = Device::new(1).unwrap().version();
    println!("Embree {version}");
    assert!(version.starts_with('3') || version.starts_with('4'));
    assert_eq!(version.split('.').count(), 3);
}

#[test]
fn barycentric_and_bilinear_coordinates() {
    let (vertices, triangles, quads) = two_faces();
    let scene = CommittedScene::new(&Device::new(1).unwrap(), &vertices, &triangles, &quads).unwrap();

    let hit = scene.intersect(&down(0.5, 1.0)).unwrap();
    assert_eq!(hit.face, 0);
    assert!((hit.u - 0.25).abs() < 1e-6 && (hit.v - 0.25).abs() < 1e-6 && (hit.t - 5.0).abs() < 1e-5);

    // Both halves into which Embree may split the quad.
    for (u, v) in [(0.2, 0.7), (0.7, 0.2), (0.9, 0.8), (0.1, 0.1)] {
        let p = Vec3::new(3.0, 0.0, 1.0) + u * Vec3::new(2.0, 1.0, 0.0) + v * Vec3::new(1.0, 3.0, 0.0);
        let hit = scene.intersect(&down(p.x, p.y)).unwrap();
        assert_eq!(hit.face, 1);
        assert!((hit.u - u).abs() < 1e-5 && (hit.v - v).abs() < 1e-5, "{hit:?} at {u}, {v}");
        assert!((hit.t - 4.0).abs() < 1e-5);
    }
    assert_eq!(scene.intersect(&down(10.0, 10.0)), None);
}

#[test]
fn packets_agree_with_single_rays() {
    let mut numbers = Numbers(1);
    let (vertices, triangles, quads) = room(200, &mut numbers);
    let scene = CommittedScene::new(&Device::new(2).unwrap(), &vertices, &triangles, &quads).unwrap();
    let (mut packet, mut shadow) = (RayPacket::new(), ShadowPacket::new());
    let (mut on_triangles, mut on_quads, mut blocked_rays) = (0, 0, 0);
    for round in 0..500 {
        let coherent = round % 2 == 0;
        packet.clear();
        shadow.clear();
        let mut rays = [None; LANES];
        for (lane, slot) in rays.iter_mut().enumerate() {
            // Every fourth lane stays inactive, a different one each round.
            if (lane + round) % 4 == 0 {
                continue;
            }
            let origin = 3.9 * numbers.next() * numbers.direction();
            let ray = Ray::segment(origin, numbers.direction(), 6.0 * numbers.next());
            packet.set(lane, &ray);
            shadow.set(lane, &ray);
            *slot = Some(ray);
        }
        scene.intersect16(&mut packet, coherent);
        let blocked = scene.occluded16(&mut shadow, coherent);
        for (lane, ray) in rays.iter().enumerate() {
            let single = ray.and_then(|ray| scene.intersect(&ray));
            assert_eq!(packet.hit(lane).map(|h| h.face), single.map(|h| h.face));
            if let (Some(a), Some(b)) = (packet.hit(lane), single) {
                assert!((a.t - b.t).abs() < 1e-4 && (a.u - b.u).abs() < 1e-3 && (a.v - b.v).abs() < 1e-3);
                if b.face < 200 { on_triangles += 1 } else { on_quads += 1 }
            }
            assert_eq!(blocked >> lane & 1 == 1, single.is_some());
            assert_eq!(ray.is_some_and(|ray| scene.occluded(&ray)), single.is_some());
            blocked_rays += u32::from(single.is_some());
        }
    }
    assert!(on_triangles > 500 && on_quads > 500 && blocked_rays < 6000);
}

#[test]
fn inactive_lanes_hit_nothing_and_keep_nothing() {
    let (vertices, triangles, quads) = two_faces();
    let scene = CommittedScene::new(&Device::new(1).unwrap(), &vertices, &triangles, &quads).unwrap();
    let (mut packet, mut shadow) = (RayPacket::new(), ShadowPacket::new());
    scene.intersect16(&mut packet, false);
    assert!((0..LANES).all(|lane| packet.hit(lane).is_none()));
    assert_eq!(scene.occluded16(&mut shadow, false), 0);

    for lane in 0..LANES {
        packet.set(lane, &down(0.5, 1.0));
        shadow.set(lane, &down(0.5, 1.0));
    }
    scene.intersect16(&mut packet, true);
    assert!((0..LANES).all(|lane| packet.hit(lane).is_some_and(|h| h.face == 0)));
    assert_eq!(scene.occluded16(&mut shadow, true), u16::MAX);

    packet.clear();
    shadow.clear();
    packet.set(3, &down(10.0, 10.0));
    shadow.set(5, &down(0.5, 1.0));
    scene.intersect16(&mut packet, false);
    assert!((0..LANES).all(|lane| packet.hit(lane).is_none()));
    assert_eq!(scene.occluded16(&mut shadow, false), 1 << 5);
}

#[test]
fn occlusion_ends_at_tfar() {
    let (vertices, triangles, quads) = two_faces();
    let scene = CommittedScene::new(&Device::new(1).unwrap(), &vertices, &triangles, &quads).unwrap();
    let ray = down(0.5, 1.0);
    for (tfar, expected) in [(4.99, false), (5.01, true), (0.0, false), (f32::INFINITY, true)] {
        assert_eq!(scene.occluded(&Ray { tfar, ..ray }), expected, "tfar {tfar}");
    }
    assert!(!scene.occluded(&Ray { tnear: 5.01, ..ray }));
}

#[test]
fn either_kind_of_face_may_be_absent() {
    let device = Device::new(1).unwrap();
    let (vertices, triangles, quads) = two_faces();
    let on_quad = down(4.5, 2.0);

    let quads_only = CommittedScene::new(&device, &vertices, &[], &quads).unwrap();
    assert_eq!(quads_only.intersect(&on_quad).unwrap().face, 0);
    assert!(!quads_only.occluded(&down(0.5, 1.0)));

    let triangles_only = CommittedScene::new(&device, &vertices, &triangles, &[]).unwrap();
    assert_eq!(triangles_only.intersect(&down(0.5, 1.0)).unwrap().face, 0);
    assert!(!triangles_only.occluded(&on_quad));

    let empty = CommittedScene::new(&device, &[], &[], &[]).unwrap();
    let mut packet = RayPacket::new();
    packet.set(0, &on_quad);
    empty.intersect16(&mut packet, false);
    assert_eq!(packet.hit(0), None);
    assert!(!empty.occluded(&on_quad) && empty.intersect(&on_quad).is_none());
}

#[test]
fn bad_geometry_is_refused_by_name() {
    let device = Device::new(1).unwrap();
    let (mut vertices, triangles, quads) = two_faces();
    let refuse = |vertices: &[[f32; 3]], triangles: &[[u32; 3]], quads: &[[u32; 4]]| {
        CommittedScene::new(&device, vertices, triangles, quads).unwrap_err().to_string()
    };
    assert_eq!(refuse(&vertices, &[[0, 1, 7]], &quads), "Embree: triangle 0 names vertex 7 of 7");
    assert_eq!(refuse(&vertices[..4], &triangles, &quads), "Embree: quad 0 names vertex 4 of 4");
    for bad in [f32::NAN, f32::INFINITY, 1e19] {
        vertices[2][1] = bad;
        assert!(refuse(&vertices, &triangles, &quads).contains("vertex 2 is not finite"));
    }
}

#[test]
fn errors_carry_the_text_of_embree() {
    let device = Device::new(1).unwrap();
    // SAFETY: an invalid buffer slot is an argument that Embree checks and refuses.
    unsafe {
        let geometry = sys::rtcNewGeometry(device.raw(), sys::RTC_GEOMETRY_TYPE_TRIANGLE);
        sys::rtcSetNewGeometryBuffer(geometry, sys::RTC_BUFFER_TYPE_INDEX, 0, sys::RTC_FORMAT_FLOAT4, 16, 1);
        sys::rtcReleaseGeometry(geometry);
    }
    let error = device.check("here").unwrap_err().to_string();
    assert!(error.starts_with("Embree: here: ") && error.contains("format"), "{error}");
    assert!(device.check("again").is_ok());
}

#[test]
fn a_scene_outlives_its_device_and_moves_between_threads() {
    let (vertices, triangles, quads) = two_faces();
    let device = Device::new(1).unwrap();
    let scene = CommittedScene::new(&device, &vertices, &triangles, &quads).unwrap();
    drop((device, vertices));
    let scene = std::thread::spawn(move || {
        std::thread::scope(|scope| {
            for _ in 0..2 {
                scope.spawn(|| {
                    let mut packet = RayPacket::new();
                    packet.set(15, &down(0.5, 1.0));
                    scene.intersect16(&mut packet, false);
                    assert!(packet.hit(15).is_some());
                });
            }
        });
        scene
    })
    .join()
    .unwrap();
    assert!(scene.occluded(&down(0.5, 1.0)));
}

/// Rays from a grid, some of which miss: every width finds the same distances.
#[test]
fn queries_of_all_widths_agree() {
    let (vertices, triangles, quads) = two_faces();
    let device = Device::new(1).unwrap();
    let scene = CommittedScene::new(&device, &vertices, &triangles, &quads).unwrap();
    let rays: Vec<Ray> = (0..64).map(|k| down(0.05 + 0.3 * (k % 8) as f32, 0.5 * (k / 8) as f32)).collect();
    let trace = |width| {
        let mut queries = Queries::new(&rays, width);
        scene.trace(&mut queries, width == Width::Sixteen);
        assert_eq!(queries.len(), 64);
        queries.distances()
    };
    let single = trace(Width::One);
    let expected: Vec<f32> =
        rays.iter().map(|r| scene.intersect(r).map_or(f32::INFINITY, |hit| hit.t)).collect();
    assert_eq!(single, expected);
    assert!(single.iter().any(|t| t.is_finite()) && single.iter().any(|t| t.is_infinite()));
    for width in Width::ALL {
        let found = trace(width);
        for (a, b) in found.iter().zip(&single) {
            assert!(a == b || (a - b).abs() < 1e-6 * b, "{width:?}: {a} {b}");
        }
    }
    // What does not fill a packet, and what is no ray, is left out.
    assert_eq!(Queries::new(&rays[..63], Width::Sixteen).len(), 48);
    let bad = Ray::new(Vec3::NAN, Vec3::Z);
    assert!(Queries::new(&[bad; 16], Width::Eight).is_empty());
}

/// Scenes smaller than a centimetre grow before Embree sees them; rays that would leave its range by that meet nothing. Debian builds
/// Embree with assertions: such a ray would end the process.
#[test]
fn rays_from_far_beyond_a_tiny_scene_meet_nothing() {
    let (vertices, triangles, quads) = two_faces();
    let vertices: Vec<[f32; 3]> = vertices.iter().map(|v| v.map(|x| 1e-3 * x)).collect();
    let device = Device::new(1).expect("Embree");
    let scene = CommittedScene::new(&device, &vertices, &triangles, &quads).expect("a tree");
    let far = Ray::new(Vec3::new(1e16, 0.0, 0.0), Vec3::NEG_X);
    assert!(scene.intersect(&far).is_none() && !scene.occluded(&far));
    let (mut packet, mut shadow) = (RayPacket::new(), ShadowPacket::new());
    for lane in 0..LANES {
        packet.set(lane, &far);
        shadow.set(lane, &far);
    }
    scene.intersect16(&mut packet, true);
    assert!((0..LANES).all(|lane| packet.hit(lane).is_none()));
    assert_eq!(scene.occluded16(&mut shadow, true), 0);
}

/// Scenes of up to the largest coordinates give what a small one gives, times a power of two.
#[test]
fn huge_scenes_are_hit_as_small_ones() {
    let mut numbers = Numbers(5);
    let (vertices, triangles, quads) = room(200, &mut numbers);
    let device = Device::new(1).expect("Embree");
    let rays: Vec<Ray> = (0..2000).map(|_| Ray::new(numbers.direction(), numbers.direction())).collect();
    let hits = |exponent: i32| -> Vec<Option<Hit>> {
        let scale = 2f32.powi(exponent);
        let vertices: Vec<[f32; 3]> = vertices.iter().map(|v| v.map(|x| x * scale)).collect();
        let scene = CommittedScene::new(&device, &vertices, &triangles, &quads).expect("a tree");
        let hit = |ray: &Ray| {
            let ray = Ray { origin: ray.origin * scale, ..*ray };
            let hit = scene.intersect(&ray);
            let mut packet = RayPacket::new();
            packet.set(3, &ray);
            scene.intersect16(&mut packet, false);
            assert_eq!(packet.hit(3).is_some(), hit.is_some());
            assert_eq!(scene.occluded(&ray), hit.is_some());
            hit.map(|hit| Hit { t: hit.t / scale, ..hit })
        };
        rays.iter().map(hit).collect()
    };
    let expected = hits(0);
    assert!(expected.iter().all(Option::is_some));
    for exponent in [30, 31, 42, 48, 57] {
        assert!(hits(exponent) == expected, "2^{exponent}");
    }
}
