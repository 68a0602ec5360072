//! What a touch costs a running session, and what it loses against starting again: a Markdown row per scene, a line per touch on request.
//!
//! ```text
//! follow_times [--each|--settle] SCENE...
//! ```
//!
//! A session starts with no touch and takes in all of the scene's one by one, never settling; with `--settle` it is settled after each touch, as
//! `reconstruct --follow` does, and the worst of the touches is told instead of the last. CPU time is that of all threads (Linux).

use palpate::geometry::TriangleMesh;
use palpate::io::{read_mesh, read_scene};
use palpate::metrics::{CompareParams, TruthReference};
use palpate::pipeline::{Followed, ReconstructParams, Session, Stages, reconstruct};
use std::cell::RefCell;
use std::error::Error;
use std::time::Instant;

/// Seconds on a processor so far, all threads.
fn cpu() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let nanoseconds = |task: std::fs::DirEntry| {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    };
    tasks.filter_map(nanoseconds).sum::<f64>() * 1e-9
}

fn iou(a: &TriangleMesh, b: &TriangleMesh) -> Result<(f64, f64), Box<dyn Error>> {
    let params = CompareParams { samples: 20_000, ..CompareParams::default() };
    let compared = TruthReference::new(b, &params)?.compare(a)?;
    Ok((compared.volumetric_iou.unwrap_or(f64::NAN), compared.distances.chamfer_mean_mm))
}

/// After one touch: IoU with the settled mesh, and with the truth of both.
fn settled(session: &mut Session, truth: Option<&TriangleMesh>) -> Result<[f64; 3], Box<dyn Error>> {
    let followed = session.reconstruction().mesh.clone();
    session.settle()?;
    let full = &session.reconstruction().mesh;
    let with_truth = |mesh: &TriangleMesh| truth.map_or(Ok(f64::NAN), |t| iou(mesh, t).map(|i| i.0));
    Ok([iou(&followed, full)?.0, with_truth(&followed)?, with_truth(full)?])
}

fn run(folder: &str, each: bool, settle: bool) -> Result<(), Box<dyn Error>> {
    let file = read_scene(folder)?;
    let whole = file.scene.clone();
    let mut scene = file.scene;
    let touches = std::mem::take(&mut scene.touches);
    let params = ReconstructParams::default();
    let begun = RefCell::new(Vec::new());
    let note = |stage: &'static str| begun.borrow_mut().push((stage, cpu()));
    let stages = Stages { on_stage: Some(&note), ..Stages::default() };
    let mut session = Session::start(scene, &params, stages)?;
    let (mut walls, mut cpus, mut again) = (Vec::new(), Vec::new(), 0);
    let truth = file.truth.as_ref().map(read_mesh).transpose()?;
    let mut least: Option<[f64; 3]> = None;
    for (i, touch) in touches.into_iter().enumerate() {
        begun.borrow_mut().clear();
        let (wall, busy) = (Instant::now(), cpu());
        let update = session.add_touch(touch)?;
        let (wall, end) = (1e3 * wall.elapsed().as_secs_f64(), cpu());
        let busy = 1e3 * (end - busy);
        if each {
            let begun = begun.borrow();
            let ends = begun.iter().skip(1).map(|s| s.1).chain([end]);
            let parts: Vec<String> =
                begun.iter().zip(ends).map(|(s, e)| format!("{} {:.1}", s.0, 1e3 * (e - s.1))).collect();
            println!("touch {i}: {wall:.0} ms, CPU {busy:.0} ms ({}); {:?}", parts.join(", "), update.followed);
        }
        if matches!(update.followed, Followed::Locally | Followed::LeftOut { .. }) {
            walls.push(wall);
            cpus.push(busy);
        } else {
            again += 1;
        }
        if settle {
            let found = settled(&mut session, truth.as_ref())?;
            println!("touch {i}: {found:.4?} {:?}", update.followed);
            least = Some(least.map_or(found, |l| if found[0] < l[0] { found } else { l }));
        }
    }
    let from_start = reconstruct(&whole, &params, &Stages::default())?;
    let followed = &session.reconstruction().mesh;
    let same = iou(followed, &from_start.mesh)?.0;
    let middle = |v: &mut Vec<f64>| {
        v.sort_unstable_by(f64::total_cmp);
        (v.get(v.len() / 2).copied().unwrap_or(f64::NAN), v.last().copied().unwrap_or(f64::NAN))
    };
    let ((wall, wall_most), (busy, busy_most)) = (middle(&mut walls), middle(&mut cpus));
    print!("| {} | {wall:.0} / {wall_most:.0} | {busy:.0} / {busy_most:.0} | {again} | {same:.4} |", whole.name);
    if let Some([same, followed, full]) = least {
        print!(" worst: {same:.4}, {followed:.4} / {full:.4} |");
    }
    if let Some(truth) = truth {
        let (a, b) = (iou(followed, &truth)?, iou(&from_start.mesh, &truth)?);
        print!(" {:.4} / {:.4} | {:.3} / {:.3} |", a.0, b.0, a.1, b.1);
    }
    println!();
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut scenes: Vec<String> = std::env::args().skip(1).collect();
    let [each, settle] = ["--each", "--settle"].map(|flag| scenes.first().is_some_and(|a| a == flag));
    if each || settle {
        scenes.remove(0);
    }
    println!(
        "| scene | ms a touch: median / worst | CPU ms | started again | IoU with a full one | IoU with the truth: followed / full | Chamfer mean, mm |"
    );
    println!("|---|---|---|---|---|---|---|");
    scenes.iter().try_for_each(|scene| run(scene, each, settle))
}
