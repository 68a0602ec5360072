use super::{ImplicitProblem, WeightedSample};
use crate::geometry::{Point, Vector};

/// Measured and guessed samples, each kind averaged in cubes of side `spacing`.
pub(super) fn merged(problem: &ImplicitProblem, spacing: f64) -> Vec<WeightedSample> {
    let mut samples = thinned(problem.measured, spacing);
    samples.extend(thinned(problem.guessed, spacing));
    samples
}

/// Averages samples in cubes. Where the normals of a cube disagree (mean shorter than 0.5: two sides of a thin wall), one sample
/// is kept per octant of the normal. O(n log n).
pub(super) fn thinned(samples: &[WeightedSample], spacing: f64) -> Vec<WeightedSample> {
    let key =
        |p: &Point| [(p.x / spacing).floor() as i32, (p.y / spacing).floor() as i32, (p.z / spacing).floor() as i32];
    let mut keyed: Vec<([i32; 3], u8, u32)> =
        samples.iter().enumerate().map(|(i, s)| (key(&s.position), octant(&s.normal), i as u32)).collect();
    keyed.sort_unstable();
    let mut out = Vec::with_capacity(keyed.len() / 2);
    for cube in keyed.chunk_by(|a, b| a.0 == b.0) {
        let all = average(cube.iter().map(|k| &samples[k.2 as usize]));
        if all.1 > 0.5 || cube.len() == 1 {
            out.push(all.0);
        } else {
            for group in cube.chunk_by(|a, b| a.1 == b.1) {
                out.push(average(group.iter().map(|k| &samples[k.2 as usize])).0);
            }
        }
    }
    out
}

fn octant(n: &Vector) -> u8 {
    u8::from(n.x < 0.0) | u8::from(n.y < 0.0) << 1 | u8::from(n.z < 0.0) << 2
}

/// The weighted mean sample and the length of its mean normal.
fn average<'a>(samples: impl Iterator<Item = &'a WeightedSample>) -> (WeightedSample, f64) {
    let (mut p, mut n, mut w, mut o, mut count) = (Vector::zeros(), Vector::zeros(), 0.0, 0.0, 0.0);
    let mut last = Vector::z();
    for s in samples {
        p += s.position.coords * s.weight;
        n += s.normal * s.weight;
        w += s.weight;
        o += s.orientation;
        count += 1.0;
        last = s.normal;
    }
    let length = n.norm() / w;
    let normal = n.try_normalize(1e-12).unwrap_or(last);
    (WeightedSample { position: Point::from(p / w), normal, weight: w / count, orientation: o / count }, length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_of_a_thin_wall_survive() {
        let at = |x: f64, n: f64| WeightedSample {
            position: Point::new(x, 0.1, 0.1),
            normal: Vector::new(n, 0.0, 0.0),
            weight: 1.0,
            orientation: 1.0,
        };
        let out = thinned(&[at(0.1, -1.0), at(0.2, -1.0), at(0.8, 1.0)], 1.0);
        assert_eq!(out.len(), 2);
        let out = thinned(&[at(0.1, 1.0), at(0.3, 1.0)], 1.0);
        assert_eq!(out.len(), 1);
        assert!((out[0].position.x - 0.2).abs() < 1e-12);
    }
}
