//! Embree alone, and the form-factor stage beside it on the same rays.

use super::{Context, Measurements, embedded, pool, rounds, thread_counts, threads_in_words};
use crate::Result;
use crate::embree::{Queries, Ray, Width};
use crate::form_factor::{AtSpecular, Casting, cast, packets_of};
use crate::mesh::{Mesh, Sides, default_element_size};
use crate::report::record::{Chart, Figure, PARAMETER, Subject, Unit};
use crate::sampling::{SobolTable, seed_of};
use crate::scene::Features;
use crate::visibility::Visibility;
use glam::Vec3;
use rayon::prelude::*;
use std::time::Instant;

/// Groups of 16 elements whose rays are traced at a time.
const TOGETHER: usize = 1;

const RATE: &str = "rays a second";
const RATIO: &str = "of Embree's rate";
const STAGE: &str = "form-factor stage";
const STAGE_WITH_CHAINS: &str = "form-factor stage, chains allowed";

pub fn run(context: &Context) -> Result<Measurements> {
    let mut found = Measurements::default();
    for name in ["cornell", "music_lesson"] {
        let (subject, figures) = scene(context, name)?;
        found.subjects.push(subject);
        found.figures.extend(figures);
    }
    Ok(found)
}

/// How Embree is called.
#[derive(Clone, Copy, PartialEq)]
struct Call {
    width: Width,
    sorted: bool,
    coherent: bool,
}

/// What the form-factor stage asks of Embree.
const AS_THE_STAGE: Call = Call { width: Width::Sixteen, sorted: true, coherent: true };

fn scene(context: &Context, name: &str) -> Result<(Subject, Vec<Figure>)> {
    let scene = embedded(name)?;
    let visibility = Visibility::new(context.device, &scene)?;
    let size = context.choose(3.0, 2.0) * default_element_size(&scene, true);
    let mesh = Mesh::new(&scene, &Sides::fronts(&scene), size, true)?;
    let rays = context.choose(256, 1024);
    let mut subject = Subject::new(
        name,
        format!("{name}: {} faces, {} elements, {rays} rays each", scene.faces.len(), mesh.len()),
        "The same rays are traced by Embree alone, in calls of 1, 4, 8 and 16 rays, and by the form-factor stage, which also \
         makes the rays and adds up what they hit. \"Sorted\" are the rays in the order in which the stage casts them: 16 \
         neighbouring elements at a time, rays of one cell of directions together. \"Unsorted\" are the same rays shuffled. \
         \"Coherent\" are calls with Embree's flag of that name. Only calls into Embree are timed for \
         Embree; the whole stage is timed for the stage. All take turns within one process.",
    );
    let calls: Vec<Call> = Width::ALL
        .into_iter()
        .flat_map(|width| [true, false].map(|sorted| Call { width, sorted, coherent: false }))
        .chain([AS_THE_STAGE])
        .collect();
    let all = context.threads();
    let threads = thread_counts(context);
    // What chains cost a scene that has no use for them.
    let diffuse = !Features::of(&scene).specular;
    let (mut ratios, mut kept) = (Vec::new(), Vec::new());
    for &n in &threads {
        let pool = pool(n)?;
        rounds(context.settings.seed, context.choose(2, 5), |seed, counts| {
            (context.observer)(&format!("embree: {name}, {n} threads, seed {seed}"));
            let rates: Vec<f64> = pool.install(|| {
                calls.iter().map(|&call| embree_rate(&visibility, &mesh, rays, seed, call)).collect()
            });
            let rate = |specular| pool.install(|| stage_rate(&visibility, &mesh, rays, seed, specular));
            // What comes first finds warmer or colder caches: each comes first in turn.
            let first = (diffuse && seed % 2 == 1).then(|| rate(AtSpecular::GoOn));
            let stage = rate(AtSpecular::End);
            let chains = first.or_else(|| diffuse.then(|| rate(AtSpecular::GoOn)));
            if !counts {
                return Ok(());
            }
            let base = calls.iter().zip(&rates).find(|(c, _)| **c == AS_THE_STAGE);
            let base = base.map_or(f64::NAN, |(_, rate)| *rate);
            let order = |c: &Call| match (c.sorted, c.coherent) {
                (true, true) => "Embree alone, sorted, coherent",
                (true, false) => "Embree alone, sorted",
                (false, _) => "Embree alone, unsorted",
            };
            let alone = calls.iter().map(|c| (order(c), c.width.rays())).zip(rates.iter().copied());
            for ((kind, width), rate) in alone
                .chain([((STAGE, Width::Sixteen.rays()), stage)])
                .chain(chains.map(|rate| ((STAGE_WITH_CHAINS, Width::Sixteen.rays()), rate)))
            {
                let threads = threads_in_words(n);
                let series = subject.series(&format!("{kind}, {threads}"), "rays a call");
                let point = series.at(width as f64);
                point.push(RATE, Unit::RaysPerSecond, rate);
                point.push(RATIO, Unit::Plain, rate / base);
            }
            if n == all {
                ratios.push(stage / base);
                kept.extend(chains.map(|rate| rate / stage));
            }
            Ok(())
        })?;
    }
    subject.charts.push(Chart::new(
        "Rays a second over rays a call",
        PARAMETER,
        RATE,
        "Higher is faster. Packets help where their rays are neighbours (sorted); the single points at 16 are sorted packets with the \
         coherent flag, and the whole form-factor stage, which calls Embree with them.",
    ));
    subject.notes.push(format!(
        "\"{RATIO}\" compares with packets of 16, sorted and coherent, in the same round: what the stage asks of Embree."
    ));
    let label = format!(
        "of Embree's own rate on the same rays is kept by the form-factor stage ({name}, {all} threads)"
    );
    let mut figures = vec![Figure { label, unit: Unit::Share, samples: ratios }];
    if diffuse {
        let label = format!(
            "of the form-factor stage's rate is kept where specular chains are allowed and no surface needs them ({name}, {all} threads)"
        );
        figures.push(Figure { label, unit: Unit::Share, samples: kept });
    }
    Ok((subject, figures))
}

/// Rays a second of Embree alone: rays over the seconds within its calls, over all threads.
fn embree_rate(visibility: &Visibility, mesh: &Mesh, rays: u32, seed: u32, call: Call) -> f64 {
    let table = SobolTable::new(rays);
    let n = mesh.len() as u32;
    let mut groups: Vec<u32> = (0..n.div_ceil(16)).collect();
    // Groups in an order without neighbours, so that an unsorted batch comes from all over the scene.
    if !call.sorted {
        groups.sort_by_key(|g| seed_of(&[seed, *g, 0x0e1]));
    }
    let batches: Vec<(f64, usize)> = groups
        .par_chunks(if call.sorted { TOGETHER } else { 4 * TOGETHER })
        .with_min_len(4)
        .map(|groups| {
            let mut batch: Vec<Ray> = Vec::with_capacity(groups.len() * 16 * rays as usize);
            for &g in groups {
                for lanes in packets_of(visibility, mesh, 16 * g..(16 * g + 16).min(n), &table, seed) {
                    let at = |v: &[[f32; 16]; 3], k: usize| Vec3::new(v[0][k], v[1][k], v[2][k]);
                    batch.extend((0..16).map(|k| Ray::new(at(&lanes.origin, k), at(&lanes.direction, k))));
                }
            }
            if !call.sorted {
                let mut keyed: Vec<(u32, Ray)> = batch
                    .iter()
                    .enumerate()
                    .map(|(k, ray)| (seed_of(&[seed, groups[0], k as u32]), *ray))
                    .collect();
                keyed.sort_by_key(|k| k.0);
                batch = keyed.into_iter().map(|k| k.1).collect();
            }
            let mut queries = Queries::new(&batch, call.width);
            let start = Instant::now();
            visibility.embree().trace(&mut queries, call.coherent);
            (start.elapsed().as_secs_f64(), queries.len())
        })
        .collect();
    let (seconds, count) = batches.iter().fold((0.0, 0), |(s, c), b| (s + b.0, c + b.1));
    count as f64 / seconds * rayon::current_num_threads() as f64
}

/// Rays a second of the whole stage; `specular` tells what rays do where a surface asks them to go on.
fn stage_rate(visibility: &Visibility, mesh: &Mesh, rays: u32, seed: u32, specular: AtSpecular) -> f64 {
    let casting =
        Casting { rays, batches: 1, seed, specular, reached: None, emitters: None, progress: &|_| () };
    let start = Instant::now();
    let (matrix, _) = cast(visibility, mesh, &casting);
    matrix.rays as f64 / start.elapsed().as_secs_f64()
}
