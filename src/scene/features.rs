//! What a scene needs: decides which parts of the program it runs at all.

use super::Scene;
use serde::Serialize;

/// The features of a scene. What is false costs nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Features {
    /// Some surface emits.
    pub emitters: bool,
    /// Light comes from outside.
    pub environment: bool,
    /// Some surface reflects or refracts specularly: pass 1 follows chains.
    pub specular: bool,
    /// Some specular lobe is wider than a perfect mirror's.
    pub glossy: bool,
    /// Some surface refracts.
    pub glass: bool,
    /// Specular weights differ between channels: three values a matrix entry instead of one.
    pub coloured_specular: bool,
    /// Some surface transmits diffusely: both its sides have elements, and are coupled.
    pub translucent: bool,
    /// Some face has shading normals.
    pub smooth_shading: bool,
    /// Some surface is black on its back.
    pub one_sided: bool,
}

impl Features {
    /// Inspects the materials that faces use.
    pub fn of(scene: &Scene) -> Features {
        let mut used = vec![false; scene.materials.len()];
        for face in &scene.faces {
            used[face.material as usize] = true;
        }
        let any =
            |f: &dyn Fn(&super::Material) -> bool| scene.materials.iter().zip(&used).any(|(m, u)| *u && f(m));
        Features {
            emitters: any(&|m| m.is_emitter()),
            environment: scene.environment.max_element() > 0.0,
            specular: any(&|m| m.is_specular()),
            glossy: any(&|m| m.is_glossy()),
            glass: any(&|m| m.is_glass()),
            coloured_specular: any(&|m| m.is_specular() && !m.has_grey_specular()),
            translucent: any(&|m| m.is_translucent()),
            smooth_shading: scene.faces.iter().any(|f| f.normals.is_some()),
            one_sided: any(&|m| !m.two_sided),
        }
    }

    /// Each feature by name, whether the scene has it, and what it brings.
    pub fn list(&self) -> [(&'static str, bool, &'static str); 9] {
        [
            ("emitters", self.emitters, "emitters sampled from every element and view point"),
            ("environment", self.environment, "escaped rays bring light"),
            ("specular", self.specular, "pass 1 follows specular chains, pass 2 recurses"),
            ("glossy", self.glossy, "GGX lobes sampled"),
            ("glass", self.glass, "Fresnel reflection and transmission"),
            ("coloured specular", self.coloured_specular, "three weights a matrix entry"),
            ("translucent", self.translucent, "diffuse transmission couples both sides"),
            ("smooth shading", self.smooth_shading, "normals interpolated"),
            ("one-sided", self.one_sided, "backs are black"),
        ]
    }
}
