//! Arrays by name in one file, as `numpy.load` opens it: a ZIP archive of NumPy's `.npy` files.
//!
//! Written without compression: what is stored is noise in its last digits, and compressing takes longer than computing it.
//! Read with or without, as `numpy.savez_compressed` may have written it.

use npyz::{AutoSerialize, DType, TypeWrite, WriterBuilder};
use std::io::{ErrorKind, Read, Result, Seek, SeekFrom, Write};
use zip::result::{ZipError, ZipResult};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// Bytes that go into the file at a time.
const BUFFER: usize = 1 << 16;
/// Bytes of an array's file before its values, at most.
const HEADER: u64 = 1 << 16;

/// Where a file is that takes nothing any more: behind whatever was written.
const NOWHERE: u64 = 1 << 48;

/// A file that is being written.
pub struct Writer<W: Write + Seek>(ZipWriter<Told<W>>);

/// A file whose first failure is told, and whose later ones are not: an archive that was given up is ended when it is dropped,
/// and what fails then is printed.
struct Told<W> {
    file: W,
    failed: bool,
}

impl<W> Told<W> {
    fn unless_failed<T>(&mut self, otherwise: T, work: impl FnOnce(&mut W) -> Result<T>) -> Result<T> {
        if self.failed {
            return Ok(otherwise);
        }
        work(&mut self.file).inspect_err(|e| self.failed = e.kind() != ErrorKind::Interrupted)
    }
}

impl<W: Write> Write for Told<W> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.unless_failed(bytes.len(), |file| file.write(bytes))
    }

    fn flush(&mut self) -> Result<()> {
        self.unless_failed((), W::flush)
    }
}

impl<W: Seek> Seek for Told<W> {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.unless_failed(NOWHERE, |file| file.seek(to))
    }
}

impl<W: Write + Seek> Writer<W> {
    /// Begins a file.
    pub fn new(file: W) -> Writer<W> {
        Writer(ZipWriter::new(Told { file, failed: false }))
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

    fn entry(&mut self, name: &str) -> Result<&mut ZipWriter<Told<W>>> {
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
        let Told { file, failed } = self.0.finish()?;
        if failed {
            return Err(std::io::Error::other("an array before could not be written"));
        }
        Ok(file)
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// A disk that is full after some bytes, and what was asked of it then.
    struct Full<'a> {
        free: usize,
        at: u64,
        asked: &'a Cell<u32>,
    }

    impl Full<'_> {
        fn refuse<T>(&self) -> Result<T> {
            self.asked.set(self.asked.get() + 1);
            Err(ErrorKind::StorageFull.into())
        }
    }

    impl Write for Full<'_> {
        fn write(&mut self, bytes: &[u8]) -> Result<usize> {
            if self.free < bytes.len() {
                return self.refuse();
            }
            (self.free, self.at) = (self.free - bytes.len(), self.at + bytes.len() as u64);
            Ok(bytes.len())
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    impl Seek for Full<'_> {
        fn seek(&mut self, to: SeekFrom) -> Result<u64> {
            if let SeekFrom::Start(at) = to {
                self.at = at;
            }
            Ok(self.at)
        }
    }

    /// Nothing is tried again, whose failure would be printed in the middle of what the program says.
    #[test]
    fn a_full_disk_is_told_once() {
        let asked = Cell::new(0);
        let write = |free: usize| {
            asked.set(0);
            let mut npz = Writer::new(Full { free, at: 0, asked: &asked });
            npz.array("a", &[100], (0..100).map(f64::from))?;
            npz.text("b", "text")?;
            npz.finish().map(drop)
        };
        let mut failed = 0;
        for free in (0..).step_by(7).take_while(|free| write(*free).is_err()) {
            assert_eq!((asked.get(), write(free).unwrap_err().kind()), (1, ErrorKind::StorageFull), "{free}");
            failed += 1;
        }
        assert!(failed > 100, "{failed}");
    }
}
