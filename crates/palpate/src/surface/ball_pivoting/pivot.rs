use super::BallPivotingParams;
use super::front::Front;
use super::grid::Grid;
use super::prepare::{checked_normals, distinct, jittered, median_spacing, thinned};
use super::project::{Quality, projected};
use crate::geometry::{Aabb, KdTree, Point, PointCloud, TriangleMesh, Vector, drop_small_pieces, split_fans};
use crate::surface::poisson::octree_order;
use crate::surface::{SurfaceError, fill_holes};
use std::collections::VecDeque;

/// Multiple of the smallest radius up to which a ball's neighbourhood is scanned for what is in its way.
const SMALL: f64 = 4.0;
/// Multiples of the median spacing that serve as radii where none are given.
const DEFAULT_RADII: [f64; 4] = [1.5, 2.5, 4.0, 6.0];
/// Diagonal of the cloud over the largest ball that bridges islands: about the size of the object's features.
const BRIDGE_SHARE: f64 = 0.25;
/// Smallest radius over the distance below which points are merged.
const MERGE_SHARE: f64 = 0.1;
/// Seeds are looked for among this many nearest neighbours: a face of an empty ball joins near points.
const SEED_NEIGHBORS: usize = 24;

/// Meshes an oriented cloud by rolling balls over it: three points make a face where a ball touches them and holds no other point.
///
/// F. Bernardini, J. Mittleman, H. Rushmeier, C. Silva, G. Taubin: "The Ball-Pivoting Algorithm for Surface Reconstruction", IEEE
/// TVCG 5(4), 1999. Differences: faces are kept as half-edges, which joins and glues fronts without the paper's loops; points are
/// first brought into general position by a tiny jitter (results keep their true place).
///
/// The result is edge-manifold, consistently oriented and, after vertices between several fans are doubled, vertex-manifold. It
/// is open where no ball found a foothold, unless [`BallPivotingParams::fill_holes`]. O(n log n) for a bounded ball-to-spacing ratio.
///
/// * `cloud` – points with outward normals; the normals decide only on which side a ball may roll
///
/// # Errors
/// [`SurfaceError`] for a cloud without normals, with values that are not finite, with less than three distinct points, or
/// where no three points admit a ball (all on one line, say).
pub fn ball_pivoting(cloud: &PointCloud, params: &BallPivotingParams) -> Result<TriangleMesh, SurfaceError> {
    params.validate()?;
    let normals = checked_normals(cloud)?;
    // Balls roll to neighbours, which are then neighbours in memory too.
    let order: Vec<usize> = octree_order(&cloud.points).into_iter().map(|i| i as usize).collect();
    let mut place: Vec<Point> = order.iter().map(|&i| cloud.points[i]).collect();
    let mut normals: Vec<Vector> = order.iter().map(|&i| normals[i]).collect();
    if params.project != Some(0) {
        let quality = Quality::of(&place, &normals);
        for _ in 0..params.project.unwrap_or_else(|| quality.rounds()) {
            (place, normals) = projected(&place, &normals, quality.radius());
        }
    }
    let mut kept = distinct(&place);
    if kept.len() < 3 {
        return Err(SurfaceError::TooFewPoints { found: kept.len(), needed: 3 });
    }
    let positions = |kept: &[usize]| kept.iter().map(|&i| place[i]).collect::<Vec<_>>();
    let radii =
        params.radii.as_ref().map_or_else(|| chosen_radii(&positions(&kept), params.fill_holes), |r| ascending(r));
    let merge_distance = params.merge_distance.unwrap_or(MERGE_SHARE * radii[0]);
    kept = thinned(&positions(&kept), merge_distance).into_iter().map(|i| kept[i]).collect();

    let points = jittered(&positions(&kept), radii[0]);
    let normals: Vec<Vector> = kept.iter().map(|&i| normals[i]).collect();
    let mut front = Front::new(kept.len());
    let tree = KdTree::new(&points);
    let small = SMALL * radii.first().copied().unwrap_or(0.0);
    for &radius in &radii {
        // Surrounded points can only be in a ball's way.
        let active: Vec<u32> = (0..points.len() as u32).filter(|&v| !front.is_inner(v)).collect();
        let all = (radius <= small).then(|| Grid::new(&points, 2.0 * radius));
        let some;
        let grid = match &all {
            Some(all) if active.len() == points.len() => all,
            _ => {
                let places: Vec<Point> = active.iter().map(|&v| points[v as usize]).collect();
                some = Grid::new(&places, 2.0 * radius);
                &some
            }
        };
        let all = all.as_ref();
        Ball { radius, points: &points, normals: &normals, tree: &tree, active, grid, all }.roll(&mut front);
    }
    if front.faces.is_empty() {
        let reason = format!("no ball of radius {radii:?} m rests on three of them");
        return Err(SurfaceError::NoSurface { points: kept.len(), reason });
    }

    let colors = cloud.colors.as_ref().map(|c| kept.iter().map(|&i| c[order[i]]).collect());
    let mut mesh = TriangleMesh { vertices: positions(&kept), faces: front.faces, colors };
    mesh = split_fans(&mesh);
    if params.min_piece_share > 0.0 {
        mesh = drop_small_pieces(&mesh, params.min_piece_share);
    }
    Ok(if params.fill_holes { fill_holes(&mesh) } else { mesh })
}

fn ascending(radii: &[f64]) -> Vec<f64> {
    let mut radii = radii.to_vec();
    radii.sort_unstable_by(f64::total_cmp);
    radii.dedup();
    radii
}

fn chosen_radii(points: &[Point], bridge: bool) -> Vec<f64> {
    let spacing = median_spacing(points);
    let mut radii: Vec<f64> = DEFAULT_RADII.iter().map(|k| k * spacing).collect();
    let largest = Aabb::of(points).map_or(0.0, |b| BRIDGE_SHARE * b.diagonal());
    let mut radius = radii[DEFAULT_RADII.len() - 1] * 2.0;
    while bridge && spacing > 0.0 && radius <= largest {
        radii.push(radius);
        radius *= 2.0;
    }
    radii
}

/// A ball of one radius and the points it rolls over.
struct Ball<'a> {
    radius: f64,
    points: &'a [Point],
    normals: &'a [Vector],
    tree: &'a KdTree,
    /// Points that were not surrounded by faces when this radius started.
    active: Vec<u32>,
    /// Finds members of `active`.
    grid: &'a Grid,
    /// Finds all points; for small balls, which it serves faster than the tree.
    all: Option<&'a Grid>,
}

impl Ball<'_> {
    /// Rolls on from the open edges that smaller balls left, then from every seed.
    fn roll(&self, front: &mut Front) {
        let mut queue = VecDeque::new();
        for face in 0..front.faces.len() {
            let corners = front.faces[face];
            if front.open_sides(face).next().is_none() {
                continue;
            }
            if let Some(center) = self.center(corners).filter(|c| self.is_empty(c)) {
                front.centers[face] = center;
                queue.extend(front.open_sides(face).map(|k| (face, k)));
            }
        }
        self.expand(front, &mut queue);
        for v in 0..self.points.len() as u32 {
            if !front.is_orphan(v) {
                continue;
            }
            if let Some((corners, center)) = self.seed(front, v) {
                let face = front.add(corners, center);
                queue.extend((0..3).map(|k| (face, k)));
                self.expand(front, &mut queue);
            }
        }
    }

    /// Pivots round the queued edges until none is left.
    fn expand(&self, front: &mut Front, queue: &mut VecDeque<(usize, usize)>) {
        while let Some((face, side)) = queue.pop_front() {
            let corners = front.faces[face];
            let (a, b, c) = (corners[side], corners[(side + 1) % 3], corners[(side + 2) % 3]);
            if front.has(b, a) {
                continue;
            }
            let Some((x, center)) = self.pivot(a, b, c, &front.centers[face]) else { continue };
            let corners = [b, a, x];
            if front.accepts(corners) {
                let face = front.add(corners, center);
                queue.extend(front.open_sides(face).map(|k| (face, k)));
            }
        }
    }

    /// Rolls the ball out of face (a, b, c) over the edge a → b: the first point it meets, and where it rests then.
    fn pivot(&self, a: u32, b: u32, c: u32, center: &Point) -> Option<(u32, Point)> {
        let (pa, pb) = (self.points[a as usize], self.points[b as usize]);
        let middle = nalgebra::center(&pa, &pb);
        let axis = (pb - pa).try_normalize(0.0)?;
        // The ball's centre turns on a circle: in the plane across the edge, from `start` towards `side`.
        let start = center - middle;
        let arm = start.norm();
        let start = start / arm;
        let side = axis.cross(&start);
        let lead = arm * arm - self.radius * self.radius;
        let mut best: Option<(f64, u32)> = None;
        self.grid.within(&middle, 2.0 * self.radius, |found, place, squared| {
            let x = self.active[found as usize];
            let to = place - middle;
            let (along, across) = (to.dot(&start), to.dot(&side));
            // The point is met where its distance along the arm is this.
            let met = (squared + lead) / (2.0 * arm);
            let in_plane = along * along + across * across;
            let beside = in_plane - met * met;
            if beside < 0.0 || x == a || x == b || x == c {
                return true;
            }
            let beside = beside.sqrt();
            let (cosine, sine) =
                ((along * met + across * beside) / in_plane, (across * met - along * beside) / in_plane);
            // Grows with the angle, a turn being 4.
            let turned = if sine >= 0.0 { 1.0 - cosine } else { 3.0 + cosine };
            if best.map_or(turned >= 0.0, |(least, y)| turned < least || (turned == least && x < y)) {
                best = Some((turned, x));
            }
            true
        });
        let (_, x) = best?;
        let corners = [b, a, x];
        let rest = self.center(corners)?;
        let agrees = self.face_normal(corners).dot(&self.normals[x as usize]) > 0.0;
        (agrees && self.is_empty(&rest)).then_some((x, rest))
    }

    /// A face at an orphan that an empty ball touches from outside, tried from near neighbours to far ones.
    fn seed(&self, front: &Front, v: u32) -> Option<([u32; 3], Point)> {
        let mut near = self.tree.nearest_n(&self.points[v as usize], SEED_NEIGHBORS + 1);
        near.retain(|&(j, distance)| j as u32 != v && distance < 2.0 * self.radius && !front.is_inner(j as u32));
        let near: Vec<u32> = near.into_iter().map(|n| n.0 as u32).collect();
        for far in 1..near.len() {
            for close in 0..far {
                let mut corners = [v, near[close], near[far]];
                if self.face_normal(corners).dot(&self.normals[v as usize]) < 0.0 {
                    corners.swap(1, 2);
                }
                let normal = self.face_normal(corners);
                if corners.iter().any(|&i| normal.dot(&self.normals[i as usize]) <= 0.0) || !front.accepts(corners) {
                    continue;
                }
                let Some(center) = self.center(corners) else { continue };
                // Most candidates fail on a near point: look there before asking the tree.
                let blocked = near.iter().any(|n| !corners.contains(n) && self.is_inside(&center, *n));
                if !blocked && self.is_empty(&center) {
                    return Some((corners, center));
                }
            }
        }
        None
    }

    /// Centre of the ball that rests on a face from outside; `None` if the face is too large for the ball or has no area.
    fn center(&self, corners: [u32; 3]) -> Option<Point> {
        let [p, q, s] = corners.map(|i| self.points[i as usize]);
        let (pq, ps) = (q - p, s - p);
        let normal = pq.cross(&ps);
        let squared = normal.norm_squared();
        let to_circumcenter =
            (normal.cross(&pq) * ps.norm_squared() + ps.cross(&normal) * pq.norm_squared()) / (2.0 * squared);
        let height = (self.radius * self.radius - to_circumcenter.norm_squared()) / squared;
        // No area makes this NaN.
        (height >= 0.0).then(|| p + to_circumcenter + normal * height.sqrt())
    }

    fn face_normal(&self, corners: [u32; 3]) -> Vector {
        let [p, q, s] = corners.map(|i| self.points[i as usize]);
        (q - p).cross(&(s - p))
    }

    fn is_inside(&self, center: &Point, v: u32) -> bool {
        let reach = self.radius * (1.0 - 1e-9);
        (self.points[v as usize] - center).norm_squared() < reach * reach
    }

    /// The corners themselves lie on the ball, not in it.
    fn is_empty(&self, center: &Point) -> bool {
        // Cells as wide as a ball that bridges holes hold much of the cloud.
        let Some(all) = self.all else {
            return self.tree.nearest(center).is_none_or(|(_, distance)| distance >= self.radius * (1.0 - 1e-9));
        };
        let mut empty = true;
        all.within(center, self.radius * (1.0 - 1e-9), |_, _, _| {
            empty = false;
            false
        });
        empty
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Topology;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;
    use std::f64::consts::PI;

    fn oriented(points: Vec<Point>, normals: Vec<Vector>) -> PointCloud {
        PointCloud::with_normals(points, normals).expect("one normal per point")
    }

    /// Points spread evenly on a unit sphere along a spiral of the golden angle.
    fn fibonacci_sphere(n: u32) -> PointCloud {
        let points: Vec<Point> = (0..n)
            .map(|i| {
                let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(n);
                let (sin, cos) = (f64::from(i) * PI * (3.0 - 5.0_f64.sqrt())).sin_cos();
                let r = (1.0 - z * z).sqrt();
                Point::new(r * cos, r * sin, z)
            })
            .collect();
        let normals = points.iter().map(|p| p.coords).collect();
        oriented(points, normals)
    }

    /// An n × n grid of spacing 1, exactly regular.
    fn sheet(n: u32) -> PointCloud {
        let points: Vec<Point> = (0..n * n).map(|k| Point::new(f64::from(k % n), f64::from(k / n), 0.0)).collect();
        let normals = vec![Vector::z(); points.len()];
        oriented(points, normals)
    }

    fn with_radii(radii: &[f64]) -> BallPivotingParams {
        BallPivotingParams { radii: Some(radii.to_vec()), ..Default::default() }
    }

    #[test]
    fn a_sphere_closes_with_one_radius() {
        let n = 20_000;
        let mesh = ball_pivoting(&fibonacci_sphere(n), &with_radii(&[0.04])).expect("meshes");
        let t = Topology::of(&mesh);
        assert!(t.is_watertight() && t.is_vertex_manifold(), "{t:?}");
        assert_eq!((mesh.vertices.len(), mesh.faces.len(), t.genus(), t.components), (20_000, 39_996, Some(0), 1));
        assert!((mesh.volume() - 4.0 / 3.0 * PI).abs() < 2e-3, "{}", mesh.volume());
    }

    #[test]
    fn a_regular_sheet_is_one_disc() {
        let mesh = ball_pivoting(&sheet(40), &with_radii(&[1.2])).expect("meshes");
        let t = Topology::of(&mesh);
        assert!(t.is_consistently_oriented() && t.is_vertex_manifold());
        assert_eq!((t.boundary_loops, t.boundary_edges, t.components, t.genus()), (1, 4 * 39, 1, Some(0)));
        assert!((mesh.area() - 39.0 * 39.0).abs() < 1e-9);
        assert!((0..mesh.faces.len()).all(|f| mesh.face_normal(f).z > 0.99));
    }

    #[test]
    fn duplicates_change_nothing() {
        let once = sheet(12);
        let mut thrice = once.clone();
        thrice.append(&once);
        thrice.append(&once);
        let params = BallPivotingParams::default();
        assert_eq!(ball_pivoting(&thrice, &params), ball_pivoting(&once, &params));
    }

    #[test]
    fn the_larger_ball_bridges_what_the_smaller_leaves() {
        // Two sheets 2.5 apart: a gap for the ball of radius 1, none for that of radius 2.
        let mut cloud = sheet(10);
        let mut other = sheet(10);
        other.points.iter_mut().for_each(|p| p.x += 11.5);
        cloud.append(&other);
        let small = Topology::of(&ball_pivoting(&cloud, &with_radii(&[1.0])).expect("meshes"));
        assert_eq!((small.components, small.boundary_loops), (2, 2));
        let mesh = ball_pivoting(&cloud, &with_radii(&[2.0, 1.0])).expect("meshes");
        let both = Topology::of(&mesh);
        assert_eq!((both.components, both.boundary_loops, both.faces), (1, 1, 2 * 81 * 2 + 2 * 9));
        assert!((mesh.area() - 9.0 * 20.5).abs() < 1e-9);
    }

    #[test]
    fn noise_and_holes_end_closed_when_asked() {
        let mut cloud = fibonacci_sphere(3000);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let mut shift = || rng.random_range(-0.02..0.02);
        cloud.points.iter_mut().for_each(|p| *p += Vector::new(shift(), shift(), shift()));
        let cloud = cloud.filtered(|i| cloud.points[i].z > -0.5);
        let open = ball_pivoting(&cloud, &BallPivotingParams::default()).expect("meshes");
        let t = Topology::of(&open);
        assert!(!t.is_closed() && t.is_consistently_oriented() && t.is_vertex_manifold(), "{t:?}");
        let params = BallPivotingParams { fill_holes: true, min_piece_share: 0.01, ..Default::default() };
        let mesh = ball_pivoting(&cloud, &params).expect("meshes");
        let t = Topology::of(&mesh);
        assert!(t.is_watertight() && t.is_vertex_manifold() && t.components == 1, "{t:?}");
        // A sphere without its cap below z = −1/2: π (2/3 + 1/2 − 1/24).
        assert!((mesh.volume() / (PI * 27.0 / 24.0) - 1.0).abs() < 0.03, "{}", mesh.volume());
    }

    #[test]
    fn islands_are_bridged_when_closing() {
        // Caps of 20° round the six axes: gaps of 50°, far beyond six spacings.
        let sphere = fibonacci_sphere(8000);
        let cloud = sphere.filtered(|i| sphere.points[i].coords.amax() > 20.0_f64.to_radians().cos());
        let open = Topology::of(&ball_pivoting(&cloud, &BallPivotingParams::default()).expect("meshes"));
        assert_eq!((open.components, open.boundary_loops), (6, 6));
        let params = BallPivotingParams { fill_holes: true, ..Default::default() };
        let mesh = ball_pivoting(&cloud, &params).expect("meshes");
        let t = Topology::of(&mesh);
        assert!(t.is_watertight() && t.components == 1, "{t:?}");
        // The convex hull of the caps holds 77.3 % of the ball (Qhull).
        assert!((mesh.volume() / (4.0 / 3.0 * PI) - 0.773).abs() < 0.02, "{}", mesh.volume());
    }

    #[test]
    fn bad_clouds_are_errors() {
        let params = BallPivotingParams::default();
        let mut cloud = sheet(3);
        cloud.normals = None;
        assert_eq!(ball_pivoting(&cloud, &params), Err(SurfaceError::NoNormals));
        let same = oriented(vec![Point::origin(); 50], vec![Vector::z(); 50]);
        assert_eq!(ball_pivoting(&same, &params), Err(SurfaceError::TooFewPoints { found: 1, needed: 3 }));
        assert!(matches!(
            ball_pivoting(&PointCloud { normals: Some(vec![]), ..Default::default() }, &params),
            Err(SurfaceError::TooFewPoints { .. })
        ));
        let line = oriented((0..50).map(|i| Point::new(f64::from(i), 0.0, 0.0)).collect(), vec![Vector::z(); 50]);
        assert!(matches!(ball_pivoting(&line, &params), Err(SurfaceError::NoSurface { points: 50, .. })));
        let mut cloud = sheet(3);
        cloud.points[4].y = f64::NAN;
        assert_eq!(ball_pivoting(&cloud, &params), Err(SurfaceError::NotFinite { index: 4 }));
        let mut cloud = sheet(3);
        cloud.normals.iter_mut().for_each(|n| n[2] = Vector::zeros());
        assert_eq!(ball_pivoting(&cloud, &params), Err(SurfaceError::ZeroNormal { index: 2, length: 0.0 }));
        for radii in [vec![], vec![-1.0], vec![f64::NAN]] {
            let error = ball_pivoting(&sheet(3), &with_radii(&radii));
            assert!(matches!(error, Err(SurfaceError::InvalidParameter { field: "radii", .. })), "{error:?}");
        }
        assert!(matches!(ball_pivoting(&sheet(3), &with_radii(&[1e-3])), Err(SurfaceError::NoSurface { .. })));
    }
}
