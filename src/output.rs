//! Output files that either are whole or do not exist: written beside their name, then renamed.

use crate::{Error, Result};
use std::collections::HashSet;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, BufWriter, Seek, Write};
use std::os::unix::fs::{FileTypeExt, PermissionsExt};
use std::path::{Path, PathBuf};
use tempfile::NamedTempFile;

/// Links to links that are followed, as many as Linux follows.
const MOST_LINKS: u32 = 40;
/// Permissions of a new file, before the user's mask.
const NEW: u32 = 0o666;

/// Where an output goes.
enum Target {
    /// A file, links followed, and the permissions of the one that is replaced.
    File(PathBuf, Option<Permissions>),
    /// A pipe or a device: nothing that could be replaced.
    Stream,
}

/// Whether a file can be written at `path`, for a command to refuse before its work is done.
///
/// What changes meanwhile is found by [`write_whole`].
pub fn check(path: &Path) -> Result<()> {
    check_all([path])
}

/// [`check`] of many files, such as the frames of a sequence: what makes a file in a folder to try it does so once.
pub fn check_all<'a>(paths: impl IntoIterator<Item = &'a Path>) -> Result<()> {
    let mut tried = HashSet::new();
    paths.into_iter().try_for_each(|path| check_in(path, &mut tried))
}

fn check_in(path: &Path, tried: &mut HashSet<PathBuf>) -> Result<()> {
    let refuse = |kind: io::ErrorKind, message: String| Err(Error::io(path, io::Error::new(kind, message)));
    let Target::File(file, old) = target(path)? else { return Ok(()) };
    let folder = folder(&file);
    if !tried.insert(folder.into()) {
        return Ok(());
    }
    if !folder.is_dir() {
        let message = format!("the folder {} does not exist; make it first", folder.display());
        return refuse(io::ErrorKind::NotFound, message);
    }
    // Permission bits do not tell of read-only file systems, access lists or root: try.
    beside(&file, old.as_ref())
        .map(drop)
        .or_else(|e| refuse(e.kind(), format!("the folder {} cannot be written to: {e}", folder.display())))
}

/// Writes a file beside its name and renames it. A file that was there before stays until then, and its permissions
/// after; where the name is a link, it is the file that it leads to. A pipe or a device is written to.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_whole_with(path, |file| file.write_all(bytes))
}

/// As [`write_whole`], for what is too large to be held as bytes.
pub fn write_whole_with(
    path: &Path,
    content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>,
) -> Result<()> {
    let disk = |e: io::Error| Error::io(path, io::Error::new(e.kind(), format!("cannot be written: {e}")));
    match target(path)? {
        Target::File(file, old) => replace(&file, old, content),
        Target::Stream => pass_on(path, content),
    }
    .map_err(disk)
}

fn replace(
    path: &Path,
    old: Option<Permissions>,
    content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>,
) -> io::Result<()> {
    let temporary = beside(path, old.as_ref())?;
    fill(temporary.as_file(), content)?;
    if let Some(old) = old {
        // The user's mask does not apply to what was there.
        temporary.as_file().set_permissions(old)?;
    }
    // Late failures of a full or remote disk show here, while the old file is still in place.
    temporary.as_file().sync_all()?;
    temporary.persist(path).map(drop).map_err(|e| e.error)
}

/// Content of a file goes back and forth, which a pipe cannot: it is passed on once it is whole.
fn pass_on(path: &Path, content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>) -> io::Result<()> {
    let mut whole = tempfile::tempfile()?;
    fill(&whole, content)?;
    whole.rewind()?;
    io::copy(&mut whole, &mut append(path)?).map(drop)
}

fn fill(file: &File, content: impl FnOnce(&mut BufWriter<&File>) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::new(file);
    content(&mut writer)?;
    writer.flush()
}

/// What is at the end of the links that `path` may be.
fn target(path: &Path) -> Result<Target> {
    let refuse = |kind: io::ErrorKind, message: String| Error::io(path, io::Error::new(kind, message));
    let unwritable = |e: io::Error| {
        let help = "choose another name, or let it be written to";
        refuse(e.kind(), format!("exists and cannot be written to ({e}); {help}"))
    };
    if path.file_name().is_none() || path.is_dir() {
        return Err(refuse(io::ErrorKind::IsADirectory, "is a folder; name a file in it".into()));
    }
    let file = match end_of_links(path) {
        // What a shell has opened as standard output is its own, even if it is a file.
        file if is_descriptor(&file) => return append(path).map(|_| Target::Stream).map_err(unwritable),
        file => file,
    };
    let found = match fs::metadata(&file) {
        Ok(found) => found,
        Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            return Ok(Target::File(file, None));
        }
        Err(e) => return Err(Error::io(path, e)),
    };
    let kind = found.file_type();
    if kind.is_fifo() {
        // Opened and closed, it would end for who reads it.
        return Ok(Target::Stream);
    }
    if !kind.is_file() && !kind.is_char_device() {
        let message = "is neither a file nor a pipe; choose another name";
        return Err(refuse(io::ErrorKind::InvalidInput, message.into()));
    }
    append(&file).map_err(unwritable)?;
    Ok(if kind.is_file() { Target::File(file, Some(found.permissions())) } else { Target::Stream })
}

/// The file that a link leads to, whether it exists or not; `path` where it is none.
fn end_of_links(path: &Path) -> PathBuf {
    let mut file = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&file) {
            Ok(to) if !is_descriptor(&file) => file = folder(&file).join(to),
            _ => break,
        }
    }
    file
}

/// Whether a path names what a process has opened, as /dev/stdout does.
fn is_descriptor(path: &Path) -> bool {
    path.is_symlink() && folder(path).canonicalize().is_ok_and(|f| f.starts_with("/proc"))
}

/// Opens a file or device to write behind what is there.
fn append(path: &Path) -> io::Result<File> {
    OpenOptions::new().append(true).open(path)
}

/// The one name of a file that may not exist yet.
pub fn place(path: &Path) -> PathBuf {
    let file = end_of_links(path);
    let folder = folder(&file);
    folder.canonicalize().unwrap_or_else(|_| folder.into()).join(file.file_name().unwrap_or_default())
}

/// The folder of a file; `.` for a bare name.
fn folder(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file beside another, removed when dropped unless it was renamed, that nobody may read who may not read the other.
fn beside(path: &Path, old: Option<&Permissions>) -> io::Result<NamedTempFile> {
    // Not made of the file's own name, which may be as long as a name can be.
    tempfile::Builder::new()
        .prefix(".twopass-")
        .suffix(".tmp")
        .permissions(old.cloned().unwrap_or_else(|| Permissions::from_mode(NEW)))
        .tempfile_in(folder(path))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;
    use std::process::Command;

    fn names(folder: &Path) -> Vec<String> {
        let name = |e: io::Result<fs::DirEntry>| e.unwrap().file_name().into_string().unwrap();
        let mut names: Vec<String> = fs::read_dir(folder).unwrap().map(name).collect();
        names.sort();
        names
    }

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o7777
    }

    /// A process of the same number in another container may be writing into the same folder.
    #[test]
    fn files_of_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        let others: Vec<String> =
            (0..64).map(|k| format!(".twopass-{}-{k}.tmp", std::process::id())).collect();
        others.iter().for_each(|name| fs::write(folder.path().join(name), "half").unwrap());
        check(&path).unwrap();
        write_whole(&path, b"whole").unwrap();
        assert!(write_whole_with(&path, |_| Err(io::Error::other("no"))).is_err());
        assert_eq!(names(folder.path()).len(), others.len() + 1);
        assert!(others.iter().all(|name| fs::read(folder.path().join(name)).unwrap() == b"half"));
        assert_eq!(fs::read(&path).unwrap(), b"whole");
    }

    #[test]
    fn permissions_stay_and_those_of_new_files_are_the_usual_ones() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        write_whole(&path, b"1").unwrap();
        let usual = folder.path().join("usual");
        fs::write(&usual, "").unwrap();
        assert_eq!(mode(&path), mode(&usual));
        for bits in [0o600, 0o666, 0o755] {
            fs::set_permissions(&path, Permissions::from_mode(bits)).unwrap();
            check(&path).unwrap();
            write_whole(&path, b"2").unwrap();
            assert_eq!(mode(&path), bits, "{bits:o}");
        }
    }

    #[test]
    fn links_stay_and_their_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("far")).unwrap();
        fs::write(at("far/old"), "old").unwrap();
        symlink("far/old", at("first")).unwrap();
        symlink("first", at("second")).unwrap();
        symlink("far/new", at("third")).unwrap();
        for (link, file) in [("second", "far/old"), ("third", "far/new")] {
            check(&at(link)).unwrap();
            write_whole(&at(link), link.as_bytes()).unwrap();
            assert_eq!(fs::read(at(file)).unwrap(), link.as_bytes());
            assert!(at(link).is_symlink());
            assert_eq!(place(&at(link)), place(&at(file)));
        }
        assert!(at("first").is_symlink());
        assert_eq!(names(&at("far")), ["new", "old"]);
        symlink("gone/a", at("lost")).unwrap();
        assert!(check(&at("lost")).unwrap_err().to_string().contains("does not exist"));
        symlink("round", at("round")).unwrap();
        assert!(check(&at("round")).is_err() && write_whole(&at("round"), b"").is_err());
        assert!(at("round").is_symlink());
    }

    #[test]
    fn pipes_and_devices_are_written_to() {
        let folder = tempfile::tempdir().unwrap();
        let null = folder.path().join("null");
        symlink("/dev/null", &null).unwrap();
        check(&null).unwrap();
        write_whole(&null, b"x").unwrap();
        assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());

        let pipe = folder.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        check(&pipe).unwrap();
        let reader = Command::new("cat").arg(&pipe).stdout(std::process::Stdio::piped()).spawn().unwrap();
        // What goes back over its beginning, as an archive's writer does.
        let content = |file: &mut BufWriter<&File>| {
            file.write_all(b"?b")?;
            file.rewind()?;
            file.write_all(b"a")
        };
        write_whole_with(&pipe, content).unwrap();
        assert_eq!(reader.wait_with_output().unwrap().stdout, b"ab");
        assert_eq!(names(folder.path()), ["null", "pipe"]);

        let socket = folder.path().join("socket");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        assert!(check(&socket).unwrap_err().to_string().contains("neither a file nor a pipe"));
    }

    #[test]
    fn a_file_that_cannot_be_written_to_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.txt");
        fs::write(&path, "kept").unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o444)).unwrap();
        if append(&path).is_ok() {
            println!("skipped: permissions do not bind this user");
            return;
        }
        for refused in [check(&path), write_whole(&path, b"new")] {
            let message = refused.unwrap_err().to_string();
            assert!(message.contains("a.txt") && message.contains("cannot be written to"), "{message}");
        }
        assert_eq!(fs::read(&path).unwrap(), b"kept");
    }
}
