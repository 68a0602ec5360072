//! Runs every scene × touch count × method and keeps what came out.

use super::dataset::{self, Case, Loaded, Source};
use super::results::{self, Key, Row};
use super::row_file::RowFile;
use super::{plots, summary};
use crate::Outcome;
use anyhow::Context as _;
use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use palpate::geometry::{Plane, TriangleMesh};
use palpate::io::read_mesh;
use palpate::metrics::{CompareParams, TruthReference, Viewpoint, oracle_plane};
use palpate::simulate::{SimulateParams, simulate_scene};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

#[derive(clap::Args)]
pub(crate) struct Args {
    /// Folder of scenes with truth, or of meshes: then scenes are simulated by the benchmark protocol
    dataset: PathBuf,
    /// Folder for results.csv, summary.md and the plots; a run that was interrupted goes on where it stopped
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// A few minutes: six objects, one view, 0, 5 and 20 touches
    #[arg(long)]
    quick: bool,
    /// Touch counts; the first N touches of a scene are used
    #[arg(long, value_delimiter = ',', default_values_t = [0, 5, 10, 20, 60], value_name = "N,…")]
    touches: Vec<usize>,
    /// Methods
    #[arg(long, value_enum, value_delimiter = ',', default_values_t = [Method::PaperBpa, Method::PaperPsr, Method::Fused])]
    methods: Vec<Method>,
    /// Where the symmetry comes from; the oracle reads the truth and is a yardstick only
    #[arg(long, value_enum, default_value_t = SymmetrySource::Estimated)]
    symmetry: SymmetrySource,
    /// Views of each object
    #[arg(long, default_value_t = 3, value_name = "N")]
    views: usize,
    /// Only objects whose name holds one of these
    #[arg(long, value_delimiter = ',', value_name = "NAME,…")]
    objects: Vec<String>,
    /// Seed of the simulation, the reconstruction and the samples
    #[arg(long, default_value_t = 0, value_name = "N")]
    seed: u64,
    /// Samples on each surface
    #[arg(long, default_value_t = CompareParams::default().samples, value_name = "N")]
    samples: usize,
    /// Run again what failed before
    #[arg(long)]
    retry_failed: bool,
}

/// A way to a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum Method {
    /// The published method, surface by ball pivoting
    PaperBpa,
    /// The published method, surface by screened Poisson reconstruction
    PaperPsr,
    /// Ours
    Fused,
}

/// Where the symmetry comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(super) enum SymmetrySource {
    /// From the evidence, as in any run
    Estimated,
    /// The plane about which the truth mirrored lies closest to itself
    Oracle,
    /// No symmetry
    None,
}

impl Method {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned())
    }
}

impl SymmetrySource {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |v| v.get_name().to_owned())
    }
}

/// One reconstruction to do.
pub(super) struct Job<'a> {
    pub(super) case: &'a Loaded,
    /// The truth's best plane, where the oracle is asked for.
    pub(super) oracle: Option<Plane>,
    pub(super) method: Method,
    pub(super) symmetry: SymmetrySource,
    pub(super) touches: usize,
    pub(super) seed: u64,
}

/// What a reconstruction gave.
pub(super) struct Answer {
    pub(super) mesh: TriangleMesh,
    pub(super) touches_used: usize,
    /// Seconds of each stage, in order.
    pub(super) stages: Vec<(String, f64)>,
}

type Reconstructor<'a> = dyn Fn(&Job) -> anyhow::Result<Answer> + Sync + 'a;

pub(crate) fn run(args: Args) -> anyhow::Result<Outcome> {
    run_with(args, &super::reconstructor::reconstruct)
}

/// Everything but the reconstruction itself, which tests replace.
fn run_with(mut args: Args, reconstruct: &Reconstructor) -> anyhow::Result<Outcome> {
    let mut cases = dataset::list(&args.dataset, if args.quick { 1 } else { args.views })?;
    cases.retain(|case| args.objects.is_empty() || args.objects.iter().any(|name| case.object.contains(name.as_str())));
    if args.quick {
        cases = dataset::quick(cases);
        args.touches = vec![0, 5, 20];
    }
    args.touches.sort_unstable();
    args.touches.dedup();
    std::fs::create_dir_all(&args.output).with_context(|| format!("making {}", args.output.display()))?;
    let results = results::open(&args.output.join("results.csv"), &conditions(&args, &cases)?, args.retry_failed)?;

    let work: Vec<(&Case, Vec<Key>)> = cases
        .iter()
        .map(|case| (case, keys(case, &args).filter(|key| !results.contains(key)).collect::<Vec<_>>()))
        .filter(|(_, keys)| !keys.is_empty())
        .collect();
    let bar = progress(work.iter().map(|(_, keys)| keys.len()).sum());
    let results = Mutex::new(results);
    on_all_threads(&work, |(case, keys)| run_case(case, keys, &args, reconstruct, &results, &bar))?;
    bar.finish_and_clear();

    let rows = results.into_inner().expect("no thread panicked while it held the results").finish()?;
    summary::write(&args.output, &rows)?;
    plots::write(&args.output, &rows)?;
    println!("{}", args.output.join("summary.md").display());
    let failed = rows.iter().filter(|row| !row.error.is_empty()).count();
    if failed > 0 {
        crate::say::warn(format!(
            "{failed} of {} runs gave no mesh: see the column `error` of results.csv",
            rows.len()
        ));
        return Ok(Outcome::Degraded);
    }
    Ok(Outcome::Done)
}

/// Works through a list on as many threads as the pool has, and stops at the first error.
///
/// Threads of their own, not the pool's: a pool thread that waits within a reconstruction would begin another scene, and the
/// time of that would count as the first one's.
fn on_all_threads<T: Sync>(work: &[T], run: impl Fn(&T) -> anyhow::Result<()> + Sync) -> anyhow::Result<()> {
    let next = AtomicUsize::new(0);
    let worker = || -> anyhow::Result<()> {
        while let Some(item) = work.get(next.fetch_add(1, Ordering::Relaxed)) {
            run(item).inspect_err(|_| next.store(work.len(), Ordering::Relaxed))?;
        }
        Ok(())
    };
    std::thread::scope(|scope| {
        let threads: Vec<_> = (0..rayon::current_num_threads()).map(|_| scope.spawn(worker)).collect();
        threads.into_iter().try_for_each(|thread| thread.join().expect("panics of a run are caught in the run"))
    })
}

/// The runs of one case that are asked for, methods within touch counts.
fn keys(case: &Case, args: &Args) -> impl Iterator<Item = Key> {
    args.touches.iter().flat_map(move |&touches| {
        args.methods.iter().map(move |method| Key {
            object: case.object.clone(),
            view: case.view,
            touches,
            method: method.name(),
            symmetry: args.symmetry.name(),
        })
    })
}

/// Runs one view of one object; what goes wrong becomes a row. The error is that of the results file alone.
fn run_case(
    case: &Case,
    keys: &[Key],
    args: &Args,
    reconstruct: &Reconstructor,
    results: &Mutex<RowFile<Row>>,
    bar: &ProgressBar,
) -> anyhow::Result<()> {
    let push = |row: Row| {
        bar.set_message(format!("{} view {}", case.object, case.view));
        bar.inc(1);
        results.lock().expect("no thread panics while it holds the results").push(row)
    };
    let prepared = load(case, args).and_then(|loaded| {
        let viewpoint =
            Viewpoint { camera: loaded.scene.frame.camera, world_from_camera: loaded.scene.frame.world_from_camera };
        let params =
            CompareParams { samples: args.samples, seed: args.seed, viewpoint: Some(viewpoint), ..Default::default() };
        let truth = TruthReference::new(&loaded.truth, &params)?;
        Ok((loaded, truth))
    });
    let (loaded, truth) = match prepared {
        Ok(prepared) => prepared,
        Err(error) => {
            return keys.iter().try_for_each(|key| push(Row::failed(key.clone(), 0, format!("{error:#}"))));
        }
    };
    let wanted = args.symmetry == SymmetrySource::Oracle;
    let oracle = if wanted { oracle_plane(&loaded.truth, args.seed).map(|(plane, _)| plane) } else { None };
    for key in keys {
        let method = *args.methods.iter().find(|m| m.name() == key.method).expect("keys are made of the methods");
        let job = Job { case: &loaded, oracle, method, symmetry: args.symmetry, touches: key.touches, seed: args.seed };
        push(run_job(&job, key, &truth, reconstruct))?;
    }
    Ok(())
}

/// One reconstruction and its comparison. A panic is a bug of the library, but no reason to lose the other runs.
fn run_job(job: &Job, key: &Key, truth: &TruthReference, reconstruct: &Reconstructor) -> Row {
    let available = job.case.scene.touches.len().min(key.touches);
    let mut row = Row::failed(key.clone(), available, String::new());
    let started = Instant::now();
    let answer = catch_unwind(AssertUnwindSafe(|| reconstruct(job))).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        Err(anyhow::anyhow!("panicked: {}", text.unwrap_or("without a message")))
    });
    row.seconds = started.elapsed().as_secs_f64();
    let judged = answer.and_then(|answer| {
        row.touches_used = answer.touches_used;
        row.stages = answer.stages;
        row.clone().with_comparison(&truth.compare(&answer.mesh)?)
    });
    match judged {
        Ok(row) => row,
        Err(error) => Row { error: format!("{error:#}"), ..row },
    }
}

fn simulation(args: &Args, view: usize) -> SimulateParams {
    let mut params = SimulateParams { view, seed: args.seed, ..SimulateParams::default() };
    params.touch.count = args.touches.iter().copied().max().unwrap_or(0);
    params
}

fn load(case: &Case, args: &Args) -> anyhow::Result<Loaded> {
    match &case.source {
        Source::Mesh(path) => {
            let simulated = simulate_scene(&case.object, &read_mesh(path)?, &simulation(args, case.view))?;
            Ok(Loaded { scene: simulated.scene, truth: simulated.truth })
        }
        Source::Scene(path) => super::reconstructor::read_scene_with_truth(path),
    }
}

/// What the numbers depend on besides the columns. The touch count is left out: a longer list begins like a shorter one.
fn conditions(args: &Args, cases: &[Case]) -> anyhow::Result<String> {
    let simulated = cases.iter().any(|case| matches!(case.source, Source::Mesh(_)));
    let mut simulation = serde_json::to_value(simulation(args, 0))?;
    if let Some(touch) = simulation["touch"].as_object_mut() {
        touch.remove("count");
    }
    Ok(format!(
        "palpate {} benchmark shape; seed {}; samples {}; scenes {}; reconstruction {}",
        env!("CARGO_PKG_VERSION"),
        args.seed,
        args.samples,
        if simulated { format!("simulated {simulation}") } else { "recorded".to_owned() },
        super::reconstructor::parameters()?,
    ))
}

fn progress(runs: usize) -> ProgressBar {
    let style = ProgressStyle::with_template("{bar:40} {pos}/{len} runs, {elapsed} gone, {eta} to go  {msg}")
        .expect("the template is valid");
    let bar = ProgressBar::new(runs as u64).with_style(style);
    bar.enable_steady_tick(std::time::Duration::from_secs(1));
    bar
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate::geometry::{Isometry, Point};

    fn args(dataset: &std::path::Path, output: &std::path::Path) -> Args {
        Args {
            dataset: dataset.to_owned(),
            output: output.to_owned(),
            quick: false,
            touches: vec![2, 0],
            methods: vec![Method::PaperPsr, Method::Fused],
            symmetry: SymmetrySource::None,
            views: 2,
            objects: vec![],
            seed: 0,
            samples: 500,
            retry_failed: false,
        }
    }

    /// A tetrahedron of 60 mm, as a file.
    fn write_tetrahedron(path: &std::path::Path) {
        let vertices = [[0., 0., 0.], [0.06, 0., 0.], [0., 0.06, 0.], [0., 0., 0.06]].map(Point::from).to_vec();
        let faces = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let mesh = TriangleMesh::new(vertices, faces).expect("indices are valid");
        palpate::io::write_mesh(path, &mesh).expect("written");
    }

    /// The truth pushed aside by 1 mm a missing touch; the paper's method fails without touches and panics with them.
    fn stand_in(job: &Job) -> anyhow::Result<Answer> {
        match job.method {
            Method::Fused => {}
            _ if job.touches == 0 => anyhow::bail!("no touch, no mesh"),
            _ => panic!("a bug"),
        }
        let off = Isometry::translation(1e-3 * (3.0 - job.touches as f64), 0.0, 0.0);
        let stages = vec![("see".to_owned(), 0.1)];
        Ok(Answer { mesh: job.case.truth.transformed(&off), touches_used: job.touches, stages })
    }

    #[test]
    fn runs_are_kept_and_not_repeated() {
        let (data, output) = (tempfile::tempdir().expect("made"), tempfile::tempdir().expect("made"));
        write_tetrahedron(&data.path().join("a.ply"));
        write_tetrahedron(&data.path().join("b.ply"));
        std::fs::write(data.path().join("broken.ply"), "ply\n").expect("written");
        let calls = AtomicUsize::new(0);
        let counted = |job: &Job| {
            calls.fetch_add(1, Ordering::Relaxed);
            stand_in(job)
        };
        let outcome = run_with(args(data.path(), output.path()), &counted).expect("failures are rows");
        assert!(matches!(outcome, Outcome::Degraded));
        // Two sound objects × two views × two touch counts × two methods; the broken mesh never gets so far.
        assert_eq!(calls.swap(0, Ordering::Relaxed), 16);
        let read = |name: &str| std::fs::read_to_string(output.path().join(name)).expect("there");
        let csv = read("results.csv");
        assert_eq!(csv.lines().count(), 2 + 24);
        assert_eq!(csv.matches("no touch, no mesh").count(), 4);
        assert_eq!(csv.matches("panicked: a bug").count(), 4);
        assert_eq!(csv.lines().filter(|l| l.starts_with("broken")).count(), 8);
        assert!(read("summary.md").contains("fused"));
        assert!(read("touches.svg").starts_with("<svg") || read("touches.svg").starts_with("<?xml"));

        run_with(args(data.path(), output.path()), &counted).expect("failures are rows");
        assert_eq!(calls.load(Ordering::Relaxed), 0);
        assert_eq!(read("results.csv"), csv);

        let again = Args { retry_failed: true, ..args(data.path(), output.path()) };
        run_with(again, &counted).expect("failures are rows");
        assert_eq!(calls.swap(0, Ordering::Relaxed), 8);
        let more = Args { touches: vec![0, 1, 2], ..args(data.path(), output.path()) };
        run_with(more, &counted).expect("failures are rows");
        assert_eq!(calls.load(Ordering::Relaxed), 8);
    }

    #[test]
    fn results_of_other_parameters_are_not_mixed_in() {
        let (data, output) = (tempfile::tempdir().expect("made"), tempfile::tempdir().expect("made"));
        write_tetrahedron(&data.path().join("a.ply"));
        run_with(
            Args { touches: vec![2], methods: vec![Method::Fused], ..args(data.path(), output.path()) },
            &stand_in,
        )
        .expect("sound");
        let other = Args { seed: 1, ..args(data.path(), output.path()) };
        let Err(error) = run_with(other, &stand_in) else { panic!("other seed must be refused") };
        assert!(error.to_string().contains("use another --output"), "{error}");
    }
}
