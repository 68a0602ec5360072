//! `init` and `check` on good input.

use crate::workshop::{Workshop, palpate};

#[test]
fn a_good_scene_passes_and_says_so() {
    let shop = Workshop::new();
    let said = shop.check();
    said.expect(0, &["can be reconstructed; touches: 2, doubts: 0"]);
    assert_eq!(said.err, "");
}

#[test]
fn check_reports_everything_at_once_also_as_json() {
    let shop = Workshop::new();
    shop.edit("fx = 60.0", "fx = 0.0").edit("[0.0, 0.0, 1.0]", "[0.0, 0.0, 2.0]");
    shop.cut("s/touches/000_height.npy", 0.5).cut("s/touches/001_contact.png", 0.5);
    shop.check()
        .expect(1, &["fx is 0", "[[touches]] 0 height_map", "[[touches]] 1 contact_mask", "wrong: 3, doubtful: 1"]);
    let said = palpate(["check", "--json", &shop.text("s")]);
    let report: serde_json::Value = serde_json::from_str(&said.out).expect("JSON and nothing else");
    assert_eq!((said.status, &report["ok"]), (1, &serde_json::json!(false)));
    assert_eq!(
        (report["errors"].as_array().map(Vec::len), report["warnings"].as_array().map(Vec::len)),
        (Some(3), Some(1))
    );
}

#[test]
fn init_makes_a_scene_that_passes() {
    let shop = Workshop::new();
    let (depth, mask, output) = (shop.text("s/depth.png"), shop.text("s/mask.png"), shop.text("new"));
    let args = ["init", "--depth", &depth, "--mask", &mask, "--intrinsics", "60,60,31.5,23.5", "--output", &output];
    // The depth of the workshop is in 0.1 mm; the default of 1 mm puts the sphere at 3.8 m, which is possible and doubtful.
    palpate(args).expect(0, &["scene.toml: median depth 3.", "palpate: warning:"]);
    palpate(["check", &output]).expect(0, &["touches: 0", "is metres_per_unit right"]);
    palpate(args).expect(1, &["there is already a scene here"]);
    let unit = palpate(args.into_iter().chain(["--force", "--metres-per-unit", "0.01"]));
    unit.expect(0, &["warning:", "the median depth is", "is metres_per_unit right"]);
}

#[test]
fn init_reads_intrinsics_from_json() {
    let shop = Workshop::new();
    shop.put("frame.json", br#"{"fx": 60, "fy": 61.5, "cx": 31.5, "cy": 23.5, "distortion": "none", "K": []}"#);
    let (depth, json, output) = (shop.text("s/depth.png"), shop.text("frame.json"), shop.text("new"));
    palpate(["init", "--depth", &depth, "--intrinsics", &json, "--output", &output]).expect(0, &[]);
    assert!(std::fs::read_to_string(shop.path("new/scene.toml")).expect("written").contains("fy = 61.5"));
}

#[test]
fn init_names_what_it_cannot_use() {
    let shop = Workshop::new();
    let (depth, output) = (shop.text("s/depth.png"), shop.text("new"));
    let init = |more: &[&str]| {
        palpate(["init", "--depth", &depth, "--intrinsics", "60,60,31.5,23.5", "--output", &output].iter().chain(more))
    };
    let (height, map) = (shop.text("s/touches/000_contact.png"), shop.text("s/touches/000_height.npy"));
    init(&["--mask", &height]).expect(1, &["000_contact.png: the size is 32×24", "the depth image needs 64×48"]);
    init(&["--color", &map]).expect(1, &["000_height.npy: not a readable PNG or JPEG file"]);
    init(&["--metres-per-unit", "0"]).expect(1, &["--metres-per-unit 0"]);
    palpate(["init", "--depth", &depth, "--intrinsics", "60,60", "--output", &output])
        .expect(1, &["four numbers FX,FY,CX,CY"]);
    palpate(["init", "--depth", &depth, "--intrinsics", "-60,60,1,1", "--output", &output]).expect(1, &["fx is -60"]);
    palpate(["init", "--output", &output]).expect(2, &["--depth"]);
    assert!(!shop.path("new").exists(), "a failed init leaves no folder");
}
