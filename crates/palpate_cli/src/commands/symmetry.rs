use crate::decoders::TouchDecoder;
use crate::{Outcome, say};
use anyhow::Context as _;
use palpate::camera::{SegmentParams, segment_object};
use palpate::evidence::{Evidence, EvidenceParams};
use palpate::io;
use palpate::pipeline::with_contacts;
use palpate::scene::Scene;
use palpate::symmetry::{
    EvidenceSearch, Hypothesis, Rejection, Symmetry, SymmetryElement, SymmetryEstimator as _, SymmetryParams,
    verdict_cloud, verdicts,
};
use palpate::tactile::{LiftParams, Patch, lift};
use serde::Serialize;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "\
Examples:
  palpate symmetry scene
  palpate symmetry scene --max-touches 0 --json
  palpate symmetry scene --keep verdicts       # then look at verdicts/*.ply in MeshLab

Every seen and felt sample is moved by a hypothesis and looked up: `support` is the share that lands on a measured surface from
elsewhere, `against` what lands in free space or beside a surface, `new` the share that lands where nothing is known.
Accepting none is an answer.";

#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub(crate) struct Args {
    /// Scene folder.
    #[arg(value_name = "SCENE")]
    scene: PathBuf,
    /// Print one JSON object instead of a table.
    #[arg(long)]
    json: bool,
    /// Folder for one cloud per hypothesis: the evidence moved by it, coloured by verdict: green supports, red lies in free space, orange
    /// lies beside a surface, grey says nothing.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
    /// Use only the first N touches.
    #[arg(long, value_name = "N")]
    max_touches: Option<usize>,
    /// A pixel on the object, where the scene has no mask.
    #[arg(long, value_parser = super::clean::pixel, value_name = "U,V")]
    pick: Option<(f64, f64)>,
    #[command(flatten)]
    decoder: TouchDecoder,
    /// Seed of the subsamples.
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
}

#[derive(Serialize)]
struct Report<'a> {
    name: &'a str,
    samples: usize,
    touches: usize,
    accepted: Vec<Entry>,
    rejected: Vec<Entry>,
}

#[derive(Serialize)]
struct Entry {
    kind: &'static str,
    /// Plane normal or axis direction, world frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    direction: Option<[f64; 3]>,
    /// normal · x = offset, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    offset: Option<f64>,
    /// Point of an axis or centre of a sphere, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    point: Option<[f64; 3]>,
    /// Rotations of an axis; absent = continuous.
    #[serde(skip_serializing_if = "Option::is_none")]
    order: Option<u32>,
    confidence: f64,
    support: f64,
    informative_support: f64,
    violation: f64,
    contradiction: f64,
    neutral: f64,
    /// Violation and contradiction of the felt samples alone.
    felt_opposition: f64,
    /// Row by row; parameters as the library documents them.
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<Vec<Vec<f64>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    let mut file = io::read_scene(&args.scene).with_context(|| format!("reading {}", args.scene.display()))?;
    let count = args.max_touches.unwrap_or(usize::MAX);
    file.scene.touches.truncate(count);
    let decoder = args.decoder.of_scene(&mut file, &args.scene, false)?;
    super::clean::warn_of_unused_pick(args.pick, &mut file);
    file.warnings.iter().for_each(say::warn);
    let scene = with_contacts(&file.scene, count, decoder.as_deref())?;
    let segment = SegmentParams { pick: args.pick, seed: args.seed, ..SegmentParams::default() };
    let visible = segment_object(&scene.frame, &segment).context("finding the object")?;
    let (patches, lost) = lift_touches(&scene);
    let params = EvidenceParams {
        pose_sigma_translation: scene.pose_sigma.translation,
        pose_sigma_rotation: scene.pose_sigma.rotation,
        ..EvidenceParams::default()
    };
    let evidence = Evidence::gather(&scene.frame, &visible, &patches, &params).context("gathering evidence")?;
    let search = EvidenceSearch { params: SymmetryParams { seed: args.seed, ..SymmetryParams::default() } };
    let symmetry = search.estimate(&evidence);
    if let Some(folder) = &args.keep {
        keep(folder, &evidence, &symmetry, &search.params)?;
    }
    let report = Report {
        name: &scene.name,
        samples: evidence.samples.len(),
        touches: patches.len(),
        accepted: symmetry.accepted.iter().map(Entry::new).collect(),
        rejected: symmetry.rejected.iter().map(Entry::new).collect(),
    };
    if args.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print_table(&report);
    }
    Ok(if lost == 0 { Outcome::Done } else { Outcome::Degraded })
}

/// Writes the evidence as each hypothesis moves it: `accepted_00_axis.ply`, `rejected_00_reflection.ply`, …, in the order of the table.
fn keep(folder: &Path, evidence: &Evidence, symmetry: &Symmetry, params: &SymmetryParams) -> anyhow::Result<()> {
    io::create_folder(folder)?;
    for (name, hypotheses) in [("accepted", &symmetry.accepted), ("rejected", &symmetry.rejected)] {
        for (i, hypothesis) in hypotheses.iter().enumerate() {
            let cloud = verdict_cloud(&verdicts(evidence, &hypothesis.element, params));
            io::write_cloud(folder.join(format!("{name}_{i:02}_{}.ply", hypothesis.element.kind())), &cloud)?;
        }
    }
    Ok(())
}

/// The patches of the touches, and how many touches had to be left out.
fn lift_touches(scene: &Scene) -> (Vec<Patch>, usize) {
    let Some(sensor) = &scene.sensor else { return (Vec::new(), 0) };
    let (mut patches, mut lost) = (Vec::new(), 0);
    for (i, touch) in scene.touches.iter().enumerate() {
        let Some(contact) = &touch.contact else { continue };
        match lift(contact, sensor, &touch.world_from_sensor, &LiftParams::default()) {
            Ok(patch) => patches.push(patch),
            Err(reason) => {
                say::warn(format!("touch {i} is left out: {reason}"));
                lost += 1;
            }
        }
    }
    (patches, lost)
}

impl Entry {
    fn new(h: &Hypothesis) -> Self {
        let (direction, offset, point, order) = match &h.element {
            SymmetryElement::Reflection(p) => (Some(p.normal.into_inner().into()), Some(p.offset), None, None),
            SymmetryElement::Axis { point, direction, order } => {
                (Some(direction.into_inner().into()), None, Some(point.coords.into()), *order)
            }
            SymmetryElement::Sphere { center } => (None, None, Some(center.coords.into()), None),
        };
        Self {
            kind: h.element.kind(),
            direction,
            offset,
            point,
            order,
            confidence: h.confidence,
            support: h.score.support,
            informative_support: h.score.informative,
            violation: h.score.violation,
            contradiction: h.score.contradiction,
            neutral: h.score.neutral,
            felt_opposition: h.score.felt_opposition,
            covariance: h.covariance.as_ref().map(|c| c.row_iter().map(|r| r.iter().copied().collect()).collect()),
            reason: h.rejection.map(reason),
        }
    }
}

/// A rejection in words.
pub(super) fn reason(rejection: Rejection) -> String {
    match rejection {
        Rejection::LittleSupport { needed } => format!("too little support ({needed:.2} needed)"),
        Rejection::Opposed { allowed } => format!("opposed (at most {allowed:.3} allowed)"),
        Rejection::Felt { allowed } => format!("touches contradict it (at most {allowed:.2} of theirs allowed)"),
        Rejection::Misfits { share } => format!("{:.0} % of the samples are not part of such a body", share * 100.0),
        Rejection::Conflict { with } => {
            let n = with.normal;
            format!("in conflict with the plane of normal ({:.2}, {:.2}, {:.2})", n.x, n.y, n.z)
        }
        Rejection::Floats { height } => {
            let way = if height > 0.0 { "float above" } else { "sink into" };
            format!("the object would {way} its support by {:.1} mm", 1e3 * height.abs())
        }
        Rejection::Vessel { share } => format!(
            "a vessel is open above and closed below ({:.0} % of the samples look at the object)",
            100.0 * share
        ),
        Rejection::AgainstAxis => "oblique to the accepted axis".to_owned(),
        Rejection::Redundant => "adds nothing to the accepted ones".to_owned(),
        other => format!("{other:?}"),
    }
}

fn print_table(report: &Report) {
    println!(
        "{}: {} samples, {}, {} accepted",
        report.name,
        report.samples,
        say::count(report.touches, "touch", "touches"),
        report.accepted.len()
    );
    if !report.accepted.is_empty() || !report.rejected.is_empty() {
        println!(
            "{:10} {:>10} {:>8} {:>8} {:>6}  where (world, metres)",
            "", "confidence", "support", "against", "new"
        );
    }
    report.accepted.iter().for_each(print_row);
    if !report.rejected.is_empty() {
        println!("rejected:");
        report.rejected.iter().for_each(print_row);
    }
}

fn print_row(e: &Entry) {
    let mut place = String::new();
    if let Some([x, y, z]) = e.direction {
        let name = if e.offset.is_some() { "normal" } else { "direction" };
        place += &format!("{name} ({x:.3}, {y:.3}, {z:.3}) ");
    }
    if let Some(offset) = e.offset {
        place += &format!("offset {offset:.4} ");
    }
    if let Some([x, y, z]) = e.point {
        place += &format!("{} ({x:.4}, {y:.4}, {z:.4}) ", if e.direction.is_some() { "through" } else { "centre" });
    }
    if let Some(reason) = &e.reason {
        place += &format!("- {reason}");
    }
    let against = e.violation + e.contradiction;
    println!(
        "{:10} {:10.2} {:8.3} {:8.3} {:6.2}  {}",
        e.kind,
        e.confidence,
        e.informative_support,
        against,
        e.neutral,
        place.trim_end()
    );
}
