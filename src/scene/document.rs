//! The TOML scene file as tables whose every entry knows its line.

use super::material::MOST_RADIANCE;
use crate::error::{Error, Result};
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A TOML text and the file that it came from.
pub(super) struct Document<'a> {
    /// The file.
    pub path: &'a Path,
    text: &'a str,
    /// Offsets of the line ends.
    line_ends: Vec<usize>,
}

impl<'a> Document<'a> {
    /// The text of the file `path`.
    pub fn new(path: &'a Path, text: &'a str) -> Document<'a> {
        Document { path, text, line_ends: text.match_indices('\n').map(|(at, _)| at).collect() }
    }

    /// Line, from 1, of a byte offset.
    pub fn line(&self, offset: usize) -> usize {
        1 + self.line_ends.partition_point(|&end| end < offset)
    }

    /// An error at `line`.
    pub fn error(&self, line: usize, message: impl Into<String>) -> Error {
        Error::parse(self.path, Some(line), message)
    }

    /// Parses the text.
    pub fn parse(&self) -> Result<DeTable<'_>> {
        DeTable::parse(self.text).map(Spanned::into_inner).map_err(|e| {
            let line = e.span().map(|s| self.line(s.start));
            Error::parse(self.path, line, e.message().trim().replace('\n', ", "))
        })
    }
}

/// One table of a document.
#[derive(Clone)]
pub(super) struct Section<'a> {
    /// The document.
    pub doc: &'a Document<'a>,
    /// Its entries.
    pub table: &'a DeTable<'a>,
    /// How messages call it, for example `material "white"`; empty for the top level.
    pub label: String,
    /// Where it starts.
    pub line: usize,
}

impl<'a> Section<'a> {
    /// The entry of that name.
    pub fn get(&self, key: &str) -> Option<Entry<'a>> {
        self.entries().find(|e| e.key == key)
    }

    /// All entries.
    pub fn entries(&self) -> impl Iterator<Item = Entry<'a>> + '_ {
        self.table.iter().map(|(key, value)| Entry {
            doc: self.doc,
            label: self.label.clone(),
            key: key.get_ref(),
            line: self.doc.line(key.span().start),
            value,
        })
    }

    /// An error about this section.
    pub fn error(&self, message: impl std::fmt::Display) -> Error {
        self.doc.error(self.line, prefixed(&self.label, message))
    }

    /// An error for a required key that is not there; `help` says what to add. Names a key that looks like a slip for it.
    pub fn missing(&self, key: &str, known: &[&str], help: &str) -> Error {
        let slip = self
            .entries()
            .find(|e| !known.contains(&e.key) && nearest(e.key, known.iter().copied()) == Some(key));
        match slip {
            Some(e) => {
                let message = format!("has no {key}; unknown key \"{}\": did you mean \"{key}\"?", e.key);
                self.doc.error(e.line, prefixed(&self.label, message))
            }
            None => self.error(format!("has no {key}; {help}")),
        }
    }

    /// Warns about each key that is not in `known`, with the nearest one that is.
    pub fn warn_unknown(&self, known: &[&str], warnings: &mut Vec<String>) {
        let mut unknown: Vec<_> = self.entries().filter(|e| !known.contains(&e.key)).collect();
        unknown.sort_by_key(|e| e.line);
        for entry in unknown {
            let hint = match nearest(entry.key, known.iter().copied()) {
                Some(near) => format!("did you mean \"{near}\"?"),
                None => format!("known keys: {}", known.join(", ")),
            };
            let message = format!("unknown key \"{}\" is ignored; {hint}", entry.key);
            warnings.push(self.doc.error(entry.line, prefixed(&self.label, message)).to_string());
        }
    }
}

/// One `key = value`.
pub(super) struct Entry<'a> {
    doc: &'a Document<'a>,
    label: String,
    /// The key.
    pub key: &'a str,
    /// The key's line.
    pub line: usize,
    value: &'a Spanned<DeValue<'a>>,
}

impl<'a> Entry<'a> {
    /// An error about this entry: `message` continues the key's name.
    pub fn error(&self, message: impl std::fmt::Display) -> Error {
        self.doc.error(self.line, prefixed(&self.label, format!("{} {message}", self.key)))
    }

    /// Where the entry is, for messages: file and line.
    pub fn place(&self) -> String {
        format!("{}:{}", self.doc.path.display(), self.line)
    }

    fn wrong_type(&self, expected: &str, found: &DeValue<'_>) -> Error {
        self.error(format!("must be {expected}, found {}", kind(found)))
    }

    /// A finite number.
    pub fn number(&self) -> Result<f64> {
        self.finite(self.value.get_ref(), "a number")
    }

    fn finite(&self, value: &DeValue<'_>, expected: &str) -> Result<f64> {
        let number = match value {
            DeValue::Float(f) => f.as_str().parse::<f64>().ok(),
            DeValue::Integer(i) => i64::from_str_radix(i.as_str(), i.radix()).ok().map(|i| i as f64),
            other => return Err(self.wrong_type(expected, other)),
        };
        match number {
            Some(n) if n.is_finite() => Ok(n),
            _ => Err(self.error(format!("must be {expected} that is finite, not {}", kind(value)))),
        }
    }

    /// A vertical field of view in degrees.
    pub fn field_of_view(&self) -> Result<f64> {
        match self.number()? {
            fov if fov > 0.0 && fov < 180.0 => Ok(fov),
            fov => Err(self.error(format!("must lie between 0 and 180 degrees, is {fov}"))),
        }
    }

    /// A number above zero.
    pub fn positive(&self) -> Result<f64> {
        let n = self.number()?;
        if n > 0.0 { Ok(n) } else { Err(self.error(format!("must be above 0, is {n}"))) }
    }

    /// A whole number from 1 to `max`.
    pub fn count(&self, max: u32) -> Result<u32> {
        self.count_from(1, max)
    }

    /// A whole number from `min` to `max`.
    pub fn count_from(&self, min: u32, max: u32) -> Result<u32> {
        self.whole(self.value.get_ref(), min, max)
    }

    fn whole(&self, value: &DeValue<'_>, min: u32, max: u32) -> Result<u32> {
        let DeValue::Integer(i) = value else {
            return Err(self.wrong_type("a whole number", value));
        };
        match i64::from_str_radix(i.as_str(), i.radix()) {
            Ok(n) if (i64::from(min)..=i64::from(max)).contains(&n) => Ok(n as u32),
            _ => Err(self.error(format!("must be a whole number from {min} to {max}, is {i}"))),
        }
    }

    /// Width and height, each from 1 to `max`.
    pub fn size(&self, max: u32) -> Result<[u32; 2]> {
        let items = self.items(2, "a list of 2 whole numbers")?;
        Ok([self.whole(items[0].get_ref(), 1, max)?, self.whole(items[1].get_ref(), 1, max)?])
    }

    /// Three finite numbers.
    pub fn vector(&self) -> Result<glam::DVec3> {
        let expected = "a list of 3 numbers";
        let items = self.items(3, expected)?;
        let mut v = [0.0; 3];
        for (slot, item) in v.iter_mut().zip(items) {
            *slot = self.finite(item.get_ref(), expected)?;
        }
        Ok(v.into())
    }

    /// A colour: three numbers, or one for all channels; none may be negative.
    pub fn color(&self) -> Result<crate::color::Rgb> {
        let color = match self.value.get_ref() {
            DeValue::Array(_) => self.vector()?,
            other => glam::DVec3::splat(self.finite(other, "a list of 3 numbers, or one number")?),
        };
        if color.min_element() < 0.0 {
            return Err(self.error(format!("must not be negative, is {color}")));
        }
        if color.max_element() > MOST_RADIANCE {
            return Err(self.error(format!("must be at most {MOST_RADIANCE:e}, is {color}")));
        }
        Ok(color)
    }

    /// `true` or `false`.
    pub fn flag(&self) -> Result<bool> {
        let value = self.value.get_ref();
        value.as_bool().ok_or_else(|| self.wrong_type("true or false", value))
    }

    /// A string.
    pub fn text(&self) -> Result<&'a str> {
        let value = self.value.get_ref();
        value.as_str().ok_or_else(|| self.wrong_type("a string", value))
    }

    /// A list of strings, each with its line.
    pub fn texts(&self) -> Result<Vec<(&'a str, usize)>> {
        let expected = "a list of strings";
        let value = self.value.get_ref();
        let array = value.as_array().ok_or_else(|| self.wrong_type(expected, value))?;
        let text = |item: &'a Spanned<DeValue<'a>>| {
            let text = item.get_ref().as_str();
            let text = text.ok_or_else(|| self.wrong_type(expected, item.get_ref()))?;
            Ok((text, self.doc.line(item.span().start)))
        };
        array.iter().map(text).collect()
    }

    /// A table, called `label` in messages.
    pub fn section(&self, label: String) -> Result<Section<'a>> {
        match self.value.get_ref() {
            DeValue::Table(table) => Ok(Section { doc: self.doc, table, label, line: self.line }),
            other => Err(self.wrong_type("a table", other)),
        }
    }

    /// A table, or a list of tables; not labelled yet.
    pub fn sections(&self) -> Result<Vec<Section<'a>>> {
        let DeValue::Array(array) = self.value.get_ref() else {
            return Ok(vec![self.section(String::new())?]);
        };
        let section = |item: &'a Spanned<DeValue<'a>>| match item.get_ref() {
            DeValue::Table(table) => {
                let line = self.doc.line(item.span().start);
                Ok(Section { doc: self.doc, table, label: String::new(), line })
            }
            other => Err(self.wrong_type("a table or a list of tables", other)),
        };
        array.iter().map(section).collect()
    }

    fn items(&self, n: usize, expected: &str) -> Result<&'a [Spanned<DeValue<'a>>]> {
        let value = self.value.get_ref();
        let array = value.as_array().ok_or_else(|| self.wrong_type(expected, value))?;
        if array.len() == n {
            Ok(array)
        } else {
            Err(self.error(format!("must be {expected}, found {}", array.len())))
        }
    }
}

/// The name among `known` that `name` was probably meant to be.
pub(super) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let wanted = name.to_lowercase();
    let distance = |k: &str| strsim::damerau_levenshtein(&wanted, &k.to_lowercase());
    let near = known.into_iter().map(|k| (distance(k), k)).min_by_key(|&(d, _)| d);
    near.filter(|(d, k)| *d <= 1 + k.chars().count() / 3).map(|(_, k)| k)
}

fn prefixed(label: &str, message: impl std::fmt::Display) -> String {
    if label.is_empty() { message.to_string() } else { format!("{label}: {message}") }
}

fn kind(value: &DeValue<'_>) -> String {
    match value {
        DeValue::String(s) => format!("the string \"{s}\""),
        DeValue::Integer(i) => i.to_string(),
        DeValue::Float(f) => f.as_str().to_string(),
        DeValue::Boolean(b) => b.to_string(),
        DeValue::Datetime(d) => format!("the date {d}"),
        DeValue::Array(_) => "a list".into(),
        DeValue::Table(_) => "a table".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_count_from_one() {
        let doc = Document::new(Path::new("x"), "ab\n\nc");
        assert_eq!([0, 2, 3, 4, 9].map(|at| doc.line(at)), [1, 1, 2, 3, 3]);
    }

    #[test]
    fn nearest_name_or_none() {
        let known = ["diffuse", "specular", "ior"];
        assert_eq!(nearest("Difuse", known), Some("diffuse"));
        assert_eq!(nearest("iro", known), Some("ior"));
        assert_eq!(nearest("texture", known), None);
    }
}
