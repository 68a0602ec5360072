use super::{IoError, atomic_write};
use std::fs;
use std::io::Write as _;
use std::path::Path;

/// Reads a text file.
///
/// # Errors
/// [`IoError::Read`] with the system's reason.
pub fn read_text(path: impl AsRef<Path>) -> Result<String, IoError> {
    let path = path.as_ref();
    fs::read_to_string(path).map_err(|source| IoError::Read { path: path.to_owned(), source })
}

/// Writes a text file, whole or not at all.
///
/// # Errors
/// As [`atomic_write`].
pub fn write_text(path: impl AsRef<Path>, text: &str) -> Result<(), IoError> {
    atomic_write(path, |writer| writer.write_all(text.as_bytes()))
}

/// Makes a folder and those above it; an existing one is fine.
///
/// # Errors
/// [`IoError::Write`] with the system's reason.
pub fn create_folder(path: impl AsRef<Path>) -> Result<(), IoError> {
    let path = path.as_ref();
    fs::create_dir_all(path).map_err(|source| IoError::Write { path: path.to_owned(), source })
}

/// Checks that a mesh could be written under this name: a known extension, and as [`check_writable`].
///
/// # Errors
/// [`IoError::Extension`], or as [`check_writable`].
pub fn check_mesh_output(path: impl AsRef<Path>) -> Result<(), IoError> {
    check_writable(path.as_ref())?;
    super::mesh_files::check_mesh_extension(path.as_ref())
}

/// Checks that a cloud could be written under this name: `.ply`, and as [`check_writable`].
///
/// # Errors
/// [`IoError::Extension`], or as [`check_writable`].
pub fn check_cloud_output(path: impl AsRef<Path>) -> Result<(), IoError> {
    check_writable(path.as_ref())?;
    super::mesh_files::check_cloud_extension(path.as_ref())
}

/// Checks that an output file could be written, before hours are spent on what goes into it.
///
/// # Errors
/// [`IoError::NoFolder`], [`IoError::IsFolder`], or [`IoError::Write`] with the system's reason.
pub fn check_writable(path: impl AsRef<Path>) -> Result<(), IoError> {
    let path = path.as_ref();
    if path.is_dir() {
        return Err(IoError::IsFolder { path: path.to_owned() });
    }
    let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !folder.is_dir() {
        return Err(IoError::NoFolder { path: path.to_owned(), folder: folder.to_owned() });
    }
    if path.exists() {
        return Ok(());
    }
    tempfile::tempfile_in(folder).map(drop).map_err(|source| IoError::Write { path: path.to_owned(), source })
}
