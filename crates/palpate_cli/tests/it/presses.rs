//! `presses`, and scenes whose touches are images.

use crate::workshop::{Said, palpate};
use std::path::Path;

fn presses(folder: &Path, more: &[&str]) -> Said {
    let output = folder.join("set").display().to_string();
    let fixed = ["presses", "--primitives", "1", "--width", "64", "--count", "4", "--shard-size", "2", "--output"];
    palpate(fixed.iter().copied().chain([output.as_str()]).chain(more.iter().copied()))
}

#[test]
fn an_interrupted_set_is_completed_with_the_same_bytes_by_any_worker() {
    let folder = tempfile::tempdir().expect("temporary folder");
    presses(folder.path(), &[]).expect(0, &["2 of 2 shards complete"]);
    let set = folder.path().join("set");
    let files = ["00001_images.npy", "00001_heights.npy", "00001_masks.npy", "00001.json"];
    let read = || files.map(|f| std::fs::read(set.join(f)).expect(f));
    let before = read();
    // The index comes last: without it the shard was interrupted.
    std::fs::remove_file(set.join("00001.json")).expect("there");
    std::fs::write(set.join("00001_images.npy"), b"half").expect("writable");
    presses(folder.path(), &["--shard", "1/2"]).expect(0, &["1 of 2 shards complete"]);
    presses(folder.path(), &["--shard", "2/2", "--threads", "1"]).expect(0, &["2 of 2 shards complete"]);
    assert!(read() == before, "the completed shard differs");
    presses(folder.path(), &["--seed", "9"]).expect(1, &["set.json", "other settings"]);
    presses(folder.path(), &["--shard", "3/2"]).expect(2, &["1 ≤ I ≤ N"]);
    presses(folder.path(), &["--depth", "40"]).expect(1, &["depth is 0.04", "0.005"]);
}

#[test]
fn a_scene_of_images_alone_is_reconstructed_if_the_untouched_gel_was_recorded() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    palpate(["simulate", "primitive:cube", "--touches", "2", "--output", &path("out")]).expect(0, &[]);
    let scene = folder.path().join("out/cube_view0/scene.toml");
    let text = std::fs::read_to_string(&scene).expect("written");
    assert!(text.contains("image = \"touches/001.jpg\"") && text.contains("touches/background.jpg"), "{text}");
    let run = |more: &[&str]| {
        let (scene, mesh, report) = (path("out/cube_view0"), path("mesh.ply"), path("report.json"));
        let fixed = ["reconstruct", &scene, "--output", &mesh, "--report", &report];
        palpate(fixed.into_iter().chain(more.iter().copied()))
    };
    run(&["--decoder", "compact"]).expect(0, &[]);
    let maps = |line: &&str| !line.starts_with("height_map") && !line.starts_with("contact_mask");
    let images: String = text.lines().filter(maps).map(|line| line.to_owned() + "\n").collect();
    std::fs::write(&scene, &images).expect("writable");
    run(&[]).expect(0, &[]);
    let report = std::fs::read_to_string(path("report.json")).expect("written");
    assert!(report.contains("\"touches_used\": 2"), "{report}");
    run(&["--decoder", "recorded"]).expect(1, &["touch 0", "no recorded height map"]);
    run(&["--decoder", "lookup"]).expect(1, &["--lookup-table"]);
    std::fs::write(&scene, images.replace("background = \"touches/background.jpg\"\n", "")).expect("writable");
    run(&[]).expect(1, &["[sensor] background"]);
    std::fs::write(path("broken.safetensors"), b"not weights").expect("writable");
    std::fs::write(&scene, &images).expect("writable");
    run(&["--weights", &path("broken.safetensors")]).expect(1, &["broken.safetensors", "safetensors"]);
}
