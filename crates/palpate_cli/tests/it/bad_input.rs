//! Every kind of bad file: the message says what and where, the exit status is right, nothing is left half-written.

use crate::workshop::{Workshop, palpate};
use palpate::geometry::Raster;
use palpate::io::{write_depth_png, write_height_map_npy, write_mask, write_npy};

#[test]
fn a_missing_file_is_named_with_the_key_that_asked_for_it() {
    let shop = Workshop::new();
    std::fs::remove_file(shop.path("s/depth.png")).expect("removed");
    shop.check().expect(1, &["scene.toml: [depth] file: cannot read", "depth.png: No such file"]);
    let shop = Workshop::new();
    std::fs::remove_file(shop.path("s/touches/001_height.npy")).expect("removed");
    shop.check().expect(1, &["[[touches]] 1 height_map: cannot read", "001_height.npy"]);
    palpate(["check", &shop.text("nowhere")]).expect(1, &["cannot read", "nowhere/scene.toml", "No such file"]);
}

#[test]
fn an_unknown_key_is_named() {
    let shop = Workshop::new();
    shop.edit("cx = ", "focus = 1.0\ncx = ");
    shop.check().expect(1, &["s/scene.toml", "unknown field `focus`"]);
    let shop = Workshop::new();
    shop.edit("[sensor]", "[tool]\nlength = 1\n\n[sensor]");
    shop.check().expect(1, &["unknown field `tool`"]);
}

#[test]
fn a_wrong_image_size_gives_both_sizes() {
    let shop = Workshop::new();
    write_depth_png(shop.path("s/depth.png"), &Raster::filled(24, 64, 0.4), 1e-4).expect("written");
    shop.check().expect(1, &["[depth] file", "the size is 64×24, but [camera] needs 64×48"]);
}

#[test]
fn depth_without_a_reading_is_an_error() {
    let shop = Workshop::new();
    write_depth_png(shop.path("s/depth.png"), &Raster::filled(48, 64, f32::NAN), 1e-4).expect("written");
    shop.check().expect(1, &["all 64×48 pixels are 0: there is no depth reading"]);
}

#[test]
fn a_quaternion_is_normalised_with_a_warning_or_refused() {
    let find = |shop: &Workshop| {
        let text = std::fs::read_to_string(shop.path("s/scene.toml")).expect("there");
        let from = text.rfind("quaternion_xyzw").expect("a touch");
        text[from..].lines().next().expect("a line").to_owned()
    };
    let set = |q: &str| {
        let shop = Workshop::new();
        let old = find(&shop);
        // The last touch: replace from the end of the file.
        let text = std::fs::read_to_string(shop.path("s/scene.toml")).expect("there");
        let at = text.rfind(&old).expect("there");
        shop.put("s/scene.toml", format!("{}quaternion_xyzw = {q} }}\n", &text[..at]).as_bytes());
        shop.check()
    };
    set("[2.0, 0.0, 0.0, 0.0]")
        .expect(0, &["[[touches]] 1 world_from_sensor: the quaternion has the length 2.0", "normalised"]);
    set("[0.0, 0.0, 0.0, 0.0]")
        .expect(1, &["[[touches]] 1 world_from_sensor", "has the length 0; a rotation needs length 1"]);
    set("[nan, 0.0, 0.0, 1.0]").expect(1, &["[[touches]] 1 world_from_sensor", "has the length NaN"]);
}

#[test]
fn heights_that_are_no_metres_are_refused() {
    let with = |z: f32| {
        let shop = Workshop::new();
        let map = Raster::from_fn(24, 32, |r, c| if (r, c) == (3, 4) { z } else { 0.0 });
        write_height_map_npy(shop.path("s/touches/000_height.npy"), &map).expect("written");
        shop.check()
    };
    with(f32::NAN).expect(1, &["[[touches]] 0 height_map", "the height at row 3, column 4 is NaN"]);
    with(-33.9).expect(1, &["|z| reaches 33.9", "is the map in millimetres or in pixels?"]);
    with(-0.5).expect(1, &["|z| reaches 0.5", "20 mm"]);
    // What `reconstruct` refuses is wrong here too: a sign that is turned, by how little ever.
    for z in [0.002, 0.00051] {
        with(z).expect(1, &["wrong: ", "[[touches]] 0: height map at (row 3, col 4)", "is the sign turned?"]);
    }
}

#[test]
fn a_depth_unit_wrong_by_ten_and_an_inverted_mask_are_doubts() {
    let shop = Workshop::new();
    shop.edit("metres_per_unit = 0.0001", "metres_per_unit = 0.001");
    shop.check().expect(0, &["doubtful", "the median depth is 3.", "is metres_per_unit right"]);
    let shop = Workshop::new();
    let mask = palpate::io::read_mask(shop.path("s/mask.png")).expect("there");
    write_mask(shop.path("s/mask.png"), &mask.map(|m| !m)).expect("written");
    shop.check().expect(0, &["doubtful", "100 % of the image border is marked", "is the mask inverted"]);
}

#[test]
fn more_threads_than_a_machine_has_are_refused() {
    palpate(["config", "--threads", "20000"]).expect(2, &["--threads", "at most 512 threads"]);
    palpate(["config", "--threads", "many"]).expect(2, &["--threads", "invalid digit"]);
}

#[test]
fn mask_and_height_map_must_agree() {
    let shop = Workshop::new();
    write_mask(shop.path("s/touches/000_contact.png"), &Raster::filled(12, 16, true)).expect("written");
    shop.check().expect(1, &["[[touches]] 0 contact_mask", "the size is 16×12, but its height map needs 32×24"]);
    let shop = Workshop::new();
    write_npy(shop.path("s/touches/000_height.npy"), &[32, 24], &[0.0; 768]).expect("written");
    shop.check().expect(1, &["the height map is 24×32", "must span the whole pad"]);
}

#[test]
fn cut_files_are_named() {
    for (file, words) in [
        ("s/depth.png", ["[depth] file", "depth.png: not a readable PNG file"]),
        ("s/mask.png", ["[mask] file", "mask.png: not a readable PNG file"]),
        ("s/touches/000_height.npy", ["[[touches]] 0 height_map", "000_height.npy: not a readable npy file"]),
        ("s/touches/001_contact.png", ["[[touches]] 1 contact_mask", "001_contact.png: not a readable PNG file"]),
        ("s/scene.toml", ["scene.toml", ""]),
    ] {
        for share in [0.0, 0.3, 0.8] {
            Workshop::new().cut(file, share).check().expect(1, &words);
        }
    }
}

#[test]
fn a_cut_or_lying_truth_mesh_is_named() {
    let shop = Workshop::new();
    let text = std::fs::read_to_string(shop.path("s/scene.toml")).expect("there") + "\n[truth]\nmesh = \"t.ply\"\n";
    shop.put("s/scene.toml", text.as_bytes());
    shop.check().expect(1, &["[truth] mesh: cannot read"]);
    let header = |n: u64| {
        format!(
            "ply\nformat binary_little_endian 1.0\nelement vertex {n}\nproperty float x\nproperty float y\nproperty float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    shop.put("s/t.ply", (header(3) + "only a few bytes").as_bytes());
    shop.check().expect(1, &["[truth] mesh", "t.ply: not a readable PLY file", "claims 3 'vertex' elements"]);
    shop.put("s/t.ply", (header(1_000_000_000_000) + "only a few bytes").as_bytes());
    shop.check().expect(1, &["claims 1000000000000 'vertex' elements, at least 12 bytes each, but 16 bytes are left"]);
}

#[test]
fn touches_need_a_sensor_and_something_felt() {
    let shop = Workshop::new();
    shop.edit("model = \"gelsight-mini\"", "model = \"gelsight-maxi\"");
    shop.check().expect(1, &["[sensor] model", "gelsight-maxi", "gelsight-mini", "custom"]);
    let shop = Workshop::new();
    shop.edit("contact_mask = \"touches/001_contact.png\"\n", "");
    shop.check().expect(1, &["[[touches]] 1 needs image, or height_map with contact_mask, or both"]);
    let shop = Workshop::new();
    shop.edit("translation = [0.01, 0.0, 0.04]", "translation = [10.0, 0.0, 40.0]");
    shop.check().expect(0, &["doubtful", "[[touches]] 1", "is world_from_sensor in metres"]);
}

#[test]
fn outputs_that_cannot_be_written_are_named() {
    let shop = Workshop::new();
    let depth = shop.text("s/depth.png");
    let init =
        |output: &str| palpate(["init", "--depth", &depth, "--intrinsics", "60,60,31.5,23.5", "--output", output]);
    init(&shop.text("no/such/folder")).expect(1, &["no/such/folder", "the folder", "does not exist"]);
    // Said before the input is read: the work may be long.
    for command in [&["clean"][..], &["mesh"], &["surface", "--method", "poisson"]] {
        let nowhere = [shop.text("nowhere"), "--output".to_owned(), shop.text("out.xyz")];
        palpate(command.iter().copied().chain(nowhere.iter().map(String::as_str))).expect(1, &["out.xyz", ".ply"]);
    }
    // A file where the scene folder should be: not writable for root either.
    shop.put("file", b"");
    init(&shop.text("file")).expect(1, &["cannot write", "file"]);
    // A folder where a file of the scene should be.
    std::fs::create_dir_all(shop.path("taken/depth.png")).expect("made");
    init(&shop.text("taken")).expect(1, &["taken/depth.png: it is a folder, a file is needed"]);
    assert!(!shop.path("taken/scene.toml").exists(), "no scene.toml without its images");
}

#[test]
fn a_reader_that_has_gone_ends_a_command_quietly() {
    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let output = std::process::Command::new(assert_cmd::cargo::cargo_bin("palpate"))
        .arg("config")
        .stdout(writer)
        .stderr(std::process::Stdio::piped())
        .output()
        .expect("runs");
    assert!(output.stderr.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
}
