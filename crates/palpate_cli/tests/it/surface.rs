//! `surface` and `inspect`.

use assert_cmd::Command;
use std::fmt::Write as _;
use std::path::Path;

fn palpate(folder: &Path, args: &[&str]) -> (i32, String, String) {
    let output = Command::cargo_bin("palpate").expect("built").current_dir(folder).args(args).output().expect("runs");
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    (output.status.code().expect("exits"), text(output.stdout), text(output.stderr))
}

/// A sphere of radius 0.1 m with (`normals`) or without its normals.
fn write_sphere(path: &Path, count: u32, normals: bool) {
    let names = if normals { "property double nx\nproperty double ny\nproperty double nz\n" } else { "" };
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\n{names}end_header\n"
    );
    for i in 0..count {
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(count);
        let (sin, cos) = (f64::from(i) * 2.399_963_229_728_653).sin_cos();
        let (x, y) = ((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin);
        write!(text, "{} {} {}", 0.1 * x, 0.1 * y, 0.1 * z).expect("a string takes all");
        let normal = if normals { format!(" {x} {y} {z}") } else { String::new() };
        writeln!(text, "{normal}").expect("a string takes all");
    }
    std::fs::write(path, text).expect("writable");
}

#[test]
fn a_cloud_becomes_a_mesh_that_inspect_calls_closed() {
    let folder = tempfile::tempdir().expect("a folder");
    write_sphere(&folder.path().join("sphere.ply"), 2000, true);
    let (status, _, errors) =
        palpate(folder.path(), &["surface", "sphere.ply", "--output", "mesh.ply", "--method", "ball-pivoting"]);
    assert_eq!(status, 0, "{errors}");
    assert!(errors.contains("2000 vertices, 3996 faces, watertight"), "{errors}");

    let (status, _, errors) = palpate(
        folder.path(),
        &["surface", "sphere.ply", "--output", "smooth.ply", "--method", "poisson", "--depth", "5"],
    );
    assert!(status == 0 && errors.contains("watertight"), "{errors}");

    let (status, json, errors) = palpate(folder.path(), &["inspect", "mesh.ply", "--json"]);
    assert_eq!(status, 0, "{errors}");
    let found: serde_json::Value = serde_json::from_str(&json).expect("one JSON object");
    for key in ["closed", "edge_manifold", "vertex_manifold", "consistently_oriented", "watertight"] {
        assert_eq!(found[key], true, "{key}");
    }
    assert_eq!(
        (&found["genus"], &found["components"], &found["self_intersecting_pairs"]),
        (&0.into(), &1.into(), &0.into())
    );
    let volume = found["volume_m3"].as_f64().expect("a number");
    assert!((volume / (4e-3 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.01, "{volume}");

    let (status, text, _) = palpate(folder.path(), &["inspect", "mesh.ply"]);
    assert_eq!(status, 0);
    assert!(text.contains("watertight             yes") && text.contains("genus                  0"), "{text}");
}

#[test]
fn radii_too_small_for_the_gaps_leave_it_open_unless_filled() {
    let folder = tempfile::tempdir().expect("a folder");
    write_sphere(&folder.path().join("sphere.ply"), 500, true);
    let surface = ["surface", "sphere.ply", "--output", "mesh.stl", "--method", "ball-pivoting", "--radius", "0.0095"];
    let (status, _, errors) = palpate(folder.path(), &surface);
    assert_eq!(status, 0, "{errors}");
    assert!(errors.contains("open: "), "{errors}");
    let (status, _, errors) = palpate(folder.path(), &[surface.as_slice(), &["0.03", "--fill-holes"]].concat());
    assert_eq!(status, 0, "{errors}");
    assert!(errors.contains("watertight"), "{errors}");
}

#[test]
fn bad_input_is_told_and_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    write_sphere(&folder.path().join("bare.ply"), 20, false);
    write_sphere(&folder.path().join("point.ply"), 1, true);
    let mesh = |cloud| palpate(folder.path(), &["surface", cloud, "--output", "mesh.ply", "--method", "ball-pivoting"]);
    for (cloud, message) in [
        ("missing.ply", "missing.ply"),
        ("bare.ply", "the cloud has no normals"),
        ("point.ply", "1 distinct points; at least 3 are required"),
    ] {
        let (status, _, errors) = mesh(cloud);
        assert!(status == 1 && errors.contains(message), "{cloud}: {status} {errors}");
    }
    let (status, _, errors) = palpate(folder.path(), &["inspect", "missing.obj"]);
    assert!(status == 1 && errors.contains("missing.obj"), "{errors}");
    let (status, ..) = palpate(folder.path(), &["surface", "bare.ply", "--output", "mesh.ply", "--method", "magic"]);
    assert_eq!(status, 2);
    assert!(!folder.path().join("mesh.ply").exists());
}

#[test]
fn a_mesh_is_cleaned_up_and_a_trimmed_one_is_said_to_be_open() {
    let folder = tempfile::tempdir().expect("a folder");
    write_sphere(&folder.path().join("sphere.ply"), 2000, true);
    let surface = ["surface", "sphere.ply", "-o", "mesh.ply", "--method", "poisson"];
    let (status, _, errors) = palpate(folder.path(), &surface);
    assert!(status == 0 && errors.contains("cells of") && errors.contains("watertight"), "{errors}");
    let tools = ["--repair", "--largest", "--smooth", "2", "--decimate", "500"];
    let (status, _, errors) =
        palpate(folder.path(), &[&["mesh", "mesh.ply", "-o", "small.ply"], tools.as_slice()].concat());
    assert!(status == 0 && errors.contains("500 faces, watertight") && errors.contains("repaired: 0"), "{errors}");
    let (_, json, _) = palpate(folder.path(), &["inspect", "small.ply", "--json"]);
    let found: serde_json::Value = serde_json::from_str(&json).expect("one JSON object");
    assert!(found["worst_aspect_ratio"].as_f64().is_some_and(|r| r >= 1.0), "{found}");
    let (status, _, errors) = palpate(folder.path(), &[surface.as_slice(), &["--trim", "1"]].concat());
    assert!(status == 0 && errors.contains("the mesh is open") && errors.contains("open: "), "{errors}");
    let (status, ..) = palpate(folder.path(), &["mesh", "mesh.ply", "-o", "x.ply", "--drop-small", "2"]);
    assert!(status == 2 && !folder.path().join("x.ply").exists());
}

#[test]
fn hostile_meshes_are_refused_by_name_and_leave_nothing() {
    let header = |vertices: &str, faces: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n\
             element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let corners = "0 0 0\n1 0 0\n0 1 0\n";
    let cases: [(&str, Vec<u8>); 9] = [
        ("empty.ply", Vec::new()),
        ("cut.ply", header("3", "1").into_bytes()[..90].to_vec()),
        ("short.ply", (header("3", "1") + "0 0 0\n1 0 0\n").into_bytes()),
        ("index.ply", (header("3", "1") + corners + "3 0 1 7\n").into_bytes()),
        ("negative.ply", (header("3", "1") + corners + "3 0 1 -2\n").into_bytes()),
        ("nan.ply", (header("3", "1") + "0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n").into_bytes()),
        ("huge.ply", (header("4000000000000", "1") + corners).into_bytes()),
        ("faceless.ply", (header("3", "0") + corners).into_bytes()),
        ("noise.stl", (0..=255).cycle().take(300).collect()),
    ];
    let folder = tempfile::tempdir().expect("a folder");
    for (name, bytes) in cases {
        std::fs::write(folder.path().join(name), bytes).expect("writable");
        let (status, _, errors) = palpate(folder.path(), &["mesh", name, "--output", "out.ply", "--fill-holes"]);
        assert!(status == 1 && errors.contains(name) && !errors.contains("panicked"), "{name}: {status} {errors}");
        assert!(!folder.path().join("out.ply").exists(), "{name}");
        let (status, _, errors) = palpate(folder.path(), &["inspect", name]);
        assert!(status == 1 && errors.contains(name) && !errors.contains("panicked"), "{name}: {status} {errors}");
    }
}
