use super::Sample;
use crate::geometry::{Point, Vector};

/// Averages samples that share a voxel.
///
/// A cell whose mean normal is longer than 0.5 gives one sample; otherwise it holds surfaces that face different ways (a thin wall, an
/// edge) and gives one per octant of the normal. σ is the mean of the members, not divided by √n: what remains after denoising is mostly common to
/// neighbours. The provenance is the first member's. Order: by voxel, then octant.
pub fn average_in_voxels(samples: &[Sample], voxel: f64) -> Vec<Sample> {
    let mut keyed: Vec<([i32; 3], u8, u32)> = samples
        .iter()
        .enumerate()
        .map(|(i, s)| ([0, 1, 2].map(|a| (s.position[a] / voxel).floor() as i32), octant(&s.normal), i as u32))
        .collect();
    keyed.sort_unstable();
    let mut averaged = Vec::new();
    for cell in keyed.chunk_by(|a, b| a.0 == b.0) {
        let mean: Vector = cell.iter().map(|k| samples[k.2 as usize].normal).sum::<Vector>() / cell.len() as f64;
        if mean.norm() > 0.5 {
            averaged.extend(average(cell, samples));
        } else {
            averaged.extend(cell.chunk_by(|a, b| a.1 == b.1).filter_map(|side| average(side, samples)));
        }
    }
    averaged
}

fn octant(n: &Vector) -> u8 {
    u8::from(n.x > 0.0) | u8::from(n.y > 0.0) << 1 | u8::from(n.z > 0.0) << 2
}

fn average(members: &[([i32; 3], u8, u32)], samples: &[Sample]) -> Option<Sample> {
    let first = samples[members.first()?.2 as usize];
    let (mut position, mut normal, mut sigma) = (Vector::zeros(), Vector::zeros(), 0.0);
    for k in members {
        let s = &samples[k.2 as usize];
        position += s.position.coords;
        normal += s.normal;
        sigma += s.sigma;
    }
    let count = members.len() as f64;
    let normal = normal.try_normalize(1e-9)?;
    Some(Sample { position: Point::from(position / count), normal, sigma: sigma / count, ..first })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Provenance;

    #[test]
    fn one_sample_per_cell_but_two_for_a_thin_wall() {
        let sample = |x: f64, z: f64, up: f64| Sample {
            position: Point::new(x, 0.0005, z),
            normal: Vector::new(0.0, 0.0, up),
            sigma: 2e-4,
            provenance: Provenance::Seen,
        };
        let one_side = [sample(0.0002, 0.0011, 1.0), sample(0.0006, 0.0013, 1.0), sample(0.0031, 0.001, 1.0)];
        let averaged = average_in_voxels(&one_side, 0.002);
        assert_eq!(averaged.len(), 2);
        assert!((averaged[0].position - Point::new(0.0004, 0.0005, 0.0012)).norm() < 1e-12);
        let wall =
            [sample(0.0, 0.0011, 1.0), sample(0.0, 0.0001, -1.0), sample(0.0, 0.0013, 1.0), sample(0.0, 0.0003, -1.0)];
        let averaged = average_in_voxels(&wall, 0.002);
        assert_eq!(averaged.len(), 2);
        assert!((averaged[0].position.z - 0.0002).abs() < 1e-12 && averaged[0].normal.z == -1.0);
        assert!((averaged[1].position.z - 0.0012).abs() < 1e-12 && averaged[1].normal.z == 1.0);
    }
}
