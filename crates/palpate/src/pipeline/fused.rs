use super::reconstruct::{Reconstruction, Stages, Warning, felt_cloud, mesh_warnings};
use super::trust::{Settled, settle};
use super::uncertainty::{Guesses, vertex_knowledge};
use super::{ReconstructError, ReconstructParams, Surface, VertexKnowledge, WeightParams, color, stages as step};
use crate::camera::{Visible, segment_object};
use crate::completion::{MovedEvidence, move_evidence};
use crate::evidence::{Evidence, Sample};
use crate::geometry::{PointCloud, TriangleMesh};
use crate::scene::Scene;
use crate::surface::{
    ImplicitField, ImplicitProblem, SurfaceError, WeightedSample, ball_pivoting, screened_poisson, solve_implicit,
};
use crate::tactile::Patch;

/// What a further touch starts from.
pub(super) struct Kept {
    pub(super) visible: Visible,
    pub(super) evidence: Evidence,
    /// Of the touches in use, in the order in which the evidence counts them.
    pub(super) patches: Vec<Patch>,
    pub(super) moved: MovedEvidence,
    pub(super) guesses: Guesses,
    pub(super) measured: Vec<WeightedSample>,
    /// `None` for another surface than the implicit one.
    pub(super) field: Option<ImplicitField>,
}

/// Our method: everything known, weighted by what it is worth, in one implicit function (method.md §3–5).
pub(super) fn reconstruct(
    scene: &Scene,
    params: &ReconstructParams,
    stages: &Stages,
) -> Result<(Reconstruction, Kept), ReconstructError> {
    let mut warnings = Vec::new();

    // See: the object's visible side, and the space that is free.
    stages.begin("see");
    let visible = segment_object(&scene.frame, &params.segment)?;
    warnings.extend(super::reconstruct::cut_by_border(&visible));
    warnings.extend(visible.support.is_none().then_some(Warning::NoSupport));

    // Feel: each contact becomes a small oriented patch.
    stages.begin("feel");
    let patches = step::feel(scene, params, stages, &mut warnings)?;
    stages.begin("evidence");
    let (evidence, patches) = step::gather(scene, &visible, patches, params, &mut warnings)?;

    // Guess: moves of the object that all the evidence agrees with; none is an answer. Touches are on trial meanwhile: poses refined,
    // wrong ones left out.
    stages.begin("symmetry");
    let Settled { evidence, patches, touches, symmetry } =
        settle(scene, &visible, evidence, patches, params, stages, &mut warnings)?;
    stages.begin("move");
    let moved = move_evidence(&evidence, &symmetry, &params.moving());

    // Fuse and mesh: one function, weighted by what each sample is worth.
    stages.begin("fuse");
    let measured: Vec<WeightedSample> = evidence.measured.iter().map(|s| weighted(s, &params.weight)).collect();
    let guessed = guessed_samples(&moved, params.orbit.orientation);
    let (mut mesh, field) = match params.surface() {
        Surface::Implicit => {
            let field =
                with_problem(&evidence, &measured, &guessed, |problem| solve_implicit(problem, &params.implicit));
            stages.begin("extract");
            (field.extract(), Some(field))
        }
        other => (point_mesh(&measured, &guessed, other, params)?, None),
    };

    if mesh.is_empty() {
        let reason = "the implicit function is nowhere negative".into();
        return Err(SurfaceError::NoSurface { points: measured.len(), reason }.into());
    }
    warnings.extend(mesh_warnings(&mesh));

    // Doubt: how sure each vertex is, and of what kind.
    stages.begin("doubt");
    let guesses = Guesses::new(&evidence, &symmetry, &moved, params.orbit.arc);
    let knowledge = params.uncertainty.then(|| vertex_knowledge(&mesh, &evidence, &guesses));
    warnings.extend(knowledge.as_ref().and_then(VertexKnowledge::warning));
    mesh.colors = color::paint(&mesh, params.color, knowledge.as_ref(), &scene.frame, &visible, &guesses);
    warnings.extend(color::missing(params.color, &mesh, &scene.frame).map(|reason| Warning::NotColored { reason }));
    let visible_cloud = visible.cloud(&scene.frame);
    let result = Reconstruction {
        mesh,
        visible: visible_cloud,
        felt: felt_cloud(&patches),
        moved: sample_cloud(&moved.kept),
        removed: sample_cloud(&moved.contradicted),
        joined: weighted_cloud(measured.iter().chain(&guessed)),
        symmetry,
        touches_used: touches.len(),
        touches,
        knowledge,
        warnings,
    };
    Ok((result, Kept { visible, evidence, patches, moved, guesses, measured, field }))
}

pub(super) fn weighted(sample: &Sample, params: &WeightParams) -> WeightedSample {
    let weight = params.of(sample.sigma);
    WeightedSample { position: sample.position, normal: sample.normal, weight, orientation: weight }
}

pub(super) fn guessed_samples(moved: &MovedEvidence, orientation: f64) -> Vec<WeightedSample> {
    let sample = |(s, &weight): (&Sample, &f64)| WeightedSample {
        position: s.position,
        normal: s.normal,
        weight,
        orientation: weight * orientation,
    };
    let far = moved.far_sides.iter().zip(&moved.far_weights);
    moved.kept.iter().zip(&moved.weights).chain(far).map(sample).collect()
}

/// Poses the fusion's problem to `solve`.
pub(super) fn with_problem<T>(
    evidence: &Evidence,
    measured: &[WeightedSample],
    guessed: &[WeightedSample],
    solve: impl FnOnce(&ImplicitProblem) -> T,
) -> T {
    let free = &evidence.free_space;
    solve(&ImplicitProblem {
        measured,
        guessed,
        bounds: evidence.bounds.inflated(12e-3),
        free: &|p| free.signed_distance(p),
        free_fine: &|p| free.clearance_with_pads(p),
    })
}

/// The same evidence meshed by a method that knows nothing of free space.
fn point_mesh(
    measured: &[WeightedSample],
    guessed: &[WeightedSample],
    surface: Surface,
    params: &ReconstructParams,
) -> Result<TriangleMesh, ReconstructError> {
    let cloud = weighted_cloud(measured.iter().chain(guessed));
    let weights: Vec<f64> = measured.iter().chain(guessed).map(|s| s.weight).collect();
    Ok(match surface {
        Surface::BallPivoting => ball_pivoting(&cloud, &params.paper.ball_pivoting)?,
        _ => screened_poisson(&cloud, Some(&weights), &params.paper.poisson)?.mesh,
    })
}

pub(super) fn sample_cloud(samples: &[Sample]) -> PointCloud {
    let points = samples.iter().map(|s| s.position).collect();
    PointCloud { points, normals: Some(samples.iter().map(|s| s.normal).collect()), colors: None }
}

pub(super) fn weighted_cloud<'a>(samples: impl Iterator<Item = &'a WeightedSample>) -> PointCloud {
    let (points, normals) = samples.map(|s| (s.position, s.normal)).unzip();
    PointCloud { points, normals: Some(normals), colors: None }
}
