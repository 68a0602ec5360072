use super::guess_sigma::GuessSigma;
use super::motion::Copying;
use super::touch_pose::{Fit, Others, Placed, RefinedTouch, TouchPoseParams, fit, precision};
use crate::evidence::Evidence;
use crate::scene::PoseSigma;
use crate::tactile::Patch;
use nalgebra::Matrix6;

/// [`super::refine_touches`] for one touch that comes last: the others stay where they are.
///
/// * `evidence` – of the camera and the other touches
/// * `known` – those touches, and the covariances of their poses
/// * `sigma` – of the new touch's stated pose
///
/// O(rounds · points · touches · copies).
pub fn refine_touch(
    evidence: &Evidence,
    known: (&[Patch], &[Matrix6<f64>]),
    touch: &Patch,
    copies: (&[Copying], &GuessSigma),
    sigma: &PoseSigma,
    params: &TouchPoseParams,
) -> RefinedTouch {
    let prior = precision(sigma);
    let others = Others::new(evidence, known.0, copies);
    let mut placed: Vec<Placed> = known
        .0
        .iter()
        .zip(known.1)
        .enumerate()
        .map(|(i, (patch, covariance))| others.place(i, patch, &Fit::stated(covariance)))
        .collect();
    let number = placed.len();
    placed.push(Placed::nothing());
    let mut last = Fit::stated(&Matrix6::from_diagonal(&prior.map(|p| 1.0 / p)));
    for _ in 0..params.rounds {
        last = fit(number, touch, &last, &others, &placed, &prior, params);
    }
    last.finished(touch, &prior)
}
