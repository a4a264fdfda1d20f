//! Reads an OBJ text line by line: says what is wrong with which line, and rewrites the rest in the
//! plain subset of the format that `tobj` reads faithfully.
//!
//! Left to itself, `tobj` 4.0 reads a line element of three vertices as a face, invents the normals
//! of corners that have none, loses the names of materials that no MTL defines, refuses comments
//! behind faces and tabs behind `usemtl`, and reports no line numbers.

use crate::error::{Error, Result};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fmt::Write;
use std::path::Path;

/// Name of faces that come before any `o` or `g`.
const UNNAMED: &str = "unnamed";

/// Objects named in one warning.
const NAMED: usize = 3;

/// Statements that are read.
const READ: [&str; 7] = ["v", "vn", "f", "o", "g", "usemtl", "mtllib"];

/// Statements that neither place nor colour a polygon.
const HARMLESS: [&str; 10] = ["s", "vt", "p", "l", "mg", "lod", "bevel", "c_interp", "d_interp", "usemap"];

/// An OBJ file in the subset that `tobj` reads faithfully.
#[derive(Debug, Default)]
pub(super) struct ObjText {
    /// `v`, `vn`, `f v//vn`, `g` and `usemtl`; the last two by index into `objects` and `materials`.
    /// The first `vn` is not a number: corners without a normal refer to it.
    pub canonical: String,
    /// Names after `o` and `g`, in the order of their first statement.
    pub objects: Vec<String>,
    /// Names after `usemtl`, in the order of their first statement.
    pub materials: Vec<String>,
    /// What follows each `mtllib`, with its line.
    pub libraries: Vec<(usize, String)>,
    /// The line of each face.
    pub face_lines: Vec<usize>,
    /// What to do where there is no face.
    pub advice: &'static str,
    /// What the user should know.
    pub warnings: Vec<String>,
}

/// Reads `text`, whose coordinates must not exceed `limit`.
pub(super) fn read(path: &Path, text: &str, limit: f64) -> Result<ObjText> {
    let mut scan = Scan { path, limit, ..Scan::new(path) };
    let text = with_line_feeds(text.trim_start_matches('\u{feff}'));
    let mut lines = text.lines().enumerate();
    while let Some((index, line)) = lines.next() {
        scan.line = index + 1;
        match line.trim_end().strip_suffix('\\') {
            None => scan.statement(line)?,
            Some(start) => {
                let mut joined = start.to_string();
                for (_, next) in lines.by_ref() {
                    let part = next.trim_end().strip_suffix('\\');
                    joined.push(' ');
                    joined.push_str(part.unwrap_or(next));
                    if part.is_none() {
                        break;
                    }
                }
                scan.statement(&joined)?;
            }
        }
    }
    scan.finish()
}

struct Scan<'a> {
    path: &'a Path,
    limit: f64,
    line: usize,
    out: ObjText,
    faces: String,
    vertices: usize,
    normals: usize,
    textures: usize,
    /// References to what the file had not defined yet: kind, index and line.
    ahead: Vec<(Kind, usize, usize)>,
    /// What the last `o` or `g` names, and its line.
    object: Option<usize>,
    head: usize,
    material: Option<usize>,
    /// What the last `o` names.
    whole: Option<usize>,
    /// Object and `o` that the last face was in.
    last: (Option<usize>, Option<usize>),
    /// By object, the `o` that its faces were in.
    wholes: BTreeMap<usize, BTreeSet<Option<usize>>>,
    /// Objects whose faces were in several `o`, each with the line that names it in the second of these.
    joined: Vec<(usize, usize)>,
    object_indices: HashMap<String, usize>,
    material_indices: HashMap<String, usize>,
    /// Object and material that `faces` is at.
    written: (Option<usize>, Option<usize>),
    elements: usize,
    unknown: Vec<String>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Vertex,
    Texture,
    Normal,
}

impl Kind {
    fn noun(self) -> &'static str {
        match self {
            Kind::Vertex => "vertex",
            Kind::Texture => "texture coordinate",
            Kind::Normal => "normal",
        }
    }

    fn plural(self) -> &'static str {
        match self {
            Kind::Vertex => "vertices",
            Kind::Texture => "texture coordinates",
            Kind::Normal => "normals",
        }
    }
}

impl<'a> Scan<'a> {
    fn new(path: &'a Path) -> Scan<'a> {
        Scan {
            path,
            limit: f64::MAX,
            line: 0,
            out: ObjText { canonical: "vn nan nan nan\n".into(), ..ObjText::default() },
            faces: String::new(),
            vertices: 0,
            normals: 0,
            textures: 0,
            ahead: Vec::new(),
            object: None,
            head: 0,
            material: None,
            whole: None,
            last: (None, None),
            wholes: BTreeMap::new(),
            joined: Vec::new(),
            object_indices: HashMap::new(),
            material_indices: HashMap::new(),
            written: (None, None),
            elements: 0,
            unknown: Vec::new(),
        }
    }

    fn error(&self, message: impl Into<String>) -> Error {
        Error::parse(self.path, Some(self.line), message)
    }

    fn warn(&mut self, line: usize, message: impl Into<String>) {
        self.out.warnings.push(Error::parse(self.path, Some(line), message).to_string());
    }

    fn statement(&mut self, line: &str) -> Result<()> {
        let line = without_comment(line);
        let (keyword, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        match keyword {
            "" => {}
            "v" => self.vertex(rest)?,
            "vn" => self.normal(rest)?,
            "f" => self.face(rest)?,
            "o" | "g" => {
                let name = if rest.is_empty() { UNNAMED } else { rest };
                self.object = Some(index_of(&mut self.object_indices, &mut self.out.objects, name));
                self.head = self.line;
                if keyword == "o" {
                    self.whole = self.object;
                }
            }
            "usemtl" if rest.is_empty() => return Err(self.error("usemtl without a material name")),
            "usemtl" => {
                self.material = Some(index_of(&mut self.material_indices, &mut self.out.materials, rest))
            }
            "mtllib" if rest.is_empty() => return Err(self.error("mtllib without a file name")),
            "mtllib" => self.out.libraries.push((self.line, rest.to_string())),
            known if HARMLESS.contains(&known) => {
                self.textures += usize::from(known == "vt");
                self.elements += usize::from(known == "p" || known == "l");
            }
            other if !self.unknown.iter().any(|u| u == other) => {
                self.unknown.push(other.to_string());
                let lower = other.to_lowercase();
                let hint = match lower != other && self.is_known(&lower) {
                    true => format!("; did you mean \"{lower}\"?"),
                    false => String::new(),
                };
                let message = format!("statement \"{other}\" is not supported and was ignored{hint}");
                self.warn(self.line, message);
            }
            _ => {}
        }
        Ok(())
    }

    fn is_known(&self, keyword: &str) -> bool {
        READ.contains(&keyword) || HARMLESS.contains(&keyword)
    }

    /// What to do about a file without faces, by what it holds instead.
    fn advice(&self) -> &'static str {
        let has = |keyword: &str| self.unknown.iter().any(|u| u == keyword);
        match () {
            () if has("ply") => "this is a PLY file: convert it to Wavefront OBJ",
            () if has("solid") => "this is an STL file: convert it to Wavefront OBJ",
            () if has("newmtl") => {
                "this is a library of materials (MTL): name the OBJ file, whose mtllib names the library"
            }
            () if has("F") => "keywords are in lower case: write f for F",
            () if self.elements > 0 => "points and lines have no area: export surfaces as faces (f 1 2 3)",
            () if self.vertices > 0 => "there are vertices alone: export surfaces as faces (f 1 2 3)",
            () if has("cstype") || has("surf") || has("curv") => {
                "free-form surfaces are not read: export them as faces"
            }
            () => "a Wavefront OBJ file has vertices (v x y z) and faces of their numbers (f 1 2 3)",
        }
    }

    fn vertex(&mut self, rest: &str) -> Result<()> {
        let v = self.numbers("v", rest)?;
        // Besides x y z: a weight, or a colour (of 3 or 4 channels), which we do not need.
        let weight = match v.len() {
            3 | 6 | 7 => 1.0,
            4 => v[3],
            n => return Err(self.error(format!("v needs 3 coordinates, found {n} numbers"))),
        };
        if let Some(c) =
            v[..3].iter().find(|&&c| !(c / weight).is_finite() || (c / weight).abs() > self.limit)
        {
            let message = match weight {
                0.0 => "the weight of a vertex must not be 0".to_string(),
                _ => format!("coordinate {c} is too large: single precision ends at 1e18 metres"),
            };
            return Err(self.error(message));
        }
        self.vertices += 1;
        self.out.canonical.push_str("v ");
        self.append(&v[..3]);
        if weight != 1.0 {
            self.out.canonical.pop();
            self.out.canonical.push(' ');
            self.append(&[weight]);
        }
        Ok(())
    }

    fn normal(&mut self, rest: &str) -> Result<()> {
        let n = self.numbers("vn", rest)?;
        if n.len() != 3 {
            return Err(self.error(format!("vn needs 3 numbers, found {}", n.len())));
        }
        self.normals += 1;
        self.out.canonical.push_str("vn ");
        self.append(&n);
        Ok(())
    }

    /// Writes numbers (which parse back to themselves) and ends the line.
    fn append(&mut self, numbers: &[f64]) {
        for (k, n) in numbers.iter().enumerate() {
            let gap = if k == 0 { "" } else { " " };
            // Writing to a String cannot fail.
            let _ = write!(self.out.canonical, "{gap}{n:e}");
        }
        self.out.canonical.push('\n');
    }

    fn face(&mut self, rest: &str) -> Result<()> {
        let corners: Vec<_> = rest.split_whitespace().collect();
        if corners.len() < 3 {
            return Err(self.error(format!("a face needs at least 3 vertices, found {}", corners.len())));
        }
        if self.object.is_none() {
            self.object = Some(index_of(&mut self.object_indices, &mut self.out.objects, UNNAMED));
        }
        if let (Some(object), true) = (self.object, self.last != (self.object, self.whole)) {
            self.last = (self.object, self.whole);
            let wholes = self.wholes.entry(object).or_default();
            if wholes.insert(self.whole) && wholes.len() == 2 {
                self.joined.push((object, self.head));
            }
        }
        let current = (self.object, self.material);
        if current != self.written {
            self.written = current;
            if let (Some(object), _) = current {
                let _ = writeln!(self.faces, "g {object}");
            }
            if let (_, Some(material)) = current {
                let _ = writeln!(self.faces, "usemtl {material}");
            }
        }
        self.faces.push('f');
        for corner in corners {
            let (vertex, normal) = self.corner(corner)?;
            // One more: the first normal stands for a missing one.
            let _ = write!(self.faces, " {vertex}//{}", normal.map_or(1, |n| n + 1));
        }
        self.faces.push('\n');
        self.out.face_lines.push(self.line);
        Ok(())
    }

    /// Indices, from 1, of a corner's vertex and normal.
    fn corner(&mut self, corner: &str) -> Result<(usize, Option<usize>)> {
        let parts: Vec<_> = corner.split('/').collect();
        let malformed =
            || self.error(format!("\"{corner}\" is not a vertex of a face (v, v/vt, v//vn or v/vt/vn)"));
        let vertex = match parts[..] {
            [vertex, ..] if !vertex.is_empty() && parts.len() <= 3 => vertex,
            _ => return Err(malformed()),
        };
        let parse = |text: &str| text.parse::<i64>().map_err(|_| malformed());
        let vertex = parse(vertex)?;
        let optional = |k: usize| match parts.get(k) {
            Some(&text) if !text.is_empty() => parse(text).map(Some),
            _ => Ok(None),
        };
        let (texture, normal) = (optional(1)?, optional(2)?);
        if let Some(texture) = texture {
            self.resolve(Kind::Texture, texture)?;
        }
        let normal = normal.map(|n| self.resolve(Kind::Normal, n)).transpose()?;
        Ok((self.resolve(Kind::Vertex, vertex)?, normal))
    }

    fn resolve(&mut self, kind: Kind, index: i64) -> Result<usize> {
        let defined = self.defined(kind);
        if index == 0 {
            let message = format!("{} index 0: indices count from 1, or from -1 backwards", kind.noun());
            return Err(self.error(message));
        }
        if index > 0 {
            // A face may come before its vertices: judge it at the end of the file.
            let index = index as usize;
            if index > defined {
                self.ahead.push((kind, index, self.line));
            }
            return Ok(index);
        }
        let back = index.unsigned_abs() as usize;
        if back > defined {
            return Err(self.out_of_range(kind, index, self.line, "come before this line"));
        }
        Ok(defined - back + 1)
    }

    fn defined(&self, kind: Kind) -> usize {
        match kind {
            Kind::Vertex => self.vertices,
            Kind::Texture => self.textures,
            Kind::Normal => self.normals,
        }
    }

    fn out_of_range(&self, kind: Kind, index: i64, line: usize, scope: &str) -> Error {
        let defined = self.defined(kind);
        let message =
            format!("{} index {index} is out of range: {defined} {} {scope}", kind.noun(), kind.plural());
        Error::parse(self.path, Some(line), message)
    }

    fn numbers(&self, keyword: &str, rest: &str) -> Result<Vec<f64>> {
        let number = |word: &str| match word.parse::<f64>() {
            Ok(n) if n.is_finite() => Ok(n),
            Ok(_) => Err(self.error(format!("{keyword}: {word} is not a finite number"))),
            Err(_) => Err(self.error(format!("{keyword}: \"{word}\" is not a number"))),
        };
        rest.split_whitespace().map(number).collect()
    }

    /// Warns of groups that are told apart by their `o` alone: these are one object here.
    fn tell_joined(&mut self) {
        let Some(&(object, line)) = self.joined.first() else { return };
        let name = |o: &Option<usize>| o.map_or(UNNAMED, |o| self.out.objects[o].as_str());
        let wholes = &self.wholes[&object];
        let mut named: Vec<String> = wholes.iter().take(NAMED).map(|o| format!("\"{}\"", name(o))).collect();
        if wholes.len() > named.len() {
            named.push(format!("{} more", wholes.len() - named.len()));
        }
        let others = match self.joined.len() - 1 {
            0 => String::new(),
            1 => "; so is 1 other group".to_string(),
            n => format!("; so are {n} other groups"),
        };
        let message = format!(
            "group \"{}\" is in {} objects ({}), but counts as one object of that name: give each of them a g of its own{others}",
            self.out.objects[object],
            wholes.len(),
            named.join(", ")
        );
        self.warn(line, message);
    }

    fn finish(mut self) -> Result<ObjText> {
        let ahead = self.ahead.iter().find(|(kind, index, _)| *index > self.defined(*kind));
        if let Some(&(kind, index, line)) = ahead {
            return Err(self.out_of_range(kind, index as i64, line, "are in the file"));
        }
        self.tell_joined();
        if self.elements > 0 {
            let path = self.path.display();
            self.out.warnings.push(format!("{path}: {} point and line elements were skipped", self.elements));
        }
        self.out.advice = self.advice();
        self.out.canonical.push_str(&self.faces);
        Ok(self.out)
    }
}

/// Text of lines that end in carriage returns alone, as those of old Macintosh files do, with line feeds in their place.
pub(super) fn with_line_feeds(text: &str) -> Cow<'_, str> {
    match text.contains('\r') && !text.contains('\n') {
        true => text.replace('\r', "\n").into(),
        false => text.into(),
    }
}

/// A comment starts the line or follows white space: names may hold a `#`, and numbers may not.
fn without_comment(line: &str) -> &str {
    let line = line.trim();
    let numeric = matches!(line.split_whitespace().next(), Some("v" | "vn" | "vt" | "f" | "l" | "p"));
    let starts =
        |&(at, _): &(usize, &str)| numeric || line[..at].chars().next_back().is_none_or(char::is_whitespace);
    match line.match_indices('#').find(starts) {
        Some((at, _)) => line[..at].trim_end(),
        None => line,
    }
}

/// Index of `name` in `names`, to whose end it is added when new.
fn index_of(indices: &mut HashMap<String, usize>, names: &mut Vec<String>, name: &str) -> usize {
    if let Some(&index) = indices.get(name) {
        return index;
    }
    indices.insert(name.to_string(), names.len());
    names.push(name.to_string());
    names.len() - 1
}
