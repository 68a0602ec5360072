use super::element::SymmetryElement;
use super::score::{Scorer, Tolerances};
use crate::geometry::{Aabb, Plane, Point, Vector};
use nalgebra::{Matrix3, Matrix6, SymmetricEigen, Unit, Vector6};
use rayon::prelude::*;

/// Random subsets of normals, and their size, for the line-geometry fit.
const SUBSETS: usize = 40;
const SUBSET_SIZE: usize = 150;
/// Upright axes are tried on a grid of this many positions per side.
const UPRIGHT_GRID: usize = 22;
const FLOOR: f64 = -0.12;

/// A line: a point and a direction.
pub(super) type Line = (Point, Unit<Vector>);

/// The best distinct axes of revolution, best first.
pub(super) fn search_axes(scorer: &Scorer, planes: &[Plane]) -> Vec<Line> {
    let tolerances = Tolerances::coarse(scorer.params);
    let mut lines: Vec<Line> = (0..SUBSETS).into_par_iter().flat_map_iter(|k| normal_line_axes(scorer, k)).collect();
    lines.extend(upright_lines(scorer));
    lines.extend(intersections(planes));
    let mut scored: Vec<(f64, Line)> = lines
        .par_iter()
        .filter_map(|&(point, direction)| {
            let element = SymmetryElement::Axis { point, direction, order: None };
            let score = scorer.score_unless_bad(&element, &tolerances, scorer.params.search_samples, FLOOR)?;
            (score.informative > 0.05).then(|| (score.value(), (point, direction)))
        })
        .collect();
    scored.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Line> = Vec::new();
    for (_, line) in scored {
        if kept.len() == scorer.params.axis_candidates {
            break;
        }
        if kept.iter().all(|k| !same_line(k, &line, &scorer.centroid)) {
            kept.push(line);
        }
    }
    kept
}

/// Whether two axes are within about 15° and 12 mm of one another near `at`.
pub(super) fn same_line(a: &Line, b: &Line, at: &Point) -> bool {
    let near = |l: &Line| l.0 + l.1.into_inner() * l.1.dot(&(at - l.0));
    a.1.dot(&b.1).abs() > 0.96 && (near(a) - near(b)).norm() < 0.012
}

/// Axes that the normal lines of a subset of the samples meet.
///
/// The normals of a surface of revolution meet its axis: with Plücker coordinates (d, m) of the axis, n · m + (p × n) · d = 0, and the
/// smallest eigenvectors of the scatter of (p × n, n) are candidates.
///
/// # References
/// Pottmann & Wallner, *Computational Line Geometry*, 2001, ch. 4.
fn normal_line_axes(scorer: &Scorer, subset: usize) -> Vec<Line> {
    let votes = &scorer.votes;
    if votes.is_empty() {
        return Vec::new();
    }
    let mut scatter = Matrix6::zeros();
    // A stride coprime to most lengths walks through the shuffled votes from a different start each time.
    for k in 0..SUBSET_SIZE.min(votes.len()) {
        let s = &votes[(subset * 67 + k * (1 + subset % 7)) % votes.len()];
        let moment = ((s.position - scorer.centroid) / scorer.radius.max(1e-6)).cross(&s.normal);
        let row = Vector6::new(moment.x, moment.y, moment.z, s.normal.x, s.normal.y, s.normal.z);
        scatter += row * row.transpose();
    }
    let eigen = SymmetricEigen::new(scatter);
    let mut order = [0, 1, 2, 3, 4, 5];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let line = |i: usize| {
        let e = eigen.eigenvectors.column(i);
        let (d, m) = (Vector::new(e[0], e[1], e[2]), Vector::new(e[3], e[4], e[5]));
        let direction = Unit::try_new(d, 1e-3)?;
        // The point nearest to the origin of a line with moment m = p × d; the part of m along d belongs to no line.
        let foot = d.cross(&m) / d.norm_squared();
        Some((scorer.centroid + foot * scorer.radius, direction))
    };
    order[..3]
        .iter()
        .filter_map(|&i| line(i))
        .filter(|l| (l.0 - scorer.centroid).norm() < 3.0 * scorer.radius)
        .collect()
}

fn upright_lines(scorer: &Scorer) -> Vec<Line> {
    let up = scorer.evidence.up();
    let (u, v) = super::element::tangents(&up);
    let flat = |s: &Point| Point::new(u.dot(&s.coords), v.dot(&s.coords), up.dot(&s.coords));
    let points: Vec<Point> = scorer.votes.iter().map(|s| flat(&s.position)).collect();
    let Some(bounds) = Aabb::of(&points) else { return Vec::new() };
    let (min, size) = (bounds.min - bounds.size() * 0.15, bounds.size() * 1.3);
    let at = |k: usize, axis: usize| min[axis] + size[axis] * (k as f64 + 0.5) / UPRIGHT_GRID as f64;
    (0..UPRIGHT_GRID * UPRIGHT_GRID)
        .map(|k| {
            let (a, b) = (at(k % UPRIGHT_GRID, 0), at(k / UPRIGHT_GRID, 1));
            (Point::from(u * a + v * b + up.into_inner() * bounds.center().z), up)
        })
        .collect()
}

/// Where the best planes meet: a body of revolution is symmetric in every plane through its axis.
fn intersections(planes: &[Plane]) -> Vec<Line> {
    let mut lines = Vec::new();
    for (i, a) in planes.iter().enumerate() {
        for b in &planes[..i] {
            let Some(direction) = Unit::try_new(a.normal.cross(&b.normal), 0.2) else { continue };
            let rows = Matrix3::from_rows(&[a.normal.transpose(), b.normal.transpose(), direction.transpose()]);
            if let Some(point) = rows.lu().solve(&Vector::new(a.offset, b.offset, 0.0)) {
                lines.push((Point::from(point), direction));
            }
        }
    }
    lines
}

/// The point nearest to all normal lines, by iteratively reweighted least squares; `None` for parallel normals.
pub(super) fn normal_line_center(scorer: &Scorer) -> Option<Point> {
    let mut center = scorer.centroid;
    let scale = 0.002;
    for round in 0..8 {
        let (mut matrix, mut right) = (Matrix3::zeros(), Vector::zeros());
        for s in &scorer.votes {
            let across = Matrix3::identity() - s.normal * s.normal.transpose();
            let miss = (across * (center - s.position)).norm();
            let weight = if round == 0 { 1.0 } else { 1.0 / (1.0 + (miss / scale).powi(2)) };
            matrix += across * weight;
            right += across * (s.position - scorer.centroid) * weight;
        }
        // Nearly parallel normals fix the centre across, not along: such a patch is no sphere.
        let eigen = matrix.symmetric_eigenvalues();
        if eigen.min() < 1e-3 * eigen.max() {
            return None;
        }
        center = scorer.centroid + matrix.lu().solve(&right)?;
    }
    Some(center)
}
