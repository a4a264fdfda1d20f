//! Small geometry: orthonormal frames, planar reflection, points on faces.

use glam::DVec3;

/// An orthonormal basis whose z axis is a surface normal.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    /// First tangent.
    pub x: DVec3,
    /// Second tangent.
    pub y: DVec3,
    /// The normal.
    pub z: DVec3,
}

impl Frame {
    /// A frame about a unit normal (Duff et al. 2017, "Building an orthonormal basis, revisited").
    pub fn new(z: DVec3) -> Frame {
        let sign = 1f64.copysign(z.z);
        let a = -1.0 / (sign + z.z);
        let b = z.x * z.y * a;
        Frame {
            x: DVec3::new(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x),
            y: DVec3::new(b, sign + z.y * z.y * a, -z.y),
            z,
        }
    }

    /// From this frame's coordinates to the scene's.
    pub fn to_scene(&self, v: DVec3) -> DVec3 {
        self.x * v.x + self.y * v.y + self.z * v.z
    }

    /// From the scene's coordinates to this frame's.
    pub fn to_local(&self, v: DVec3) -> DVec3 {
        DVec3::new(v.dot(self.x), v.dot(self.y), v.dot(self.z))
    }
}

/// Mirror image of direction `d` (pointing away from the surface) about unit normal `n`.
pub fn reflect(d: DVec3, n: DVec3) -> DVec3 {
    2.0 * d.dot(n) * n - d
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal_and_right_handed() {
        for z in
            [DVec3::Z, -DVec3::Z, DVec3::X, DVec3::new(0.6, 0.0, -0.8), DVec3::new(1.0, 2.0, 3.0).normalize()]
        {
            let f = Frame::new(z);
            assert!(f.x.cross(f.y).distance(z) < 1e-14);
            assert!(f.x.dot(z).abs() < 1e-14 && (f.x.length() - 1.0).abs() < 1e-14);
            let v = DVec3::new(0.1, -0.7, 0.3);
            assert!(f.to_local(f.to_scene(v)).distance(v) < 1e-14);
        }
    }

    #[test]
    fn reflection_keeps_the_angle() {
        let r = reflect(DVec3::new(0.6, 0.0, 0.8), DVec3::Z);
        assert!(r.distance(DVec3::new(-0.6, 0.0, 0.8)) < 1e-15);
    }
}
