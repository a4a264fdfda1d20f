//! The hot kernels, one by one, so that a developer sees a regression: `cargo bench --bench kernels [-- NAME]`.
//!
//! Single-threaded, on the repository's Cornell box. What users wait for is measured by `twopass bench`.

#![allow(missing_docs)] // of the functions that criterion's macros make

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use twopass::bench::embedded;
use twopass::color::Rgb;
use twopass::embree::{Device, RayLanes, RayPacket};
use twopass::form_factor::{AtSpecular, Casting, HemicubeSettings, cast, hemicube, packets_of};
use twopass::mesh::{Mesh, Sides, default_element_size};
use twopass::radiosity::{Transport, solve_irradiance};
use twopass::sampling::SobolTable;
use twopass::scene::Scene;
use twopass::visibility::Visibility;

const RAYS: u32 = 1024;

fn kernels(c: &mut Criterion) {
    // One thread: a regression must not hide behind the scheduler.
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global().expect("the first pool");
    let scene = embedded("cornell").expect("a scene that the program holds");
    let device = Device::new(1).expect("Embree");
    let visibility = Visibility::new(&device, &scene).expect("a tree");
    let size = 4.0 * default_element_size(&scene, true);
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), size, true).expect("a mesh");
    rays(c, &visibility, &mesh);
    rows(c, &scene, &visibility, &mesh);
    hemicubes(c, &scene, &mesh);
}

fn rays(c: &mut Criterion, visibility: &Visibility, mesh: &Mesh) {
    let table = SobolTable::new(RAYS);
    let mut group = c.benchmark_group("rays");
    group.throughput(Throughput::Elements(16 * u64::from(RAYS)));
    // Those of 16 neighbouring elements.
    let mut first = 0;
    let mut next = || {
        first = (first + 16) % (mesh.len() as u32 - 15);
        packets_of(visibility, mesh, first..first + 16, &table, 0)
    };
    group.bench_function("generation", |b| b.iter(|| black_box(next())));
    let trace = |packet: &mut RayPacket, lanes: &[RayLanes]| {
        for lanes in lanes {
            packet.fill(lanes, u16::MAX);
            visibility.closest16(packet, true);
        }
        black_box(packet.hit(0));
    };
    let mut packet = RayPacket::new();
    group.bench_function("packet trace", |b| {
        b.iter_batched(&mut next, |lanes| trace(&mut packet, &lanes), BatchSize::SmallInput);
    });
    group.finish();
}

fn rows(c: &mut Criterion, scene: &Scene, visibility: &Visibility, mesh: &Mesh) {
    let casting = |rays| Casting {
        rays,
        batches: 4,
        seed: 0,
        specular: AtSpecular::End,
        reached: None,
        emitters: None,
        progress: &|_| (),
    };
    let mut group = c.benchmark_group("matrix");
    group.sample_size(20);
    group.throughput(Throughput::Elements(mesh.len() as u64 * u64::from(RAYS)));
    // Generation, trace and accumulation together; what the two above do not explain is accumulation.
    group.bench_function("rows", |b| b.iter(|| black_box(cast(visibility, mesh, &casting(RAYS)))));

    let (matrix, _) = cast(visibility, mesh, &casting(RAYS));
    let ones = vec![Rgb::ONE; mesh.len()];
    group.throughput(Throughput::Elements(matrix.stored() as u64));
    group.bench_function("multiplication", |b| b.iter(|| black_box(matrix.multiply(&ones))));
    let transport = Transport::of(scene, mesh);
    let incident = matrix.multiply(&ones);
    group.bench_function("solution", |b| {
        b.iter(|| solve_irradiance(&matrix, &transport, black_box(&incident), 1e-8).map(|s| s.1.iterations));
    });
    group.finish();
}

/// Faces drawn into item buffers and delta factors summed, one hemi-cube an element.
fn hemicubes(c: &mut Criterion, scene: &Scene, mesh: &Mesh) {
    let mut group = c.benchmark_group("hemi-cube");
    group.sample_size(20);
    for resolution in [8u32, 64] {
        let settings = HemicubeSettings { resolution, grid: 1, rotations: 0, seed: 0 };
        // A top and four halves.
        let pixels = mesh.len() as u64 * 3 * u64::from(resolution).pow(2);
        group.throughput(Throughput::Elements(pixels));
        group.bench_function(format!("fill, {resolution} pixels"), |b| {
            b.iter(|| black_box(hemicube(scene, mesh, &settings, None, &|_| ())));
        });
    }
    group.finish();
}

criterion_group!(benches, kernels);
criterion_main!(benches);
