use crate::Outcome;
use anyhow::Context as _;
use palpate::io::read_mesh;
use palpate::metrics::{CompareParams, Comparison, compare};
use std::path::PathBuf;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// The mesh to judge
    predicted: PathBuf,
    /// The true surface, in the same frame and unit (metres); nothing is aligned
    truth: PathBuf,
    /// One JSON object on standard output
    #[arg(long)]
    json: bool,
    /// Samples on each surface
    #[arg(long, default_value_t = CompareParams::default().samples, value_name = "N")]
    samples: usize,
    /// Seed of the samples
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let predicted = read_mesh(&args.predicted)?;
    let truth = read_mesh(&args.truth)?;
    let params = CompareParams { samples: args.samples, seed: args.seed, ..CompareParams::default() };
    let comparison = compare(&predicted, &truth, &params)
        .with_context(|| format!("comparing {} with {}", args.predicted.display(), args.truth.display()))?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&comparison)?);
    } else {
        print!("{}", table(&comparison));
    }
    Ok(Outcome::Done)
}

/// The comparison for people to read.
fn table(c: &Comparison) -> String {
    let d = &c.distances;
    let yes = |b: bool| if b { "yes" } else { "no" };
    let mut lines = vec![
        ("volumetric IoU", c.volumetric_iou.map_or_else(|| "–".to_owned(), |iou| format!("{iou:.4}"))),
        ("chamfer, mean", format!("{:.4} mm   (half the sum of both mean distances)", d.chamfer_mean_mm)),
        ("chamfer, squared", format!("{:.4} mm²  (sum of both mean squared distances)", d.chamfer_squared_mm2)),
        ("accuracy", format!("{:.4} mm   (predicted → truth, mean)", d.accuracy_mm)),
        ("completeness", format!("{:.4} mm   (truth → predicted, mean)", d.completeness_mm)),
        ("Hausdorff 95 %", format!("{:.4} mm", d.hausdorff95_mm)),
        ("F-score 1 / 2 / 5 mm", format!("{:.4} / {:.4} / {:.4}", d.f_score_1mm, d.f_score_2mm, d.f_score_5mm)),
        ("normal consistency", format!("{:.4}", d.normal_consistency)),
        ("watertight", yes(c.watertight).to_owned()),
        ("edge-manifold", yes(c.edge_manifold).to_owned()),
        ("components", c.components.to_string()),
        ("faces", c.faces.to_string()),
    ];
    lines.extend(c.note.clone().map(|note| ("note", note)));
    lines.iter().map(|(name, value)| format!("{name:<21} {value}\n")).collect()
}
