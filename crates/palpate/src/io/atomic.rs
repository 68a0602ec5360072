use super::IoError;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;

/// Writes a file that is complete or not there: into a temporary file of the same folder, which takes the final name only after
/// `write` succeeded and everything reached the system. An interrupted run leaves the old file, or none, under that name.
///
/// Devices and pipes (`/dev/stdout`) are written directly: renaming a file over them would replace them.
///
/// # Errors
/// [`IoError::NoFolder`], [`IoError::IsFolder`], or [`IoError::Write`] with the system's reason.
pub fn atomic_write(
    path: impl AsRef<Path>,
    write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<(), IoError> {
    let path = path.as_ref();
    let failed = |source| IoError::Write { path: path.to_owned(), source };
    if path.is_dir() {
        return Err(IoError::IsFolder { path: path.to_owned() });
    }
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if !folder.is_dir() {
        return Err(IoError::NoFolder { path: path.to_owned(), folder: folder.to_owned() });
    }
    if path.metadata().is_ok_and(|m| !m.is_file()) {
        let mut device = File::options().write(true).open(path).map_err(failed)?;
        return fill(&mut device, write).map_err(failed);
    }
    let mut temporary = builder().tempfile_in(folder).map_err(failed)?;
    fill(temporary.as_file_mut(), write).map_err(failed)?;
    temporary.persist(path).map_err(|e| failed(e.error))?;
    Ok(())
}

fn fill(file: &mut File, write: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>) -> io::Result<()> {
    let mut writer = BufWriter::new(file);
    write(&mut writer)?;
    writer.flush()
}

/// Temporary files are private by default; an output should have the permissions that any new file gets.
fn builder() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".palpate-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_the_old_file_and_nothing_else() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("out.txt");
        atomic_write(&path, |w| w.write_all(b"old")).expect("first write");
        let error = atomic_write(&path, |w| {
            w.write_all(b"half of the new")?;
            w.flush()?;
            Err(io::Error::other("stopped"))
        });
        assert!(matches!(error, Err(IoError::Write { .. })));
        assert_eq!(std::fs::read(&path).expect("still there"), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).expect("listing").count(), 1);
    }

    #[test]
    fn a_panicking_writer_leaves_no_file() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("out.txt");
        let result = std::panic::catch_unwind(|| atomic_write(&path, |_| panic!("killed")));
        assert!(result.is_err() && std::fs::read_dir(folder.path()).expect("listing").count() == 0);
    }

    #[test]
    fn missing_folder_and_folder_in_the_way_are_named() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let missing = atomic_write(folder.path().join("no/out.ply"), |_| Ok(())).expect_err("no such folder");
        assert!(missing.to_string().contains("does not exist"), "{missing}");
        let is_folder = atomic_write(folder.path(), |_| Ok(())).expect_err("a folder");
        assert!(is_folder.to_string().contains("it is a folder"), "{is_folder}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_device_is_written_and_not_replaced() {
        let full = atomic_write("/dev/full", |w| w.write_all(b"x")).expect_err("always full");
        assert!(matches!(full, IoError::Write { .. }));
        atomic_write("/dev/null", |w| w.write_all(b"x")).expect("swallows everything");
        assert!(!Path::new("/dev/null").metadata().expect("still there").is_file());
    }
}
