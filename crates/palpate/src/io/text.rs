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

/// Checks that files could be written into a folder, which is there or could be made.
///
/// # Errors
/// [`IoError::IsFile`] if it, or one above it, is a file; [`IoError::Write`] with the system's reason.
pub fn check_folder(path: impl AsRef<Path>) -> Result<(), IoError> {
    let path = path.as_ref();
    // What is not there yet is made in the nearest folder above that is.
    let there = path.ancestors().find(|p| p.as_os_str().is_empty() || p.exists()).unwrap_or(Path::new("."));
    let there = if there.as_os_str().is_empty() { Path::new(".") } else { there };
    if !there.is_dir() {
        return Err(IoError::IsFile { path: path.to_owned(), file: there.to_owned() });
    }
    tempfile::tempfile_in(there).map(drop).map_err(|source| IoError::Write { path: path.to_owned(), source })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_cannot_be_made_names_the_file_in_the_way() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let file = folder.path().join("file");
        fs::write(&file, "").expect("written");
        check_folder(folder.path()).expect("there");
        check_folder(folder.path().join("a/b")).expect("can be made");
        assert!(!folder.path().join("a").exists(), "only looked at");
        check_folder("somewhere").expect("can be made here");
        for path in [file.clone(), file.join("below")] {
            let error = check_folder(&path).expect_err("a file is in the way").to_string();
            assert!(error.contains("a folder is needed") && error.contains(&path.display().to_string()), "{error}");
        }
    }
}
