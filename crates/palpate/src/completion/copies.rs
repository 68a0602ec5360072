use super::correction::Correction;
use super::motion::Copying;
use crate::evidence::{Provenance, Sample, cell_and_side};
use crate::geometry::{Point, Vector};
use rayon::prelude::*;

/// Copies that share a cell of this side, and face the same way, become one, metres. An axis lays dozens of copies of every
/// sample over one another, where the samples are a millimetre or two apart.
pub(super) const OVERLAP: f64 = 1e-3;

/// The samples moved by the motions of one family, where symmetry puts them: those that stay in the orbit, overlapping ones averaged; and
/// those of outcasts.
///
/// * `members` – number of the copying and the copying
///
/// O(n log n) in samples · motions.
pub(super) fn copies(samples: &[Sample], members: &[(u32, &Copying)], outcast: &[bool]) -> (Vec<Sample>, Vec<Sample>) {
    let [within, out] = [false, true].map(|wanted| {
        let of = samples.iter().zip(outcast).filter(move |(_, out)| **out == wanted).map(|(s, _)| s);
        members.par_iter().flat_map_iter(|(m, c)| of.clone().map(|s| copy_of(s, c, *m))).collect::<Vec<_>>()
    });
    if members.len() < 2 { (within, out) } else { (averaged(&within), out) }
}

/// The copy of a sample by copying number `m`.
pub(super) fn copy_of(sample: &Sample, copying: &Copying, m: u32) -> Sample {
    Sample {
        position: copying.motion.point(&sample.position),
        normal: copying.motion.vector(&sample.normal),
        sigma: sample.sigma.hypot(2e-3),
        provenance: Provenance::Moved { motion: m },
    }
}

/// A copy, moved by what its family misses there.
pub(super) fn corrected(copy: Sample, correction: &Correction) -> Sample {
    let miss = correction.shift(&(copy.position, copy.normal));
    Sample { position: copy.position + copy.normal * miss, ..copy }
}

/// The copies of several families, of which those that overlap become one that weighs as much as they did together.
pub(super) fn merged(copies: &[Sample], weights: &[f64]) -> (Vec<Sample>, Vec<f64>) {
    let of = |group: &[Keyed]| {
        let weight = |i: &u32| weights[*i as usize];
        (mean(copies, group, weight), group.iter().map(|(_, i)| weight(i)).sum::<f64>())
    };
    let keyed = keyed(copies);
    groups(&keyed).par_iter().map(|group| of(group)).unzip()
}

/// One sample for each cell and side, in their order.
fn averaged(copies: &[Sample]) -> Vec<Sample> {
    let keyed = keyed(copies);
    groups(&keyed).par_iter().map(|group| mean(copies, group, |_| 1.0)).collect()
}

/// Cell and side of a copy, and its number.
type Keyed = ([i32; 6], u32);

/// The copies, in the order of their cells and sides.
fn keyed(copies: &[Sample]) -> Vec<Keyed> {
    let key = |(i, s): (usize, &Sample)| (cell_and_side(&s.position, &s.normal, OVERLAP), i as u32);
    let mut keyed: Vec<Keyed> = copies.par_iter().enumerate().map(key).collect();
    keyed.par_sort_unstable();
    keyed
}

fn groups(keyed: &[Keyed]) -> Vec<&[Keyed]> {
    keyed.chunk_by(|a, b| a.0 == b.0).collect()
}

/// The weighted mean, with the provenance of the first.
fn mean(copies: &[Sample], group: &[Keyed], weight: impl Fn(&u32) -> f64) -> Sample {
    let first = &copies[group[0].1 as usize];
    let (mut position, mut normal, mut sigma, mut sum) = (Vector::zeros(), Vector::zeros(), 0.0, 0.0);
    for (_, i) in group {
        let (s, w) = (&copies[*i as usize], weight(i));
        position += s.position.coords * w;
        normal += s.normal * w;
        sigma += s.sigma * w;
        sum += w;
    }
    if sum <= 0.0 {
        return *first;
    }
    Sample {
        position: Point::from(position / sum),
        normal: normal.try_normalize(1e-9).unwrap_or(first.normal),
        sigma: sigma / sum,
        ..*first
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::symmetry::SymmetryElement;

    #[test]
    fn copies_round_an_axis_that_overlap_become_one_on_the_surface() {
        let axis = SymmetryElement::Axis { point: Point::origin(), direction: Vector::z_axis(), order: None };
        let turns = axis.motions(40).into_iter().map(|motion| Copying { motion, score: 1.0, family: 0 });
        let turns: Vec<Copying> = turns.collect();
        let members: Vec<(u32, &Copying)> = (0..).zip(&turns).collect();
        // A quarter of a cylinder of 40 mm, a sample each 1.3 mm and one that is out.
        let samples: Vec<Sample> = (0..40 * 48)
            .map(|i| {
                let (row, a) = (i / 48, f64::from(i % 48) * 0.0325);
                let normal = Vector::new(a.cos(), a.sin(), 0.0);
                let position = Point::from(normal * 0.04 + Vector::z() * f64::from(row) * 1.3e-3);
                Sample { position, normal, sigma: 1e-3, provenance: Provenance::Seen }
            })
            .collect();
        let outcast: Vec<bool> = (0..samples.len()).map(|i| i == 7).collect();
        let (within, out) = copies(&samples, &members, &outcast);
        let all = samples.len() * members.len();
        assert_eq!(out.len(), members.len());
        assert!(within.len() * 3 < all, "{} of {all} are left", within.len());
        for s in &within {
            let flat = Vector::new(s.position.x, s.position.y, 0.0);
            assert!((flat.norm() - 0.04).abs() < 2e-5 && flat.normalize().dot(&s.normal) > 0.999, "{s:?}");
        }
        // A patch of 1 cm² on the hidden side is as full as cells are.
        let here = |s: &&Sample| s.normal.x < -0.992 && (0.02..0.03).contains(&s.position.z);
        assert!(within.iter().filter(here).count() as f64 > 0.6 * 1e-4 / (OVERLAP * OVERLAP));
    }

    #[test]
    fn copies_of_several_families_become_one_and_weigh_as_much() {
        let copy = |x: f64, up: f64, motion: u32| Sample {
            position: Point::new(x, 1e-4, 1e-4),
            normal: Vector::z() * up,
            sigma: 1e-3,
            provenance: Provenance::Moved { motion },
        };
        // Two in one cell, one in another, one there that faces the other way.
        let copies = [copy(1e-4, 1.0, 0), copy(4.1e-3, 1.0, 0), copy(9e-4, 1.0, 5), copy(2e-4, -1.0, 5)];
        let (kept, weights) = merged(&copies, &[0.1, 0.1, 0.3, 0.3]);
        let found = |x: f64, up: f64| {
            let here = |s: &Sample| (s.position.x - x).abs() < 1e-12 && s.normal.z == up;
            kept.iter().position(here).map(|i| weights[i])
        };
        assert_eq!(kept.len(), 3, "{kept:?}");
        assert!((found(7e-4, 1.0).expect("their weighted mean") - 0.4).abs() < 1e-12);
        assert_eq!(found(4.1e-3, 1.0), Some(0.1));
        assert_eq!(found(2e-4, -1.0), Some(0.3), "the other side of a thin part stays its own");
        assert!((weights.iter().sum::<f64>() - 0.8).abs() < 1e-12);
    }
}
