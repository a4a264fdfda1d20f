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
use crate::scene::{Camera, Scene};
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
    let scene = visibility.scene();
    film(scene, camera, (settings.spp, settings.seed), progress, |origin, direction, sampler| {
        let context =
            Context { scene, visibility, emitters, solution, settings: *settings, rays: Cell::new(0) };
        let radiance = match settings.method {
            Method::Path => context.path(origin, direction, sampler),
            _ => context.view(origin, direction, sampler),
        };
        (radiance, context.rays.get())
    })
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
    film(scene, camera, (spp, seed), progress, |origin, direction, sampler| {
        let Some(hit) = visibility.closest(origin, direction.as_vec3(), u32::MAX) else {
            return (scene.environment, 1);
        };
        let emitted = emitters.at(hit.face, hit.front).map_or(Rgb::ZERO, |(radiance, _)| radiance);
        let uv = DVec2::new(f64::from(hit.u), f64::from(hit.v));
        let leaving = solution.leaving(scene, (hit.face, hit.front), uv, -direction, sampler.numbers(1));
        (emitted + leaving, 1)
    })
}

/// Averages samples over pixels, tile by tile on all cores. `sample` gives the radiance along a camera ray and the
/// number of rays that it took.
fn film(
    scene: &Scene,
    camera: &Camera,
    (spp, seed): (u32, u32),
    progress: &(dyn Fn(u64) + Sync),
    sample: impl Fn(Vec3, DVec3, Sampler) -> (Rgb, u64) + Sync,
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
                    let seed = seed_of(&[seed, x, y, 0x91e]);
                    let mut sum = Rgb::ZERO;
                    for index in 0..spp {
                        let sampler = Sampler { seed, index };
                        let u = sampler.numbers(0);
                        let direction = frame.direction(f64::from(x) + u[0], f64::from(y) + u[1]);
                        let (radiance, cast) = sample(frame.origin().as_vec3(), direction, sampler);
                        sum += radiance;
                        rays += cast;
                    }
                    pixels.push((sum / f64::from(spp.max(1))).as_vec3().to_array());
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
