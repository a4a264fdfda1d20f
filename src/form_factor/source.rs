//! The rays of a few neighbouring elements, 16 at a time, ordered so that a packet shares a narrow cone.
//!
//! Elements that follow each other and face the same way form a **group** of up to 16. Each group and randomisation has
//! one Owen scrambling of the points; each element shifts them by its own random bits (exclusive or): the origins by all
//! bits, the directions only below the leading [`SobolTable::shared_bits`]. So ray k of every element of the group lies
//! in the same cell of directions, and ray k of all of them makes a packet.
//!
//! An Owen scrambling followed by such a shift is again one: each element has the points that it would have alone. And
//! its shift is uniform within the cells, which hold equally many points each: given the scrambling, its expectation
//! is the mean over all origins and directions, whatever the scrambling. So the estimates of two elements of a group are
//! uncorrelated, though they share it.

use crate::embree::{LANES, RayLanes};
use crate::geometry::Frame;
use crate::mesh::Mesh;
use crate::sampling::{Scramble, ScrambledPoints, SobolTable, cosine_hemisphere_rough, seed_of, unit};
use crate::visibility::Visibility;
use glam::{DVec2, DVec3, Vec3};
use std::ops::Range;

/// Cosine between the normals of a group's first element and of any other, at least.
const ALIKE: f32 = 0.95;

/// What an element's rays have in common.
#[derive(Clone, Copy)]
pub(super) struct Source {
    pub(super) element: u32,
    pub(super) face: u32,
    pub(super) normal: DVec3,
    pub(super) area: f64,
}

/// Elements of one group, split from a block's elements; always the same whichever of them are cast.
pub(super) fn groups(mesh: &Mesh, normals: &[Vec3], block: Range<u32>) -> impl Iterator<Item = Range<u32>> {
    let normal = move |e: u32| {
        let (face, front, _) = mesh.place(e);
        normals[face as usize] * if front { 1.0 } else { -1.0 }
    };
    let mut next = block.start;
    std::iter::from_fn(move || {
        let first = next;
        let facing = (first < block.end).then(|| normal(first))?;
        next += 1;
        while next < block.end && next - first < LANES as u32 && normal(next).dot(facing) >= ALIKE {
            next += 1;
        }
        Some(first..next)
    })
}

/// The elements of a group that are cast, laid out over the lanes of a packet: with m elements, a power of
/// two ([`shared`]), lane l holds element l mod m and the (l / m)-th of the points that are due.
pub(super) struct Lanes {
    pub(super) sources: Vec<Source>,
    /// Lanes of one point.
    width: usize,
    origin: [[f32; LANES]; 3],
    a: [[f32; LANES]; 3],
    b: [[f32; LANES]; 3],
    x: [[f32; LANES]; 3],
    y: [[f32; LANES]; 3],
    z: [[f32; LANES]; 3],
    triangle: [bool; LANES],
    /// Some are triangles.
    triangles: bool,
    /// Of elements that are no parallelograms.
    twist: Option<Twist>,
    shift: [[u32; LANES]; 4],
}

/// What elements of quads that are no parallelograms need besides.
#[derive(Clone, Copy, Default)]
struct Twist {
    /// From where the third corner of a parallelogram would be to where it is.
    c: [[f32; LANES]; 3],
    /// How the density of area changes along both edges ([`crate::scene::FaceFrame::slopes`]).
    slopes: [[f32; LANES]; 2],
}

impl Lanes {
    pub(super) fn new(visibility: &Visibility, mesh: &Mesh, elements: impl Iterator<Item = u32>) -> Lanes {
        let scene = visibility.scene();
        let none = [[0.0; LANES]; 3];
        let mut lanes = Lanes {
            sources: Vec::with_capacity(LANES),
            width: 1,
            origin: none,
            a: none,
            b: none,
            x: none,
            y: none,
            z: none,
            triangle: [false; LANES],
            triangles: false,
            twist: None,
            shift: [[0; LANES]; 4],
        };
        for (k, element) in elements.enumerate() {
            let (face, _, cell) = mesh.place(element);
            let place = scene.face_frame(&scene.faces[face as usize]);
            let grid = mesh.grid(face);
            let inside = visibility.inside_cell(face, grid.cell_frame(cell));
            let (o, a, b) = inside;
            let normal = mesh.normal(scene, element);
            let frame = Frame::new(normal);
            let origin = visibility.leave(face, place.at(o), normal);
            let edge = |d: DVec2| {
                (d.x * place.e1 + d.y * place.e2 + (o.x * d.y + o.y * d.x) * place.twist).as_vec3()
            };
            if place.is_twisted() {
                let twist = lanes.twist.get_or_insert_default();
                let (c, slopes) = ((a.x * b.y * place.twist).as_vec3(), place.slopes(inside));
                (0..3).for_each(|d| twist.c[d][k] = c[d]);
                (0..2).for_each(|d| twist.slopes[d][k] = slopes[d] as f32);
            }
            for c in 0..3 {
                lanes.origin[c][k] = origin[c];
                lanes.a[c][k] = edge(a)[c];
                lanes.b[c][k] = edge(b)[c];
                lanes.x[c][k] = frame.x.as_vec3()[c];
                lanes.y[c][k] = frame.y.as_vec3()[c];
                lanes.z[c][k] = frame.z.as_vec3()[c];
            }
            lanes.triangle[k] = grid.is_triangle();
            lanes.triangles |= grid.is_triangle();
            lanes.sources.push(Source { element, face, normal, area: mesh.area(element) });
        }
        debug_assert!(lanes.sources.len().is_power_of_two());
        lanes.width = lanes.sources.len();
        lanes
    }

    /// Copies what the first lanes hold to the others.
    fn repeat(&mut self) {
        let width = self.width;
        for l in width..LANES {
            for v in [&mut self.origin, &mut self.a, &mut self.b, &mut self.x, &mut self.y, &mut self.z] {
                v.iter_mut().for_each(|c| c[l] = c[l % width]);
            }
            self.triangle[l] = self.triangle[l % width];
            for t in self.twist.iter_mut().flat_map(|t| t.c.iter_mut().chain(&mut t.slopes)) {
                t[l] = t[l % width];
            }
            self.shift.iter_mut().for_each(|c| c[l] = c[l % width]);
        }
    }

    /// The shifts of one randomisation; directions keep their leading `shared` bits.
    pub(super) fn shift(&mut self, seed: u32, batch: u32, shared: u32) {
        for (k, s) in self.sources.iter().enumerate() {
            for (d, lanes) in self.shift.iter_mut().enumerate() {
                let bits = seed_of(&[seed, s.element, batch, d as u32]);
                lanes[k] = if d < 2 { bits } else { bits >> shared };
            }
        }
        self.repeat();
    }

    /// Points that one packet takes.
    pub(super) fn points_a_packet(&self) -> usize {
        LANES / self.width
    }

    /// Index in `sources` of a lane's element, and which of the packet's points it takes.
    #[inline]
    pub(super) fn place(&self, lane: usize) -> (usize, usize) {
        // A power of two: shifting is far quicker than to divide.
        (lane & (self.width - 1), lane >> self.width.trailing_zeros())
    }

    /// Bit l: lane l holds a ray, where `points` points are left.
    pub(super) fn active(&self, points: usize) -> u16 {
        (0..LANES).fold(0, |bits, lane| bits | u16::from(self.place(lane).1 < points) << lane)
    }

    /// Numbers in [0, 1) by dimension and lane, of packets that take several points.
    #[inline(never)]
    fn spread(&self, points: &ScrambledPoints, first: usize) -> [[f32; LANES]; 4] {
        let mut p = [[0.0; LANES]; 4];
        for (d, (p, shift)) in p.iter_mut().zip(&self.shift).enumerate() {
            let due = &points.coordinate(d)[first..];
            *p = match (due.len() >= self.points_a_packet(), self.width) {
                (true, 8) => repeated::<8>(due, shift),
                (true, 4) => repeated::<4>(due, shift),
                (true, 2) => repeated::<2>(due, shift),
                (true, 1) => repeated::<1>(due, shift),
                _ => {
                    let due = |l: usize| due[self.place(l).1.min(due.len() - 1)];
                    std::array::from_fn(|l| unit(due(l) ^ shift[l]))
                }
            };
        }
        p
    }

    /// The rays of the points from `first` on. `WHOLE`: a packet takes one point.
    ///
    /// No closures for lanes here: these would not be compiled for the wider registers.
    #[inline(always)]
    pub(super) fn rays<const WHOLE: bool>(&self, points: &ScrambledPoints, first: usize) -> RayLanes {
        let mut p = [[0.0f32; LANES]; 4];
        if WHOLE {
            for (d, (p, shift)) in p.iter_mut().zip(&self.shift).enumerate() {
                let x = points.coordinate(d)[first];
                for (p, s) in p.iter_mut().zip(shift) {
                    *p = unit(x ^ s);
                }
            }
        } else {
            p = self.spread(points, first);
        }
        let mut rays = RayLanes { origin: [[0.0; LANES]; 3], direction: [[0.0; LANES]; 3] };
        let (mut s, mut t) = (p[0], p[1]);
        if self.triangles {
            for l in 0..LANES {
                // [`crate::sampling::triangle`] without a branch.
                let (u, v) = (p[0][l], p[1][l]);
                let half = 0.5 * u.min(v);
                let folded = if v > u { (half, v - half) } else { (u - half, half) };
                (s[l], t[l]) = if self.triangle[l] { folded } else { (u, v) };
            }
        }
        if let Some(Twist { slopes: [along_s, along_t], .. }) = &self.twist {
            // [`crate::scene::FaceFrame::even`] in single precision.
            for l in 0..LANES {
                s[l] = linear(along_s[l], s[l]);
                t[l] = linear(along_t[l] / (1.0 + (2.0 * s[l] - 1.0) * along_s[l]), t[l]);
            }
        }
        let (mut dx, mut dy, mut dz) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            [dx[l], dy[l], dz[l]] = cosine_hemisphere_rough(p[2][l], p[3][l]);
        }
        for c in 0..3 {
            for l in 0..LANES {
                rays.origin[c][l] = self.origin[c][l] + s[l] * self.a[c][l] + t[l] * self.b[c][l];
                rays.direction[c][l] = dx[l] * self.x[c][l] + dy[l] * self.y[c][l] + dz[l] * self.z[c][l];
            }
        }
        if let Some(twist) = &self.twist {
            for c in 0..3 {
                for l in 0..LANES {
                    rays.origin[c][l] += s[l] * t[l] * twist.c[c][l];
                }
            }
        }
        rays
    }
}

/// Each coordinate in as many lanes as share a point, shifted; `WIDTH` is known when this is compiled, so that lanes are filled whole
/// registers at a time.
#[inline(always)]
fn repeated<const WIDTH: usize>(due: &[u32], shift: &[u32; LANES]) -> [f32; LANES] {
    let due = &due[..LANES / WIDTH];
    let mut lanes = [0.0; LANES];
    for l in 0..LANES {
        lanes[l] = unit(due[l / WIDTH] ^ shift[l]);
    }
    lanes
}

/// x in [0, 1] for `r` uniform there, with a density that goes linearly from `1 - slope` at 0 to `1 + slope` at 1.
#[inline(always)]
fn linear(slope: f32, r: f32) -> f32 {
    let start = 1.0 - slope;
    2.0 * r / (start + (start * start + 4.0 * slope * r).sqrt())
}

/// Which of `m` elements of a group share packets: powers of two, so that each packet is full; each alone where 16 rays of one
/// element have a narrower cone than the common cell of directions.
pub(super) fn shared(m: usize, table: &SobolTable) -> impl Iterator<Item = Range<usize>> {
    let most = if (LANES << (2 * table.shared_bits())) > table.len() { LANES } else { 1 };
    let mut next = 0;
    std::iter::from_fn(move || {
        let first = next;
        let left = (m - first).checked_ilog2()?;
        next += most.min(1 << left);
        Some(first..next)
    })
}

/// The packets that [`super::cast`] casts from a run of elements in the first randomisation of their rows, in the same
/// order, those left out that are not full: for measurements of single parts of that work.
pub fn packets_of(
    visibility: &Visibility,
    mesh: &Mesh,
    elements: Range<u32>,
    table: &SobolTable,
    seed: u32,
) -> Vec<RayLanes> {
    let normals: Vec<Vec3> = visibility.scene().faces.iter().map(|f| f.normal.as_vec3()).collect();
    let (mut packets, mut points) = (Vec::new(), ScrambledPoints::default());
    for group in groups(mesh, &normals, elements) {
        table.scramble(&Scramble::new(seed_of(&[seed, group.start, 0])), &mut points);
        for part in shared(group.len(), table) {
            let mut lanes = Lanes::new(visibility, mesh, part.map(|k| group.start + k as u32));
            lanes.shift(seed, 0, table.shared_bits());
            let step = lanes.points_a_packet();
            let full = |first: &usize| lanes.active(table.len() - first) == u16::MAX;
            packets.extend((0..table.len()).step_by(step).filter(full).map(|k| match step {
                1 => lanes.rays::<true>(&points, k),
                _ => lanes.rays::<false>(&points, k),
            }));
        }
    }
    packets
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whatever the number of elements, packets are full, and each lane has the coordinate of the point that it takes.
    #[test]
    fn packets_are_full_and_each_lane_has_its_point() {
        // 16 rays of one element have a narrower cone than a shared cell, and a wider one.
        let (apart, together) = (SobolTable::new(1000), SobolTable::new(1024));
        for m in 0..=LANES {
            let parts: Vec<Range<usize>> = shared(m, &together).collect();
            let set: u32 = parts.iter().map(|p| p.len() as u32).sum();
            assert_eq!(
                parts.iter().map(|p| p.len() as u32).fold(0, |bits, len| bits | len),
                set,
                "{parts:?}"
            );
            assert!(parts.iter().all(|p| LANES % p.len() == 0) && set as usize == m);
            assert!(parts.windows(2).all(|p| p[0].end == p[1].start) && parts.iter().all(|p| p.end <= m));
            assert_eq!(shared(m, &apart).collect::<Vec<_>>(), (0..m).map(|k| k..k + 1).collect::<Vec<_>>());
        }
        let due: Vec<u32> = (0..16).map(|k| k << 28).collect();
        let shift = std::array::from_fn(|l| (l as u32) << 24);
        let each = |width: usize| std::array::from_fn(|l| (l / width) as f32 / 16.0 + l as f32 / 256.0);
        assert_eq!(repeated::<8>(&due, &shift), each(8));
        assert_eq!(repeated::<4>(&due, &shift), each(4));
        assert_eq!(repeated::<2>(&due, &shift), each(2));
        assert_eq!(repeated::<1>(&due, &shift), each(1));
    }
}
