use std::path::{Path, PathBuf};

/// Why a file could not be read or written. Messages name the file, what was found and what was needed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IoError {
    /// The file cannot be opened or read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// The file cannot be written; nothing was left under its name.
    #[error("cannot write {}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why, in the system's words.
        source: std::io::Error,
    },
    /// The folder that should hold the output is not there.
    #[error("cannot write {}: the folder {} does not exist", path.display(), folder.display())]
    NoFolder {
        /// The output.
        path: PathBuf,
        /// Its missing folder.
        folder: PathBuf,
    },
    /// A folder has the name of the output.
    #[error("cannot write {}: it is a folder, a file is needed", path.display())]
    IsFolder {
        /// The output.
        path: PathBuf,
    },
    /// A file has the name of the folder for the output, or of one above it.
    #[error("cannot write into {}: {} is a file, a folder is needed", path.display(), file.display())]
    IsFile {
        /// The folder.
        path: PathBuf,
        /// The file in its way.
        file: PathBuf,
    },
    /// The content breaks the rules of its format, or is cut short.
    #[error("{}: not a readable {format} file: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Name of the format.
        format: &'static str,
        /// What is wrong, and where.
        reason: String,
    },
    /// The extension names no format that is known here.
    #[error("{}: the extension tells the format and must be one of {known}", path.display())]
    Extension {
        /// The file.
        path: PathBuf,
        /// Extensions that would do.
        known: &'static str,
    },
    /// A mesh was asked for, but the file holds no face.
    #[error("{}: no faces ({vertices} vertices); a mesh is needed", path.display())]
    NoFaces {
        /// The file.
        path: PathBuf,
        /// Vertices that it does hold.
        vertices: usize,
    },
    /// A vertex is NaN, infinite or absurdly far away.
    #[error("{}: vertex {index} is ({}, {}, {}); finite coordinates below 1e9 are needed", path.display(), value[0], value[1], value[2])]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Which vertex, from 0.
        index: usize,
        /// Its coordinates.
        value: [f64; 3],
    },
    /// An image, map or array has the wrong size.
    #[error("{}: the size is {}×{}, but {needed_by} needs {}×{} (width × height)", path.display(), found[0], found[1], needed[0], needed[1])]
    Size {
        /// The file.
        path: PathBuf,
        /// Width and height found.
        found: [usize; 2],
        /// Width and height needed.
        needed: [usize; 2],
        /// What asks for that size.
        needed_by: &'static str,
    },
    /// The values cannot mean what they should.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What was found and what is needed.
        reason: String,
    },
    /// `scene.toml` is not understood.
    #[error("{}: {reason}", path.display())]
    Scene {
        /// The scene file.
        path: PathBuf,
        /// The key, what was found and what is needed.
        reason: String,
    },
    /// A file that a key of `scene.toml` names is missing or bad.
    #[error("{}: {key}", scene.display())]
    InScene {
        /// The scene file.
        scene: PathBuf,
        /// The key that names the file.
        key: String,
        /// What is wrong with it.
        source: Box<IoError>,
    },
}

impl IoError {
    pub(super) fn malformed(path: &Path, format: &'static str, reason: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), format, reason: reason.into() }
    }

    pub(super) fn content(path: &Path, reason: impl Into<String>) -> Self {
        Self::Content { path: path.to_owned(), reason: reason.into() }
    }
}

/// The whole file.
pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, IoError> {
    std::fs::read(path).map_err(|source| IoError::Read { path: path.to_owned(), source })
}
