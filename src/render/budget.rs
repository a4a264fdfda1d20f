//! How many hemisphere rays each block of pixels gets, so that the image's noise is least for their number in all.
//!
//! With n rays on a block whose rays deviate by s, the sum of s^2 / n over the blocks is least for n in proportion to s (Neyman
//! 1934, optimal allocation). What is known of the patches in sight ([`super::guide`]) tells s beforehand; no sample
//! does, so the estimate stays free of bias.

use super::block::BLOCK;
use super::guide::Guides;
use super::{Context, Renderer};
use crate::color;
use crate::mesh::NONE;
use crate::scene::Camera;
use rayon::prelude::*;

/// Least rays of a block over those asked for: what is dark keeps most of its smoothness.
const LEAST: f64 = 0.5;
/// Most of them.
const MOST: f64 = 8.0;
/// Rays along each side of a block that find out what it shows.
const LOOKS: u32 = 2;
/// Blocks that tell how much there is to share out, about: those of a picture of 512 x 512.
const TELLING: u32 = 1 << 14;
/// 2^32 over the golden ratio: its multiples are spread evenly.
const GOLDEN: u32 = 0x9e37_79b9;

/// Hemisphere rays at a sample, by block of pixels.
pub(super) struct Budget {
    columns: u32,
    rays: Vec<u32>,
}

impl Budget {
    /// Those of a pixel's block.
    pub fn of(&self, (x, y): (u32, u32)) -> u32 {
        self.rays[(y / BLOCK * self.columns + x / BLOCK) as usize]
    }
}

/// What one ray of a block sees: the patches that receive light on both sides, and the albedos by which it is seen.
type Seen = [(u32, f32); 2];

impl Context<'_, '_> {
    /// What the rays of a block see; nothing of those that meet no diffuse surface.
    fn seen(&self, guides: &Guides, camera: &Camera, block: u32) -> [Option<Seen>; (LOOKS * LOOKS) as usize] {
        let frame = camera.frame(self.scene);
        let columns = camera.size[0].div_ceil(BLOCK);
        let corner = [block % columns * BLOCK, block / columns * BLOCK];
        let edge = [0, 1].map(|d| (camera.size[d] - corner[d]).min(BLOCK));
        std::array::from_fn(|k| {
            let k = k as u32;
            let at = |d: usize, k: u32| {
                f64::from(corner[d]) + f64::from(edge[d]) * (f64::from(k) + 0.5) / f64::from(LOOKS)
            };
            let (origin, direction) = frame.ray(at(0, k % LOOKS), at(1, k / LOOKS));
            let hit = self.visibility.closest(origin, direction.as_vec3(), u32::MAX)?;
            let material = self.scene.material(&self.scene.faces[hit.face as usize]);
            let lit = material.is_diffuse() && (hit.front || material.two_sided);
            lit.then(|| {
                let receives = |albedo, side| match color::mean(albedo) {
                    0.0 => (NONE, 0.0),
                    albedo => (guides.patch(&hit, side), albedo as f32),
                };
                [receives(material.diffuse, 1.0), receives(material.diffuse_transmission, -1.0)]
            })
        })
    }
}

impl Renderer<'_, '_> {
    /// Rays of every block, or those of some `pixels`, where a camera's patches are few enough to be looked at, and the rays that this
    /// took.
    pub(super) fn budget(&self, camera: &Camera, pixels: Option<&[[u32; 2]]>) -> (Option<Budget>, u64) {
        let Some(guides) = &self.guides else { return (None, 0) };
        let columns = camera.size[0].div_ceil(BLOCK);
        let blocks = columns * camera.size[1].div_ceil(BLOCK);
        // In no step with the columns of blocks.
        let tells = |block: u32| block.wrapping_mul(GOLDEN) <= u32::MAX / blocks.div_ceil(TELLING);
        let mut wanted = vec![pixels.is_none(); blocks as usize];
        pixels
            .into_iter()
            .flatten()
            .for_each(|[x, y]| wanted[(y / BLOCK * columns + x / BLOCK) as usize] = true);
        let seen: Vec<_> = (0..blocks)
            .into_par_iter()
            .map(|block| {
                let needed = tells(block) || wanted[block as usize];
                needed.then(|| self.context(None, self.settings).seen(guides, camera, block))
            })
            .collect();
        let looks = seen.iter().flatten().count() as u64 * u64::from(LOOKS * LOOKS);
        let patches_of = |which: &dyn Fn(u32) -> bool| -> Vec<u32> {
            let chosen = seen.iter().enumerate().filter(|(block, _)| which(*block as u32));
            let mut patches: Vec<u32> =
                chosen.flat_map(|(_, seen)| seen.iter().flatten().flatten().flatten().map(|s| s.0)).collect();
            patches.par_sort_unstable();
            patches.dedup();
            patches.retain(|p| *p != NONE);
            patches
        };
        if !guides.are_worth(patches_of(&tells).len()) {
            return (None, looks);
        }
        let patches = patches_of(&|_| true);
        let known: Vec<(f64, u64)> = patches
            .par_iter()
            .map(|patch| {
                let context = self.context(None, self.settings);
                (context.deviation(guides, *patch), context.traced().rays)
            })
            .collect();
        let cast: u64 = known.iter().map(|k| k.1).sum();
        let deviation = |patch: u32| patches.binary_search(&patch).map_or(0.0, |k| known[k].0);
        let blocks: Vec<Option<f64>> = seen
            .iter()
            .map(|rays| {
                let rays = rays.as_ref()?;
                let variance = |seen: &Seen| {
                    seen.iter().map(|(p, a)| (f64::from(*a) * deviation(*p)).powi(2)).sum::<f64>()
                };
                let (sum, count) =
                    rays.iter().flatten().fold((0.0, 0.0), |(s, n), seen| (s + variance(seen), n + 1.0));
                (count > 0.0).then(|| f64::sqrt(sum / count))
            })
            .collect();
        (Some(Budget { columns, rays: share_out(&blocks, tells, self.settings.gather_rays) }), looks + cast)
    }
}

/// Rays about in proportion to deviations, `asked` on average (or near it) over the blocks that tell, and where nothing is known. They are `asked` times powers of two,
/// with which low-discrepancy points are at their best.
fn share_out(deviations: &[Option<f64>], tells: impl Fn(u32) -> bool, asked: u32) -> Vec<u32> {
    let telling = deviations.iter().enumerate().filter(|(block, _)| tells(*block as u32));
    let known: Vec<f64> = telling.filter_map(|(_, d)| *d).collect();
    let mean = known.iter().sum::<f64>() / known.len().max(1) as f64;
    let rays =
        |scale: f64, deviation: f64| (scale * deviation / mean).clamp(LEAST, MOST).log2().round().exp2();
    if mean.is_nan() || mean <= 0.0 {
        return vec![asked; deviations.len()];
    }
    // The more rays a block has at one scale, the more it has at a larger one; the ends leave all of them the least and the most.
    let (mut low, mut high) = (0.0, 2.0 * MOST);
    let all = |scale: f64| known.iter().map(|d| rays(scale, *d)).sum::<f64>() / known.len() as f64;
    for _ in 0..32 {
        let scale = 0.5 * (low + high);
        if all(scale) > 1.0 { high = scale } else { low = scale }
    }
    // Between them many blocks of one deviation may move together: what comes closer to the number asked for.
    let scale = if all(low) * all(high) < 1.0 { high } else { low };
    let count = |d: f64| ((f64::from(asked) * rays(scale, d)).round() as u32).max(1);
    deviations.iter().map(|d| d.map_or(asked, count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares go with the deviations, within their limits, and are as many as asked for in all.
    #[test]
    fn shares_go_with_deviations() {
        let few_bright: Vec<Option<f64>> =
            (0..1000).map(|k| Some(if k < 20 { 100.0 } else { 1.0 })).collect();
        let rays = share_out(&few_bright, |_| true, 16);
        assert_eq!((rays[0], rays[999]), (128, 16));
        let slope: Vec<Option<f64>> = (0..1000).map(|k| Some(f64::from(k))).collect();
        let rays = share_out(&slope, |_| true, 64);
        assert_eq!([10, 400, 700, 999].map(|k| rays[k]), [32, 64, 64, 128]);
        let mean = f64::from(rays.iter().sum::<u32>()) / 1000.0;
        assert!((mean - 64.0).abs() < 0.2, "{mean} {rays:?}");
    }

    /// What is not known gets what is asked for, and so does all where nothing deviates.
    #[test]
    fn what_is_not_known_is_not_moved() {
        assert_eq!(share_out(&[None, Some(1.0), Some(3.0), None], |_| true, 8)[0], 8);
        assert_eq!(share_out(&[None, Some(0.0), Some(0.0)], |_| true, 8), [8, 8, 8]);
        assert_eq!(share_out(&[None; 3], |_| true, 8), [8, 8, 8]);
        assert_eq!(share_out(&[Some(2.0); 3], |_| true, 1), [1, 1, 1]);
    }
}
