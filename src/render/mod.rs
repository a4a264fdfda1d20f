//! Pass 2: images, from the solution of pass 1 and rays over the specular lobes.

mod diffuse;
mod lobe;
mod path;
mod view;

use crate::color::Rgb;
use crate::emitters::Emitters;
use crate::image::Image;
use crate::radiosity::{Directional, Solution};
use crate::sampling::{seed_of, sobol};
use crate::scene::{Camera, CameraFrame, Scene};
use crate::visibility::Visibility;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;
use std::cell::Cell;

/// How the light at a point is found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// Both passes.
    TwoPass(Quality),
    /// Pass 1 alone: diffuse light interpolated, specular surfaces black.
    Radiosity,
    /// Classical ray tracing (Whitted 1980): light from emitters and specular rays, no diffuse
    /// interreflection.
    Whitted,
    /// Unbiased path tracing with next-event estimation: the reference.
    Path,
}

/// Where two-pass rendering takes a point's diffuse light from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quality {
    /// Interpolated radiosity.
    Mesh,
    /// Emitters sampled anew, the rest interpolated.
    Direct,
    /// Emitters sampled anew, the rest gathered over the hemisphere from interpolated radiosity.
    Gather,
}

/// How glossy lobes are sampled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Estimator {
    /// The paper's: a grid of n x n cells about the mirror direction, one jittered ray a cell.
    Frustum(u32),
    /// Importance sampling of the lobe, with this many rays at the first glossy surface.
    Lobe(u32),
}

/// What to render and how much work to spend.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Method and quality.
    pub method: Method,
    /// Samples a pixel.
    pub spp: u32,
    /// Hemisphere rays at each sample ([`Quality::Gather`]).
    pub gather_rays: u32,
    /// Emitter samples at each sample.
    pub emitter_samples: u32,
    /// Glossy lobes.
    pub estimator: Estimator,
    /// Seed.
    pub seed: u32,
}

/// Everything a view ray may ask.
pub(crate) struct Context<'a, 's> {
    scene: &'s Scene,
    visibility: &'a Visibility<'s>,
    emitters: &'a Emitters,
    solution: Option<&'a Solution>,
    settings: Settings,
    /// Rays cast so far.
    rays: Cell<u64>,
}

impl Context<'_, '_> {
    /// Counts rays that were cast.
    fn cast(&self, rays: u32) {
        self.rays.set(self.rays.get() + u64::from(rays));
    }
}

/// Numbers for one sample of one pixel: the same dimension of all samples of a pixel is one
/// low-discrepancy sequence. Sets of four dimensions are padded by reseeding (Burley 2020, section 5): the
/// first Sobol dimensions have far better projections than the later ones.
#[derive(Clone, Copy)]
pub(crate) struct Sampler {
    seed: u32,
    index: u32,
}

impl Sampler {
    /// Four numbers of this sample.
    fn numbers(&self, set: u32) -> [f64; 4] {
        sobol(self.index, 0, seed_of(&[self.seed, set]))
    }

    /// Four numbers of the `k`-th of `count` sub-samples of this sample.
    fn split(&self, set: u32, k: u32, count: u32) -> [f64; 4] {
        sobol(self.index.wrapping_mul(count).wrapping_add(k), 0, seed_of(&[self.seed, set]))
    }

    /// Independent numbers for what lies behind branch `branch`.
    fn branch(&self, branch: u32) -> Sampler {
        Sampler { seed: seed_of(&[self.seed, branch, 0xb4a]), index: self.index }
    }

    /// The same for one of `count` sub-samples, which become samples in their own right.
    fn branch_split(&self, branch: u32, k: u32, count: u32) -> Sampler {
        Sampler {
            seed: seed_of(&[self.seed, branch, 0xb4a]),
            index: self.index.wrapping_mul(count).wrapping_add(k),
        }
    }
}

const TILE: u32 = 16;
/// Samples of a pixel that sees a mirror or glass, for each one asked for, at quality gather. What is seen there (the image
/// of a lamp in a facet, say) is as fine as the pixel or finer, and needs samples of the pixel more than hemisphere
/// rays at each.
const FINER: u32 = 8;
/// Rays along one side of a pixel that look for mirrors and glass.
const PROBES: u32 = 3;

/// Whether a pixel at (x, y) sees a perfect mirror or glass first. The answer depends on no sample of the pixel, so
/// that samples chosen by it are without bias.
fn sees_perfect_lobe(visibility: &Visibility, frame: &CameraFrame, x: u32, y: u32) -> bool {
    let scene = visibility.scene();
    (0..PROBES * PROBES).any(|k| {
        let at = |k: u32| (f64::from(k) + 0.5) / f64::from(PROBES);
        let direction = frame.direction(f64::from(x) + at(k % PROBES), f64::from(y) + at(k / PROBES));
        let hit = visibility.closest(frame.origin().as_vec3(), direction.as_vec3(), u32::MAX);
        hit.is_some_and(|h| scene.material(&scene.faces[h.face as usize]).has_perfect_lobe())
    })
}

/// Renders an image: mean radiance over each pixel's area [W m^-2 sr^-1], row 0 at the top.
///
/// `solution` is needed by every method but [`Method::Whitted`] and [`Method::Path`]; without it diffuse
/// interreflection is left out. Returns the image and the number of rays cast. `progress` is called with the number of pixels finished. The result does
/// not depend on the number of threads.
pub fn render(
    visibility: &Visibility,
    emitters: &Emitters,
    solution: Option<&Solution>,
    camera: &Camera,
    settings: &Settings,
    progress: &(dyn Fn(u64) + Sync),
) -> (Image, u64) {
    let shader = Shader::new(visibility, emitters, solution, settings);
    film(visibility.scene(), camera, progress, |frame, x, y| shader.pixel(frame, x, y))
}

/// Renders some pixels of an image alone, (column, row) from the top left: what [`render`] gives for them, and the rays cast.
pub fn render_pixels(
    visibility: &Visibility,
    emitters: &Emitters,
    solution: Option<&Solution>,
    (camera, pixels): (&Camera, &[[u32; 2]]),
    settings: &Settings,
) -> (Vec<Rgb>, u64) {
    let shader = Shader::new(visibility, emitters, solution, settings);
    let frame = camera.frame(visibility.scene());
    let shaded: Vec<(Rgb, u64)> =
        pixels.par_iter().with_min_len(TILE as usize).map(|[x, y]| shader.pixel(&frame, *x, *y)).collect();
    (shaded.iter().map(|s| s.0).collect(), shaded.iter().map(|s| s.1).sum())
}

/// Shades pixel after pixel.
struct Shader<'a, 's> {
    visibility: &'a Visibility<'s>,
    emitters: &'a Emitters,
    solution: Option<&'a Solution>,
    settings: Settings,
    /// Settings of pixels that see a mirror or glass first; none where they are the same.
    finer: Option<Settings>,
}

impl<'a, 's> Shader<'a, 's> {
    fn new(
        visibility: &'a Visibility<'s>,
        emitters: &'a Emitters,
        solution: Option<&'a Solution>,
        settings: &Settings,
    ) -> Shader<'a, 's> {
        let scene = visibility.scene();
        // As many hemisphere rays a pixel in all.
        let finer = Settings {
            spp: settings.spp.saturating_mul(FINER),
            gather_rays: settings.gather_rays.div_ceil(FINER),
            emitter_samples: settings.emitter_samples.div_ceil(FINER),
            estimator: match settings.estimator {
                Estimator::Lobe(n) => Estimator::Lobe(n.div_ceil(FINER)),
                frustum => frustum,
            },
            ..*settings
        };
        let gathers = settings.method == Method::TwoPass(Quality::Gather);
        let looks = gathers && scene.faces.iter().any(|f| scene.material(f).has_perfect_lobe());
        Shader { visibility, emitters, solution, settings: *settings, finer: looks.then_some(finer) }
    }

    /// Mean radiance over a pixel [W m^-2 sr^-1], and the rays cast for it.
    fn pixel(&self, frame: &CameraFrame, x: u32, y: u32) -> (Rgb, u64) {
        let &Shader { visibility, emitters, solution, .. } = self;
        let settings = match self.finer {
            Some(finer) if sees_perfect_lobe(visibility, frame, x, y) => finer,
            _ => self.settings,
        };
        let scene = visibility.scene();
        let context = Context { scene, visibility, emitters, solution, settings, rays: Cell::new(0) };
        if self.finer.is_some() {
            context.cast(PROBES * PROBES);
        }
        let radiance =
            pixel(frame, (x, y), (settings.spp, settings.seed), |origin, direction, sampler| match settings
                .method
            {
                Method::Path => context.path(origin, direction, sampler),
                _ => context.view(origin, direction, sampler),
            });
        (radiance, context.rays.get())
    }
}

/// Which pixels of an image see no emitter directly nor have a neighbour that does, row by row: errors are measured over them
/// (DESIGN section 2), as the edges of lamps would hide all else.
pub fn sees_no_emitter(visibility: &Visibility, emitters: &Emitters, camera: &Camera) -> Vec<bool> {
    const RAYS: u32 = 4;
    let frame = camera.frame(visibility.scene());
    let [width, height] = camera.size;
    let sees = |x: u32, y: u32| {
        (0..RAYS * RAYS).any(|k| {
            let at = |j: u32| (f64::from(j) + 0.5) / f64::from(RAYS);
            let direction = frame.direction(f64::from(x) + at(k % RAYS), f64::from(y) + at(k / RAYS));
            let hit = visibility.closest(frame.origin().as_vec3(), direction.as_vec3(), u32::MAX);
            hit.is_some_and(|hit| emitters.at(hit.face, hit.front).is_some())
        })
    };
    let seen: Vec<bool> = (0..width * height).into_par_iter().map(|k| sees(k % width, k / width)).collect();
    let near = |k: u32, n: u32| k.saturating_sub(1)..(k + 2).min(n);
    (0..width * height)
        .map(|k| {
            let (x, y) = (k % width, k / width);
            !near(y, height).any(|j| near(x, width).any(|i| seen[(j * width + i) as usize]))
        })
        .collect()
}

/// Renders directional radiosity ([`Directional`]): every surface shows what was solved for, emitters their emission.
///
/// Like [`render`], with `spp` samples a pixel.
pub fn render_directional(
    visibility: &Visibility,
    emitters: &Emitters,
    solution: &Directional,
    camera: &Camera,
    (spp, seed): (u32, u32),
    progress: &(dyn Fn(u64) + Sync),
) -> (Image, u64) {
    let scene = visibility.scene();
    film(scene, camera, progress, |frame, x, y| {
        let radiance = pixel(frame, (x, y), (spp, seed), |origin, direction, sampler| {
            let Some(hit) = visibility.closest(origin, direction.as_vec3(), u32::MAX) else {
                return scene.environment;
            };
            let emitted = emitters.at(hit.face, hit.front).map_or(Rgb::ZERO, |(radiance, _)| radiance);
            let uv = DVec2::new(f64::from(hit.u), f64::from(hit.v));
            emitted + solution.leaving(scene, (hit.face, hit.front), uv, -direction, sampler.numbers(1))
        });
        (radiance, u64::from(spp))
    })
}

/// Mean over the samples of a pixel of the radiance along their camera rays.
fn pixel(
    frame: &CameraFrame,
    (x, y): (u32, u32),
    (spp, seed): (u32, u32),
    sample: impl Fn(Vec3, DVec3, Sampler) -> Rgb,
) -> Rgb {
    let seed = seed_of(&[seed, x, y, 0x91e]);
    let samples = (0..spp).map(|index| {
        let sampler = Sampler { seed, index };
        let u = sampler.numbers(0);
        let direction = frame.direction(f64::from(x) + u[0], f64::from(y) + u[1]);
        sample(frame.origin().as_vec3(), direction, sampler)
    });
    samples.sum::<Rgb>() / f64::from(spp.max(1))
}

/// All pixels of an image, tile by tile on all cores; `shade` gives a pixel's radiance and the rays that it took.
fn film(
    scene: &Scene,
    camera: &Camera,
    progress: &(dyn Fn(u64) + Sync),
    shade: impl Fn(&CameraFrame, u32, u32) -> (Rgb, u64) + Sync,
) -> (Image, u64) {
    let frame = camera.frame(scene);
    let [width, height] = camera.size;
    let columns = width.div_ceil(TILE);
    let tiles: Vec<(Vec<[f32; 3]>, u64)> = (0..columns * height.div_ceil(TILE))
        .into_par_iter()
        .map(|tile| {
            let mut rays = 0;
            let (x0, y0) = (tile % columns * TILE, tile / columns * TILE);
            let mut pixels = Vec::with_capacity((TILE * TILE) as usize);
            for y in y0..(y0 + TILE).min(height) {
                for x in x0..(x0 + TILE).min(width) {
                    let (radiance, cast) = shade(&frame, x, y);
                    rays += cast;
                    pixels.push(radiance.as_vec3().to_array());
                }
            }
            progress(pixels.len() as u64);
            (pixels, rays)
        })
        .collect();
    let mut image = Image::new(width as usize, height as usize);
    for (tile, (pixels, _)) in tiles.iter().enumerate() {
        let (x0, y0) = (tile as u32 % columns * TILE, tile as u32 / columns * TILE);
        let w = TILE.min(width - x0);
        for (k, pixel) in pixels.iter().enumerate() {
            image.set((x0 + k as u32 % w) as usize, (y0 + k as u32 / w) as usize, *pixel);
        }
    }
    (image, tiles.iter().map(|t| t.1).sum())
}
