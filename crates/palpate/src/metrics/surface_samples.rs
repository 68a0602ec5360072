use crate::geometry::{Point, TriangleMesh};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

/// Points spread over a mesh, each with the face it lies on, in the order of the faces.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceSamples {
    /// Positions, metres.
    pub points: Vec<Point>,
    /// Face of each point.
    pub faces: Vec<usize>,
}

impl SurfaceSamples {
    /// Draws `count` points, uniform by area.
    ///
    /// The cumulative area is cut into `count` equal strata with one draw in each: unbiased like independent draws, with
    /// less variance, and neighbours in the list are neighbours on the mesh. Inside a triangle: Osada et al., *Shape
    /// Distributions*, ACM ToG 2002, eq. 1. Zero-area faces get nothing; a mesh without area gives no sample.
    pub fn draw(mesh: &TriangleMesh, count: usize, seed: u64) -> Self {
        let mut cumulative = Vec::with_capacity(mesh.faces.len());
        let mut area = 0.0;
        for face in 0..mesh.faces.len() {
            area += mesh.area_vector(face).norm();
            cumulative.push(area);
        }
        let mut samples = Self { points: Vec::new(), faces: Vec::new() };
        if !(area > 0.0 && area.is_finite()) {
            return samples;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut face = 0;
        for stratum in 0..count {
            let at = (stratum as f64 + rng.random::<f64>()) / count as f64 * area;
            // The last faces may be degenerate, so stop on the one where the area is reached.
            while cumulative[face] <= at && cumulative[face] < area {
                face += 1;
            }
            let [a, b, c] = mesh.triangle(face);
            let (r, s) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
            samples.points.push(a + (b - a) * (r * (1.0 - s)) + (c - a) * (r * s));
            samples.faces.push(face);
        }
        samples
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles of area 1/2 and 3/2, with a degenerate one before, between and after.
    fn two_triangles() -> TriangleMesh {
        let vertices = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [3., 0., 5.], [0., 1., 5.], [0., 0., 5.]];
        let faces = vec![[0, 0, 1], [0, 1, 2], [1, 2, 2], [5, 3, 4], [3, 3, 3]];
        TriangleMesh::new(vertices.map(Point::from).to_vec(), faces).expect("indices are valid")
    }

    #[test]
    fn each_face_gets_its_share_of_the_area() {
        let samples = SurfaceSamples::draw(&two_triangles(), 4000, 1);
        let on = |face| samples.faces.iter().filter(|&&f| f == face).count();
        assert_eq!([on(0), on(1), on(2), on(3), on(4)], [0, 1000, 0, 3000, 0]);
    }

    #[test]
    fn samples_are_uniform_inside_a_triangle() {
        let samples = SurfaceSamples::draw(&two_triangles(), 40_000, 2);
        let first: Vec<_> = samples.points.iter().filter(|p| p.z == 0.0).collect();
        let n = first.len() as f64;
        // Mean of x over the unit right triangle is 1/3, of x² 1/6, of xy 1/12.
        assert!((first.iter().map(|p| p.x).sum::<f64>() / n - 1.0 / 3.0).abs() < 0.005);
        assert!((first.iter().map(|p| p.x * p.x).sum::<f64>() / n - 1.0 / 6.0).abs() < 0.005);
        assert!((first.iter().map(|p| p.x * p.y).sum::<f64>() / n - 1.0 / 12.0).abs() < 0.005);
    }

    #[test]
    fn seed_decides_and_no_area_gives_nothing() {
        let mesh = two_triangles();
        assert_eq!(SurfaceSamples::draw(&mesh, 50, 3), SurfaceSamples::draw(&mesh, 50, 3));
        assert_ne!(SurfaceSamples::draw(&mesh, 50, 3), SurfaceSamples::draw(&mesh, 50, 4));
        let line = TriangleMesh::new(mesh.vertices, vec![[0, 1, 1]]).expect("indices are valid");
        assert!(SurfaceSamples::draw(&line, 50, 3).is_empty());
    }
}
