//! `reconstruct --follow`: touches that are added to a scene while the program runs.

use crate::workshop::{Workshop, palpate};
use palpate::io::read_mesh;
use std::io::{BufRead as _, BufReader};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::Duration;

const COARSE: &[u8] = b"[implicit]\nspacing = 0.003\ndense_cells = 20000\n";

/// The scene as it was without its last touches, and their blocks.
fn without_touches(shop: &Workshop) -> (String, Vec<String>) {
    let text = std::fs::read_to_string(shop.path("s/scene.toml")).expect("there");
    let mut parts = text.split("[[touches]]");
    let before = parts.next().expect("a beginning").to_owned();
    (before, parts.map(|p| format!("[[touches]]{p}")).collect())
}

struct Running {
    child: Child,
    lines: BufReader<ChildStdout>,
}

impl Running {
    fn start(shop: &Workshop, more: &[&str]) -> Self {
        shop.put("coarse.toml", COARSE);
        let (scene, out, config) = (shop.text("s"), shop.text("out.ply"), shop.text("coarse.toml"));
        let mut child = Command::new(assert_cmd::cargo::cargo_bin!("palpate"))
            .args(["reconstruct", &scene, "--output", &out, "--config", &config, "--follow"])
            .args(more)
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .expect("the program starts");
        let lines = BufReader::new(child.stdout.take().expect("piped"));
        Self { child, lines }
    }

    /// The next line that it says; empty at the end.
    fn line(&mut self) -> String {
        let mut line = String::new();
        self.lines.read_line(&mut line).expect("text");
        line
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
    }
}

#[test]
fn the_mesh_keeps_up_with_touches_and_ends_as_if_all_had_been_there() {
    let shop = Workshop::detailed();
    let (before, touches) = without_touches(&shop);
    assert_eq!(touches.len(), 2);
    shop.put("s/scene.toml", before.as_bytes());
    let mut running = Running::start(&shop, &["--max-touches", "2", "--settle", "0.2"]);
    assert!(running.line().contains("0 touches"));
    let untouched = std::fs::read(shop.path("out.ply")).expect("written at once");
    let mut text = before;
    for (i, touch) in touches.iter().enumerate() {
        text.push_str(touch);
        // As `capture` does it: never half a file under its name.
        shop.put("s/scene.tmp", text.as_bytes());
        std::fs::rename(shop.path("s/scene.tmp"), shop.path("s/scene.toml")).expect("renamed");
        let line = running.line();
        assert!(line.starts_with(&format!("touch {i}: ")) && line.contains(" ms"), "{line}");
        read_mesh(shop.path("out.ply")).expect("whole at any time");
        let line = running.line();
        assert!(line.starts_with("settled: "), "{line}");
    }
    assert!(running.child.wait().expect("it ends by itself").success());
    let followed = std::fs::read(shop.path("out.ply")).expect("written");
    assert!(followed != untouched);
    let (scene, full, config) = (shop.text("s"), shop.text("full.ply"), shop.text("coarse.toml"));
    palpate(["reconstruct", &scene, "--output", &full, "--config", &config]).expect(0, &["2 touches"]);
    assert!(followed == std::fs::read(full).expect("written"), "settled is not what a full run writes");
}

#[test]
fn it_waits_through_a_torn_file_and_begins_anew_with_another_scene() {
    let shop = Workshop::detailed();
    let (before, touches) = without_touches(&shop);
    let one = format!("{before}{}", touches[0]);
    shop.put("s/scene.toml", one.as_bytes());
    let mut running = Running::start(&shop, &["--settle", "inf"]);
    assert!(running.line().contains("1 touch,"));
    shop.put("s/scene.toml", format!("{one}[[touches]]\nheight_m").as_bytes());
    std::thread::sleep(Duration::from_millis(300));
    shop.put("s/scene.toml", format!("{one}{}", touches[1]).as_bytes());
    assert!(running.line().starts_with("touch 1: "));
    shop.put("s/scene.toml", before.as_bytes());
    assert!(running.line().contains("the scene was changed"));
    assert!(running.line().contains("0 touches"));
}

#[test]
fn what_does_not_go_with_it_is_said() {
    let shop = Workshop::new();
    let (scene, out) = (shop.text("s"), shop.text("out.ply"));
    palpate(["reconstruct", &scene, &scene, "--output", &out, "--follow"]).expect(1, &["--follow takes one scene"]);
    palpate(["reconstruct", &scene, "--output", &out, "--follow", "--settle=-1"]).expect(1, &["--settle is -1"]);
    palpate(["reconstruct", &scene, "--output", &out, "--follow", "--method", "paper"]).expect(2, &["--method"]);
}
