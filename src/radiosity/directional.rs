//! Directional radiosity, after Immel, Cohen and Greenberg (1986), "A radiosity method for non-diffuse environments".
//!
//! The method that two-pass rendering was set against: specular light is solved for independently of the view, too, by
//! storing the radiance of every specular element for every cell of a discretised hemisphere. An element gathers from
//! what it sees through each cell; a diffuse element sends out one radiosity, a specular one a radiance for each cell
//! besides. The number of unknowns is that of specular elements times directions, and a highlight is as sharp as the cells:
//! both must grow together, which is what the comparison shows.

use super::{Field, Transport};
use crate::bsdf;
use crate::color::Rgb;
use crate::emitters::Emitters;
use crate::geometry::Frame;
use crate::mesh::{Mesh, NONE, Nodes};
use crate::sampling::{concentric_disc, concentric_square, seed_of, sobol};
use crate::scene::{Material, Scene};
use crate::visibility::Visibility;
use crate::{Error, Result};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Samples of the outgoing directions of a cell for the table of a lobe, at least; one for every eight cells otherwise.
const LOBE_SAMPLES: u32 = 64;
/// Change of an iteration, as a share of the whole, that ends the solve.
const SETTLED: f64 = 1e-4;
/// Most iterations; facing perfect mirrors come near.
const MOST_ITERATIONS: usize = 500;
/// Memory above which a scene is refused [bytes].
const MOST_BYTES: f64 = 4.0 * (1u64 << 30) as f64;

/// A hemisphere divided into n x n cells of equal solid angle (concentric map).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Hemisphere {
    n: u32,
}

impl Hemisphere {
    /// The division with about `directions` cells.
    pub fn new(directions: u32) -> Hemisphere {
        Hemisphere { n: f64::from(directions).sqrt().round().clamp(1.0, 1024.0) as u32 }
    }

    /// Number of cells.
    pub fn cells(&self) -> u32 {
        self.n * self.n
    }

    /// The direction at (s, t) in [0, 1)^2 of a cell; z along the normal.
    pub fn direction(&self, cell: u32, s: f64, t: f64) -> DVec3 {
        let n = f64::from(self.n);
        let disc = concentric_disc((f64::from(cell % self.n) + s) / n, (f64::from(cell / self.n) + t) / n);
        let r2 = disc.length_squared();
        let scale = (2.0 - r2).max(0.0).sqrt();
        DVec3::new(disc.x * scale, disc.y * scale, (1.0 - r2).max(0.0))
    }

    /// The cell of a direction (z not negative), moved by `jitter` (in cells, [-0.5, 0.5)^2) but not off the square.
    pub fn cell(&self, direction: DVec3, jitter: DVec2) -> u32 {
        let flat = DVec2::new(direction.x, direction.y).normalize_or_zero();
        let (u, v) = concentric_square(flat * (1.0 - direction.z.clamp(0.0, 1.0)).sqrt());
        let n = f64::from(self.n);
        let at = |x: f64, j: f64| ((x * n + j).max(0.0) as u32).min(self.n - 1);
        at(v, jitter.y) * self.n + at(u, jitter.x)
    }
}

/// What an element sees through a cell of its hemisphere.
#[derive(Debug, Clone, Copy)]
struct Link {
    /// The element, [`NONE`] where nothing shines, [`OUTSIDE`] where the ray left the scene.
    element: u32,
    /// The cell of that element's hemisphere from which it is seen.
    cell: u32,
}

const OUTSIDE: u32 = NONE - 1;

/// One term of a lobe: what an outgoing cell takes from an incoming one.
#[derive(Debug, Clone, Copy)]
struct Term {
    cell: u32,
    /// The incoming cell lies on the other side.
    transmitted: bool,
    weight: Rgb,
}

/// Terms by outgoing cell.
type Lobe = Vec<Vec<Term>>;

/// A solved scene with directional radiosity.
#[derive(Debug, Clone)]
pub struct Directional {
    mesh: Mesh,
    nodes: Nodes,
    hemisphere: Hemisphere,
    /// Reflected diffuse radiosity [W m^-2].
    diffuse: Field,
    /// Place of each element among the specular ones, or [`NONE`].
    specular: Vec<u32>,
    /// Specular radiance by (specular element, cell) [W m^-2 sr^-1].
    radiance: Vec<[f32; 3]>,
    /// Iterations of the solve.
    pub iterations: usize,
    /// Rays cast.
    pub rays: u64,
    /// Bytes that links and radiances took.
    pub bytes: f64,
}

impl Directional {
    /// Elements of the solution.
    pub fn elements(&self) -> usize {
        self.mesh.len()
    }

    /// Values stored for directions: specular elements times cells.
    pub fn directional_values(&self) -> usize {
        self.radiance.len()
    }

    /// Radiance that leaves (u, v) of a side towards `wo`, emission left out [W m^-2 sr^-1].
    ///
    /// `jitter` in [0, 1)^4 moves the place by up to half an element and the direction by up to half a cell: their mean is
    /// the interpolation between elements and cells.
    pub fn leaving(&self, scene: &Scene, side: (u32, bool), uv: DVec2, wo: DVec3, jitter: [f64; 4]) -> Rgb {
        let (face, front) = side;
        let diffuse = self.diffuse.at(&self.mesh, &self.nodes, side, uv.x as f32, uv.y as f32);
        let Some(diffuse) = diffuse else { return Rgb::ZERO };
        let grid = self.mesh.grid(face);
        let step = DVec2::new(1.0 / f64::from(grid.lattice.nu), 1.0 / f64::from(grid.lattice.nv));
        let moved = uv + (DVec2::new(jitter[0], jitter[1]) - 0.5) * step;
        let element = self.mesh.element(face, front, moved.x as f32, moved.y as f32);
        let mut radiance = diffuse / PI;
        if self.specular[element as usize] != NONE {
            let local = local(&frame(scene, face), front, wo);
            let cell = self.hemisphere.cell(local, DVec2::new(jitter[2], jitter[3]) - 0.5);
            let k = self.specular[element as usize] * self.hemisphere.cells() + cell;
            radiance += Rgb::from(self.radiance[k as usize].map(f64::from));
        }
        radiance
    }
}

/// Solves for the light of every element and direction.
///
/// `directions` is the number of cells of a hemisphere, about; one ray is cast through each, from each element. Light straight
/// from emitters onto diffuse surfaces is given by `direct` [W m^-2], one value an element of `mesh`, which must have
/// elements on purely specular sides too.
///
/// # Errors
/// The scene would take more memory than is sensible; the message says how much.
pub fn solve_directional(
    visibility: &Visibility,
    mesh: Mesh,
    emitters: &Emitters,
    direct: &[Rgb],
    directions: u32,
    seed: u32,
) -> Result<Directional> {
    let scene = visibility.scene();
    let hemisphere = Hemisphere::new(directions);
    let side = |e: u32| {
        let (face, front, _) = mesh.place(e);
        let material = scene.material(&scene.faces[face as usize]);
        (material, front, front || material.two_sided)
    };
    let n = mesh.len() as u32;
    let mut specular = vec![NONE; n as usize];
    let mut count = 0;
    for e in 0..n {
        let (material, _, reflects) = side(e);
        if reflects && material.is_specular() {
            specular[e as usize] = count;
            count += 1;
        }
    }
    let bytes = require_memory(n, count, hemisphere)?;
    let lobes = Lobes::new(scene, hemisphere, seed);
    let tracer = Tracer { visibility, mesh: &mesh, specular: &specular, hemisphere, seed };
    let links: Vec<Vec<Link>> = (0..n).into_par_iter().with_min_len(16).map(|e| tracer.links(e)).collect();
    let mut transport = Transport::of(scene, &mesh);
    for e in 0..n {
        if !side(e).2 {
            (transport.reflectance[e as usize], transport.transmittance[e as usize]) = (Rgb::ZERO, Rgb::ZERO);
        }
    }
    let emission: Vec<Rgb> = (0..n)
        .map(|e| {
            let (face, front, _) = mesh.place(e);
            emitters.at(face, front).map_or(Rgb::ZERO, |(radiance, _)| radiance)
        })
        .collect();
    let system = System { mesh: &mesh, links: &links, specular: &specular, hemisphere, lobes: &lobes, scene };
    let mut diffuse = transport.reflect(direct);
    let mut radiance = vec![[0f32; 3]; count as usize * hemisphere.cells() as usize];
    let mut iterations = 0;
    loop {
        let gathered = system.iterate(&tracer, &emission, &diffuse, &radiance);
        let irradiance: Vec<Rgb> = gathered.iter().zip(direct).map(|(g, d)| g.irradiance + *d).collect();
        let next = transport.reflect(&irradiance);
        let (mut change, mut total) = (0.0, 0.0);
        for (a, b) in diffuse.iter().zip(&next) {
            change += (*a - *b).abs().element_sum();
            total += b.element_sum();
        }
        let mut at = 0;
        for part in gathered.iter().map(|g| &g.radiance) {
            for (a, b) in radiance[at..at + part.len()].iter_mut().zip(part) {
                for c in 0..3 {
                    change += f64::from((a[c] - b[c]).abs()) * PI / f64::from(hemisphere.cells());
                    total += f64::from(b[c]) * PI / f64::from(hemisphere.cells());
                }
                *a = *b;
            }
            at += part.len();
        }
        diffuse = next;
        iterations += 1;
        if change <= SETTLED * total || iterations >= MOST_ITERATIONS {
            break;
        }
    }
    let nodes = Nodes::new(scene, &mesh);
    let field = Field::new(&mesh, &nodes, &vec![1.0; mesh.len()], &diffuse);
    let rays = u64::from(n) * u64::from(hemisphere.cells());
    Ok(Directional { nodes, hemisphere, diffuse: field, specular, radiance, iterations, rays, bytes, mesh })
}

/// Bytes of links and radiances, refused where they are too many.
fn require_memory(elements: u32, specular: u32, hemisphere: Hemisphere) -> Result<f64> {
    let cells = f64::from(hemisphere.cells());
    let links = f64::from(elements) * cells * size_of::<Link>() as f64;
    // The radiances of one iteration and of the next.
    let radiances = 2.0 * f64::from(specular) * cells * 12.0;
    if links + radiances > MOST_BYTES {
        let gib = |b: f64| b / f64::from(1u32 << 30);
        return Err(Error::Usage(format!(
            "directional radiosity of {elements} elements ({specular} of them specular) with {cells} directions each needs about \
             {:.1} GiB ({:.1} for what they see, {:.1} for radiances), more than {:.0} GiB: choose a larger \
             --element-size or fewer --directions",
            gib(links + radiances),
            gib(links),
            gib(radiances),
            gib(MOST_BYTES)
        )));
    }
    Ok(links + radiances)
}

/// Tangents and front normal of a face. Both sides of a face use the same tangents, so that a direction keeps its first
/// two coordinates when it passes through.
fn frame(scene: &Scene, face: u32) -> Frame {
    Frame::new(scene.faces[face as usize].normal)
}

/// Coordinates on a side of a face; z along the side's normal.
fn local(frame: &Frame, front: bool, direction: DVec3) -> DVec3 {
    let d = frame.to_local(direction);
    if front { d } else { DVec3::new(d.x, d.y, -d.z) }
}

/// The lobes of each material, seen from either side.
struct Lobes(Vec<[Lobe; 2]>);

impl Lobes {
    fn new(scene: &Scene, hemisphere: Hemisphere, seed: u32) -> Lobes {
        let lobe = |material: &Material, front: bool| -> Lobe {
            if !material.is_specular() {
                return Vec::new();
            }
            (0..hemisphere.cells())
                .into_par_iter()
                .map(|c| terms(material, front, hemisphere, c, seed))
                .collect()
        };
        Lobes(scene.materials.iter().map(|m| [lobe(m, true), lobe(m, false)]).collect())
    }
}

/// What leaves through a cell, by the cells it comes from: the lobe sampled from directions all over the cell.
fn terms(material: &Material, front: bool, hemisphere: Hemisphere, cell: u32, seed: u32) -> Vec<Term> {
    let mut terms: Vec<Term> = Vec::new();
    let samples = LOBE_SAMPLES.max(hemisphere.cells() / 8);
    for k in 0..samples {
        let p = sobol(k, 0, seed_of(&[seed, cell, 0xd1]));
        let q = sobol(k, 0, seed_of(&[seed, cell, 0xd2]));
        let wo = hemisphere.direction(cell, p[0], p[1]);
        let Some(s) = bsdf::sample_specular(material, wo, DVec3::Z, front, [p[2], p[3], q[0]]) else {
            continue;
        };
        let into = DVec3::new(s.direction.x, s.direction.y, s.direction.z.abs());
        let from = hemisphere.cell(into, DVec2::ZERO);
        let weight = s.weight / f64::from(samples);
        match terms.iter_mut().find(|t| t.cell == from && t.transmitted == s.transmitted) {
            Some(term) => term.weight += weight,
            None => terms.push(Term { cell: from, transmitted: s.transmitted, weight }),
        }
    }
    terms
}

struct Tracer<'a, 's> {
    visibility: &'a Visibility<'s>,
    mesh: &'a Mesh,
    specular: &'a [u32],
    hemisphere: Hemisphere,
    seed: u32,
}

impl Tracer<'_, '_> {
    /// The direction through a cell of an element, in local coordinates.
    fn direction(&self, element: u32, cell: u32) -> DVec3 {
        let p = sobol(cell, 0, seed_of(&[self.seed, element, 0xd3]));
        self.hemisphere.direction(cell, p[2], p[3])
    }

    /// One ray through each cell, from points all over the element.
    fn links(&self, element: u32) -> Vec<Link> {
        let scene = self.visibility.scene();
        let place = self.mesh.place_of(scene, element);
        let (face, normal) = (place.face, place.normal);
        let tangents = frame(scene, face);
        (0..self.hemisphere.cells())
            .map(|c| {
                let p = sobol(c, 0, seed_of(&[self.seed, element, 0xd3]));
                let d = self.direction(element, c);
                let direction = tangents.x * d.x + tangents.y * d.y + normal * d.z;
                let origin = self.visibility.leave(face, self.visibility.start(&place, p[0], p[1]), normal);
                let Some(hit) = self.visibility.closest(origin, direction.as_vec3(), face) else {
                    return Link { element: OUTSIDE, cell: 0 };
                };
                let seen = self.mesh.element(hit.face, hit.front, hit.u, hit.v);
                let is_specular = seen != NONE && self.specular[seen as usize] != NONE;
                let cell = if is_specular {
                    let back = local(&frame(scene, hit.face), hit.front, -direction);
                    self.hemisphere.cell(back, DVec2::ZERO)
                } else {
                    0
                };
                Link { element: seen, cell }
            })
            .collect()
    }
}

/// What an element gathered: irradiance without light straight from emitters, and what it reflects specularly.
struct Gathered {
    irradiance: Rgb,
    radiance: Vec<[f32; 3]>,
}

struct System<'a> {
    mesh: &'a Mesh,
    links: &'a [Vec<Link>],
    specular: &'a [u32],
    hemisphere: Hemisphere,
    lobes: &'a Lobes,
    scene: &'a Scene,
}

impl System<'_> {
    /// Radiance along a link, and the part of it that an emitter sends.
    fn along(&self, link: &Link, emission: &[Rgb], diffuse: &[Rgb], radiance: &[[f32; 3]]) -> (Rgb, Rgb) {
        match link.element {
            NONE => (Rgb::ZERO, Rgb::ZERO),
            OUTSIDE => (self.scene.environment, Rgb::ZERO),
            e => {
                let e = e as usize;
                let mut sum = diffuse[e] / PI + emission[e];
                if self.specular[e] != NONE {
                    let k = self.specular[e] * self.hemisphere.cells() + link.cell;
                    sum += Rgb::from(radiance[k as usize].map(f64::from));
                }
                (sum, emission[e])
            }
        }
    }

    fn iterate(
        &self,
        tracer: &Tracer,
        emission: &[Rgb],
        diffuse: &[Rgb],
        radiance: &[[f32; 3]],
    ) -> Vec<Gathered> {
        let arriving = |e: u32| -> Vec<(Rgb, Rgb)> {
            self.links[e as usize].iter().map(|l| self.along(l, emission, diffuse, radiance)).collect()
        };
        (0..self.mesh.len() as u32)
            .into_par_iter()
            .with_min_len(16)
            .map(|e| {
                let own = arriving(e);
                let (mut sum, mut cosines) = (Rgb::ZERO, 0.0);
                for (cell, (all, emitted)) in own.iter().enumerate() {
                    let cos = tracer.direction(e, cell as u32).z;
                    sum += (*all - *emitted) * cos;
                    cosines += cos;
                }
                let irradiance = if cosines > 0.0 { sum * (PI / cosines) } else { Rgb::ZERO };
                let mut reflected = Vec::new();
                if self.specular[e as usize] != NONE {
                    let (face, front, _) = self.mesh.place(e);
                    let material = self.scene.faces[face as usize].material as usize;
                    let lobe = &self.lobes.0[material][usize::from(!front)];
                    let through = lobe.iter().flatten().any(|t| t.transmitted);
                    let behind = match self.mesh.opposite(e) {
                        o if through && o != NONE => arriving(o),
                        _ => Vec::new(),
                    };
                    reflected = lobe
                        .iter()
                        .map(|terms| {
                            let from = |t: &Term| {
                                let side = if t.transmitted { &behind } else { &own };
                                side.get(t.cell as usize).map_or(Rgb::ZERO, |a| a.0) * t.weight
                            };
                            terms.iter().map(from).sum::<Rgb>().as_vec3().to_array()
                        })
                        .collect();
                }
                Gathered { irradiance, radiance: reflected }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_hold_their_directions() {
        for n in [1u32, 16, 100, 1024] {
            let h = Hemisphere::new(n);
            for cell in 0..h.cells() {
                for (s, t) in [(0.5, 0.5), (0.1, 0.9), (0.95, 0.05)] {
                    let d = h.direction(cell, s, t);
                    assert!((d.length() - 1.0).abs() < 1e-12 && d.z >= 0.0);
                    assert_eq!(h.cell(d, DVec2::ZERO), cell, "{n}: {d}");
                }
            }
        }
    }

    /// Cells of equal solid angle: the mean of z over the hemisphere is 1/2, of z^2 is 1/3.
    #[test]
    fn cells_have_equal_solid_angles() {
        let h = Hemisphere::new(4096);
        let mean = |f: &dyn Fn(DVec3) -> f64| {
            (0..h.cells()).map(|c| f(h.direction(c, 0.5, 0.5))).sum::<f64>() / f64::from(h.cells())
        };
        assert!((mean(&|d| d.z) - 0.5).abs() < 1e-3);
        assert!((mean(&|d| d.z * d.z) - 1.0 / 3.0).abs() < 1e-3);
        assert!(mean(&|d| d.x).abs() < 1e-9 && mean(&|d| d.y).abs() < 1e-9);
    }

    /// A mirror of albedo 0.7 passes 0.7 of what arrives on, from cells about the mirror direction.
    #[test]
    fn a_mirrors_terms_keep_its_albedo() {
        let mut mirror = Material::new("mirror");
        mirror.specular = Rgb::splat(0.7);
        let h = Hemisphere::new(256);
        for cell in 0..h.cells() {
            let terms = terms(&mirror, true, h, cell, 0);
            let sum: Rgb = terms.iter().map(|t| t.weight).sum();
            assert!((sum.x - 0.7).abs() < 1e-12);
            let out = h.direction(cell, 0.5, 0.5);
            let expected = DVec3::new(-out.x, -out.y, out.z);
            assert!(terms.iter().all(|t| h.direction(t.cell, 0.5, 0.5).dot(expected) > 0.9));
        }
    }

    #[test]
    fn a_scene_too_large_is_refused_with_its_memory() {
        let error = require_memory(1_000_000, 500_000, Hemisphere::new(1024)).unwrap_err().to_string();
        assert!(error.contains("GiB") && error.contains("--directions"), "{error}");
        assert!(require_memory(1000, 500, Hemisphere::new(1024)).is_ok());
    }
}
