//! Surface materials.

use crate::color::{self, Rgb};

/// Larger radiances, or sums of them, would leave the range of single precision, in which images are written [W m^-2 sr^-1].
pub(super) const MOST_RADIANCE: f64 = 1e30;

/// Below this GGX width a lobe is a perfect mirror: its angular size is below f32's resolution.
pub const MIRROR_ALPHA: f64 = 1e-4;

/// How a surface reflects, transmits and emits. All albedos are products of the paper's
/// `k` and `rho` (DESIGN section 2) and sum to at most 1 in each channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the MTL or the scene file.
    pub name: String,
    /// Diffuse albedo, [0, 1].
    pub diffuse: Rgb,
    /// Diffuse transmittance (translucency), [0, 1].
    pub diffuse_transmission: Rgb,
    /// Albedo of the specular lobe, [0, 1].
    pub specular: Rgb,
    /// Perceptual roughness, [0, 1]; 0 is a perfect mirror.
    pub roughness: f64,
    /// Specular transmittance of glass, [0, 1]; zero: opaque. What each crossing of the surface leaves of the
    /// refracted light, as MTL's `Tf` is read by other renderers too (a tint of the interface): a body of glass, crossed
    /// twice, shows its square, whatever its thickness. Beer's law, by length, would need a unit that MTL does not have.
    pub specular_transmission: Rgb,
    /// Index of refraction inside, relative to outside.
    pub ior: f64,
    /// The surface is a sheet of glass with both its faces: light goes straight on.
    pub thin: bool,
    /// Emitted radiance [W m^-2 sr^-1], from the front.
    pub emission: Rgb,
    /// Emit from the back too.
    pub emit_both_sides: bool,
    /// Reflect on both sides; a one-sided surface is black on its back. Of what lets light through, the loader makes both take part.
    pub two_sided: bool,
}

impl Material {
    /// A black, two-sided material.
    pub fn new(name: impl Into<String>) -> Material {
        Material {
            name: name.into(),
            diffuse: Rgb::ZERO,
            diffuse_transmission: Rgb::ZERO,
            specular: Rgb::ZERO,
            roughness: 0.0,
            specular_transmission: Rgb::ZERO,
            ior: 1.5,
            thin: false,
            emission: Rgb::ZERO,
            emit_both_sides: false,
            two_sided: true,
        }
    }

    /// What a surface gets whose material is defined nowhere: diffuse, 50 % grey.
    pub fn grey(name: impl Into<String>) -> Material {
        Material { diffuse: Rgb::splat(0.5), ..Material::new(name) }
    }

    /// Scales the four albedos down, all alike, where they would reflect and transmit more than
    /// arrives in some channel. Returns the largest sum before, if it was above 1.
    pub fn conserve_energy(&mut self) -> Option<f64> {
        let sum = self.diffuse + self.diffuse_transmission + self.specular + self.specular_transmission;
        let sum = sum.max_element();
        if sum <= 1.0 + 1e-9 {
            return None;
        }
        self.diffuse /= sum;
        self.diffuse_transmission /= sum;
        self.specular /= sum;
        self.specular_transmission /= sum;
        Some(sum)
    }

    /// Leaves out the specular albedo of glass that cannot come on top of what it transmits: those who write `specular = 1`
    /// beside `specular_transmission = 1` mean the tint of the Fresnel reflection, which glass has of itself. Returns
    /// whether that was so.
    pub fn leave_reflection_to_fresnel(&mut self) -> bool {
        let meant = self.is_glass()
            && self.ior != 1.0
            && self.specular != Rgb::ZERO
            && (self.specular + self.specular_transmission).max_element() > 1.0 + 1e-9;
        if meant {
            self.specular = Rgb::ZERO;
        }
        meant
    }

    /// GGX width: roughness squared.
    pub fn alpha(&self) -> f64 {
        self.roughness * self.roughness
    }

    /// Reflects or transmits diffusely, so pass 1 gathers at it.
    pub fn is_diffuse(&self) -> bool {
        self.diffuse != Rgb::ZERO || self.is_translucent()
    }

    /// Couples its two sides by diffuse transmission.
    pub fn is_translucent(&self) -> bool {
        self.diffuse_transmission != Rgb::ZERO
    }

    /// Reflects or refracts specularly, so chains go on at it.
    pub fn is_specular(&self) -> bool {
        self.specular != Rgb::ZERO || self.is_glass()
    }

    /// Reflects or refracts over a lobe that has a width.
    pub fn is_glossy(&self) -> bool {
        let spreads = self.specular != Rgb::ZERO || (self.is_glass() && self.ior != 1.0);
        spreads && self.alpha() >= MIRROR_ALPHA
    }

    /// Reflects or refracts in one direction only, as a mirror, clear glass or a thin window does.
    pub fn has_perfect_lobe(&self) -> bool {
        let smooth = self.alpha() < MIRROR_ALPHA;
        self.is_specular() && (smooth || (self.is_glass() && self.ior == 1.0))
    }

    /// Refracts.
    pub fn is_glass(&self) -> bool {
        self.specular_transmission != Rgb::ZERO
    }

    /// Light goes through, to one side of a sheet from the other.
    pub fn lets_through(&self) -> bool {
        self.is_glass() || self.is_translucent()
    }

    /// Is the surface of a body of another index than its surroundings: a window or a thin sheet is not.
    pub fn bends(&self) -> bool {
        self.is_glass() && !self.thin && self.ior != 1.0
    }

    /// Whether a translucent sheet of this material, laid on `base`, is one opaque surface with it.
    pub fn can_coat(&self, base: &Material) -> bool {
        let opaque = |m: &Material| !m.is_glass() && !m.is_emitter();
        self.is_translucent() && opaque(self) && opaque(base) && !base.is_translucent()
    }

    /// This opaque material under a translucent sheet, in contact: light that the sheet lets through goes back and forth
    /// between them, so that of what arrives `rho + tau^2 rho_b / (1 - rho rho_b)` leaves again, where rho and tau are the
    /// reflectance and transmittance of the sheet and rho_b is the reflectance of what it lies on (Stokes 1862, of a pile of
    /// plates). What comes through the sheet is diffuse, and so may be what lies below.
    pub fn coated(&self, sheet: &Material) -> Material {
        let (below, above) = (self.diffuse + self.specular, sheet.diffuse + sheet.specular);
        let tau = sheet.diffuse_transmission;
        // Of perfect white between perfect white nothing comes through.
        let between = (Rgb::ONE - above * below).max(Rgb::splat(f64::MIN_POSITIVE));
        Material {
            name: format!("{} on {}", sheet.name, self.name),
            diffuse: sheet.diffuse + tau * tau * below / between,
            diffuse_transmission: Rgb::ZERO,
            two_sided: self.two_sided,
            ..sheet.clone()
        }
    }

    /// Emits light.
    pub fn is_emitter(&self) -> bool {
        self.emission != Rgb::ZERO
    }

    /// Whether a surface shows the same on its back as on its front.
    pub fn is_alike_on_both_sides(&self) -> bool {
        self.two_sided && (self.emit_both_sides || !self.is_emitter())
    }

    /// Radiance emitted from the front (`true`) or the back.
    pub fn emitted(&self, front: bool) -> Rgb {
        if front || self.emit_both_sides { self.emission } else { Rgb::ZERO }
    }

    /// Whether chains through this material keep one weight for all channels.
    pub fn has_grey_specular(&self) -> bool {
        let grey = color::is_grey(self.specular) && color::is_grey(self.specular_transmission);
        // Glass reflects what the diffuse part leaves.
        grey && (!self.is_glass() || color::is_grey(self.diffuse + self.diffuse_transmission))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn energy_is_conserved_in_the_worst_channel() {
        let mut m = Material::new("m");
        m.diffuse = Rgb::new(0.5, 1.0, 0.0);
        m.specular = Rgb::splat(0.5);
        m.specular_transmission = Rgb::new(0.5, 0.5, 0.25);
        m.emission = Rgb::splat(5.0);
        assert_eq!(m.conserve_energy(), Some(2.0));
        assert_eq!((m.diffuse, m.specular), (Rgb::new(0.25, 0.5, 0.0), Rgb::splat(0.25)));
        assert_eq!(m.specular_transmission, Rgb::new(0.25, 0.25, 0.125));
        assert_eq!(m.emission, Rgb::splat(5.0));
        assert_eq!(m.conserve_energy(), None);
    }

    #[test]
    fn glass_with_a_reflectance_of_one_is_glass() {
        let mut m = Material::new("m");
        (m.specular, m.specular_transmission) = (Rgb::ONE, Rgb::ONE);
        assert!(m.leave_reflection_to_fresnel());
        assert_eq!((m.specular, m.conserve_energy()), (Rgb::ZERO, None));
        // Silvered glass: half a mirror, half glass.
        (m.specular, m.specular_transmission) = (Rgb::splat(0.5), Rgb::splat(0.5));
        assert!(!m.leave_reflection_to_fresnel());
        assert_eq!(m.specular, Rgb::splat(0.5));
    }

    #[test]
    fn sheets_on_opaque_surfaces_pass_light_back_and_forth() {
        let mut sheet = Material { diffuse_transmission: Rgb::new(0.5, 0.3, 0.7), ..Material::new("sheet") };
        sheet.diffuse = Rgb::new(0.2, 0.6, 0.3);
        let base = Material { diffuse: Rgb::new(0.8, 0.5, 1.0), ..Material::new("base") };
        assert!(sheet.can_coat(&base) && !base.can_coat(&sheet) && !sheet.can_coat(&sheet));
        let both = base.coated(&sheet);
        for c in 0..3 {
            // What goes down, and comes back up, pass by pass.
            let (mut up, mut down) = (sheet.diffuse[c], sheet.diffuse_transmission[c]);
            for _ in 0..200 {
                let back = down * base.diffuse[c];
                up += back * sheet.diffuse_transmission[c];
                down = back * sheet.diffuse[c];
            }
            assert!((both.diffuse[c] - up).abs() < 1e-14);
        }
        // Nothing is lost in the last channel.
        assert!((both.diffuse[2] - 1.0).abs() < 1e-14 && !both.is_translucent());
        // Nor made where all of it is white.
        sheet.diffuse = Rgb::ONE;
        sheet.diffuse_transmission = Rgb::ZERO;
        assert_eq!(Material { diffuse: Rgb::ONE, ..base }.coated(&sheet).diffuse, Rgb::ONE);
    }

    #[test]
    fn rounding_is_not_excess() {
        let mut m = Material::grey("m");
        m.diffuse_transmission = Rgb::splat(0.5 + 1e-10);
        let before = m.clone();
        assert_eq!(m.conserve_energy(), None);
        assert_eq!(m, before);
    }
}
