//! `train`, of builds that have it: runs, resumed runs, and what is refused.

use crate::workshop::{Said, palpate};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const SPLIT: &str = "name = 'tiny'\ntrain = ['primitive:*']\nvalidation = ['002']\n";

/// A set of eight presses with its split and parameters of a network that a test can afford.
struct Lesson {
    folder: TempDir,
}

impl Lesson {
    fn new() -> Self {
        let lesson = Self { folder: tempfile::tempdir().expect("temporary folder") };
        let set = lesson.text("set");
        let fixed = ["presses", "--primitives", "1", "--width", "64", "--count", "8", "--shard-size", "4", "--output"];
        palpate(fixed.iter().copied().chain([set.as_str()])).expect(0, &["2 of 2 shards complete"]);
        // Indenters are for training alone: the second half stands in for presses of an object.
        let index = lesson.path("set/00001.json");
        let mut records: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&index).expect("there")).expect("JSON");
        let presses = records.as_array_mut().expect("a list of presses");
        for press in presses {
            press["object"] = "002_master_chef_can".into();
        }
        std::fs::write(&index, records.to_string()).expect("written");
        std::fs::write(lesson.path("split.toml"), SPLIT).expect("written");
        std::fs::write(lesson.path("tiny.toml"), parameters()).expect("written");
        lesson
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    fn train(&self, data: &str, config: &str, run: &str, more: &[&str]) -> Said {
        palpate(self.arguments(data, config, run, more))
    }

    fn arguments(&self, data: &str, config: &str, run: &str, more: &[&str]) -> Vec<String> {
        let (data, split) = (self.text(data), self.text("split.toml"));
        let (config, run) = (self.text(config), self.text(run));
        let fixed = ["train", "height-map", "--data", &data, "--split", &split, "--config", &config, "--output", &run];
        fixed.iter().chain(more).map(|&a| a.to_owned()).collect()
    }

    fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).expect(name)
    }
}

/// Two epochs of one step.
fn parameters() -> String {
    let parts = [
        "[network]\nwidth = 1\nhead = 'signed-height-map'\ndropout = 0.0\n",
        "[data]\nrows = 32\ncols = 32\ninput = 'difference'\ntarget = 'indentation-mm'\n",
        "[loss]\nkind = 'root-mean-square'\n",
        "[augment]\ngain = 0.05\noffset = 1.0\nnoise = 0.5\n",
        "[run]\nseed = 0\nepochs = 2\nbatch_size = 4\nlearning_rate = 0.001\nclip_norm = 1.0\nvalidate_every = 0\npatience = 0\n",
        "[run.schedule]\nkind = 'constant'\n[run.optimizer]\nkind = 'adam'\n",
    ];
    parts.concat()
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> = entries.map(|e| e.expect("readable").file_name().display().to_string()).collect();
    names.sort();
    names
}

#[test]
fn a_run_leaves_its_files_and_a_resumed_one_the_same_bytes() {
    let lesson = Lesson::new();
    lesson.train("set", "tiny.toml", "whole", &[]).expect(0, &["4 presses for training, 4", "finished after 2 steps"]);
    let files = ["best.safetensors", "checkpoint.safetensors", "curves.svg", "metrics.csv", "train.toml"];
    assert_eq!(names(&lesson.path("whole")), files);
    let metrics = String::from_utf8(lesson.read("whole/metrics.csv")).expect("text");
    assert!(metrics.starts_with("step,epoch,learning_rate,train_loss,rmse_mm"), "{metrics}");
    assert_eq!(metrics.lines().count(), 3, "{metrics}");

    lesson.train("set", "tiny.toml", "whole", &[]).expect(1, &["holds the checkpoint of a run", "resume"]);
    lesson.train("set", "tiny.toml", "parted", &["--resume"]).expect(1, &["parted", "no checkpoint to resume"]);
    lesson.train("set", "tiny.toml", "parted", &["--epochs", "1"]).expect(0, &["finished after 1 steps"]);
    lesson.train("set", "tiny.toml", "parted", &["--resume"]).expect(0, &["finished after 2 steps"]);
    // All but the command and the clock.
    let tensors = |run: &str| {
        let bytes = lesson.read(&format!("{run}/checkpoint.safetensors"));
        let header = 8 + u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes")) as usize;
        bytes[header..].to_vec()
    };
    assert!(tensors("whole") == tensors("parted"), "the resumed run differs");
}

#[test]
fn what_cannot_be_trained_on_is_named_and_nothing_is_left() {
    let lesson = Lesson::new();
    std::fs::create_dir(lesson.path("empty")).expect("made");
    lesson.train("empty", "tiny.toml", "run", &[]).expect(1, &["empty", "set.json"]);
    lesson.train("nowhere", "tiny.toml", "run", &[]).expect(1, &["nowhere"]);
    let edited = |from: &str, to: &str| {
        let text = parameters();
        assert!(text.contains(from), "{from}");
        std::fs::write(lesson.path("bad.toml"), text.replacen(from, to, 1)).expect("written");
        lesson.train("set", "bad.toml", "run", &[])
    };
    edited("batch_size = 4", "batch_size = 0").expect(1, &["batch_size is 0", "at least 1"]);
    edited("learning_rate = 0.001", "learning_rate = nan").expect(1, &["learning_rate is NaN", "(0, 1]"]);
    edited("rows = 32", "rows = 3").expect(1, &["3 × 32", "32 … 2048"]);
    edited("epochs = 2", "epoch = 2").expect(1, &["bad.toml", "epoch"]);
    edited("'signed-height-map'", "'contact-mask'").expect(1, &["ContactMask", "height-map"]);
    edited("[network]", "[network").expect(1, &["bad.toml"]);
    lesson.train("set", "missing.toml", "run", &[]).expect(1, &["missing.toml"]);
    std::fs::write(lesson.path("split.toml"), "name = 'none'\ntrain = ['*']\nvalidation = ['999']\n").expect("written");
    lesson.train("set", "tiny.toml", "run", &[]).expect(1, &["validation", "8 presses"]);
    assert!(!lesson.path("run").exists());
}

#[test]
fn a_checkpoint_of_another_network_or_of_none_is_refused_and_kept() {
    let lesson = Lesson::new();
    lesson.train("set", "tiny.toml", "run", &["--epochs", "1"]).expect(0, &[]);
    std::fs::write(lesson.path("wide.toml"), parameters().replace("width = 1", "width = 2")).expect("written");
    let before = lesson.read("run/checkpoint.safetensors");
    lesson.train("set", "wide.toml", "run", &["--resume"]).expect(1, &["checkpoint", "\"width\":1", "\"width\":2"]);
    lesson.train("set", "tiny.toml", "run", &["--resume", "--seed", "7"]).expect(1, &["seed 0, now it is 7"]);
    assert!(lesson.read("run/checkpoint.safetensors") == before);

    std::fs::write(lesson.path("run/checkpoint.safetensors"), &before[..before.len() / 2]).expect("written");
    lesson.train("set", "tiny.toml", "run", &["--resume"]).expect(1, &["checkpoint.safetensors"]);
    // Weights alone are no checkpoint.
    std::fs::copy(lesson.path("run/best.safetensors"), lesson.path("run/checkpoint.safetensors")).expect("copied");
    lesson.train("set", "tiny.toml", "run", &["--resume"]).expect(1, &["checkpoint.safetensors", "training_state"]);
}

#[cfg(unix)]
#[test]
fn a_checkpoint_that_cannot_be_finished_leaves_the_one_before_to_resume_from() {
    let lesson = Lesson::new();
    lesson.train("set", "tiny.toml", "run", &["--epochs", "1"]).expect(0, &[]);
    let (files, before) = (names(&lesson.path("run")), lesson.read("run/checkpoint.safetensors"));
    // No file may grow to the size of the checkpoint, as on a disk that fills up: the system refuses the bytes beyond.
    let blocks = usize::midpoint(lesson.read("run/best.safetensors").len(), before.len()) / 512;
    let limited = format!("trap '' XFSZ; ulimit -f {blocks}; exec \"$@\"");
    let program = assert_cmd::cargo::cargo_bin!("palpate").display().to_string();
    let arguments = lesson.arguments("set", "tiny.toml", "run", &["--resume"]);
    let output = std::process::Command::new("sh")
        .args(["-c", &limited, "sh", &program])
        .args(&arguments)
        .output()
        .expect("the shell starts");
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("checkpoint.safetensors") && said.contains("File too large"), "{said}");
    assert!(lesson.read("run/checkpoint.safetensors") == before, "the old checkpoint changed");
    assert!(names(&lesson.path("run")).iter().all(|n| files.contains(n) || n == "curves.svg"), "leftovers");
    lesson.train("set", "tiny.toml", "run", &["--resume"]).expect(0, &["finished after 2 steps"]);
}
