//! Output files that either are whole or do not exist: written beside their name, then renamed.

use crate::{Error, Result};
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// Whether a file can be written at `path`, for a command to refuse before its work is done.
///
/// What changes meanwhile is found by [`write_whole`].
pub fn check(path: &Path) -> Result<()> {
    let refuse = |kind: io::ErrorKind, message: String| Err(Error::io(path, io::Error::new(kind, message)));
    let folder = folder(path);
    if path.file_name().is_none() || path.is_dir() {
        return refuse(io::ErrorKind::IsADirectory, "is a folder; name a file in it".into());
    }
    if !folder.is_dir() {
        let message = format!("the folder {} does not exist; make it first", folder.display());
        return refuse(io::ErrorKind::NotFound, message);
    }
    // Permission bits do not tell of read-only file systems, access lists or root: try.
    let probe = Temporary::beside(path);
    File::create_new(&probe.0)
        .map(drop)
        .or_else(|e| refuse(e.kind(), format!("the folder {} cannot be written to: {e}", folder.display())))
}

/// Writes a file beside its name and renames it. A file that was there before stays until then.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole_with(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], for what is too large to be held as bytes.
pub fn write_whole_with(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<()> {
    let disk = |e: io::Error| Error::io(path, io::Error::new(e.kind(), format!("cannot be written: {e}")));
    let temporary = Temporary::beside(path);
    let mut writer = BufWriter::new(File::create_new(&temporary.0).map_err(disk)?);
    content(&mut writer).map_err(disk)?;
    let file = writer.into_inner().map_err(|e| disk(e.into_error()))?;
    // Late failures of a full or remote disk show here, while the old file is still in place.
    file.sync_all().map_err(disk)?;
    drop(file);
    fs::rename(&temporary.0, path).map_err(disk)
}

/// The folder of a file; `.` for a bare name.
fn folder(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file beside another, removed when dropped unless it was renamed.
struct Temporary(PathBuf);

impl Temporary {
    fn beside(path: &Path) -> Temporary {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let count = COUNT.fetch_add(1, Ordering::Relaxed);
        // Not made of the file's own name, which may be as long as a name can be.
        Temporary(folder(path).join(format!(".twopass-{}-{count}.tmp", std::process::id())))
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // Fails where the file was renamed or never made: both are as they should be.
        let _ = fs::remove_file(&self.0);
    }
}
