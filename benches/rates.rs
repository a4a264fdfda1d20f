//! Rays per second of the form-factor stage beside Embree's own rate on the same rays.
//!
//! `cargo bench --bench rates [-- THREADS...]`. Both are measured in turn, in one process; the median of
//! several rounds and their range are printed.

use std::path::Path;
use std::time::Instant;
use twopass::embree::Device;
use twopass::form_factor::{Casting, cast, time_embree};
use twopass::mesh::{Mesh, Sides, default_element_size};
use twopass::scene::load;
use twopass::visibility::Visibility;

const RAYS: u32 = 1024;
const ROUNDS: usize = 7;

fn main() {
    let asked: Vec<usize> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let cores = std::thread::available_parallelism().map_or(1, |n| n.get());
    let threads = if asked.is_empty() { vec![1, cores] } else { asked };
    for n in threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().expect("a thread pool");
        pool.install(|| measure(n));
    }
}

fn measure(threads: usize) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell/cornell.toml");
    let scene = load(&path).expect("the scene of this repository");
    let device = Device::new(threads).expect("Embree");
    let visibility = Visibility::new(&device, &scene).expect("a tree");
    let mesh =
        Mesh::new(&scene, &Sides::fronts(&scene), 2.0 * default_element_size(&scene), true).expect("a mesh");
    let (mut raw, mut stage) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let (seconds, rays) = time_embree(&visibility, &mesh, RAYS, 0);
        raw.push(rays as f64 / seconds * threads as f64 / 1e6);
        let casting = Casting {
            rays: RAYS,
            batches: 1,
            seed: 0,
            specular: false,
            reached: None,
            emitters: None,
            progress: &|_| (),
        };
        let start = Instant::now();
        let (matrix, _) = cast(&visibility, &mesh, &casting);
        stage.push(matrix.rays as f64 / start.elapsed().as_secs_f64() / 1e6);
    }
    let mut ratio: Vec<f64> = stage.iter().zip(&raw).map(|(s, r)| s / r).collect();
    for v in [&mut raw, &mut stage, &mut ratio] {
        v.sort_by(f64::total_cmp);
    }
    let text = |v: &[f64]| format!("{:6.2} ({:.2} to {:.2})", v[ROUNDS / 2], v[0], v[ROUNDS - 1]);
    println!(
        "Embree {}, {threads} threads, {} elements, {RAYS} rays each\n  Embree alone       {} Mrays/s\n  \
         form-factor stage  {} Mrays/s\n  ratio              {}",
        device.version(),
        mesh.len(),
        text(&raw),
        text(&stage),
        text(&ratio)
    );
}
