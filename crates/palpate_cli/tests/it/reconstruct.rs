//! The main job as a process: what it writes, what it says, how it ends.

use crate::workshop::{Said, Workshop, palpate};
use palpate::geometry::{Raster, Topology};
use palpate::io::{read_mesh, write_depth_png, write_height_map_npy, write_mask};

fn reconstruct(shop: &Workshop, more: &[&str]) -> Said {
    let (scene, out) = (shop.text("s"), shop.text("out.ply"));
    let mut args = vec!["reconstruct", &scene, "--output", &out, "--config"];
    let config = shop.text("coarse.toml");
    shop.put("coarse.toml", b"[implicit]\nspacing = 0.003\ndense_cells = 20000\n");
    args.push(&config);
    args.extend(more);
    palpate(args)
}

#[test]
fn a_scene_becomes_a_closed_mesh_with_report_and_steps() {
    let shop = Workshop::detailed();
    let (report, keep) = (shop.text("report.json"), shop.text("steps"));
    reconstruct(&shop, &["--report", &report, "--keep", &keep]).expect(0, &["faces", "2 touches"]);
    let mesh = read_mesh(shop.path("out.ply")).expect("written");
    assert!(Topology::of(&mesh).is_watertight());
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(report).expect("written")).expect("JSON");
    assert_eq!(report["counts"]["touches_used"], 2);
    assert_eq!(report["mesh"]["closed"], true);
    assert!(report["timings"].as_array().is_some_and(|t| t.len() > 5));
    for step in ["visible", "moved", "removed", "felt", "fused", "mesh"] {
        assert!(shop.path("steps").join(step).with_extension("ply").is_file(), "{step}");
    }
}

#[test]
fn the_same_bytes_whatever_the_number_of_threads() {
    let shop = Workshop::detailed();
    let mut written = Vec::new();
    for threads in ["1", "2"] {
        reconstruct(&shop, &["--threads", threads]).expect(0, &[]);
        written.push(std::fs::read(shop.path("out.ply")).expect("written"));
    }
    assert!(written[0] == written[1], "1 and 2 threads gave different files");
}

#[test]
fn zero_touches_are_fine_and_the_paper_method_too() {
    let shop = Workshop::detailed();
    reconstruct(&shop, &["--max-touches", "0"]).expect(0, &["0 touches"]);
    reconstruct(&shop, &["--method", "paper", "--surface", "ball-pivoting"]).expect(0, &["faces"]);
    reconstruct(&shop, &["--method", "paper"]).expect(0, &["faces"]);
    reconstruct(&shop, &["--method", "paper", "--surface", "implicit"]).expect(1, &["'poisson' or 'ball-pivoting'"]);
}

#[test]
fn a_touch_far_from_the_object_is_left_out_and_said() {
    let shop = Workshop::detailed();
    let text = std::fs::read_to_string(shop.path("s/scene.toml")).expect("there");
    let at = text.rfind("translation = [").expect("the last touch");
    let end = at + text[at..].find(']').expect("closed");
    let moved = format!("{}translation = [0.9, 0.0, 0.04{}", &text[..at], &text[end..]);
    shop.put("s/scene.toml", moved.as_bytes());
    reconstruct(&shop, &[]).expect(3, &["touch 1 was left out", "mm from the visible side"]);
    assert!(shop.path("out.ply").is_file(), "exit status 3 means that there is a mesh");
}

#[test]
fn an_object_cut_by_the_border_is_said() {
    let shop = Workshop::detailed();
    // The same sphere, with the left half of the image missing: its outline now runs along the border of what was taken.
    shop.edit("cx = 95.5", "cx = 5.5").edit("width = 192", "width = 102");
    let file = palpate::io::read_depth_png(shop.path("s/depth.png"), 1e-4).expect("there");
    let cropped = Raster::from_fn(144, 102, |r, c| file[(r, c + 90)]);
    write_depth_png(shop.path("s/depth.png"), &cropped, 1e-4).expect("written");
    write_mask(shop.path("s/mask.png"), &cropped.map(|z| z.is_finite())).expect("written");
    reconstruct(&shop, &[]).expect(3, &["the image border cuts the object"]);
}

#[test]
fn bad_maps_are_errors_that_leave_nothing_behind() {
    let nan = Workshop::detailed();
    let mut map = Raster::filled(24, 32, 0.0f32);
    map[(3, 4)] = f32::NAN;
    write_height_map_npy(nan.path("s/touches/000_height.npy"), &map).expect("written");
    reconstruct(&nan, &[]).expect(1, &["000_height.npy"]);
    let pixels = Workshop::detailed();
    write_height_map_npy(pixels.path("s/touches/000_height.npy"), &Raster::filled(24, 32, -12.0f32)).expect("written");
    reconstruct(&pixels, &[]).expect(1, &["000_height.npy", "pixels"]);
    assert!(!nan.path("out.ply").exists() && !pixels.path("out.ply").exists());
}

#[test]
fn outputs_that_cannot_be_written_are_said_before_the_work() {
    let shop = Workshop::detailed();
    let scene = shop.text("s");
    palpate(["reconstruct", &scene, "--output", &shop.text("missing/out.ply")]).expect(1, &["missing"]);
    palpate(["reconstruct", &scene, "--output", &shop.text("out.3ds")]).expect(1, &["out.3ds", ".stl"]);
    palpate(["reconstruct", &scene, &scene, "--output", &shop.text("out.ply")]).expect(1, &["must be a folder"]);
    palpate(["reconstruct", &scene]).expect(2, &["--output"]);
}

#[test]
fn a_file_is_written_once_or_not_at_all() {
    let shop = Workshop::detailed();
    reconstruct(&shop, &["--report", &shop.text("out.ply")])
        .expect(1, &["out.ply", "--output and --report would both be"]);
    std::fs::create_dir_all(shop.path("steps/felt.ply")).expect("made");
    reconstruct(&shop, &["--keep", &shop.text("steps")]).expect(1, &["felt.ply", "folder"]);
    assert!(!shop.path("out.ply").exists(), "no mesh of a run that failed");
    let (scene, inside) = (shop.text("s"), shop.text("kept/visible.ply"));
    std::fs::create_dir(shop.path("kept")).expect("made");
    let args = ["reconstruct", &scene, "--output", &inside, "--keep", &shop.text("kept")];
    palpate(args).expect(1, &["visible.ply", "--output and --keep would both be"]);
    // The mesh of --keep is the output.
    let (config, mesh) = (shop.text("coarse.toml"), shop.text("kept/mesh.ply"));
    let args = ["reconstruct", &scene, "--output", &mesh, "--keep", &shop.text("kept"), "--config", &config];
    palpate(args).expect(0, &["kept/mesh.ply"]);
    // What is read stays.
    let own = shop.text("s/scene.toml");
    reconstruct(&shop, &["--report", &own]).expect(1, &["--report would overwrite", "scene.toml, which is read"]);
    reconstruct(&shop, &["--report", &config]).expect(1, &["--report would overwrite", "coarse.toml, which is read"]);
    let params = shop.text("kept/params.toml");
    let args = ["reconstruct", &scene, "--output", &mesh, "--keep", &shop.text("kept"), "--config", &params];
    palpate(args).expect(1, &["--keep would overwrite", "params.toml, which is read"]);
}

#[test]
fn one_scene_into_a_folder() {
    let shop = Workshop::detailed();
    shop.put("coarse.toml", b"[implicit]\nspacing = 0.003\ndense_cells = 20000\n");
    let (scene, config) = (shop.text("s"), shop.text("coarse.toml"));
    for folder in ["new/", "new"] {
        let output = format!("{}/{folder}", shop.text(""));
        palpate(["reconstruct", &scene, "--output", &output, "--config", &config]).expect(0, &["s.ply"]);
        assert!(shop.path("new/s.ply").is_file());
    }
    palpate(["reconstruct", &scene, &scene, "--output", &shop.text("none")]).expect(1, &["two scenes are called 's'"]);
    assert!(!shop.path("none").exists(), "a refused run leaves no folder");
    let (file, output) = (shop.text("s/scene.toml"), format!("{}/", shop.text("of_a_file")));
    palpate(["reconstruct", &file, "--output", &output, "--config", &config]).expect(0, &["s.ply"]);
    assert!(shop.path("of_a_file/s.ply").is_file());
    let (lost, output) = (shop.text("lost"), format!("{}/", shop.text("none")));
    palpate(["reconstruct", &lost, "--output", &output, "--keep", &output]).expect(1, &["lost"]);
    assert!(!shop.path("none").exists(), "nor does a scene that cannot be read");
}

#[test]
fn flags_that_do_nothing_say_so() {
    let shop = Workshop::detailed();
    let said = reconstruct(&shop, &["--decoder", "compact", "--pick", "3,4", "--color", "image"]);
    said.expect(3, &["palpate: warning: --decoder compact: 2 of 2 touches have no image", "--pick is not used"]);
    said.expect(3, &["the vertices are not coloured: the scene has no colour image", "genus 0", "2 touches, "]);
    let weights = shop.text("w.bin");
    shop.put("w.bin", b"");
    reconstruct(&shop, &["--weights", &weights]).expect(0, &["so none is decoded"]);
    reconstruct(&shop, &["--max-touches", "1"]).expect(0, &["1 touch, "]);
}

#[test]
fn colours_that_cannot_be_are_refused_before_the_work() {
    let shop = Workshop::detailed();
    reconstruct(&shop, &["--method", "paper", "--color", "sigma"]).expect(1, &["color can only be 'none'"]);
    let (scene, out) = (shop.text("s"), shop.text("out.stl"));
    palpate(["reconstruct", &scene, "--output", &out, "--color", "sigma"]).expect(1, &["an .stl holds no colours"]);
    assert!(!shop.path("out.stl").exists());
}

#[test]
fn a_wall_in_metres_is_refused() {
    let shop = Workshop::detailed();
    for wall in ["0.002", "0", "NaN"] {
        reconstruct(&shop, &["--wall", wall]).expect(1, &[&format!("--wall {wall}"), "2 mm is 2"]);
    }
}

#[test]
fn vertices_keep_what_is_known_of_them_while_they_stay_where_they_are() {
    let shop = Workshop::detailed();
    reconstruct(&shop, &[]).expect(0, &[]);
    let (from, to) = (shop.text("out.ply"), shop.text("new.ply"));
    let (mesh, known) = palpate::io::read_mesh_with(&from).expect("written");
    assert!(known.sigma_mm.is_some() && known.provenance.is_some());
    palpate(["mesh", &from, "--output", &to, "--largest", "--repair"]).expect(0, &[]);
    let (kept, values) = palpate::io::read_mesh_with(&to).expect("written");
    assert_eq!(Some(values), known.carried(&mesh, &kept));
    palpate(["mesh", &from, "--output", &to, "--smooth", "2"]).expect(0, &["warning", "vertices were moved or made"]);
    assert!(palpate::io::read_mesh_with(&to).expect("written").1.is_empty());
    palpate(["mesh", &from, "--output", &shop.text("new.obj")]).expect(0, &["only a .ply holds them"]);
    // The picture shows them; a mesh without them is drawn plain and that is said.
    let mut pictures = Vec::new();
    for by in ["plain", "provenance", "sigma"] {
        let args = ["render", &from, "--output", &shop.text("p.png"), "--size", "64x64", "--color-by", by];
        assert_eq!(palpate(args).expect(0, &[]).err, "");
        pictures.push(std::fs::read(shop.path("p.png")).expect("written"));
    }
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2] && pictures[0] != pictures[2]);
    palpate(["render", &to, "--output", &shop.text("p.png"), "--color-by", "sigma"]).expect(0, &["no sigma_mm"]);
}

#[test]
fn an_unknown_parameter_is_named() {
    let shop = Workshop::detailed();
    shop.put("bad.toml", b"[implicit]\nspaceing = 0.001\n");
    reconstruct(&shop, &[]).expect(0, &[]);
    let (scene, out, config) = (shop.text("s"), shop.text("o.ply"), shop.text("bad.toml"));
    palpate(["reconstruct", &scene, "--output", &out, "--config", &config]).expect(1, &["bad.toml", "spaceing"]);
}

#[test]
fn a_parameter_out_of_range_is_named_before_the_work() {
    let shop = Workshop::detailed();
    for (line, field) in [("spacing = 0.0", "implicit.spacing"), ("dense_cells = 100", "implicit.dense_cells")] {
        shop.put("bad.toml", format!("[implicit]\n{line}\n").as_bytes());
        let (scene, out, config) = (shop.text("s"), shop.text("o.ply"), shop.text("bad.toml"));
        palpate(["reconstruct", &scene, "--output", &out, "--config", &config]).expect(1, &[field]);
    }
}

#[test]
fn a_touch_without_contact_and_a_bad_scene_cost_only_themselves() {
    let shop = Workshop::detailed();
    write_mask(shop.path("s/touches/001_contact.png"), &Raster::filled(24, 32, false)).expect("written");
    reconstruct(&shop, &[]).expect(3, &["touch 1 was left out"]);
    let (good, bad, out) = (shop.text("s"), shop.text("nowhere"), shop.text("meshes"));
    let config = shop.text("coarse.toml");
    palpate(["reconstruct", &good, &bad, "--output", &out, "--config", &config]).expect(3, &["nowhere"]);
    assert!(shop.path("meshes/s.ply").is_file());
    palpate(["reconstruct", &good, &good, "--output", &out]).expect(1, &["two scenes are called 's'"]);
}

#[test]
fn an_interrupted_run_leaves_no_partial_file() {
    let shop = Workshop::detailed();
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin!("palpate"))
        .args(["reconstruct", &shop.text("s"), "--output", &shop.text("out.ply")])
        .stdout(std::process::Stdio::null())
        .stderr(std::process::Stdio::null())
        .spawn()
        .expect("the program starts");
    std::thread::sleep(std::time::Duration::from_millis(100));
    child.kill().expect("still running or just done");
    child.wait().expect("ended");
    // Either nothing, or a whole mesh: never a part.
    if shop.path("out.ply").exists() {
        read_mesh(shop.path("out.ply")).expect("a whole file");
    }
}

#[test]
fn the_written_defaults_are_the_defaults() {
    let said = palpate(["config"]);
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../config/default.toml");
    let written = std::fs::read_to_string(file).expect("config/default.toml is in the repository");
    assert_eq!(said.out, written, "remake it with `palpate config > config/default.toml`");
}
