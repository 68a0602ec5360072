//! `simulate`.

use assert_cmd::Command;
use std::path::Path;

fn palpate(folder: &Path, args: &[&str]) -> (i32, String) {
    let output = Command::cargo_bin("palpate").expect("built").current_dir(folder).args(args).output().expect("runs");
    (output.status.code().expect("exits"), String::from_utf8(output.stderr).expect("UTF-8"))
}

#[test]
fn the_same_command_writes_the_same_bytes_whatever_the_threads() {
    let folder = tempfile::tempdir().expect("a folder");
    for (output, threads) in [("a", "1"), ("b", "2")] {
        let args = [
            "simulate",
            "primitive:cube",
            "--touches",
            "1",
            "--map-width",
            "40",
            "--threads",
            threads,
            "--output",
            output,
        ];
        let (status, errors) = palpate(folder.path(), &args);
        assert_eq!(status, 0, "{errors}");
    }
    for file in
        ["scene.toml", "depth.png", "mask.png", "truth.ply", "touches/000_height.npy", "touches/000_contact.png"]
    {
        let bytes = |output| std::fs::read(folder.path().join(output).join("cube_view0").join(file)).expect(file);
        assert!(bytes("a") == bytes("b"), "{file} differs");
    }
}

#[test]
fn unknown_solids_and_sensors_are_named_with_what_is_known() {
    let folder = tempfile::tempdir().expect("a folder");
    let (status, errors) = palpate(folder.path(), &["simulate", "primitive:teapot", "--output", "out"]);
    assert_eq!(status, 1);
    assert!(errors.contains("'teapot'") && errors.contains("torus"), "{errors}");
    let args = ["simulate", "primitive:cube", "--sensor", "gelsite", "--output", "out"];
    let (status, errors) = palpate(folder.path(), &args);
    assert_eq!(status, 1);
    assert!(errors.contains("'gelsite'") && errors.contains("gelsight-mini"), "{errors}");
    assert!(!folder.path().join("out").exists());
}
