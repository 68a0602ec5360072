//! `palpate symmetry` as a process.

use crate::workshop::{Workshop, palpate};

#[test]
fn every_hypothesis_is_kept_with_its_verdicts() {
    let shop = Workshop::detailed();
    let folder = shop.path("verdicts");
    let (scene, keep) = (shop.path("s").display().to_string(), folder.display().to_string());
    let said = palpate(["symmetry", &scene, "--json", "--keep", &keep]);
    said.expect(0, &[]);
    let report: serde_json::Value = serde_json::from_str(&said.out).expect("one object and nothing else");
    let count = |name: &str| report[name].as_array().expect("a list").len();
    let mut names: Vec<String> = std::fs::read_dir(&folder)
        .expect("made")
        .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert!(count("accepted") > 0);
    assert_eq!(names.len(), count("accepted") + count("rejected"), "{names:?}");
    let cloud = palpate::io::read_cloud(folder.join(&names[0])).expect("a cloud");
    assert!(names[0].starts_with("accepted_00_") && cloud.len() > 100);
    let green = palpate::symmetry::Verdict::Supports.color();
    assert!(cloud.colors.expect("verdicts").contains(&green), "nothing supports what is accepted");
}

#[test]
fn a_scene_that_is_not_there_is_named() {
    palpate(["symmetry", "no/such/scene"]).expect(1, &["no/such/scene"]);
}
