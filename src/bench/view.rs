//! One view of a scene, rendered over and over and compared with its reference.

use super::pictures::exposure;
use super::reference::{Reference, path_settings, reference_of};
use super::{Context, embedded};
use crate::Result;
use crate::emitters::Emitters;
use crate::image::{Comparison, Difference, Image, Options, relative_rmse_halves};
use crate::pipeline::{self, Pass1};
use crate::radiosity::Solution;
use crate::render::{Estimator, GATHER_RAYS, Method, Settings, render};
use crate::report::record::{Subject, Unit};
use crate::scene::{Camera, Scene};
use crate::visibility::Visibility;
use std::time::Instant;

/// Time from a loaded scene to the picture.
pub(super) const FIRST: &str = "first frame";
/// Time of a frame where the solution of pass 1 is kept.
pub(super) const NEXT: &str = "following frame";
/// Error against the reference.
pub(super) const ERROR: &str = "relative RMSE";
/// Perceived difference from the reference, its noise included: 0 equal, 1 as unlike as can be.
pub(super) const FLIP: &str = "FLIP";
/// What most series of images vary.
pub(super) const SPP: &str = "samples a pixel";

/// The settings of `twopass render`, but for the samples a pixel.
pub(super) fn settings(method: Method, spp: u32, seed: u32) -> Settings {
    match method {
        Method::Path => path_settings(spp, seed),
        _ => Settings {
            method,
            spp,
            gather_rays: GATHER_RAYS,
            emitter_samples: 4,
            estimator: Estimator::Lobe(4),
            seed,
        },
    }
}

/// The scene file's settings of pass 1; coarser in a quick run.
pub(super) fn pass1(context: &Context, scene: &Scene) -> Pass1 {
    let full = Pass1::of(scene);
    let quick = Pass1 { rays: 256, element_size: full.element_size.map(|s| 2.0 * s), ..full };
    context.choose(quick, full)
}

/// The scene's camera, at the size at which images are measured.
pub(super) fn small_camera(context: &Context, scene: &Scene) -> Result<Camera> {
    let width = context.choose(64, 160);
    let mut camera = scene.camera(None)?.clone();
    camera.size = [width, width * camera.size[1] / camera.size[0]];
    Ok(camera)
}

/// One scene, ready to be rendered over and over.
pub(super) struct View<'a, 's> {
    pub context: &'a Context<'a>,
    pub visibility: &'a Visibility<'s>,
    pub emitters: &'a Emitters,
    pub camera: &'a Camera,
    pub reference: &'a Reference,
}

/// Does something with the measured view of the program's own scene `name`, and how its reference is made, in words.
pub(super) fn with_view<T>(
    context: &Context,
    name: &str,
    measure: impl FnOnce((&View, &str)) -> Result<T>,
) -> Result<T> {
    let scene = embedded(name)?;
    let camera = small_camera(context, &scene)?;
    let visibility = Visibility::new(context.device, &scene)?;
    let emitters = Emitters::new(&visibility);
    let (reference, by) = reference_of(name, context, &visibility, &emitters, &camera)?;
    let view = View {
        context,
        visibility: &visibility,
        emitters: &emitters,
        camera: &camera,
        reference: &reference,
    };
    measure((&view, &by))
}

/// A frame and what it cost.
pub(super) struct Frame {
    pub image: Image,
    /// Wall time \[s\].
    pub seconds: f64,
    pub rays: u64,
}

impl View<'_, '_> {
    /// Pass 2.
    pub fn frame(&self, settings: &Settings, solution: Option<&Solution>) -> Frame {
        let start = Instant::now();
        let (image, traced) =
            render(self.visibility, self.emitters, solution, self.camera, settings, &|_| ());
        Frame { image, seconds: start.elapsed().as_secs_f64(), rays: traced.rays }
    }

    /// Pass 1 with its wall time \[s\].
    pub fn solve(&self, pass1: &Pass1) -> Result<(Solution, f64)> {
        let start = Instant::now();
        let cameras = std::slice::from_ref(self.camera);
        let stages = &mut Vec::new();
        let solved = pipeline::solve(self.visibility, self.emitters, cameras, pass1, &|_| (), stages)?;
        Ok((solved.solution, start.elapsed().as_secs_f64()))
    }

    /// The error of an image over the pixels of `mask`.
    pub fn compare(&self, image: &Image, mask: &[bool]) -> Result<Comparison> {
        let [a, b] = &self.reference.halves;
        relative_rmse_halves(image, a, b, Some(mask))
    }

    /// Adds a frame's time and error to a point; `pass1` is the time before the first frame.
    pub fn record(
        &self,
        subject: &mut Subject,
        (series, parameter, at): (&str, &str, f64),
        frame: &Frame,
        pass1: f64,
        mask: &[bool],
    ) -> Result<()> {
        let c = self.compare(&frame.image, mask)?;
        let [a, b] = &self.reference.halves;
        let options = Options { mask: Some(mask), exposure: exposure(self.reference) };
        let flip = Difference::new(&frame.image, a, Some(b), &options)?.flip;
        let point = subject.series(series, parameter).at(at);
        point.push(FIRST, Unit::Seconds, pass1 + frame.seconds);
        point.push(NEXT, Unit::Seconds, frame.seconds);
        point.push(ERROR, Unit::Share, c.relative_rmse);
        point.push("standard error", Unit::Share, c.standard_error);
        point.push("bias", Unit::Share, c.mean_bias);
        point.push(FLIP, Unit::Plain, flip);
        point.push("rays of a frame", Unit::Count, frame.rays as f64);
        let error = point.summary(ERROR).map_or(0.0, |s| s.median);
        point.unresolved = error < self.reference.resolution;
        Ok(())
    }
}
