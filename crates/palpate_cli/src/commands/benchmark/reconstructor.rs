//! The one place where the benchmark meets the pipeline.

use super::dataset::Loaded;
use super::shape::{Answer, Job, Method, SymmetrySource};
use crate::progress::StageClock;
use anyhow::Context as _;
use palpate::evidence::Evidence;
use palpate::io::{read_mesh, read_scene};
use palpate::pipeline::{self, ReconstructParams, Stages, Surface};
use palpate::symmetry::{Hypothesis, Score, Symmetry, SymmetryElement, SymmetryEstimator};
use std::path::Path;

/// An answer that does not look at the evidence.
struct Given(Symmetry);

impl SymmetryEstimator for Given {
    fn estimate(&self, _: &Evidence) -> Symmetry {
        self.0.clone()
    }
}

/// Reconstructs by the library.
pub(super) fn reconstruct(job: &Job) -> anyhow::Result<Answer> {
    let (method, surface) = match job.method {
        Method::PaperBpa => (pipeline::Method::Paper, Some(Surface::BallPivoting)),
        Method::PaperPsr => (pipeline::Method::Paper, Some(Surface::Poisson)),
        Method::Fused => (pipeline::Method::Fused, None),
    };
    let params = ReconstructParams {
        method,
        surface,
        seed: job.seed,
        max_touches: Some(job.touches),
        ..ReconstructParams::default()
    };
    let given = match job.symmetry {
        SymmetrySource::Estimated => None,
        SymmetrySource::None => Some(Given(Symmetry::default())),
        SymmetrySource::Oracle => Some(Given(oracle(job)?)),
    };
    let clock = StageClock::silent();
    let stages = Stages {
        symmetry: given.as_ref().map(|given| given as &dyn SymmetryEstimator),
        on_stage: Some(&|stage| clock.begin(stage)),
        ..Stages::default()
    };
    let result = pipeline::reconstruct(&job.case.scene, &params, &stages)?;
    let stages = clock.finish().into_iter().map(|(name, seconds)| (name.to_owned(), seconds)).collect();
    Ok(Answer { mesh: result.mesh, touches_used: result.touches_used, stages })
}

/// The truth's best plane, as a symmetry that the evidence is said to support fully.
fn oracle(job: &Job) -> anyhow::Result<Symmetry> {
    let plane = job.oracle.context("the truth has no area")?;
    let hypothesis = Hypothesis {
        element: SymmetryElement::Reflection(plane),
        score: Score { support: 1.0, informative: 1.0, ..Score::default() },
        confidence: 1.0,
        covariance: None,
        rejection: None,
    };
    Ok(Symmetry { accepted: vec![hypothesis], rejected: Vec::new() })
}

/// Reads a scene folder and its truth.
pub(super) fn read_scene_with_truth(path: &Path) -> anyhow::Result<Loaded> {
    let file = read_scene(path)?;
    let truth = file.truth.with_context(|| format!("{} has no [truth] to judge by", path.display()))?;
    Ok(Loaded { scene: file.scene, truth: read_mesh(truth)? })
}

/// The parameters of the reconstruction, on one line.
pub(super) fn parameters() -> anyhow::Result<String> {
    Ok(serde_json::to_string(&ReconstructParams::default())?)
}
