//! Touches on trial: poses refined, wrong touches left out, before anything is fused.

use super::reconstruct::{SettledTouch, Stages, Warning};
use super::{ReconstructError, ReconstructParams};
use crate::camera::Visible;
use crate::completion::{Copying, GuessSigma, RefinedTouch, copying_radius, copyings, objections, refine_touches};
use crate::evidence::Evidence;
use crate::scene::{PoseSigma, Scene};
use crate::symmetry::Symmetry;
use crate::tactile::Patch;
use nalgebra::{Matrix6, Vector6};

/// What remains after the trial.
pub(super) struct Settled {
    pub(super) evidence: Evidence,
    pub(super) patches: Vec<Patch>,
    pub(super) touches: Vec<SettledTouch>,
    pub(super) symmetry: Symmetry,
}

/// Refines the touches' poses if their σ is stated, leaves out those that cannot be where they say, and estimates the symmetry.
///
/// With exact poses and no wrong touch the evidence is returned as it came.
pub(super) fn settle(
    scene: &Scene,
    visible: &Visible,
    evidence: Evidence,
    patches: Vec<(usize, Patch)>,
    params: &ReconstructParams,
    stages: &Stages,
    warnings: &mut Vec<Warning>,
) -> Result<Settled, ReconstructError> {
    let stated = stated_sigma(scene, params);
    let uncertain = is_uncertain(&stated);
    let mut trial = Trial { evidence, covariances: vec![covariance(&stated); patches.len()], patches };
    let mut symmetry = stages.estimator().estimate(&trial.evidence);
    if trial.patches.is_empty() {
        return Ok(trial.settled(symmetry));
    }
    // What the camera and the other touches rule out goes first: one wrong touch can cost a right symmetry.
    if params.touches.judge && trial.judge(&symmetry, params, warnings) {
        trial.gather(scene, visible, params)?;
        symmetry = stages.estimator().estimate(&trial.evidence);
    }
    if params.touches.refine && uncertain {
        trial.refine(&symmetry, &stated, params);
        trial.gather(scene, visible, params)?;
        symmetry = stages.estimator().estimate(&trial.evidence);
        // Known better now, a touch can be told wrong by less.
        if params.touches.judge && trial.judge(&symmetry, params, warnings) {
            trial.gather(scene, visible, params)?;
            symmetry = stages.estimator().estimate(&trial.evidence);
        }
    }
    Ok(trial.settled(symmetry))
}

struct Trial {
    evidence: Evidence,
    patches: Vec<(usize, Patch)>,
    covariances: Vec<Matrix6<f64>>,
}

impl Trial {
    fn settled(self, symmetry: Symmetry) -> Settled {
        let settled = |((touch, patch), covariance): (&(usize, Patch), &Matrix6<f64>)| SettledTouch {
            touch: *touch,
            world_from_sensor: patch.world_from_sensor,
            covariance: *covariance,
        };
        let touches = self.patches.iter().zip(&self.covariances).map(settled).collect();
        Settled { evidence: self.evidence, patches: self.patches.into_iter().map(|p| p.1).collect(), touches, symmetry }
    }

    fn bare(&self) -> Vec<Patch> {
        self.patches.iter().map(|(_, p)| p.clone()).collect()
    }

    fn copies(&self, symmetry: &Symmetry, params: &ReconstructParams) -> (Vec<Copying>, GuessSigma) {
        let radius = copying_radius(&self.evidence, symmetry);
        let copies = copyings(symmetry, radius, params.orbit.arc);
        let sigma = GuessSigma::new(&self.evidence, symmetry, &copies, radius, params.orbit.arc);
        (copies, sigma)
    }

    /// Leaves out the touches that something objects to; whether there were any.
    fn judge(&mut self, symmetry: &Symmetry, params: &ReconstructParams, warnings: &mut Vec<Warning>) -> bool {
        let (copies, sigma) = self.copies(symmetry, params);
        let widths: Vec<PoseSigma> = self.covariances.iter().map(width).collect();
        let found = objections(&self.evidence, &self.bare(), (&copies, &sigma), &widths, &params.touches.check);
        let kept: Vec<bool> = found.iter().map(Option::is_none).collect();
        for ((touch, _), objection) in self.patches.iter().zip(&found) {
            if let Some(objection) = objection {
                warnings.push(Warning::TouchLeftOut { touch: *touch, reason: objection.to_string() });
            }
        }
        let all = kept.iter().all(|k| *k);
        let mut keep = kept.iter();
        self.patches.retain(|_| keep.next().copied().unwrap_or(true));
        let mut keep = kept.iter();
        self.covariances.retain(|_| keep.next().copied().unwrap_or(true));
        !all
    }

    fn refine(&mut self, symmetry: &Symmetry, stated: &PoseSigma, params: &ReconstructParams) {
        let (copies, sigma) = self.copies(symmetry, params);
        let refined = refine_touches(&self.evidence, &self.bare(), (&copies, &sigma), stated, &params.touches.pose);
        for (i, RefinedTouch { patch, covariance, .. }) in refined.into_iter().enumerate() {
            self.patches[i].1 = patch;
            self.covariances[i] = covariance;
        }
    }

    fn gather(&mut self, scene: &Scene, visible: &Visible, params: &ReconstructParams) -> Result<(), ReconstructError> {
        let frame = &scene.frame;
        self.evidence = Evidence::gather_posed(frame, visible, &self.bare(), &self.covariances, &params.evidence)?;
        Ok(())
    }
}

/// What the scene or the parameters say of the poses, whichever is more.
pub(super) fn stated_sigma(scene: &Scene, params: &ReconstructParams) -> PoseSigma {
    PoseSigma {
        translation: scene.pose_sigma.translation.max(params.evidence.pose_sigma_translation),
        rotation: scene.pose_sigma.rotation.max(params.evidence.pose_sigma_rotation),
    }
}

pub(super) fn is_uncertain(sigma: &PoseSigma) -> bool {
    sigma.translation > 0.0 || sigma.rotation > 0.0
}

pub(super) fn covariance(sigma: &PoseSigma) -> Matrix6<f64> {
    let (r, t) = (sigma.rotation.powi(2), sigma.translation.powi(2));
    Matrix6::from_diagonal(&Vector6::new(r, r, r, t, t, t))
}

/// σ of a pose along the press, and of its tilt.
pub(super) fn width(covariance: &Matrix6<f64>) -> PoseSigma {
    let of = |i: usize| covariance[(i, i)].max(0.0);
    PoseSigma { translation: of(5).sqrt(), rotation: of(0).max(of(1)).sqrt() }
}
