//! What a command is about to write, looked at before anything is computed: no target is a file that is read, no two are one file, and all
//! could be written.

use anyhow::{bail, ensure};
use palpate::io::{check_folder, check_writable};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

#[derive(Default)]
pub(crate) struct Targets {
    /// By what names one file, the way it was written.
    inputs: BTreeMap<PathBuf, PathBuf>,
    files: BTreeMap<PathBuf, String>,
}

impl Targets {
    /// Nothing of this is to be overwritten.
    pub(crate) fn keep<P: AsRef<Path>>(inputs: impl IntoIterator<Item = P>) -> Self {
        let named = |p: P| (one_name(p.as_ref()), p.as_ref().to_owned());
        Self { inputs: inputs.into_iter().map(named).collect(), files: BTreeMap::new() }
    }

    /// A file that will be written.
    ///
    /// * `what` – what it is for, in messages
    pub(crate) fn file(&mut self, path: &Path, what: &str) -> anyhow::Result<()> {
        self.take(path, what)?;
        Ok(check_writable(path)?)
    }

    /// Files that will be written into a folder, which is made if it is missing: name, and what it is for.
    pub(crate) fn files_in<N: AsRef<str>, W: AsRef<str>>(
        &mut self,
        folder: &Path,
        files: impl IntoIterator<Item = (N, W)>,
    ) -> anyhow::Result<()> {
        check_folder(folder)?;
        for (name, what) in files {
            let path = folder.join(name.as_ref());
            self.take(&path, what.as_ref())?;
            ensure!(!path.is_dir(), "cannot write {}: it is a folder, a file is needed", path.display());
        }
        Ok(())
    }

    fn take(&mut self, path: &Path, what: &str) -> anyhow::Result<()> {
        let name = one_name(path);
        if let Some(input) = self.inputs.get(&name) {
            bail!("{what} would overwrite {}, which is read: choose another place", input.display());
        }
        match self.files.insert(name, what.to_owned()) {
            None => Ok(()),
            Some(before) => {
                bail!("{before} and {what} would both be {}: each needs a file of its own", path.display())
            }
        }
    }
}

/// The same for every way to write a path: links followed as far as it exists.
pub(crate) fn one_name(path: &Path) -> PathBuf {
    let mut rest = Vec::new();
    let mut there = path;
    loop {
        let here = if there.as_os_str().is_empty() { Path::new(".") } else { there };
        if let Ok(found) = here.canonicalize() {
            return rest.iter().rev().fold(found, |all: PathBuf, part| all.join(part));
        }
        match (there.parent(), there.file_name()) {
            (Some(parent), Some(name)) => {
                rest.push(name);
                there = parent;
            }
            // A name that ends in .. below what does not exist: no file.
            _ => return path.to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_file_is_one_however_it_is_written() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("a")).expect("made");
        std::fs::write(at("in.png"), "").expect("written");
        let mut targets = Targets::keep([at("in.png")]);
        let said = |result: anyhow::Result<()>| result.expect_err("in the way").to_string();
        let input = said(targets.file(&at("a/../in.png"), "--output"));
        assert!(input.contains("--output would overwrite") && input.contains("in.png, which is read"), "{input}");
        targets.file(&at("out.toml"), "--output").expect("free");
        let twice = said(targets.file(&at("a/../out.toml"), "--coverage"));
        assert!(twice.contains("--output and --coverage would both be"), "{twice}");
        let clash = said(targets.files_in(&at("new/folder"), [("x.png", "a/x.jpg"), ("x.png", "b/x.jpg")]));
        assert!(clash.contains("a/x.jpg and b/x.jpg would both be") && clash.contains("x.png"), "{clash}");
        assert!(said(targets.files_in(&at("in.png"), [("y.png", "y")])).contains("a folder is needed"));
        assert!(said(targets.files_in(folder.path(), [("a", "y")])).contains("it is a folder"));
        assert!(!at("new").exists(), "only looked at");
    }
}
