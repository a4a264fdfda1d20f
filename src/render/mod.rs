//! Pass 2: images, from the solution of pass 1 and rays over the specular lobes.

mod block;
mod budget;
mod diffuse;
mod guide;
mod landing;
mod lobe;
mod mask;
mod path;
mod view;

use crate::color::Rgb;
use crate::embree::{LANES, RayLanes, RayPacket};
use crate::emitters::Emitters;
use crate::image::Image;
use crate::medium::Media;
use crate::radiosity::{Directional, Solution};
use crate::sampling::{seed_of, sobol, sobol_bits};
use crate::scene::{Camera, CameraFrame, Scene};
use crate::visibility::Visibility;
use block::BLOCK;
use budget::Budget;
use glam::{DVec2, DVec3, Vec3};
use guide::Guides;
use landing::Landings;
pub use mask::sees_no_emitter;
use pulp::Arch;
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

/// Hemisphere rays at each sample, where no other number is asked for.
///
/// The error of `gather` goes with samples times rays, not with either: 32 x 16 errs by a tenth to a third less than
/// 16 x 32 in about the same time (glass aside), as more samples also find the edges of lamps and what mirrors show.
pub const GATHER_RAYS: u32 = 16;

impl Method {
    /// Samples a pixel, where no other number is asked for.
    pub fn default_spp(self) -> u32 {
        match self {
            Method::Path => 256,
            Method::TwoPass(Quality::Gather) => 32,
            _ => 16,
        }
    }
}

impl Quality {
    /// All, from the fastest to the finest.
    pub const ALL: [Quality; 3] = [Quality::Mesh, Quality::Direct, Quality::Gather];

    /// Its name on the command line and in scene files.
    pub fn name(self) -> &'static str {
        match self {
            Quality::Mesh => "mesh",
            Quality::Direct => "direct",
            Quality::Gather => "gather",
        }
    }
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
    /// Hemisphere rays at each sample ([`Quality::Gather`]), on average over the picture.
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
    landings: &'a Landings,
    guides: Option<&'a Guides>,
    settings: Settings,
    arch: Arch,
    /// Work so far, `dropped` summed over all samples.
    work: Cell<Traced>,
}

impl Context<'_, '_> {
    /// Counts rays that were cast.
    fn cast(&self, rays: u32) {
        let work = self.work.get();
        self.work.set(Traced { rays: work.rays + u64::from(rays), ..work });
    }

    /// Counts a branch that is cut off, and its share of what a camera ray sees.
    fn cut(&self, share: f64) {
        let work = self.work.get();
        self.work.set(Traced { dropped: work.dropped + share, ..work });
    }

    /// Work so far, of all pixels as one.
    fn traced(&self) -> Traced {
        let work = self.work.get();
        Traced { dropped: work.dropped / f64::from(self.settings.spp.max(1)), ..work }
    }
}

/// What it took to render a picture.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Traced {
    /// Rays cast.
    pub rays: u64,
    /// Of these, rays that looked at the whole picture beforehand, for quality gather.
    pub looks: u64,
    /// Share of the camera rays' weight, over the whole picture, on branches that were cut off after their 512th specular
    /// surface: what they would have shown is missing.
    pub dropped: f64,
}

/// What a user should know of branches that were cut off ([`Traced::dropped`]): that more than one part in 10,000 is missing.
pub fn cut_off(dropped: f64) -> Option<String> {
    (dropped > 1e-4).then(|| {
        format!(
            "view rays were cut off at their 512th mirror or glass surface: {:.2} % of their weight is missing from the picture",
            100.0 * dropped
        )
    })
}

impl std::ops::Add for Traced {
    type Output = Traced;

    fn add(self, other: Traced) -> Traced {
        Traced {
            rays: self.rays + other.rays,
            looks: self.looks + other.looks,
            dropped: self.dropped + other.dropped,
        }
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
        sobol(self.index, 0, self.seed_of(set))
    }

    /// The seed of a set's numbers.
    fn seed_of(&self, set: u32) -> u32 {
        seed_of(&[self.seed, set])
    }

    /// Four numbers of this sample in units of 2^-32, for several pixels to shift.
    fn bits(&self, set: u32) -> [u32; 4] {
        sobol_bits(self.index, self.seed_of(set))
    }

    /// What a pixel shifts the numbers of a set by that it shares with others: the same for all of its samples.
    fn shift(&self, set: u32) -> [u32; 3] {
        let seed = self.seed_of(set);
        [0, 1, 2].map(|d| seed_of(&[seed, d]))
    }

    /// Four numbers of the `k`-th of `count` sub-samples of this sample.
    fn split(&self, set: u32, k: u32, count: u32) -> [f64; 4] {
        sobol(self.index.wrapping_mul(count).wrapping_add(k), 0, self.seed_of(set))
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

/// Settings of pixels that see a mirror or glass first: as many hemisphere rays in all.
fn finer(settings: &Settings) -> Settings {
    Settings {
        spp: settings.spp.saturating_mul(FINER),
        gather_rays: settings.gather_rays.div_ceil(FINER),
        emitter_samples: settings.emitter_samples.div_ceil(FINER),
        estimator: match settings.estimator {
            Estimator::Lobe(n) => Estimator::Lobe(n.div_ceil(FINER)),
            frustum => frustum,
        },
        ..*settings
    }
}

/// Whether a pixel at (x, y) sees a perfect mirror or glass first. The answer depends on no sample of the pixel, so
/// that samples chosen by it are without bias.
fn sees_perfect_lobe(visibility: &Visibility, frame: &CameraFrame, x: u32, y: u32) -> bool {
    let scene = visibility.scene();
    let mut rays = RayLanes { origin: [[0.0; LANES]; 3], direction: [[0.0; LANES]; 3] };
    for k in 0..PROBES * PROBES {
        let at = |k: u32| (f64::from(k) + 0.5) / f64::from(PROBES);
        let (origin, direction) = frame.ray(f64::from(x) + at(k % PROBES), f64::from(y) + at(k / PROBES));
        rays.set(k as usize, origin, direction.as_vec3());
    }
    let mut packet = RayPacket::new();
    packet.fill(&rays, (1 << (PROBES * PROBES)) - 1);
    visibility.closest16(&mut packet, true);
    (0..(PROBES * PROBES) as usize).any(|k| {
        let hit = visibility.lane(&packet, k, rays.origin(k), rays.direction(k), u32::MAX);
        hit.is_some_and(|h| scene.material(&scene.faces[h.face as usize]).has_perfect_lobe())
    })
}

/// Renders an image: mean radiance over each pixel's area [W m^-2 sr^-1], row 0 at the top.
///
/// `solution` is needed by every method but [`Method::Whitted`] and [`Method::Path`]; without it diffuse
/// interreflection is left out. Returns the image and what it took. `progress` is called with the number of pixels finished. The result does
/// not depend on the number of threads.
pub fn render(
    visibility: &Visibility,
    emitters: &Emitters,
    solution: Option<&Solution>,
    camera: &Camera,
    settings: &Settings,
    progress: &(dyn Fn(u64) + Sync),
) -> (Image, Traced) {
    Renderer::new(visibility, emitters, solution, camera.size, settings).render(camera, progress)
}

/// Some pixels of an image alone, (column, row) from the top left: what [`render`] gives for them, and what it took;
/// what was dropped is summed over the pixels.
pub fn render_pixels(
    visibility: &Visibility,
    emitters: &Emitters,
    solution: Option<&Solution>,
    (camera, pixels): (&Camera, &[[u32; 2]]),
    settings: &Settings,
) -> (Vec<Rgb>, Traced) {
    let renderer = Renderer::new(visibility, emitters, solution, camera.size, settings);
    let (budget, looks) = renderer.budget(camera, Some(pixels));
    let frame = camera.frame(visibility.scene());
    let index2 = index2_at(visibility, &frame);
    let shaded: Vec<(Vec<Rgb>, Traced)> = pixels
        .par_iter()
        .with_min_len(TILE as usize)
        .map(|[x, y]| renderer.block(&frame, budget.as_ref(), &[(*x, *y)]))
        .collect();
    let traced = shaded.iter().fold(Traced::default(), |sum, pixel| sum + pixel.1);
    let radiance = shaded.iter().flat_map(|s| s.0.iter().map(|r| *r * index2)).collect();
    (radiance, Traced { rays: traced.rays + looks, looks, ..traced })
}

/// Renders images of one size, one after the other, and keeps what they share.
pub struct Renderer<'a, 's> {
    visibility: &'a Visibility<'s>,
    emitters: &'a Emitters,
    solution: Option<&'a Solution>,
    landings: Landings,
    guides: Option<Guides>,
    settings: Settings,
    /// Whether pixels are probed for a mirror or glass seen first, where settings are finer.
    probes: bool,
    /// What the processor can do.
    arch: Arch,
}

impl<'a, 's> Renderer<'a, 's> {
    /// For images of `size` pixels; else as [`render`].
    pub fn new(
        visibility: &'a Visibility<'s>,
        emitters: &'a Emitters,
        solution: Option<&'a Solution>,
        size: [u32; 2],
        settings: &Settings,
    ) -> Renderer<'a, 's> {
        let scene = visibility.scene();
        let gathers = settings.method == Method::TwoPass(Quality::Gather);
        let probes = gathers && scene.faces.iter().any(|f| scene.material(f).has_perfect_lobe());
        let landings = Landings::new(scene, emitters, solution);
        let guides = solution.and_then(|s| Guides::new(scene, s, size, settings));
        Renderer {
            visibility,
            emitters,
            solution,
            landings,
            guides,
            settings: *settings,
            probes,
            arch: Arch::new(),
        }
    }

    /// [`render`], from one camera: what it gives does not depend on what was rendered before.
    pub fn render(&self, camera: &Camera, progress: &(dyn Fn(u64) + Sync)) -> (Image, Traced) {
        let (budget, looks) = self.budget(camera, None);
        let shade = |frame: &CameraFrame, pixels: &[(u32, u32)]| self.block(frame, budget.as_ref(), pixels);
        let (image, traced) = film(self.visibility, camera, progress, shade);
        (image, Traced { rays: traced.rays + looks, looks, ..traced })
    }

    /// What a ray may ask where a picture has these settings.
    fn context<'c>(&'c self, guides: Option<&'c Guides>, settings: Settings) -> Context<'c, 's> {
        let &Renderer { visibility, emitters, solution, ref landings, arch, .. } = self;
        let scene = visibility.scene();
        let work = Cell::default();
        Context { scene, visibility, emitters, solution, landings, guides, settings, arch, work }
    }

    /// Mean radiance (over index squared) over pixels of one block [W m^-2 sr^-1], and what it took; what was dropped is summed over the pixels.
    /// Without a budget rays go everywhere alike.
    fn block(
        &self,
        frame: &CameraFrame,
        budget: Option<&Budget>,
        pixels: &[(u32, u32)],
    ) -> (Vec<Rgb>, Traced) {
        let guides = self.guides.as_ref().filter(|_| budget.is_some());
        let gather_rays = budget.zip(pixels.first()).map_or(self.settings.gather_rays, |(b, at)| b.of(*at));
        let settings = Settings { gather_rays, ..self.settings };
        let coarse = self.context(guides, settings);
        if settings.method == Method::Path {
            let path = |origin, direction, sampler| coarse.path(origin, direction, sampler);
            let radiance = pixels.iter().map(|at| pixel(frame, *at, (settings.spp, settings.seed), path));
            return (radiance.collect(), coarse.traced());
        }
        if !self.probes {
            return (coarse.block(frame, pixels)[..pixels.len()].to_vec(), coarse.traced());
        }
        coarse.cast(PROBES * PROBES * pixels.len() as u32);
        let finely = |at: &(u32, u32)| sees_perfect_lobe(self.visibility, frame, at.0, at.1);
        let (many, few): (Vec<_>, Vec<_>) = pixels.iter().partition(|at| finely(at));
        let finer = self.context(guides, finer(&settings));
        let mut found: Vec<((u32, u32), Rgb)> = Vec::with_capacity(pixels.len());
        for (context, pixels) in [(&coarse, few), (&finer, many)] {
            found.extend(pixels.iter().copied().zip(context.block(frame, &pixels)));
        }
        let radiance = |at: &(u32, u32)| found.iter().find(|f| f.0 == *at).map_or(Rgb::ZERO, |f| f.1);
        (pixels.iter().map(radiance).collect(), coarse.traced() + finer.traced())
    }
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
) -> (Image, Traced) {
    let scene = visibility.scene();
    film(visibility, camera, progress, |frame, pixels| {
        let seen = |origin: Vec3, direction: DVec3, sampler: Sampler| {
            let Some(hit) = visibility.closest(origin, direction.as_vec3(), u32::MAX) else {
                return scene.environment;
            };
            let emitted = emitters.at(hit.face, hit.front).map_or(Rgb::ZERO, |(radiance, _)| radiance);
            let uv = DVec2::new(f64::from(hit.u), f64::from(hit.v));
            emitted + solution.leaving(scene, (hit.face, hit.front), uv, -direction, sampler.numbers(1))
        };
        let radiance = pixels.iter().map(|at| pixel(frame, *at, (spp, seed), seen)).collect();
        (radiance, Traced { rays: u64::from(spp) * pixels.len() as u64, ..Traced::default() })
    })
}

/// Squared index of the medium in which a camera's eye lies: what rays bring is radiance over that, and what is seen is radiance.
fn index2_at(visibility: &Visibility, frame: &CameraFrame) -> f64 {
    let media = Media::new(visibility.scene());
    media.map_or(1.0, |media| media.point_index2(visibility, frame.origin()))
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
        let (origin, direction) = frame.ray(f64::from(x) + u[0], f64::from(y) + u[1]);
        sample(origin, direction, sampler)
    });
    samples.sum::<Rgb>() / f64::from(spp.max(1))
}

/// All pixels of an image, tile by tile on all cores; `shade` gives the radiance (over index squared) of the pixels of a block, at most
/// [`BLOCK`] x [`BLOCK`], and the rays that they took.
fn film(
    visibility: &Visibility,
    camera: &Camera,
    progress: &(dyn Fn(u64) + Sync),
    shade: impl Fn(&CameraFrame, &[(u32, u32)]) -> (Vec<Rgb>, Traced) + Sync,
) -> (Image, Traced) {
    let frame = camera.frame(visibility.scene());
    let index2 = index2_at(visibility, &frame);
    let [width, height] = camera.size;
    let columns = width.div_ceil(TILE);
    // Coordinates of the pixels of a square, as far as they are in the image.
    let square = |x0: u32, y0: u32, edge: u32| {
        let row = move |y| (x0..(x0 + edge).min(width)).map(move |x| (x, y));
        (y0..(y0 + edge).min(height)).flat_map(row)
    };
    let tiles: Vec<(Vec<_>, Traced)> = (0..columns * height.div_ceil(TILE))
        .into_par_iter()
        .with_max_len(1)
        .map(|tile| {
            let mut traced = Traced::default();
            let mut pixels = Vec::with_capacity((TILE * TILE) as usize);
            let corners = square(tile % columns * TILE, tile / columns * TILE, TILE);
            for (x, y) in corners.filter(|(x, y)| x % BLOCK == 0 && y % BLOCK == 0) {
                let block: Vec<(u32, u32)> = square(x, y, BLOCK).collect();
                let (radiance, work) = shade(&frame, &block);
                traced = traced + work;
                pixels.extend(
                    block.into_iter().zip(radiance.iter().map(|r| (*r * index2).as_vec3().to_array())),
                );
            }
            progress(pixels.len() as u64);
            (pixels, traced)
        })
        .collect();
    let mut image = Image::new(width as usize, height as usize);
    for ((x, y), pixel) in tiles.iter().flat_map(|t| &t.0) {
        image.set(*x as usize, *y as usize, *pixel);
    }
    let all = tiles.iter().fold(Traced::default(), |sum, tile| sum + tile.1);
    (image, Traced { dropped: all.dropped / (f64::from(width) * f64::from(height)).max(1.0), ..all })
}
