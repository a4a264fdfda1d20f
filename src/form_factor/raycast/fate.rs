//! What became of the rays of one element in one randomisation.

use super::super::gathered::EmitterIrradiance;
use super::super::specular::ChainEnd;
use crate::color::Rgb;

/// A sum smaller than this part of what it should be is not scaled to that.
const LEAST: f64 = 1e-3;

/// Counts of rays, and sums over them.
#[derive(Clone, Copy, Default)]
pub(super) struct Fate {
    /// Landed where no light comes: began on a covered part of the element, and do not count.
    pub covered: u32,
    /// Left the scene at once.
    pub escaped: u32,
    /// Were absorbed where they first landed.
    pub absorbed: u32,
    /// Met the back of glass first, or what is black or glass inside of it.
    pub inside: u32,
    /// Of those, the squared indices less one.
    pub index2: f64,
    /// Ends of the chains.
    pub chains: ChainEnd,
    /// From emitters on the way.
    pub emitted: EmitterIrradiance,
}

impl Fate {
    /// What each of `rays` rays counts, so that all shares of this randomisation together make exactly what its open rays do, and what
    /// is lost is what surfaces absorb, not what Russian roulette took by chance: where surfaces pass on nearly all light, the one would
    /// hide the other. The ratio is off by the relative variance of the sum, which is small and falls with the number of rays.
    ///
    /// Where roulette left nothing, it counts as dropped.
    pub fn settle(&mut self, rays: usize) -> Rgb {
        let open = rays as f64 - f64::from(self.covered);
        let sum = Rgb::splat(open) + self.chains.roulette;
        let mut scale = Rgb::ONE;
        for c in 0..3 {
            if sum[c] > LEAST * open {
                scale[c] = open / sum[c];
            } else {
                self.chains.dropped[c] += open - sum[c];
            }
        }
        scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares of three channels: as they are, scaled, and nothing left.
    #[test]
    fn roulette_takes_no_light() {
        let chains = ChainEnd { roulette: Rgb::new(0.0, -4.0, -8.0), ..ChainEnd::default() };
        let mut fate = Fate { covered: 2, chains, ..Fate::default() };
        assert_eq!(fate.settle(10), Rgb::new(1.0, 2.0, 1.0));
        assert_eq!(fate.chains.dropped, Rgb::new(0.0, 0.0, 8.0));
    }
}
