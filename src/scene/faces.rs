//! From polygons in file units to the faces of a scene.

use super::obj::{ObjFile, Polygon};
use super::{Face, Material, coplanar, footing, frame, polygon};
use crate::error::{Error, Result};
use glam::{DVec2, DVec3};
use rustc_hash::FxHashMap;

/// Shading normals within this of the geometric normal say nothing new.
const FLAT_TOLERANCE: f64 = 1e-6;

/// How the objects and materials of one file are numbered in the scene.
#[derive(Debug, Default)]
pub(super) struct Numbering {
    /// Scene object of each of the file's objects.
    pub objects: Vec<u32>,
    /// Scene material of each of the file's materials.
    pub materials: Vec<u32>,
    /// Scene material of the faces without one.
    pub no_material: u32,
}

impl Numbering {
    /// Scene material of a polygon.
    fn material(&self, polygon: &Polygon) -> u32 {
        polygon.material.map_or(self.no_material, |m| self.materials[m as usize])
    }
}

/// The geometry of a scene.
#[derive(Debug, Default)]
pub(super) struct Geometry {
    pub vertices: Vec<DVec3>,
    pub normals: Vec<DVec3>,
    pub faces: Vec<Face>,
    pub triangle_count: usize,
    pub polygon_count: usize,
    pub center: DVec3,
    pub radius: f64,
    pub warnings: Vec<String>,
}

/// Splits the polygons of `files`, numbered in the scene by `numbering`, cuts those that overlap in one plane (surfaces in
/// contact get new materials), and moves them to the
/// centre of their bounding box.
///
/// # Errors
/// No polygon has an area, or there are more vertices than 32 bits can number.
pub(super) fn build(
    files: &[ObjFile],
    numbering: &[Numbering],
    unit: f64,
    materials: &mut Vec<Material>,
) -> Result<Geometry> {
    let mut builder = Builder { unit, ..Builder::default() };
    for (file, numbers) in files.iter().zip(numbering) {
        for (name, number) in file.objects.iter().zip(&numbers.objects) {
            builder.object_names.insert(*number, name.clone());
        }
    }
    for (file, numbers) in files.iter().zip(numbering) {
        builder.normal_numbers.clear();
        for polygon in &file.polygons {
            builder.add(file, numbers, polygon, materials)?;
        }
    }
    builder.finish(files, materials)
}

/// An error's message, with the first of the warnings that may tell what led to it and would be lost with the scene.
pub(super) fn with_warnings(message: &str, warnings: &[String]) -> String {
    const MOST: usize = 5;
    let mut lines = vec![message.to_string()];
    lines.extend(warnings.iter().take(MOST).map(|w| format!("warning: {w}")));
    if warnings.len() > MOST {
        lines.push(format!("and {} more warnings", warnings.len() - MOST));
    }
    lines.join("\n")
}

/// What a face is made of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Made {
    pub object: u32,
    pub material: u32,
}

/// Faces with the same corners: what the first is made of, and bit k where a front looked to side k.
#[derive(Debug, Default)]
struct Seen {
    first: Made,
    sides: u8,
}

impl Seen {
    /// Whether a face adds anything: none with its front on that side came before, and it is not what one surface of one material,
    /// `one_sheet`, shows on its other side.
    fn add(&mut self, side: u8, made: Made, one_sheet: bool) -> bool {
        if self.sides == 0 {
            self.first = made;
        } else if self.sides >> side & 1 == 1 || one_sheet && self.first == made {
            return false;
        }
        self.sides |= 1 << side;
        true
    }
}

/// How often something happened, to which objects, and where first.
#[derive(Debug, Default)]
struct Tally {
    objects: Vec<(String, usize)>,
    /// Where each is.
    place: FxHashMap<String, usize>,
    first: String,
}

impl Tally {
    fn add(&mut self, file: &ObjFile, polygon: &Polygon) {
        let name = &file.objects[polygon.object as usize];
        if self.objects.is_empty() {
            self.first = format!("{}:{}", file.path.display(), polygon.line);
        }
        match self.place.get(name) {
            Some(k) => self.objects[*k].1 += 1,
            None => {
                self.place.insert(name.clone(), self.objects.len());
                self.objects.push((name.clone(), 1));
            }
        }
    }

    /// `{first}: {n} faces {what} (object "a": 2, object "b": 1)`; `many` follows several faces.
    fn warning(&self, one: &str, many: &str) -> Option<String> {
        let total: usize = self.objects.iter().map(|(_, n)| n).sum();
        let mut parts: Vec<_> =
            self.objects.iter().take(5).map(|(o, n)| format!("object \"{o}\": {n}")).collect();
        if self.objects.len() > parts.len() {
            parts.push("...".into());
        }
        let (faces, what) = if total == 1 { ("face", one) } else { ("faces", many) };
        (total > 0).then(|| format!("{}: {total} {faces} {what} ({})", self.first, parts.join(", ")))
    }
}

#[derive(Default)]
struct Builder {
    unit: f64,
    /// Distinct points in metres.
    points: Vec<DVec3>,
    point_numbers: FxHashMap<[u64; 3], u32>,
    normals: Vec<DVec3>,
    /// Scene normal of a file's normal.
    normal_numbers: FxHashMap<u32, u32>,
    faces: Vec<Face>,
    polygon_count: u32,
    seen_polygons: FxHashMap<Vec<u32>, Seen>,
    seen_faces: FxHashMap<[u32; 4], Seen>,
    object_names: FxHashMap<u32, String>,
    no_area: Tally,
    duplicates: Tally,
    bent: Tally,
    crossed: Tally,
    zero_normals: Tally,
    averted_normals: Tally,
}

impl Builder {
    fn add(
        &mut self,
        file: &ObjFile,
        numbers: &Numbering,
        polygon: &Polygon,
        materials: &[Material],
    ) -> Result<()> {
        // Equal points become one vertex, whatever indices the file gave them. A corner that
        // repeats the one before it adds nothing.
        let mut vertices: Vec<u32> = Vec::with_capacity(polygon.corners.len());
        let mut kept = Vec::with_capacity(polygon.corners.len());
        for (k, &corner) in polygon.corners.iter().enumerate() {
            let vertex = self.vertex(file, corner)?;
            if vertices.last() != Some(&vertex) {
                vertices.push(vertex);
                kept.push(k);
            }
        }
        while vertices.len() > 1 && vertices.first() == vertices.last() {
            vertices.pop();
        }
        let points: Vec<_> = vertices.iter().map(|&v| self.points[v as usize]).collect();
        let split = polygon::split(&points);
        if split.faces.is_empty() {
            self.no_area.add(file, polygon);
            return Ok(());
        }
        let mut sorted = vertices.clone();
        sorted.sort_unstable();
        let made =
            Made { object: numbers.objects[polygon.object as usize], material: numbers.material(polygon) };
        let one_sheet = materials[made.material as usize].is_alike_on_both_sides();
        let side = u8::from(coplanar::sign(polygon::area_vector(&points).normalize_or_zero()) < 0.0);
        if !self.seen_polygons.entry(sorted).or_default().add(side, made, one_sheet) {
            self.duplicates.add(file, polygon);
            return Ok(());
        }
        if split.bent {
            self.bent.add(file, polygon);
        }
        if split.crossed {
            self.crossed.add(file, polygon);
        }
        let shading = self.shading(file, polygon, &kept);
        let before = self.faces.len();
        for corners in split.faces {
            let face_vertices = corners.map(|c| vertices[c]);
            let mut key = face_vertices;
            if corners[2] == corners[3] {
                // Which vertex a triangle repeats says nothing.
                key[3] = u32::MAX;
            }
            key.sort_unstable();
            if self.seen_faces.entry(key).or_default().add(side, made, one_sheet) {
                let normals = shading.as_ref().map(|s| corners.map(|c| s[c]));
                self.face(file, polygon, made, face_vertices, normals);
            } else {
                self.duplicates.add(file, polygon);
            }
        }
        self.polygon_count += u32::from(self.faces.len() > before);
        Ok(())
    }

    fn vertex(&mut self, file: &ObjFile, corner: u32) -> Result<u32> {
        // Adding zero makes -0 and 0 one point.
        let point = file.positions[corner as usize] * self.unit + DVec3::ZERO;
        let next = u32::try_from(self.points.len());
        let next = next.map_err(|_| Error::parse(&file.path, None, "more than 4294967295 vertices"))?;
        let number = *self.point_numbers.entry(point.to_array().map(f64::to_bits)).or_insert(next);
        if number == next {
            self.points.push(point);
        }
        Ok(number)
    }

    /// Scene normals of a polygon's corners, where it has usable ones.
    fn shading(&mut self, file: &ObjFile, polygon: &Polygon, kept: &[usize]) -> Option<Vec<u32>> {
        let normals = polygon.normals.as_ref()?;
        let mut shading = Vec::with_capacity(kept.len());
        for &corner in kept {
            let number = normals[corner];
            let Some(unit) = file.normals[number as usize].try_normalize() else {
                self.zero_normals.add(file, polygon);
                return None;
            };
            shading.push(*self.normal_numbers.entry(number).or_insert_with(|| {
                self.normals.push(unit);
                (self.normals.len() - 1) as u32
            }));
        }
        Some(shading)
    }

    fn face(
        &mut self,
        file: &ObjFile,
        polygon: &Polygon,
        made: Made,
        vertices: [u32; 4],
        normals: Option<[u32; 4]>,
    ) {
        let mut face = Face {
            vertices,
            normals,
            object: made.object,
            material: made.material,
            polygon: self.polygon_count,
            normal: DVec3::ZERO,
            area: 0.0,
            skew: DVec2::ZERO,
        };
        measure(&mut face, &self.points);
        if let Some(normals) = normals {
            let normals = normals.map(|n| self.normals[n as usize]);
            if normals.iter().any(|n| n.dot(face.normal) <= 0.0) {
                self.averted_normals.add(file, polygon);
                face.normals = None;
            } else if normals.iter().all(|n| n.distance(face.normal) <= FLAT_TOLERANCE) {
                face.normals = None;
            }
        }
        self.faces.push(face);
    }

    /// `{n} faces are {what} (object "a": 2, object "b": 1)` of one object number a face.
    fn named(&self, objects: &[u32], what: &str) -> Option<String> {
        let mut counts: Vec<(u32, usize)> = Vec::new();
        let mut place: FxHashMap<u32, usize> = FxHashMap::default();
        for &object in objects {
            let k = *place.entry(object).or_insert(counts.len());
            if k == counts.len() {
                counts.push((object, 0));
            }
            counts[k].1 += 1;
        }
        let mut parts: Vec<String> = counts
            .iter()
            .take(5)
            .map(|(o, n)| format!("object \"{}\": {n}", self.object_names.get(o).map_or("", String::as_str)))
            .collect();
        if counts.len() > parts.len() {
            parts.push("...".into());
        }
        let faces = if objects.len() == 1 { "face is" } else { "faces are" };
        (!objects.is_empty()).then(|| format!("{} {faces} {what} ({})", objects.len(), parts.join(", ")))
    }

    fn finish(mut self, files: &[ObjFile], materials: &mut Vec<Material>) -> Result<Geometry> {
        let repeats = ("dropped that repeats an earlier face", "dropped that repeat earlier faces");
        let same = |what: &'static str| (what, what);
        let tallies = [
            (&self.no_area, same("of zero area dropped")),
            (&self.duplicates, repeats),
            (&self.bent, same("far from planar; split from the first corner where that is possible")),
            (&self.crossed, same("whose edges cross; the split may cover parts twice or not at all")),
            (&self.zero_normals, same("shaded flat for lack of a shading normal's direction")),
            (&self.averted_normals, same("shaded flat because a shading normal points away from the front")),
        ];
        let warning = |(tally, (one, many)): &(&Tally, (&str, &str))| tally.warning(one, many);
        let mut warnings: Vec<_> = tallies.iter().filter_map(warning).collect();
        if self.faces.is_empty() {
            let file = files.iter().find(|f| !f.polygons.is_empty());
            let path = file.or(files.first()).map(|f| f.path.clone()).unwrap_or_default();
            let why = "no faces: none of them has an area";
            return Err(Error::parse(path, None, with_warnings(why, &warnings)));
        }
        let cut = coplanar::cut(&mut self.faces, &mut self.points, materials);
        for (objects, what) in [
            (&cut.objects, "in the plane of others, cut where these cover them"),
            (
                &cut.joined,
                "translucent and in the plane of opaque ones: one opaque surface with these where they touch",
            ),
            (&cut.kept, "in the plane of others that cover them; not cut, for their shading normals"),
            (
                &cut.parted,
                "back to back with others in one plane: moved off them by as little as rays can tell",
            ),
            (
                &cut.narrow,
                "nearer to others than single precision tells on faces of that size; light between them may be wrong",
            ),
        ] {
            warnings.extend(self.named(objects, what));
        }
        footing::divide(&mut self.faces, &mut self.points, materials);
        self.faces.sort_by_key(|f| !f.is_triangle());

        let mut vertices = Compacted::default();
        let mut normals = Compacted::default();
        for face in &mut self.faces {
            face.vertices = face.vertices.map(|v| vertices.number(v, &self.points));
            face.normals = face.normals.map(|n| n.map(|n| normals.number(n, &self.normals)));
        }
        let mut vertices = vertices.values;
        let low = vertices.iter().copied().fold(DVec3::INFINITY, DVec3::min);
        let high = vertices.iter().copied().fold(DVec3::NEG_INFINITY, DVec3::max);
        let center = 0.5 * low + 0.5 * high;
        vertices.iter_mut().for_each(|v| *v -= center);
        self.faces.iter_mut().for_each(|face| measure(face, &vertices));
        let too_small: Vec<u32> = self
            .faces
            .iter()
            .filter(|f| !survives_single_precision(f, &vertices))
            .map(|f| f.object)
            .collect();
        let what = "too small or thin for single precision in a scene of this size: rays may miss";
        warnings.extend(self.named(&too_small, what));
        Ok(Geometry {
            triangle_count: self.faces.iter().filter(|f| f.is_triangle()).count(),
            polygon_count: self.polygon_count as usize,
            radius: 0.5 * (high - low).length(),
            center,
            vertices,
            normals: normals.values,
            faces: self.faces,
            warnings,
        })
    }
}

/// The values that are used, in the order of first use.
#[derive(Default)]
struct Compacted {
    values: Vec<DVec3>,
    numbers: FxHashMap<u32, u32>,
}

impl Compacted {
    fn number(&mut self, old: u32, values: &[DVec3]) -> u32 {
        *self.numbers.entry(old).or_insert_with(|| {
            self.values.push(values[old as usize]);
            (self.values.len() - 1) as u32
        })
    }
}

/// Sets area, normal and skew of a face from its vertices.
fn measure(face: &mut Face, points: &[DVec3]) {
    let corners = face.vertices.map(|v| points[v as usize]);
    let even = face.is_triangle() || polygon::is_parallelogram(corners);
    face.skew = if even { DVec2::ZERO } else { frame::skew(corners) };
    let corners = if face.is_triangle() { &corners[..3] } else { &corners[..] };
    let area = polygon::area_vector(corners);
    face.area = area.length();
    face.normal = area.normalize_or_zero();
}

/// Whether a face keeps its area and normal to a percent when rays see it: in single precision.
fn survives_single_precision(face: &Face, points: &[DVec3]) -> bool {
    let mut seen = *face;
    let corners = face.vertices.map(|v| points[v as usize].as_vec3().as_dvec3());
    seen.vertices = if face.is_triangle() { [0, 1, 2, 2] } else { [0, 1, 2, 3] };
    measure(&mut seen, &corners);
    (seen.area * seen.normal - face.area * face.normal).length() <= 0.01 * face.area
}
