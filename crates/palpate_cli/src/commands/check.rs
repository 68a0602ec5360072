use crate::Outcome;
use anyhow::bail;
use palpate::io::check_scene;
use std::path::PathBuf;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Scene folder
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Write one JSON object and nothing else to standard output
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let Args { scene: folder, json } = args;
    let check = check_scene(&folder);
    let scene = check.scene.as_ref().map(|file| &file.scene);
    let (touches, warnings) = (scene.map(|s| s.touches.len()), check.warnings);
    // The alternate form of anyhow writes an error with its causes.
    let errors: Vec<String> = check.errors.into_iter().map(|e| format!("{:#}", anyhow::Error::from(e))).collect();
    if json {
        let report = serde_json::json!({
            "scene": folder,
            "ok": errors.is_empty(),
            "touches": touches,
            "errors": errors,
            "warnings": warnings,
        });
        println!("{report:#}");
    } else {
        for error in &errors {
            println!("wrong: {error}");
        }
        for warning in &warnings {
            println!("doubtful: {warning}");
        }
        if let Some(touches) = touches {
            println!("{}: can be reconstructed; touches: {touches}, doubts: {}", folder.display(), warnings.len());
        }
    }
    if !errors.is_empty() {
        bail!("{}: wrong: {}, doubtful: {}", folder.display(), errors.len(), warnings.len());
    }
    Ok(Outcome::Done)
}
