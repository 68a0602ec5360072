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
    let check = check_scene(&args.scene);
    let scene = check.scene.as_ref().map(|file| &file.scene);
    let (touches, warnings) = (scene.map(|s| s.touches.len()), check.warnings);
    // The alternate form of anyhow writes an error with its causes.
    let errors: Vec<String> = check.errors.into_iter().map(|e| format!("{:#}", anyhow::Error::from(e))).collect();
    if args.json {
        let report = serde_json::json!({
            "scene": args.scene,
            "ok": errors.is_empty(),
            "touches": touches,
            "errors": errors,
            "warnings": warnings,
        });
        println!("{report:#}");
    } else {
        errors.iter().for_each(|e| println!("wrong: {e}"));
        warnings.iter().for_each(|w| println!("doubtful: {w}"));
        if let Some(touches) = touches {
            println!("{}: can be reconstructed; touches: {touches}, doubts: {}", args.scene.display(), warnings.len());
        }
    }
    if !errors.is_empty() {
        bail!("{}: wrong: {}, doubtful: {}", args.scene.display(), errors.len(), warnings.len());
    }
    Ok(Outcome::Done)
}
