//! Specular chains of pass 1: rays that go on over mirrors, glass and glossy lobes.
//!
//! A chain carries its weight; each diffuse surface on the way is counted with the weight that the
//! chain had when it arrived (DESIGN section 2). Scenes without specular surfaces never come here.

use crate::bsdf::Specular;
use crate::color::{self, Rgb};
use crate::emitters::{Emitters, Passage};
use crate::sampling::{seed_of, sobol};
use crate::visibility::{SurfaceHit, Visibility};
use glam::{DVec3, Vec3};

/// Surfaces that a chain touches at most; what it still carries is reported as dropped.
const LONGEST: u32 = 1024;
/// Chains weaker than this play Russian roulette.
const WEAK: f64 = 0.1;
/// Chains longer than this play Russian roulette, whatever they carry.
const LONG: u32 = 128;
/// Chance that such a chain goes on. A smaller one would leave light that is caught in glass to few chains of great weight.
const GOES_ON: f64 = 0.99;

/// What a chain carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carried {
    /// Radiance, backwards: from where it is seen to where it comes from.
    Radiance,
    /// Power, forwards, from an emitter.
    Power,
}

/// What became of the weight that no diffuse surface on a chain's way has taken.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ChainEnd {
    /// Left the scene.
    pub escaped: Rgb,
    /// Lost in specular reflection or refraction, or at black surfaces.
    pub absorbed: Rgb,
    /// Still carried where the chain was cut.
    pub dropped: Rgb,
    /// What Russian roulette added to the weight, or took from it: zero on average. All shares together, what diffuse surfaces took
    /// included, make 1 and this.
    pub roulette: Rgb,
    /// Rays cast.
    pub rays: u32,
}

/// One meeting of a chain with a surface.
#[derive(Debug, Clone, Copy)]
pub struct Link {
    /// Where.
    pub hit: SurfaceHit,
    /// Weight on arrival.
    pub weight: Rgb,
    /// How the path went so far.
    pub passage: Passage,
    /// Length of the path so far \[m\].
    pub length: f64,
    /// Direction of arrival.
    pub direction: DVec3,
}

/// Follows specular chains.
pub struct Chains<'a, 's> {
    visibility: &'a Visibility<'s>,
    emitters: Option<&'a Emitters>,
}

impl<'a, 's> Chains<'a, 's> {
    /// Chains in a scene; with `emitters`, paths over flat mirrors are told apart.
    pub fn new(visibility: &'a Visibility<'s>, emitters: Option<&'a Emitters>) -> Chains<'a, 's> {
        Chains { visibility, emitters }
    }

    /// Follows the chain that begins where a ray from `origin` along `direction` met `hit`.
    ///
    /// `visit` sees every surface after the first. `point` and `seed` name the random numbers. `worth`, in (0, 1], is what
    /// the light is multiplied by where the chain begins: one that counts for little need not be followed far.
    pub fn follow(
        &self,
        carried: Carried,
        (origin, direction, hit): (Vec3, Vec3, SurfaceHit),
        (point, seed): (u32, u32),
        worth: f64,
        mut visit: impl FnMut(&Link),
    ) -> ChainEnd {
        let scene = self.visibility.scene();
        let mut at = self.visibility.point(&hit);
        let mut direction = direction.as_dvec3();
        let mut length = at.point.distance(origin.as_dvec3());
        let mut weight = Rgb::ONE;
        let mut passage = Passage::Straight;
        let mut end = ChainEnd::default();
        for k in 0..LONGEST {
            let material = scene.material(&scene.faces[at.face as usize]);
            let black = !at.front && !material.two_sided;
            // Diffuse surfaces take their part where `visit` counts them.
            let offered = if material.is_diffuse() && !black { weight * pass_on(material) } else { weight };
            end.absorbed += offered;
            if black || !material.is_specular() {
                return end;
            }
            let u = sobol(point, 1 + k % 60, if k < 60 { seed } else { seed_of(&[seed, k]) });
            let wo = -direction;
            let specular = Specular::new(material, wo, at.facing(wo), at.geometric, at.front);
            let Some(s) = specular.sample([u[0], u[1], u[2]]) else { return end };
            // A shading normal may have turned the direction of a wide lobe to the wrong side of the face.
            if (s.direction.dot(at.geometric) > 0.0) == s.transmitted {
                return end;
            }
            weight *= s.weight;
            if carried == Carried::Power {
                weight *= s.power_factor(wo, at.geometric);
            }
            let strength = worth * color::mean(weight);
            let survive = if strength < WEAK { strength / WEAK } else { 1.0 };
            let survive = if k < LONG { survive } else { survive.min(GOES_ON) };
            end.absorbed -= weight;
            if survive < 1.0 {
                end.roulette -= weight;
                if u[3] >= survive {
                    return end;
                }
                weight /= survive;
                end.roulette += weight;
            }
            let image = self.emitters.is_some_and(|e| e.is_image_mirror(at.face));
            passage = if passage == Passage::Straight && image { Passage::Image } else { Passage::Chain };
            direction = s.direction;
            let side = if s.transmitted { -at.geometric } else { at.geometric };
            let from = self.visibility.leave(at.face, at.point, side);
            end.rays += 1;
            let Some(next) = self.visibility.closest(from, direction.as_vec3(), at.face) else {
                end.escaped = weight;
                return end;
            };
            let before = at.point;
            at = self.visibility.point(&next);
            length += at.point.distance(before);
            visit(&Link { hit: next, weight, passage, length, direction });
        }
        end.dropped = weight;
        end
    }
}

/// The share that a surface passes on specularly at most.
pub fn pass_on(material: &crate::scene::Material) -> Rgb {
    if material.is_glass() {
        Rgb::ONE - material.diffuse - material.diffuse_transmission
    } else {
        material.specular
    }
}
