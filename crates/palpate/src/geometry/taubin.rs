use super::{TriangleMesh, Vector};

/// Steps towards and away from the neighbours' mean; their pass band is 1/λ + 1/μ = 0.1, as in the paper.
const SHRINK: f64 = 0.330;
const GROW: f64 = -0.341;

/// The mesh with noise smoothed away and its volume nearly kept: each round moves every vertex towards the mean of its neighbours and then back by a
/// little more. Vertices on a boundary move along with their boundary neighbours only.
///
/// * `rounds` – pairs of steps; 10 removes noise of an edge length, 50 rounds off corners
///
/// # References
/// Taubin, *A signal processing approach to fair surface design*, SIGGRAPH 1995, §3: λ = 0.330, and μ from k = 1/λ + 1/μ = 0.1.
pub fn taubin_smoothed(mesh: &TriangleMesh, rounds: usize) -> TriangleMesh {
    let neighbours = neighbours(mesh);
    let mut smooth = mesh.clone();
    for step in (0..2 * rounds).map(|k| if k % 2 == 0 { SHRINK } else { GROW }) {
        let old = smooth.vertices.clone();
        for (v, near) in smooth.vertices.iter_mut().zip(&neighbours) {
            if !near.is_empty() {
                let sum: Vector = near.iter().map(|&n| old[n as usize].coords).sum();
                let to_mean = sum / near.len() as f64 - v.coords;
                *v += to_mean * step;
            }
        }
    }
    smooth
}

/// For each vertex those it shares an edge with; for a boundary vertex those along the boundary.
fn neighbours(mesh: &TriangleMesh) -> Vec<Vec<u32>> {
    let mut edges: Vec<(u32, u32)> =
        mesh.faces.iter().flat_map(|f| [0, 1, 2].map(|k| (f[k], f[(k + 1) % 3]))).filter(|e| e.0 != e.1).collect();
    edges.extend(edges.clone().iter().map(|&(a, b)| (b, a)));
    edges.sort_unstable();
    let count = |e: &[(u32, u32)]| e.len();
    let mut all = vec![Vec::new(); mesh.vertices.len()];
    let mut boundary = vec![Vec::new(); mesh.vertices.len()];
    // An edge of two faces is named twice from each end, one of one face once.
    for edge in edges.chunk_by(|a, b| a == b) {
        let (a, b) = edge[0];
        all[a as usize].push(b);
        if count(edge) == 1 {
            boundary[a as usize].push(b);
        }
    }
    all.into_iter().zip(boundary).map(|(all, boundary)| if boundary.is_empty() { all } else { boundary }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_pcg::Pcg64Mcg;

    /// An n × n sheet of spacing 1.
    fn sheet(n: u32) -> TriangleMesh {
        let vertices = (0..n * n).map(|k| Point::new(f64::from(k % n), f64::from(k / n), 0.0)).collect();
        let at = |x: u32, y: u32| y * n + x;
        let square = |k: u32| {
            let (x, y) = (k % (n - 1), k / (n - 1));
            [[at(x, y), at(x + 1, y), at(x + 1, y + 1)], [at(x, y), at(x + 1, y + 1), at(x, y + 1)]]
        };
        TriangleMesh::new(vertices, (0..(n - 1) * (n - 1)).flat_map(square).collect()).expect("valid")
    }

    #[test]
    fn noise_goes_and_the_border_stays_in_its_plane() {
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        let mut mesh = sheet(30);
        mesh.vertices.iter_mut().for_each(|v| v.z = rng.random_range(-0.5..0.5));
        let rms = |m: &TriangleMesh| (m.vertices.iter().map(|v| v.z * v.z).sum::<f64>() / 900.0).sqrt();
        let smooth = taubin_smoothed(&mesh, 20);
        assert!(rms(&smooth) < 0.5 * rms(&mesh), "{} of {}", rms(&smooth), rms(&mesh));
        assert_eq!(taubin_smoothed(&mesh, 0), mesh);
        // The border does not creep inwards.
        let flat = taubin_smoothed(&sheet(30), 20);
        let size = flat.bounds().expect("has vertices").size();
        assert!(size.x > 28.3 && size.z == 0.0, "{size}");
    }
}
