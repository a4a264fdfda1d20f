//! Arrays by name in one file, as `numpy.load` opens it: a ZIP archive of NumPy's `.npy` files.
//!
//! Written without compression: what is stored is noise in its last digits, and compressing takes longer than computing it.
//! Read with or without, as `numpy.savez_compressed` may have written it.

use npyz::{AutoSerialize, DType, TypeWrite, WriterBuilder};
use std::io::{Read, Result, Seek, Write};
use zip::result::{ZipError, ZipResult};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Bytes that go into the file at a time.
const BUFFER: usize = 1 << 16;
/// Bytes of an array's file before its values, at most.
const HEADER: u64 = 1 << 16;

/// A file that is being written.
pub struct Writer<W: Write + Seek>(ZipWriter<W>);

impl<W: Write + Seek> Writer<W> {
    /// Begins a file.
    pub fn new(file: W) -> Writer<W> {
        Writer(ZipWriter::new(file))
    }

    /// Adds an array, rows first; `values` are as many as `shape` says.
    ///
    /// # Errors
    /// Those of the file; there are more values, or fewer.
    pub fn array<T: AutoSerialize>(
        &mut self,
        name: &str,
        shape: &[u64],
        values: impl Iterator<Item = T>,
    ) -> Result<()> {
        let kind = T::default_dtype();
        let options = npyz::WriteOptions::new_header_only().dtype(kind.clone()).shape(shape);
        let entry = options.writer(self.entry(name)?).write_header_only()?;
        // npyz's own writer hands on each number by itself.
        let writer = T::writer(&kind).map_err(std::io::Error::other)?;
        let mut left = shape.iter().product::<u64>();
        let mut buffer = Vec::with_capacity(BUFFER + 16);
        for value in values {
            left =
                left.checked_sub(1).ok_or_else(|| std::io::Error::other("more values than the shape has"))?;
            writer.write_one(&mut buffer, &value)?;
            if buffer.len() >= BUFFER {
                entry.write_all(&buffer)?;
                buffer.clear();
            }
        }
        if left > 0 {
            return Err(std::io::Error::other("fewer values than the shape has"));
        }
        entry.write_all(&buffer)
    }

    /// Adds a text without dimensions, as bytes.
    ///
    /// # Errors
    /// Those of the file.
    pub fn text(&mut self, name: &str, text: &str) -> Result<()> {
        let kind = DType::Plain(format!("|S{}", text.len()).parse().map_err(std::io::Error::other)?);
        let options = npyz::WriteOptions::new().dtype(kind).shape(&[]);
        let mut writer = options.writer(self.entry(name)?).begin_nd()?;
        writer.push(text.as_bytes())?;
        writer.finish()
    }

    /// Adds a row of texts, as NumPy's fixed-width Unicode, which it reads without pickle.
    ///
    /// # Errors
    /// Those of the file.
    pub fn texts(&mut self, name: &str, texts: &[String]) -> Result<()> {
        let width = texts.iter().map(|t| t.chars().count()).max().unwrap_or(0).max(1);
        let kind = DType::Plain(format!("<U{width}").parse().map_err(std::io::Error::other)?);
        let options = npyz::WriteOptions::new_header_only().dtype(kind).shape(&[texts.len() as u64]);
        let entry = options.writer(self.entry(name)?).write_header_only()?;
        for text in texts {
            let characters = text.chars().map(u32::from).chain(std::iter::repeat(0)).take(width);
            let bytes: Vec<u8> = characters.flat_map(u32::to_le_bytes).collect();
            entry.write_all(&bytes)?;
        }
        Ok(())
    }

    fn entry(&mut self, name: &str) -> Result<&mut ZipWriter<W>> {
        // More than 4 GiB need to be announced before it is known how much there is.
        let stored =
            SimpleFileOptions::default().compression_method(CompressionMethod::Stored).large_file(true);
        self.0.start_file(format!("{name}.npy"), stored)?;
        Ok(&mut self.0)
    }

    /// Ends the file.
    ///
    /// # Errors
    /// Those of the file.
    pub fn finish(self) -> Result<W> {
        Ok(self.0.finish()?)
    }
}

/// A file that is being read.
pub struct Reader<R: Read + Seek>(ZipArchive<R>);

impl<R: Read + Seek> Reader<R> {
    /// Opens a file.
    ///
    /// # Errors
    /// It is no archive, or a damaged one.
    pub fn new(file: R) -> ZipResult<Reader<R>> {
        Ok(Reader(ZipArchive::new(file)?))
    }

    /// Whether there is such an array.
    pub fn has(&self, name: &str) -> bool {
        self.0.index_for_name(&format!("{name}.npy")).is_some()
    }

    /// The bytes of an array's `.npy` file, checked against their checksum; none where there is no such array.
    ///
    /// # Errors
    /// The entry is damaged, or more than `most` bytes of values: a small file may hold any number of zeros.
    pub fn bytes(&mut self, name: &str, most: u64) -> ZipResult<Option<Vec<u8>>> {
        let entry = match self.0.by_name(&format!("{name}.npy")) {
            Err(ZipError::FileNotFound) => return Ok(None),
            found => found?,
        };
        let mut bytes = Vec::new();
        let most = most.saturating_add(HEADER);
        // One more, so that the checksum is looked at where the entry ends in time.
        entry.take(most + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > most {
            return Err(ZipError::InvalidArchive("it is longer than it can be".into()));
        }
        Ok(Some(bytes))
    }
}
