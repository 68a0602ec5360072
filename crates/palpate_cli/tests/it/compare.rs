//! `palpate compare` and the refusals of `palpate benchmark shape`, at the process boundary.

use assert_cmd::Command;
use palpate::geometry::{Isometry, Point, TriangleMesh};
use std::path::Path;

fn palpate() -> Command {
    Command::cargo_bin("palpate").expect("the binary is built before its tests")
}

/// A tetrahedron of 60 mm, moved along x.
fn write_tetrahedron(path: &Path, along_x: f64) {
    let vertices = [[0., 0., 0.], [0.06, 0., 0.], [0., 0.06, 0.], [0., 0., 0.06]].map(Point::from).to_vec();
    let mesh =
        TriangleMesh::new(vertices, vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]).expect("indices are valid");
    let moved = mesh.transformed(&Isometry::translation(along_x, 0.0, 0.0));
    palpate::io::write_mesh(path, &moved).expect("written");
}

#[test]
fn json_holds_the_contract_and_nothing_else() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (a, b) = (folder.path().join("a.ply"), folder.path().join("b.ply"));
    write_tetrahedron(&a, 0.001);
    write_tetrahedron(&b, 0.0);
    let output = palpate().arg("compare").args([&a, &b]).args(["--json", "--samples", "2000"]).output().expect("runs");
    assert!(output.status.success());
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON object");
    for key in ["chamfer_squared_mm2", "chamfer_mean_mm", "accuracy_mm", "completeness_mm", "hausdorff95_mm"] {
        assert!(json[key].as_f64().is_some_and(|v| v > 0.0 && v < 2.0), "{key}: {}", json[key]);
    }
    for key in ["f_score_1mm", "f_score_2mm", "f_score_5mm", "normal_consistency", "volumetric_iou"] {
        assert!(json[key].as_f64().is_some_and(|v| v > 0.5 && v <= 1.0), "{key}: {}", json[key]);
    }
    assert_eq!((&json["watertight"], &json["components"], &json["faces"]), (&true.into(), &1.into(), &4.into()));
    assert!(json["note"].is_null() && json["hidden"].is_null());

    let output = palpate().arg("compare").args([&a, &b]).args(["--samples", "2000"]).output().expect("runs");
    let text = String::from_utf8(output.stdout).expect("text");
    assert!(text.contains("mm²") && text.contains("volumetric IoU"), "{text}");
}

#[test]
fn what_is_wrong_is_named() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (a, missing) = (folder.path().join("a.ply"), folder.path().join("missing.ply"));
    write_tetrahedron(&a, 0.0);
    let run = |args: &[&Path]| {
        let output = palpate().arg("compare").args(args).output().expect("runs");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, message) = run(&[&a, &missing]);
    assert!(code == Some(1) && message.contains("missing.ply"), "{code:?} {message}");
    assert_eq!(run(&[&a]).0, Some(2));
    let empty = folder.path().join("empty");
    std::fs::create_dir(&empty).expect("made");
    let output =
        palpate().args(["benchmark", "shape"]).arg(&empty).arg("--output").arg(folder.path().join("out")).output();
    let output = output.expect("runs");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && message.contains("neither scene folders"), "{message}");
}
