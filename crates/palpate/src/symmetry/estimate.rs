use super::accept::{confidence, give_way, judge, resolve_conflicts};
use super::axes::{Line, normal_line_center, same_line, search_axes};
use super::element::SymmetryElement;
use super::params::SymmetryParams;
use super::planes::{across_best, same, search_offsets, search_planes};
use super::refine::{covariance, refine, refine_near, refine_offset, refine_roughly};
use super::resting::resting_plane;
use super::score::{Score, Scorer, Tolerances};
use crate::evidence::Evidence;
use crate::geometry::{Plane, Point, Vector};
use nalgebra::{DMatrix, Unit};
use rayon::prelude::*;

/// Opposition per informative support, with the wide tolerances of the search, beyond which no axis has become acceptable when refined: of
/// those that did (30 YCB objects, two views, 0 and 20 touches) the worst had 0.27.
const HOPELESS: f64 = 0.5;

/// Guesses the symmetry of a partly seen object.
pub trait SymmetryEstimator: Sync {
    /// Hypotheses for the evidence, accepted and rejected. Accepting none is an answer.
    fn estimate(&self, evidence: &Evidence) -> Symmetry;
}

/// What was found.
#[derive(Debug, Clone, Default)]
pub struct Symmetry {
    /// What the evidence accepts, in the order of use: the axis to revolve about if there is one, then planes, then spheres. At most one axis
    /// and [`SymmetryParams::planes`] planes.
    pub accepted: Vec<Hypothesis>,
    /// What was refined and then dropped, best first.
    pub rejected: Vec<Hypothesis>,
}

impl Symmetry {
    /// The accepted planes, in the order of use.
    pub fn planes(&self) -> impl Iterator<Item = &Plane> {
        self.accepted
            .iter()
            .filter_map(|h| if let SymmetryElement::Reflection(p) = &h.element { Some(p) } else { None })
    }
}

/// Why a hypothesis was dropped.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Rejection {
    /// Hardly anything lands on a measured surface.
    LittleSupport {
        /// Informative support needed.
        needed: f64,
    },
    /// Too much lands in free space or beside the surface.
    Opposed {
        /// Violation and contradiction allowed for its support.
        allowed: f64,
    },
    /// Touches contradict it, however well the seen side agrees.
    Felt {
        /// Violation and contradiction allowed of the felt samples.
        allowed: f64,
    },
    /// Too much of the object leaves the body of revolution.
    Misfits {
        /// Share of the samples that does.
        share: f64,
    },
    /// It disagrees with a better plane.
    Conflict {
        /// That plane.
        with: Plane,
    },
    /// It would turn a vessel upside down: much of the object looks at the object, and a vessel is open above and closed below.
    Vessel {
        /// Share of the samples that look at the object.
        share: f64,
    },
    /// It neither holds the accepted axis of revolution nor cuts it at a right angle.
    AgainstAxis,
    /// The object would float above its support, or sink into it.
    Floats {
        /// By this much, metres.
        height: f64,
    },
    /// It adds nothing to the accepted ones.
    Redundant,
}

/// A possible symmetry and what the evidence says of it.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// What maps the object onto itself.
    pub element: SymmetryElement,
    /// Means over the moved evidence.
    pub score: Score,
    /// 0–1.
    pub confidence: f64,
    /// Of the element's parameters at the evidence's centroid: plane 3×3 (turn about u, about v, shift along the normal), axis 4×4 (turn about u,
    /// about v, shift along u, along v), sphere 3×3 (centre); radians and metres. `None` where support leaves a parameter undetermined.
    pub covariance: Option<DMatrix<f64>>,
    /// `None` = accepted.
    pub rejection: Option<Rejection>,
}

/// The default estimator: searches planes, axes and spheres on the evidence itself.
#[derive(Debug, Clone, Copy, Default)]
pub struct EvidenceSearch {
    /// Search and acceptance.
    pub params: SymmetryParams,
}

impl SymmetryEstimator for EvidenceSearch {
    fn estimate(&self, evidence: &Evidence) -> Symmetry {
        let scorer = Scorer::new(evidence, &self.params);
        let candidates = search_planes(&scorer);
        let planes = refined_planes(&scorer, &candidates);
        let planes = distinct_refined(&scorer, across_best(&scorer, &planes).into_iter().chain(planes).collect());
        let best: Vec<Plane> = planes.iter().take(5).map(|p| p.0).collect();
        let lines = search_axes(&scorer, &best);
        let (mut axes, sphere) = rayon::join(
            || lines.par_iter().map(|line| refined_axis(&scorer, line)).collect::<Vec<Hypothesis>>(),
            || sphere(&scorer),
        );
        if let Some((_, axis)) = &sphere {
            // The axis that shows most of the hidden side, not the one that scores best.
            axes.insert(0, axis.clone());
        } else {
            axes.sort_by(|a, b| usefulness(b).total_cmp(&usefulness(a)));
        }
        let mut hypotheses: Vec<Hypothesis> =
            planes.par_iter().map(|(p, s)| hypothesis(&scorer, SymmetryElement::Reflection(*p), *s)).collect();
        for axis in &mut axes {
            give_way(axis, &hypotheses);
        }
        let mut symmetry = Symmetry::default();
        let direction = pick_axis(&scorer, axes, &mut symmetry);
        hypotheses.extend(direction.and_then(|d| plane_across(&scorer, &d)));
        let resting = resting_plane(&scorer, direction.as_ref());
        for h in resolve_conflicts(&scorer, hypotheses, resting, direction.as_ref()) {
            if h.rejection.is_none() { &mut symmetry.accepted } else { &mut symmetry.rejected }.push(h);
        }
        symmetry.accepted.extend(sphere.map(|s| s.0));
        symmetry.rejected.sort_by(|a, b| b.score.value().total_cmp(&a.score.value()));
        symmetry
    }
}

/// Accepts the first acceptable axis; the others are rejected. Returns its direction.
fn pick_axis(scorer: &Scorer, axes: Vec<Hypothesis>, symmetry: &mut Symmetry) -> Option<Vector> {
    let mut direction = None;
    let mut lines = Vec::new();
    for mut h in axes {
        let SymmetryElement::Axis { point, direction: d, .. } = h.element else { continue };
        if lines.iter().any(|l| same_line(l, &(point, d), &scorer.centroid)) {
            continue;
        }
        lines.push((point, d));
        if h.rejection.is_none() && direction.is_some() {
            h.rejection = Some(Rejection::Redundant);
        }
        if h.rejection.is_none() {
            direction = Some(d.into_inner());
            symmetry.accepted.push(h);
        } else {
            symmetry.rejected.push(h);
        }
    }
    direction
}

/// What an element is worth: support, and unknown space to fill. One that maps the visible side onto itself scores high and adds nothing.
fn usefulness(h: &Hypothesis) -> f64 {
    h.score.value() * (h.score.neutral + 0.02)
}

/// An axis refined; one that is opposed beyond hope when it is known to a degree is left there, rejected.
fn refined_axis(scorer: &Scorer, &(point, direction): &Line) -> Hypothesis {
    let (rough, score) = refine_roughly(scorer, &SymmetryElement::Axis { point, direction, order: None });
    if score.opposition() > HOPELESS * score.informative + scorer.params.slack {
        let score = scorer.score(&rough, &Tolerances::fine(scorer.params), scorer.params.refine_samples);
        let hypothesis = hypothesis(scorer, rough, score);
        if hypothesis.rejection.is_some() {
            return hypothesis;
        }
    }
    let (element, score) = refine_near(scorer, &rough);
    hypothesis(scorer, element, score)
}

/// Planes refined, best first. What comes to the same place is refined to the end once.
fn refined_planes(scorer: &Scorer, candidates: &[Plane]) -> Vec<(Plane, Score)> {
    let each = |planes: Vec<Plane>, step: fn(&Scorer, &SymmetryElement) -> (SymmetryElement, Score)| {
        let refined = planes.par_iter().filter_map(|plane| match step(scorer, &SymmetryElement::Reflection(*plane)) {
            (SymmetryElement::Reflection(plane), score) => Some((plane, score)),
            _ => None,
        });
        distinct_refined(scorer, refined.collect())
    };
    let rough = each(candidates.to_vec(), refine_roughly);
    each(rough.into_iter().map(|r| r.0).collect(), refine_near)
}

/// Best first, without those that refinement brought to the same place.
fn distinct_refined(scorer: &Scorer, mut refined: Vec<(Plane, Score)>) -> Vec<(Plane, Score)> {
    refined.sort_by(|a, b| b.1.value().total_cmp(&a.1.value()));
    let mut kept: Vec<(Plane, Score)> = Vec::new();
    for r in refined {
        if kept.iter().all(|k| !same(&k.0, &r.0, &scorer.centroid, 0.999, 0.002)) {
            kept.push(r);
        }
    }
    kept
}

pub(super) fn hypothesis(scorer: &Scorer, element: SymmetryElement, score: Score) -> Hypothesis {
    let params = scorer.params;
    let rejection = judge(scorer, &element, &score);
    let covariance = if rejection.is_none() { covariance(scorer, &element) } else { None };
    Hypothesis { element, score, confidence: confidence(&element, &score, params), covariance, rejection }
}

/// The sphere hypothesis and the axis it lends, if the two axes through its centre across the view are both acceptable.
fn sphere(scorer: &Scorer) -> Option<(Hypothesis, Hypothesis)> {
    let center = normal_line_center(scorer)?;
    let (element, score) = refine(scorer, &SymmetryElement::Sphere { center });
    let SymmetryElement::Sphere { center } = element else { return None };
    let sphere = hypothesis(scorer, element, score);
    let view = (center - scorer.evidence.camera_center).try_normalize(1e-9)?;
    let first = Unit::try_new(scorer.evidence.up().cross(&view), 1e-3).unwrap_or_else(|| across(&view));
    let second = Unit::new_normalize(view.cross(&first));
    let axis = |center: Point, direction: Unit<Vector>| {
        let element = SymmetryElement::Axis { point: center, direction, order: None };
        let score = scorer.score(&element, &Tolerances::fine(scorer.params), scorer.params.refine_samples);
        hypothesis(scorer, element, score)
    };
    let axes = [axis(center, first), axis(center, second)];
    let accepted = sphere.rejection.is_none() && axes.iter().all(|h| h.rejection.is_none());
    let [a, b] = axes;
    accepted.then(|| if b.score.value() > a.score.value() { (sphere.clone(), b) } else { (sphere, a) })
}

/// The best plane perpendicular to an accepted axis: the search, which knows nothing of the axis, may have refined it away.
fn plane_across(scorer: &Scorer, axis: &Vector) -> Option<Hypothesis> {
    let plane = search_offsets(scorer, axis)?;
    let fine = Tolerances::fine(scorer.params);
    let (element, score) = refine_offset(scorer, &plane, &fine);
    Some(hypothesis(scorer, element, score))
}

fn across(view: &Vector) -> Unit<Vector> {
    Unit::new_unchecked(super::element::tangents(view).0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::EvidenceParams;
    use crate::evidence::testing::{Solid, touch, view};
    use crate::tactile::Patch;

    fn evidence(solids: &[Solid], patches: &[Patch]) -> Evidence {
        let (frame, visible) = view(solids, 0.001);
        Evidence::gather(&frame, &visible, patches, &EvidenceParams::default()).expect("the solid is seen")
    }

    fn estimate(solids: &[Solid], patches: &[Patch]) -> Symmetry {
        EvidenceSearch::default().estimate(&evidence(solids, patches))
    }

    /// Angle (degrees) and offset at `at` (metres) of the accepted plane nearest to the one through `at` with normal `n`.
    fn nearest(symmetry: &Symmetry, n: Vector, at: &Point) -> (f64, f64) {
        let error = |p: &Plane| (p.normal.dot(&n).abs().min(1.0).acos().to_degrees(), p.signed_distance(at).abs());
        symmetry.planes().map(error).min_by(|a, b| a.0.total_cmp(&b.0)).expect("some plane is accepted")
    }

    #[test]
    fn a_box_has_its_planes() {
        let center = Point::new(0.0, 0.0, 0.03);
        let solids = [Solid::Box(center, Vector::new(0.045, 0.025, 0.03), 0.8)];
        let symmetry = estimate(&solids, &[]);
        let right = [Vector::new(0.8_f64.cos(), 0.8_f64.sin(), 0.0), Vector::new(-(0.8_f64.sin()), 0.8_f64.cos(), 0.0)];
        for n in right {
            let (angle, offset) = nearest(&symmetry, n, &center);
            assert!(angle < 2.0 && offset < 0.002, "normal {n}: off by {angle}°, {offset} m");
        }
        for plane in symmetry.planes() {
            let angle = right.iter().chain(&[Vector::z()]).map(|n| plane.normal.dot(n).abs()).fold(0.0, f64::max);
            assert!(angle > 0.998, "a wrong plane is accepted: {plane:?}");
        }
    }

    #[test]
    fn a_cylinder_has_its_axis_and_a_covariance() {
        let center = Point::new(0.01, -0.005, 0.04);
        let symmetry = estimate(&[Solid::Cylinder(center, 0.03, 0.04)], &[]);
        let first = &symmetry.accepted[0];
        let SymmetryElement::Axis { point, direction, .. } = first.element else { panic!("no axis first: {first:?}") };
        let miss = (center - point).cross(&direction).norm();
        assert!(direction.z.abs() > 0.9995 && miss < 0.001, "axis {direction:?} misses the centre by {miss}");
        let covariance = first.covariance.as_ref().expect("four parameters are determined");
        let sigma = covariance[(2, 2)].sqrt();
        assert!(covariance.shape() == (4, 4) && sigma > 2e-5 && sigma < 2e-3, "σ of the shift: {sigma}");
    }

    #[test]
    fn a_handle_does_not_cost_a_can_its_axis() {
        let center = Point::new(0.0, 0.0, 0.05);
        let handle = Solid::Box(Point::new(0.0, 0.056, 0.05), Vector::new(0.010, 0.026, 0.042), 0.0);
        let symmetry = estimate(&[Solid::Cylinder(center, 0.035, 0.05), handle], &[]);
        let axis = symmetry.accepted.iter().find(|h| matches!(h.element, SymmetryElement::Axis { .. }));
        let axis = axis.expect("the can's axis");
        let allowed = SymmetryParams::default().axis_ratio * axis.score.informative + SymmetryParams::default().slack;
        assert!(axis.score.opposition() > allowed, "the handle hardly opposes: {axis:?}");
    }

    #[test]
    fn a_ball_has_its_centre_and_an_axis_across_the_view() {
        let center = Point::new(0.0, 0.0, 0.035);
        let evidence = evidence(&[Solid::Sphere(center, 0.035)], &[]);
        let symmetry = EvidenceSearch::default().estimate(&evidence);
        let sphere = symmetry.accepted.iter().find_map(|h| match h.element {
            SymmetryElement::Sphere { center } => Some(center),
            _ => None,
        });
        let miss = (sphere.expect("a ball is a sphere") - center).norm();
        assert!(miss < 0.001, "centre off by {miss}");
        let SymmetryElement::Axis { direction, .. } = symmetry.accepted[0].element else {
            panic!("an axis comes first")
        };
        let view = (center - evidence.camera_center).normalize();
        assert!(direction.dot(&view).abs() < 0.02, "an axis towards the camera shows nothing new");
    }

    #[test]
    fn a_lopsided_object_has_no_upright_plane() {
        let solids = [
            Solid::Box(Point::new(0.0, 0.0, 0.02), Vector::new(0.045, 0.025, 0.02), 0.3),
            Solid::Sphere(Point::new(0.03, 0.02, 0.045), 0.022),
            Solid::Cylinder(Point::new(-0.02, -0.03, 0.035), 0.014, 0.035),
        ];
        let symmetry = estimate(&solids, &[]);
        let upright: Vec<_> = symmetry.planes().filter(|p| p.normal.z.abs() < 0.3).collect();
        assert!(upright.is_empty(), "accepted {upright:?}");
        assert!(!symmetry.rejected.is_empty() && symmetry.rejected.iter().all(|h| h.rejection.is_some()));
    }

    #[test]
    fn what_lies_flat_is_alike_above_and_below() {
        // From above, next to nothing of the sides is seen; only contact with the support tells how far down it reaches.
        let half = 0.006;
        let solids = [
            Solid::Box(Point::new(0.0, 0.0, half), Vector::new(0.05, 0.012, half), 0.3),
            Solid::Box(Point::new(0.04, 0.025, half), Vector::new(0.012, 0.02, half), 0.3),
        ];
        let (angle, offset) = nearest(&estimate(&solids, &[]), Vector::z(), &Point::new(0.0, 0.0, half));
        assert!(angle < 2.0 && offset < 0.0007, "off by {angle}°, {offset} m");
    }

    #[test]
    fn a_slanted_top_over_a_level_bottom_is_not_alike_above_and_below() {
        let mesh = crate::simulate::Solid::named("bracket").expect("listed").mesh(1e-4, 3e-3);
        let mut params = crate::simulate::SimulateParams::default();
        params.touch.count = 0;
        let scene = crate::simulate::simulate_scene("bracket", &mesh, &params).expect("valid").scene;
        let visible =
            crate::camera::segment_object(&scene.frame, &crate::camera::SegmentParams::default()).expect("seen");
        let evidence = Evidence::gather(&scene.frame, &visible, &[], &EvidenceParams::default()).expect("seen");
        let params = SymmetryParams::default();
        let resting = resting_plane(&Scorer::new(&evidence, &params), None).expect("there is a support");
        let SymmetryElement::Reflection(plane) = resting.element else { panic!("{resting:?}") };
        assert!(plane.normal.z.abs() > 0.9999, "{plane:?}");
    }

    #[test]
    fn the_two_sides_of_a_thin_board_support_the_plane_between_them() {
        let center = Point::new(0.0, 0.0, 0.03);
        let solids = [Solid::Box(center, Vector::new(0.03, 0.025, 0.0025), 0.3)];
        let at = |k: i32| Vector::new(f64::from(k % 3 - 1) * 0.016, f64::from(k / 3 - 1) * 0.014, 0.0);
        let below: Vec<Patch> = (0..9).map(|k| touch(&solids, Point::from(at(k)), center + at(k))).collect();
        let (params, evidence) = (SymmetryParams::default(), evidence(&solids, &below));
        let scorer = Scorer::new(&evidence, &params);
        let plane = Plane::new(Vector::z(), &center).expect("a direction");
        let score = scorer.score(&SymmetryElement::Reflection(plane), &Tolerances::fine(&params), 800);
        assert!(score.support > 0.6, "{score:?}");
        assert!(score.informative > 0.5 * score.support, "{score:?}");
    }

    #[test]
    fn a_cone_is_not_alike_above_and_below() {
        let level = Point::new(0.0, 0.0, 0.02);
        let solids = [Solid::Cylinder(level, 0.04, 0.02), Solid::Cylinder(Point::new(0.0, 0.0, 0.055), 0.02, 0.015)];
        let symmetry = estimate(&solids, &[]);
        assert!(symmetry.planes().all(|p| p.normal.z.abs() < 0.5), "{:?}", symmetry.accepted);
    }

    #[test]
    fn a_touch_on_the_hidden_side_rejects_a_plane_that_it_contradicts() {
        // From the front this is a box; a step as wide as it is hides behind it.
        let (center, half, yaw) = (Point::new(0.0, 0.0, 0.03), Vector::new(0.02, 0.04, 0.03), 20.0_f64.to_radians());
        let (front, side) = (Vector::new(yaw.cos(), yaw.sin(), 0.0), Vector::new(-yaw.sin(), yaw.cos(), 0.0));
        let step = Point::from(Vector::z() * 0.014 - front * 0.034);
        let solids = [Solid::Box(center, half, yaw), Solid::Box(step, Vector::new(0.014, 0.036, 0.014), yaw)];
        let across = |s: &Symmetry| s.planes().any(|p| p.normal.dot(&front).abs() > 0.95);
        assert!(across(&estimate(&solids, &[])), "nothing seen speaks against the plane between front and back");
        let touches: Vec<Patch> = [-0.025, -0.01, 0.01, 0.025]
            .iter()
            .flat_map(|&y| {
                let to = step + side * y;
                [touch(&solids, to - front * 0.1, to), touch(&solids, to + Vector::z() * 0.1, to)]
            })
            .collect();
        assert!(!across(&estimate(&solids, &touches)), "the touched step has no mate on the seen front");
    }

    #[test]
    fn the_same_evidence_gives_the_same_answer_for_any_number_of_threads() {
        let solids = [Solid::Box(Point::new(0.0, 0.0, 0.03), Vector::new(0.045, 0.025, 0.03), 0.8)];
        let run = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a small pool");
            pool.install(|| format!("{:?}", estimate(&solids, &[])))
        };
        assert_eq!(run(1), run(3));
    }

    #[test]
    fn an_axis_is_refined_or_rejected() {
        let (center, params) = (Point::new(0.01, -0.005, 0.04), SymmetryParams::default());
        let refined = |solid: Solid, point: Point, direction: Vector| {
            let evidence = evidence(&[solid], &[]);
            let scorer = Scorer::new(&evidence, &params);
            refined_axis(&scorer, &(point, Unit::new_normalize(direction)))
        };
        let can = Solid::Cylinder(center, 0.03, 0.04);
        let near = refined(can, center + Vector::new(0.003, 0.0, 0.0), Vector::new(0.05, 0.03, 1.0));
        let SymmetryElement::Axis { point, direction, .. } = near.element else { panic!("{near:?}") };
        let miss = (center - point).cross(&direction).norm();
        assert!(near.rejection.is_none() && direction.z.abs() > 0.9995 && miss < 0.001, "{near:?}");
        // Across a flat box nothing turns into itself.
        let flat = Solid::Box(Point::new(0.0, 0.0, 0.01), Vector::new(0.05, 0.03, 0.01), 0.3);
        let across = refined(flat, Point::new(0.0, 0.0, 0.01), Vector::new(0.3, 1.0, 0.0));
        assert!(across.rejection.is_some(), "{across:?}");
    }
}
