//! `next-touch` and `explore` as processes.

use crate::workshop::{Workshop, palpate};

const COARSE: &[u8] = b"[reconstruct.implicit]\nspacing = 0.005\ndense_cells = 8000\n";

#[test]
fn next_touch_prints_poses_as_json_and_as_a_table() {
    let shop = Workshop::detailed();
    shop.put("plan.toml", COARSE);
    let (scene, plan) = (shop.text("s"), shop.text("plan.toml"));
    let args = ["next-touch", &scene, "--count", "2", "--candidates", "30", "--config", &plan];
    palpate(args).expect(0, &["rank", "gain mm", "from anything measured"]);
    let said = palpate(args.iter().chain(&["--json"]));
    said.expect(0, &[]);
    let report: serde_json::Value = serde_json::from_str(&said.out).expect("one JSON object");
    let touches = report["touches"].as_array().expect("a list");
    assert_eq!(touches.len(), 2);
    let gain = |i: usize| touches[i]["expected_gain_mm"].as_f64().expect("a number");
    assert!(gain(0) >= gain(1) && gain(1) > 0.0);
    assert!(touches[0]["world_from_sensor"]["quaternion_xyzw"].as_array().is_some_and(|q| q.len() == 4));
    // One thread or two: the same bytes.
    let one = palpate(args.iter().chain(&["--json", "--threads", "1"]));
    assert_eq!(one.out, said.out);
}

#[test]
fn touches_that_are_images_alone_are_decoded() {
    let shop = Workshop::new();
    let out = shop.text("sim");
    palpate(["simulate", "primitive:cube", "--touches", "2", "--map-width", "40", "--output", &out]).expect(0, &[]);
    let (file, scene) = (shop.path("sim/cube_view0/scene.toml"), shop.text("sim/cube_view0"));
    let text = std::fs::read_to_string(&file).expect("written");
    let recorded = |line: &&str| line.starts_with("height_map") || line.starts_with("contact_mask");
    let images: String = text.lines().filter(|line| !recorded(line)).map(|line| format!("{line}\n")).collect();
    assert!(images.contains("image = ") && images.len() < text.len(), "{images}");
    std::fs::write(&file, images).expect("written");
    shop.put("plan.toml", COARSE);
    let plan = shop.text("plan.toml");
    palpate(["next-touch", &scene, "--candidates", "10", "--config", &plan]).expect(0, &["rank"]);
    palpate(["symmetry", &scene]).expect(0, &["2 touches"]);
    let idle = "palpate: warning: --lookup-table is not used: the decoder is 'compact'";
    palpate(["symmetry", &scene, "--lookup-table", "simulated"]).expect(0, &[idle]);
    for command in ["next-touch", "symmetry"] {
        palpate([command, &scene, "--decoder", "recorded"]).expect(1, &["touch 0"]);
        palpate([command, &scene, "--decoder", "lookup"]).expect(1, &["needs --lookup-table"]);
    }
}

#[test]
fn the_plan_file_counts_and_flags_win_over_it() {
    let shop = Workshop::detailed();
    let scene = shop.text("s");
    let plan = shop.text("plan.toml");
    let keys = b"count = 2\ncandidates = 15\nseed = 3\n";
    shop.put("plan.toml", &[&keys[..], COARSE].concat());
    let list = |more: &[&str]| {
        let said = palpate(["next-touch", &scene, "--json", "--config", &plan].iter().chain(more));
        said.expect(0, &[]);
        said.out
    };
    let touches = |json: &str| {
        let report: serde_json::Value = serde_json::from_str(json).expect("one JSON object");
        report["touches"].as_array().map_or(0, Vec::len)
    };
    let from_file = list(&[]);
    assert_eq!(touches(&from_file), 2);
    assert_eq!(touches(&list(&["--count", "1"])), 1);
    assert_ne!(list(&["--seed", "4"]), from_file);
    shop.put("plan.toml", &[&b"count = 2\ncandidates = 15\nseed = 4\n"[..], COARSE].concat());
    assert_ne!(list(&[]), from_file, "the file's seed counts");
    shop.put("plan.toml", b"sensor = \"gelsite\"\ncandidates = 15\n");
    palpate(["explore", "primitive:cube", "--output", &shop.text("out"), "--config", &plan]).expect(1, &["'gelsite'"]);
}

#[test]
fn the_defaults_of_the_plan_are_printed_and_read_back() {
    let shop = Workshop::new();
    let printed = palpate(["config", "--plan"]);
    printed.expect(0, &["candidates = 200", "[belief]", "[reconstruct.implicit]"]);
    shop.put("plan.toml", printed.out.as_bytes());
    let again = palpate(["config", "--plan", "--config", &shop.text("plan.toml")]);
    assert_eq!(again.out, printed.out, "{}", again.err);
}

#[test]
fn next_touch_says_what_is_wrong() {
    let shop = Workshop::detailed();
    shop.put("plan.toml", COARSE);
    let (scene, reach) = (shop.text("s"), shop.text("reach.toml"));
    palpate(["next-touch", &scene, "--count", "0"]).expect(1, &["--count is 0; at least 1"]);
    palpate(["next-touch", &scene, "--reach", &shop.text("none.toml")]).expect(1, &["none.toml"]);
    for (text, wanted) in [
        (&b"keep_inn = []"[..], "keep_inn"),
        (&b"\xff\xfe"[..], "reach.toml"),
        (&b"approach = { direction = [0, 0, -1], max_angle_deg = 0 }"[..], "reach.approach.max_angle_deg is 0"),
    ] {
        shop.put("reach.toml", text);
        palpate(["next-touch", &scene, "--reach", &reach]).expect(1, &[wanted, "reach.toml"]);
    }
    shop.put("reach.toml", b"workspace = { min = [5, 5, 5], max = [6, 6, 6] }");
    let plan = shop.text("plan.toml");
    palpate(["next-touch", &scene, "--reach", &reach, "--config", &plan]).expect(1, &["no reachable pose"]);
    shop.edit("[support]\nnormal = [0.0, 0.0, 1.0]\noffset = -0.04\n", "");
    palpate(["next-touch", &scene, "--config", &plan]).expect(1, &["no support plane is known", "[support]"]);
}

#[test]
fn explore_writes_errors_a_table_and_a_plot_and_goes_on_where_it_stopped() {
    let shop = Workshop::new();
    shop.put("plan.toml", COARSE);
    let (out, plan) = (shop.text("out"), shop.text("plan.toml"));
    let run = |policy: &str| {
        palpate([
            "explore",
            "primitive:cube",
            "--touches",
            "1",
            "--candidates",
            "3",
            "--config",
            &plan,
            "--output",
            &out,
            "--policy",
            policy,
        ])
    };
    run("random").expect(0, &["| random | 1 | 1 |", "errors.csv"]);
    let first = std::fs::read_to_string(shop.path("out/errors.csv")).expect("written");
    assert_eq!(first.lines().count(), 2 + 2, "{first}");
    run("random,next-best").expect(0, &["| next-best | 1 | 1 |"]);
    let both = std::fs::read_to_string(shop.path("out/errors.csv")).expect("written");
    assert!(first.lines().all(|line| both.contains(line)), "the earlier run is kept");
    let svg = std::fs::read_to_string(shop.path("out/touches.svg")).expect("written");
    assert!(svg.contains("next-best"));
    shop.put("plan.toml", b"[reconstruct.implicit]\nspacing = 0.006\ndense_cells = 8000\n");
    run("even").expect(1, &["other parameters"]);
}

#[test]
fn the_plan_of_explore_gives_the_seed_and_not_the_number_of_candidates() {
    let shop = Workshop::new();
    let (out, plan) = (shop.text("out"), shop.text("plan.toml"));
    let args =
        ["explore", "primitive:cube", "--touches", "1", "--policy", "random", "--config", &plan, "--output", &out];
    for (keys, seed) in [("candidates = 200\ncount = 3\nseed = 7\n", "7"), ("seed = 8\n", "8")] {
        shop.put("plan.toml", &[keys.as_bytes(), COARSE].concat());
        palpate(args).expect(0, &["| random | 1 |"]);
        let rows = std::fs::read_to_string(shop.path("out/errors.csv")).expect("written");
        assert!(rows.lines().next().is_some_and(|l| l.contains("\"candidates\":20,")), "{rows}");
        assert!(rows.contains(&format!("cube,0,{seed},random,1,1,")), "{rows}");
    }
}

#[test]
fn explore_refuses_open_meshes_and_no_touches_and_writes_nothing() {
    let shop = Workshop::new();
    let out = shop.text("out");
    shop.put("open.obj", b"v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nv 0 0 0.05\nf 1 3 2\nf 1 2 4\nf 1 4 3\n");
    palpate(["explore", &shop.text("open.obj"), "--output", &out]).expect(1, &["'open' is not closed", "3 boundary"]);
    palpate(["explore", "primitive:cube", "--touches", "0", "--output", &out]).expect(1, &["--touches is 0"]);
    palpate(["explore", "primitive:cube", "--policy", "best", "--output", &out]).expect(2, &["next-best", "oracle"]);
    assert!(!shop.path("out").exists());
}
