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
fn a_scene_is_made_anew_only_if_asked_and_then_without_its_old_touches() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = |touches: &str, more: &[&str]| {
        let args = ["simulate", "primitive:cube", "--map-width", "40", "--output", "a", "--touches", touches];
        palpate(folder.path(), &[&args, more].concat())
    };
    let (status, errors) = run("2", &[]);
    assert_eq!(status, 0, "{errors}");
    let (status, errors) = run("1", &[]);
    assert!(status == 1 && errors.contains("cube_view0: there is already a scene here; --force"), "{errors}");
    let touch = |n: usize| folder.path().join(format!("a/cube_view0/touches/00{n}_height.npy"));
    assert!(touch(1).is_file(), "a refusal leaves the scene as it is");
    let (status, errors) = run("1", &["--force"]);
    assert_eq!(status, 0, "{errors}");
    assert!(touch(0).is_file() && !touch(1).exists());
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
