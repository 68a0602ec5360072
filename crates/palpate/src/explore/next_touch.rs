use super::{Belief, Candidate, EvidenceDistance, ExploreError, Gain, NextTouchParams, Planner};
use crate::geometry::{Isometry, Point};
use crate::pipeline::{Stages, reconstruct, with_contacts};
use crate::scene::Scene;

/// A touch worth making.
#[derive(Debug, Clone)]
pub struct NextTouch {
    /// Where, and how the surface is expected to lie there.
    pub candidate: Candidate,
    /// What it is expected to give, after the better ones of the list.
    pub gain: Gain,
    /// Distance of the aimed point from the nearest seen or felt point, metres.
    pub from_measured: f64,
    /// σ there by distance from what was measured alone, metres.
    pub local_sigma: f64,
}

impl NextTouch {
    /// Expected pose of the sensor frame when pressed.
    pub fn world_from_sensor(&self) -> &Isometry {
        &self.candidate.world_from_sensor
    }

    /// Why this one, in a line.
    pub fn why(&self) -> String {
        let mm = |x: f64| 1e3 * x;
        let far = format!("{:.0} mm from anything measured", mm(self.from_measured));
        if self.gain.disagreement > self.local_sigma {
            format!("hypotheses differ by {:.1} mm here; {far}", mm(self.gain.disagreement))
        } else {
            format!("{far}, σ {:.1} mm", mm(self.gain.sigma))
        }
    }
}

/// Proposes up to `params.count` touches of an object, the best first, each next one on the assumption that the earlier are made.
///
/// Reconstructs the scene with `params.reconstruct`, believes ([`Belief`]), draws reachable poses ([`Planner::candidates`]) and ranks
/// them ([`rank`]). Gains are positive and fall along the list; a touch that is expected to give nothing is not proposed.
///
/// # Errors
/// [`ExploreError`] if a parameter is out of range, no support plane is known, the object cannot be reconstructed, or no pose is reachable.
pub fn next_touches(scene: &Scene, params: &NextTouchParams, stages: &Stages) -> Result<Vec<NextTouch>, ExploreError> {
    let planner = Planner::new(scene, params)?;
    // Decoded once: every hypothesis is solved on the same touches.
    let scene = &with_contacts(scene, params.reconstruct.max_touches.unwrap_or(usize::MAX), stages.decoder)?;
    let current = reconstruct(scene, &params.reconstruct, stages)?;
    let uncertainty = EvidenceDistance::new(&current, &params.belief);
    let belief = Belief::new(scene, &current, &params.reconstruct, &params.belief, &uncertainty)?;
    let candidates = planner.candidates(&current.mesh, params.candidates, params.seed, &[])?;
    let mut measured = current.visible.points;
    measured.extend(current.felt.points);
    Ok(rank(belief, candidates, params.count, &measured))
}

/// The best `count` of the candidates in greedy order; of equals the first.
///
/// * `measured` – seen and felt points, world frame, for the reasons
pub fn rank(mut belief: Belief, mut candidates: Vec<Candidate>, count: usize, measured: &[Point]) -> Vec<NextTouch> {
    let mut chosen = Vec::new();
    while chosen.len() < count {
        let gains: Vec<Gain> = candidates.iter().map(|c| belief.gain(&c.footprint, &c.normal)).collect();
        let better = |&a: &usize, &b: &usize| gains[a].mean_distance.total_cmp(&gains[b].mean_distance).then(b.cmp(&a));
        let Some(best) = (0..gains.len()).max_by(better).filter(|&i| gains[i].mean_distance > 0.0) else { break };
        let candidate = candidates.swap_remove(best);
        let squared = measured.iter().map(|m| (m - candidate.point).norm_squared()).fold(f64::INFINITY, f64::min);
        let local_sigma = belief.local_sigma(&candidate.point);
        belief.condition(&candidate.footprint, &candidate.normal);
        chosen.push(NextTouch { candidate, gain: gains[best], from_measured: squared.sqrt(), local_sigma });
    }
    chosen
}
