use super::element::{SymmetryElement, tangents, tilted};
use super::score::{Score, Scorer, Tolerances};
use crate::geometry::{Plane, Vector};
use nalgebra::{DMatrix, DVector};

/// Steps of the pattern search, radians (and, times the object's radius, metres): coarse tolerances down to the second, fine ones to the last.
const STEPS: [f64; 3] = [0.08, 0.02, 0.0006];
/// What becomes of a step when none helps.
const SHRINK: f64 = 0.35;
/// Least σ of a residual, metres, and how many neighbouring votes share one error: what noise alone would make too sure.
const RESIDUAL_FLOOR: f64 = 0.0005;
const CORRELATED_VOTES: f64 = 10.0;

/// Number of degrees of freedom: plane 3, axis 4, sphere 3.
pub(super) fn degrees_of_freedom(element: &SymmetryElement) -> usize {
    match element {
        SymmetryElement::Axis { .. } => 4,
        _ => 3,
    }
}

/// The element moved by small parameters, in the order that covariances use.
///
/// * plane – turn about u, turn about v (radians), shift along the normal (metres), all at the evidence's centroid
/// * axis – turn about u, turn about v, shift along u, shift along v, at the point of the axis nearest to the centroid
/// * sphere – shift of the centre along x, y, z
///
/// (u, v) are the tangents that the fixed rule of the library gives for the normal or direction. Parametrised at the centroid because a
/// tilt about a far point shifts the plane as well.
pub(super) fn perturbed(scorer: &Scorer, element: &SymmetryElement, d: &[f64]) -> SymmetryElement {
    match element {
        SymmetryElement::Reflection(plane) => {
            let foot = scorer.centroid - plane.normal.into_inner() * (plane.signed_distance(&scorer.centroid) - d[2]);
            let normal = tilted(&plane.normal, d[0], d[1]);
            SymmetryElement::Reflection(Plane { normal, offset: normal.dot(&foot.coords) })
        }
        SymmetryElement::Axis { point, direction, order } => {
            let (u, v) = tangents(direction);
            let foot = point + direction.into_inner() * direction.dot(&(scorer.centroid - point));
            let point = foot + u * d[2] + v * d[3];
            SymmetryElement::Axis { point, direction: tilted(direction, d[0], d[1]), order: *order }
        }
        SymmetryElement::Sphere { center } => {
            SymmetryElement::Sphere { center: center + nalgebra::Vector3::new(d[0], d[1], d[2]) }
        }
    }
}

/// Size of a step of each parameter for a step of one radian.
fn units(scorer: &Scorer, element: &SymmetryElement) -> Vec<f64> {
    let r = scorer.radius;
    match element {
        SymmetryElement::Reflection(_) => vec![1.0, 1.0, r],
        SymmetryElement::Axis { .. } => vec![1.0, 1.0, r, r],
        SymmetryElement::Sphere { .. } => vec![r; 3],
    }
}

/// Climbs the score by a pattern search: a step up or down in each parameter, shortened when none helps.
pub(super) fn refine(scorer: &Scorer, start: &SymmetryElement) -> (SymmetryElement, Score) {
    refine_near(scorer, &refine_roughly(scorer, start).0)
}

/// The first half: to about a degree, with the tolerances of the search.
pub(super) fn refine_roughly(scorer: &Scorer, start: &SymmetryElement) -> (SymmetryElement, Score) {
    let (params, coarse) = (scorer.params, Tolerances::coarse(scorer.params));
    let best = climb(scorer, start, &coarse, params.search_samples, [STEPS[0], STEPS[1]], &axes(scorer, start));
    (best, scorer.score(&best, &coarse, params.search_samples))
}

/// The second half, with the fine tolerances: for a start that is known to a few degrees.
pub(super) fn refine_near(scorer: &Scorer, start: &SymmetryElement) -> (SymmetryElement, Score) {
    let params = scorer.params;
    let fine = Tolerances::fine(params);
    let best = climb(scorer, start, &fine, params.refine_samples, [STEPS[1], STEPS[2]], &axes(scorer, start));
    (best, scorer.score(&best, &fine, params.refine_samples))
}

/// A step in each parameter alone, for a step of one radian.
fn axes(scorer: &Scorer, element: &SymmetryElement) -> Vec<[f64; 4]> {
    let one = |(i, unit): (usize, &f64)| std::array::from_fn(|k| if k == i { *unit } else { 0.0 });
    units(scorer, element).iter().enumerate().map(one).collect()
}

/// The best plane near `start` that is perpendicular to one or two directions.
pub(super) fn refine_perpendicular(
    scorer: &Scorer,
    start: &Plane,
    first: &Vector,
    second: Option<&Vector>,
) -> Option<(SymmetryElement, Score)> {
    let params = scorer.params;
    let across = |n: Vector| match second {
        Some(second) => first.cross(second) * first.cross(second).dot(&n),
        None => n - first * first.dot(&n),
    };
    let foot = scorer.centroid - start.normal.into_inner() * start.signed_distance(&scorer.centroid);
    let start = SymmetryElement::Reflection(Plane::new(across(start.normal.into_inner()), &foot)?);
    let SymmetryElement::Reflection(plane) = &start else { return None };
    let (u, v) = tangents(&plane.normal);
    let mut axes = vec![[0.0, 0.0, scorer.radius, 0.0]];
    if second.is_none() {
        axes.push([first.dot(&u), first.dot(&v), 0.0, 0.0]);
    }
    let fine = Tolerances::fine(params);
    let best = climb(scorer, &start, &fine, params.refine_samples, [STEPS[0], STEPS[2]], &axes);
    let SymmetryElement::Reflection(plane) = &best else { return None };
    // Finite steps leave the constraint by their square; put the normal back.
    let foot = scorer.centroid - plane.normal.into_inner() * plane.signed_distance(&scorer.centroid);
    let best = SymmetryElement::Reflection(Plane::new(across(plane.normal.into_inner()), &foot)?);
    Some((best, scorer.score(&best, &fine, params.refine_samples)))
}

/// The best plane near `start` with its normal.
pub(super) fn refine_offset(scorer: &Scorer, start: &Plane, tolerances: &Tolerances) -> (SymmetryElement, Score) {
    let (start, votes) = (SymmetryElement::Reflection(*start), scorer.params.refine_samples);
    let axes = [[0.0, 0.0, scorer.radius, 0.0]];
    let best = climb(scorer, &start, tolerances, votes, [STEPS[1], STEPS[2]], &axes);
    (best, scorer.score(&best, tolerances, votes))
}

/// Steps along `axes`, which hold the change of the parameters of [`perturbed`] per unit step. Where no step helps, the parabolas through the
/// steps up and down say where between them the best may be.
fn climb(
    scorer: &Scorer,
    start: &SymmetryElement,
    tolerances: &Tolerances,
    votes: usize,
    [from, to]: [f64; 2],
    axes: &[[f64; 4]],
) -> SymmetryElement {
    let (mut best, mut course, mut step) = (*start, scorer.course(start, tolerances, votes, None), from);
    while step > to {
        let (mut improved, mut top) = (false, [0.0; 4]);
        for axis in axes {
            let mut sides = [0.0; 2];
            for (side, sign) in sides.iter_mut().zip([1.0, -1.0]) {
                let candidate = perturbed(scorer, &best, &axis.map(|a| a * sign * step));
                let rival = scorer.course(&candidate, tolerances, votes, Some(&course));
                *side = rival.value;
                if rival.value > course.value + 1e-9 {
                    (best, course, improved) = (candidate, rival, true);
                    break;
                }
            }
            let bend = (2.0 * course.value - sides[0] - sides[1]).max(1e-12);
            for (top, axis) in top.iter_mut().zip(axis) {
                *top += axis * 0.5 * step * (sides[0] - sides[1]) / bend;
            }
        }
        if !improved {
            let candidate = perturbed(scorer, &best, &top);
            let rival = scorer.course(&candidate, tolerances, votes, Some(&course));
            if rival.value > course.value + 1e-9 {
                (best, course) = (candidate, rival);
            }
            step *= SHRINK;
        }
    }
    best
}

/// Covariance of the parameters of [`perturbed`] from the residuals' curvature; `None` where they leave a parameter undetermined.
pub(super) fn covariance(scorer: &Scorer, element: &SymmetryElement) -> Option<DMatrix<f64>> {
    let (params, n) = (scorer.params, degrees_of_freedom(element));
    let tolerances = Tolerances::fine(params);
    let at = |d: &[f64]| scorer.residuals(&perturbed(scorer, element, d), &tolerances, params.refine_samples);
    let middle = at(&[0.0; 4]);
    let scale = units(scorer, element);
    let columns: Vec<_> = (0..n)
        .map(|i| {
            let mut d = [0.0; 4];
            let h = 1e-3 * scale[i];
            d[i] = h;
            let plus = at(&d);
            d[i] = -h;
            (h, plus, at(&d))
        })
        .collect();
    let (mut information, mut squares, mut count) = (DMatrix::zeros(n, n), 0.0, 0.0_f64);
    for (k, residual) in middle.iter().enumerate() {
        let Some(residual) = residual else { continue };
        let slope = |c: &(f64, Vec<Option<f64>>, Vec<Option<f64>>)| Some((c.1[k]? - c.2[k]?) / (2.0 * c.0));
        let Some(row) = columns.iter().map(slope).collect::<Option<Vec<f64>>>() else { continue };
        let row = DVector::from_vec(row);
        information += &row * row.transpose();
        squares += residual * residual;
        count += 1.0;
    }
    let variance = (squares / count.max(1.0)).max(RESIDUAL_FLOOR * RESIDUAL_FLOOR);
    information.try_inverse().map(|inverse| inverse * (variance * CORRELATED_VOTES))
}
