//! The one error type. Every variant names the file, line or object that it is about.

use std::path::{Path, PathBuf};

/// Whatever can go wrong between reading a scene and writing a result.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file could not be read or written.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: std::io::Error,
    },
    /// A file holds something that cannot be used.
    #[error("{}{}: {message}", path.display(), line.map(|l| format!(":{l}")).unwrap_or_default())]
    Parse {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1, where known.
        line: Option<usize>,
        /// What is wrong and what to do.
        message: String,
    },
    /// A part of the scene (camera, material, object) is unusable.
    #[error("{what}: {message}")]
    Scene {
        /// The part by its name, for example `camera "main"`.
        what: String,
        /// What is wrong and what to do.
        message: String,
    },
    /// A request that makes no sense; exit code 2.
    #[error("{0}")]
    Usage(String),
    /// Embree refused.
    #[error("Embree: {0}")]
    Embree(String),
    /// An image could not be read or written.
    #[error("{}: {message}", path.display())]
    Image {
        /// The image file.
        path: PathBuf,
        /// What the image library said.
        message: String,
    },
}

/// `Result` with this crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An I/O error about `path`.
    pub fn io(path: impl AsRef<Path>, source: std::io::Error) -> Error {
        Error::Io { path: path.as_ref().into(), source }
    }

    /// A malformed file, at `line` (from 1) where known.
    pub fn parse(path: impl AsRef<Path>, line: Option<usize>, message: impl Into<String>) -> Error {
        Error::Parse { path: path.as_ref().into(), line, message: message.into() }
    }

    /// An unusable part of the scene.
    pub fn scene(what: impl Into<String>, message: impl Into<String>) -> Error {
        Error::Scene { what: what.into(), message: message.into() }
    }

    /// Process exit code: 2 for bad usage, 1 for everything else.
    pub fn exit_code(&self) -> u8 {
        match self {
            Error::Usage(_) => 2,
            _ => 1,
        }
    }
}
