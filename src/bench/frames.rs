//! Frames a second where the solution of pass 1 is kept: tracing, shading, encoding and writing together.

use super::view::{ERROR, SPP, View, pass1, settings};
use crate::image::{self, WriteOptions};
use crate::render::{Method, Quality, Renderer};
use crate::report::record::{Chart, PARAMETER, Subject, Unit};
use crate::scene::Camera;
use crate::sequence::render_frames;
use crate::{Error, Result};
use std::time::Instant;

const RATE: &str = "frames a second";
const BUSY: &str = "share of the time that the encoder is busy";
const BYTES: &str = "bytes of a frame";

/// Qualities `mesh` and `direct` along a short path of the camera, written as OpenEXR.
pub(super) fn frames(stage: &View, name: &str) -> Result<Subject> {
    let context = stage.context;
    let size: u32 = context.choose(256, 512);
    let mut subject = Subject::new(
        &format!("{name}-frames"),
        format!("{name}: frames of {size} x {size} pixels"),
        "How many frames a second come from a kept solution of pass 1, written as OpenEXR in 32-bit floats. The camera moves from \
         frame to frame; while one is encoded and written, the next ones are traced. The relative RMSE is that of the other \
         pictures of this scene, which are smaller, at the same quality and samples a pixel.",
    );
    let folder = tempfile::tempdir().map_err(|e| Error::io(std::env::temp_dir(), e))?;
    let (solution, _) = stage.solve(&pass1(context, stage.visibility.scene()))?;
    let count: u32 = context.choose(2, 8);
    for round in 0..context.choose(1, 3) {
        let seed = context.settings.seed.wrapping_add(round);
        (context.observer)(&format!("images: {}, seed {seed}", subject.name));
        for quality in [Quality::Mesh, Quality::Direct] {
            for spp in [1, 4] {
                let settings = settings(Method::TwoPass(quality), spp, seed);
                let renderer =
                    Renderer::new(stage.visibility, stage.emitters, Some(&solution), [size; 2], &settings);
                let trace = |frame: u32| {
                    let camera = moved(stage.camera, f64::from(frame) / f64::from(count), size);
                    renderer.render(&camera, &|_| ())
                };
                let path = |frame: u32| folder.path().join(format!("{frame}.exr"));
                let options = WriteOptions::default();
                let start = Instant::now();
                let times = render_frames(0..count, trace, |frame, image| {
                    image::write(image, &path(frame), &options)
                })?;
                let seconds = start.elapsed().as_secs_f64();
                let writing: f64 = times.iter().map(|t| t.write_seconds).sum();
                let bytes = std::fs::metadata(path(0)).map_err(|e| Error::io(path(0), e))?.len();
                let small = stage.frame(&settings, Some(&solution));
                let error = stage.compare(&small.image, &stage.reference.mask)?.relative_rmse;
                let point = subject.series(quality.name(), SPP).at(f64::from(spp));
                point.push(RATE, Unit::Plain, f64::from(count) / seconds);
                point.push(BUSY, Unit::Share, writing / seconds);
                point.push(BYTES, Unit::Bytes, bytes as f64);
                point.push(ERROR, Unit::Share, error);
            }
        }
    }
    let about =
        "Higher is faster. Where the encoder is busy all the time, it and not the tracing sets the rate.";
    subject.charts.push(Chart::new("Frames a second over samples a pixel", PARAMETER, RATE, about));
    Ok(subject)
}

/// The camera, for square pictures of `size` pixels an edge, a share of the way along a step to its right by a tenth of its distance.
fn moved(camera: &Camera, share: f64, size: u32) -> Camera {
    let view = camera.target - camera.origin;
    let step = 0.1 * share * view.cross(camera.up).normalize_or_zero() * view.length();
    Camera { origin: camera.origin + step, size: [size; 2], ..camera.clone() }
}
