//! What a benchmark runs on: scene folders with truth, or meshes from which scenes are simulated.

use anyhow::{Context as _, bail};
use palpate::geometry::TriangleMesh;
use palpate::scene::Scene;
use std::path::{Path, PathBuf};

const MESH_EXTENSIONS: [&str; 4] = ["ply", "obj", "off", "stl"];

/// Objects of `--quick` if present: a box, a bottle, a curved and a hollow one, a tool, a ball.
const QUICK: [&str; 6] =
    ["004_sugar_box", "006_mustard_bottle", "011_banana", "025_mug", "035_power_drill", "055_baseball"];

/// One view of one object, not yet loaded.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Case {
    pub(super) object: String,
    pub(super) view: usize,
    pub(super) source: Source,
}

/// Where a case comes from.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Source {
    /// A scene folder.
    Scene(PathBuf),
    /// A mesh file.
    Mesh(PathBuf),
}

/// A case in memory.
pub(super) struct Loaded {
    pub(super) scene: Scene,
    pub(super) truth: TriangleMesh,
}

/// Lists the cases of a data set, by object and view.
///
/// A folder with scenes in it takes the views it has (up to `views` an object); meshes are simulated in `views` views.
pub(super) fn list(folder: &Path, views: usize) -> anyhow::Result<Vec<Case>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("reading the data set {}", folder.display()))?;
    let mut paths = entries.map(|e| Ok(e?.path())).collect::<anyhow::Result<Vec<_>>>()?;
    paths.push(folder.to_owned());
    paths.sort();
    let scenes: Vec<&PathBuf> = paths.iter().filter(|p| p.join("scene.toml").is_file()).collect();
    let is_mesh = |p: &&PathBuf| {
        let extension = p.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
        p.is_file() && extension.is_some_and(|e| MESH_EXTENSIONS.contains(&e.as_str()))
    };
    let mut cases: Vec<Case> = if scenes.is_empty() {
        let meshes = paths.iter().filter(is_mesh);
        meshes.flat_map(|path| (0..views).map(|view| Case::new(path, view, Source::Mesh(path.clone())))).collect()
    } else {
        let cases = scenes.into_iter().map(|path| {
            let name = stem(path);
            let (_, view) = split_view(&name);
            Case::new(path, view, Source::Scene(path.clone()))
        });
        cases.filter(|case| case.view < views).collect()
    };
    if cases.is_empty() {
        bail!(
            "{} holds neither scene folders (with scene.toml) nor meshes (.{})",
            folder.display(),
            MESH_EXTENSIONS.join(", .")
        );
    }
    cases.sort_by(|a, b| (&a.object, a.view).cmp(&(&b.object, b.view)));
    Ok(cases)
}

/// The cases of a short run: six objects, the first view of each.
pub(super) fn quick(mut cases: Vec<Case>) -> Vec<Case> {
    let mut seen: Vec<String> = Vec::new();
    cases.retain(|case| !seen.contains(&case.object) && (seen.push(case.object.clone()), true).1);
    if QUICK.iter().all(|name| seen.iter().any(|s| s == name)) {
        cases.retain(|case| QUICK.contains(&case.object.as_str()));
    } else if cases.len() > 6 {
        // Other objects: six spread over the list.
        let step = cases.len() as f64 / 6.0;
        cases = (0..6).map(|i| cases[(f64::from(i) * step) as usize].clone()).collect();
    }
    cases
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

/// `mug_view2` is view 2 of the mug; without such an ending it is view 0.
fn split_view(name: &str) -> (&str, usize) {
    name.rsplit_once("_view").and_then(|(object, view)| Some((object, view.parse().ok()?))).unwrap_or((name, 0))
}

impl Case {
    fn new(path: &Path, view: usize, source: Source) -> Self {
        let object = match source {
            Source::Scene(_) => split_view(&path.file_name().unwrap_or_default().to_string_lossy()).0.to_owned(),
            Source::Mesh(_) => stem(path),
        };
        Self { object, view, source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_and_scenes_are_told_apart() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let at = |name: &str| folder.path().join(name);
        assert!(list(folder.path(), 3).is_err());
        std::fs::write(at("b.ply"), "").expect("written");
        std::fs::write(at("a.OBJ"), "").expect("written");
        std::fs::write(at("notes.txt"), "").expect("written");
        let names = |cases: &[Case]| cases.iter().map(|c| (c.object.clone(), c.view)).collect::<Vec<_>>();
        let cases = list(folder.path(), 2).expect("two meshes");
        assert_eq!(names(&cases), [("a", 0), ("a", 1), ("b", 0), ("b", 1)].map(|(n, v)| (n.to_owned(), v)));
        for name in ["mug_view0", "mug_view1", "can"] {
            std::fs::create_dir(at(name)).expect("made");
            std::fs::write(at(name).join("scene.toml"), "").expect("written");
        }
        let cases = list(folder.path(), 2).expect("three scenes");
        assert_eq!(names(&cases), [("can", 0), ("mug", 0), ("mug", 1)].map(|(n, v)| (n.to_owned(), v)));
        assert_eq!(names(&quick(cases)), [("can", 0), ("mug", 0)].map(|(n, v)| (n.to_owned(), v)));
    }
}
