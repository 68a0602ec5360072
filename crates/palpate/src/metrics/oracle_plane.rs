use super::surface_samples::SurfaceSamples;
use crate::geometry::{Bvh, Plane, Point, TriangleMesh, Vector};
use nalgebra::Matrix3;
use rayon::prelude::*;

/// Directions tried on the half-sphere, besides the principal axes.
const DIRECTIONS: usize = 200;
/// Planes refined on few samples.
const KEPT: usize = 8;
/// Planes of these refined on many.
const FINISHED: usize = 3;

/// Mean distance between a mesh and its mirror image, metres: 0 if the plane is a symmetry of the mesh.
///
/// `samples` points on the mesh, seeded, are reflected and measured against its triangles. `None` without area.
pub fn mirror_error(mesh: &TriangleMesh, plane: &Plane, samples: usize, seed: u64) -> Option<f64> {
    let points = SurfaceSamples::draw(mesh, samples, seed).points;
    (!points.is_empty()).then(|| error(&Bvh::new(mesh), &points, plane))
}

/// The plane about which the **truth** mirrored lies closest to itself, and its [`mirror_error`].
///
/// An oracle: it reads what a reconstruction must not know, and exists to tell how much of an error the symmetry estimate
/// causes. Principal planes and planes of evenly spread direction through the centroid; the best are refined in tilt and
/// offset by pattern search. `None` without area.
pub fn oracle_plane(truth: &TriangleMesh, seed: u64) -> Option<(Plane, f64)> {
    let coarse = SurfaceSamples::draw(truth, 300, seed).points;
    let fine = SurfaceSamples::draw(truth, 1500, seed.wrapping_add(1)).points;
    let (first, bvh) = (fine.first()?, Bvh::new(truth));
    let centroid = first + fine.iter().map(|p| p - first).sum::<Vector>() / fine.len() as f64;

    let normals: Vec<Vector> = principal_axes(&fine, &centroid).into_iter().chain(half_sphere(DIRECTIONS)).collect();
    let mut candidates: Vec<(f64, Plane)> = normals
        .par_iter()
        .filter_map(|n| Plane::new(*n, &centroid))
        .map(|plane| (error(&bvh, &coarse, &plane), plane))
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    candidates.truncate(KEPT);

    let reach = truth.bounds()?.diagonal() / 2.0;
    let refine_all = |planes: &[(f64, Plane)], points: &[Point], steps| -> Vec<(f64, Plane)> {
        let mut refined: Vec<_> =
            planes.par_iter().map(|(_, plane)| refine(&bvh, points, *plane, &centroid, reach, steps)).collect();
        refined.sort_by(|a, b| a.0.total_cmp(&b.0));
        refined
    };
    let mut refined = refine_all(&candidates, &coarse, (0.1, 0.004));
    refined.truncate(FINISHED);
    refined = refine_all(&refined, &fine, (0.008, 0.0002));
    refined.first().map(|&(error, plane)| (plane, error))
}

fn error(bvh: &Bvh, points: &[Point], plane: &Plane) -> f64 {
    let distance = |p: &Point| bvh.closest_point(&plane.reflect_point(p)).map_or(0.0, |s| s.distance);
    points.iter().map(distance).sum::<f64>() / points.len() as f64
}

/// Pattern search over two tilts (radians) and the offset (in units of `reach`): halve the step where nothing improves.
fn refine(
    bvh: &Bvh,
    points: &[Point],
    start: Plane,
    centroid: &Point,
    reach: f64,
    (mut step, finest): (f64, f64),
) -> (f64, Plane) {
    let (mut best, mut plane) = (error(bvh, points, &start), start);
    while step > finest {
        let normal = plane.normal.into_inner();
        let across = normal.cross(&Vector::ith(normal.iamin(), 1.0)).normalize();
        let along = normal.cross(&across);
        let at = centroid - normal * plane.signed_distance(centroid);
        let moves = [across, -across, along, -along].map(|tilt| Plane::new(normal + tilt * step, &at));
        let shifts = [step, -step].map(|s| Plane::new(normal, &(at + normal * (s * reach))));
        let better = moves
            .into_iter()
            .chain(shifts)
            .flatten()
            .map(|plane| (error(bvh, points, &plane), plane))
            .filter(|(e, _)| *e < best)
            .min_by(|a, b| a.0.total_cmp(&b.0));
        match better {
            Some(found) => (best, plane) = found,
            None => step /= 2.0,
        }
    }
    (best, plane)
}

fn principal_axes(points: &[Point], centroid: &Point) -> Vec<Vector> {
    let covariance: Matrix3<f64> = points.iter().map(|p| (p - centroid) * (p - centroid).transpose()).sum();
    covariance.symmetric_eigen().eigenvectors.column_iter().map(Into::into).collect()
}

/// A Fibonacci spiral over the upper half-sphere.
fn half_sphere(count: usize) -> impl Iterator<Item = Vector> {
    let golden_angle = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    (0..count).map(move |i| {
        let z = (i as f64 + 0.5) / count as f64;
        let (sin, cos) = (golden_angle * i as f64).sin_cos();
        let r = (1.0 - z * z).sqrt();
        Vector::new(r * cos, r * sin, z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Isometry;
    use crate::metrics::test_shapes::cuboid;

    /// A box with one corner pushed out along its diagonal: its one family of planes holds that diagonal.
    fn lopsided() -> TriangleMesh {
        let mut mesh = cuboid(Vector::new(0.1, 0.1, 0.06));
        for p in &mut mesh.vertices {
            if p.z > 0.0 {
                // Top face shifted along +x: symmetric about y = 0 only.
                p.x += 0.03;
            }
        }
        mesh
    }

    #[test]
    fn finds_the_only_plane_of_a_sheared_box() {
        let move_it = Isometry::new(Vector::new(0.4, -0.2, 0.1), Vector::new(0.3, -0.5, 0.9));
        let (plane, error) = oracle_plane(&lopsided().transformed(&move_it), 1).expect("has area");
        let expected = Plane::new(Vector::y(), &Point::origin()).expect("a unit normal").transformed(&move_it);
        assert!(plane.normal.dot(&expected.normal).abs() > 1.0 - 1e-5, "{plane:?} {expected:?}");
        assert!(expected.signed_distance(&(move_it * Point::origin())).abs() < 1e-12);
        assert!(plane.signed_distance(&(move_it * Point::origin())).abs() < 1e-4);
        assert!(error < 2e-4, "{error}");
    }

    #[test]
    fn mirror_error_of_a_shifted_plane_is_what_it_moves() {
        // Mirroring a cube about a plane d off its centre shifts it by 2 d: end faces 2 d and less, side faces by the strip.
        let cube = cuboid(Vector::repeat(0.1));
        let at = |x: f64| Plane::new(Vector::x(), &Point::new(x, 0.0, 0.0)).expect("a unit normal");
        assert!(mirror_error(&cube, &at(0.0), 2000, 1).expect("has area") < 1e-12);
        let error = mirror_error(&cube, &at(0.002), 2000, 1).expect("has area");
        assert!((0.3e-3..1.4e-3 + 1e-4).contains(&error), "{error}");
        assert!(mirror_error(&TriangleMesh::default(), &at(0.0), 10, 1).is_none());
    }
}
