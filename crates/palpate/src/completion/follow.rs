use super::copies::{copy_of, corrected};
use super::motion::families;
use super::orbit::{Covered, MovedEvidence, OrbitParams, in_free_space, leaves_orbit};
use crate::evidence::{Evidence, Provenance, Sample};
use crate::geometry::Aabb;
use rayon::prelude::*;

/// What more evidence did to the guesses.
#[derive(Debug, Clone, Default)]
pub struct MovedChange {
    /// Guesses that a new measurement replaces or rules out.
    pub dropped: Vec<Sample>,
    /// The guesses from this one on are new.
    pub added: usize,
}

impl MovedEvidence {
    /// Follows `evidence.samples[from..]`, which came later: moves them by the motions that are there, and drops the guesses that they
    /// replace or rule out.
    ///
    /// The rules are those of [`super::move_evidence`]; the motions stay as they are. O(new samples · (samples + motions · log samples) + guesses).
    pub fn follow(&mut self, evidence: &Evidence, from: usize, params: &OrbitParams) -> MovedChange {
        let (known, new) = evidence.samples.split_at(from);
        let families = families(&self.copyings);
        let known_near: Vec<&Sample> = near(known, new, params.orbit_radius);
        // Per family: the places of new samples that are not part of the orbit, and of known ones beside new ones.
        let outcasts: Vec<[Vec<&Sample>; 2]> = families
            .par_iter()
            .map(|members| {
                let bad = |s: &&Sample| leaves_orbit(evidence, members, &s.position, params);
                [new.iter().filter(bad).collect(), known_near.iter().copied().filter(bad).collect()]
            })
            .collect();
        let dropped = self.drop_contradicted(new, &outcasts, params);
        let added = self.kept.len();
        let covered = Covered::new(&evidence.samples, params);
        let per_motion: Vec<[Vec<Sample>; 2]> = self
            .copyings
            .par_iter()
            .enumerate()
            .map(|(m, copying)| {
                let out = &outcasts[copying.family as usize];
                let correction = &self.corrections[copying.family as usize];
                let (mut kept, mut contradicted) = (Vec::new(), Vec::new());
                for sample in new {
                    let moved = corrected(copy_of(sample, copying, m as u32), correction);
                    let beside = out.iter().flatten().any(|o| close(o, sample, params.orbit_radius));
                    if beside || in_free_space(evidence, &moved.position, params) {
                        contradicted.push(moved);
                    } else if !covered.holds(&moved.position, &moved.normal) {
                        kept.push(moved);
                    }
                }
                [kept, contradicted]
            })
            .collect();
        for (copying, [kept, contradicted]) in self.copyings.iter().zip(per_motion) {
            self.weights.extend(std::iter::repeat_n(params.weight_of(copying), kept.len()));
            self.kept.extend(kept);
            self.contradicted.extend(contradicted);
        }
        MovedChange { dropped, added }
    }

    /// Takes out the guesses that a new sample of agreeing normal replaces, and the copies of samples beside a new outcast.
    fn drop_contradicted(
        &mut self,
        new: &[Sample],
        outcasts: &[[Vec<&Sample>; 2]],
        params: &OrbitParams,
    ) -> Vec<Sample> {
        let Some(bounds) = Aabb::of(new.iter().map(|s| &s.position)) else { return Vec::new() };
        let bounds = bounds.inflated(params.measured_radius);
        let replaced = |s: &Sample| {
            bounds.contains(&s.position)
                && new.iter().any(|n| params.replaces(n, (n.position - s.position).norm(), &s.normal))
        };
        let (copyings, corrections) = (&self.copyings, &self.corrections);
        let ruled_out = |s: &Sample| {
            let Provenance::Moved { motion } = s.provenance else { return false };
            let copying = &copyings[motion as usize];
            let [bad, _] = &outcasts[copying.family as usize];
            !bad.is_empty() && {
                // Where the copy lay before it was corrected: corrections hardly change over their own length.
                let shift = corrections[copying.family as usize].shift(&(s.position, s.normal));
                let source = copying.motion.inverse().point(&(s.position - s.normal * shift));
                bad.iter().any(|b| (b.position - source).norm() < params.orbit_radius)
            }
        };
        let gone = |s: &Sample| replaced(s) || ruled_out(s);
        let dropped = drop_where(&mut self.kept, &mut self.weights, gone);
        [dropped, drop_where(&mut self.far_sides, &mut self.far_weights, gone)].concat()
    }
}

/// Takes out the samples that are gone, with their weights.
fn drop_where(
    samples: &mut Vec<Sample>,
    weights: &mut Vec<f64>,
    gone: impl Fn(&Sample) -> bool + Send + Sync,
) -> Vec<Sample> {
    let out: Vec<bool> = samples.par_iter().map(gone).collect();
    let dropped = samples.iter().zip(&out).filter(|(_, out)| **out).map(|(s, _)| *s).collect();
    let mut gone = out.iter();
    samples.retain(|_| !gone.next().copied().unwrap_or(false));
    let mut gone = out.iter();
    weights.retain(|_| !gone.next().copied().unwrap_or(false));
    dropped
}

fn close(a: &Sample, b: &Sample, radius: f64) -> bool {
    (a.position - b.position).norm_squared() < radius * radius
}

/// The known samples within `radius` of a new one.
fn near<'a>(known: &'a [Sample], new: &[Sample], radius: f64) -> Vec<&'a Sample> {
    let Some(bounds) = Aabb::of(new.iter().map(|s| &s.position)) else { return Vec::new() };
    let bounds = bounds.inflated(radius);
    known.iter().filter(|k| bounds.contains(&k.position) && new.iter().any(|n| close(k, n, radius))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::completion::move_evidence;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::geometry::{Plane, Point, Vector};
    use crate::symmetry::{Hypothesis, Score, Symmetry, SymmetryElement};
    use nalgebra::Matrix6;

    #[test]
    fn what_follows_agrees_with_moving_all_at_once() {
        let middle = Point::new(0.0, 0.0, 0.03);
        let solids = [Solid::Box(middle, Vector::new(0.04, 0.025, 0.03), 0.0)];
        let (frame, visible) = view(&solids, 0.0005);
        let plane = |n: Vector| Hypothesis {
            element: SymmetryElement::Reflection(Plane::new(n, &middle).expect("it has a direction")),
            score: Score { support: 1.0, informative: 0.5, ..Score::default() },
            confidence: 1.0,
            covariance: None,
            rejection: None,
        };
        let symmetry = Symmetry { accepted: vec![plane(Vector::x()), plane(Vector::y())], rejected: Vec::new() };
        // One touch on the hidden side, where there are guesses, and one that stands off a face: its copies float in the open.
        let stray = [Solid::Box(middle, Vector::new(0.04, 0.025, 0.045), 0.0)];
        let patches = [
            touch(&solids, Point::new(-0.2, 0.0, 0.03), middle),
            touch(&stray, Point::new(-0.02, 0.0, 0.2), Point::new(-0.02, 0.0, 0.03)),
        ];
        let (params, orbit) = (EvidenceParams::default(), OrbitParams::default());
        let mut evidence = Evidence::gather(&frame, &visible, &[], &params).expect("seen");
        let mut moved = move_evidence(&evidence, &symmetry, &orbit);
        let before = moved.kept.len();
        for (i, patch) in patches.iter().enumerate() {
            let [from, _] = evidence.add_touch(patch, i as u32, &Matrix6::zeros(), &params);
            let change = moved.follow(&evidence, from, &orbit);
            assert_eq!(moved.kept.len(), moved.weights.len());
            assert!(
                i > 0 || (change.dropped.len() > 10 && change.added == before - change.dropped.len()),
                "{change:?}"
            );
        }
        let whole = move_evidence(&evidence, &symmetry, &orbit);
        let place = |s: &Sample| s.position.coords.map(|c| (c * 1e9).round() as i64);
        let sorted = |m: &MovedEvidence| {
            let mut all: Vec<[i64; 3]> = m.kept.iter().map(|s| place(s).into()).collect();
            all.sort_unstable();
            all
        };
        let (a, b) = (sorted(&moved), sorted(&whole));
        let only = |a: &[[i64; 3]], b: &[[i64; 3]]| a.iter().filter(|p| b.binary_search(p).is_err()).count();
        let differ = only(&a, &b) + only(&b, &a);
        assert!(differ * 50 < b.len(), "{differ} of {} guesses differ", b.len());
        assert!(moved.contradicted.len() > 10, "copies in the open are contradicted");
    }
}
