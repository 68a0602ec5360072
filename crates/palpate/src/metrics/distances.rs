use super::quantile;
use serde::{Deserialize, Serialize};

/// Samples of one surface against another surface: how far, and how well the normals agree.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SampleDistances {
    /// Distance of each sample to the other surface, metres.
    pub distances: Vec<f64>,
    /// Dot product of the sample's face normal with that of the nearest face.
    pub normal_dots: Vec<f64>,
}

impl SampleDistances {
    /// The samples for which `keep` is true.
    pub(super) fn filtered(&self, keep: &[bool]) -> Self {
        let kept = |values: &[f64]| values.iter().zip(keep).filter(|(_, k)| **k).map(|(v, _)| *v).collect();
        Self { distances: kept(&self.distances), normal_dots: kept(&self.normal_dots) }
    }

    fn mean(&self, value: impl Fn(f64) -> f64) -> f64 {
        mean(self.distances.iter().map(|&d| value(d)))
    }

    fn share_within(&self, threshold: f64) -> f64 {
        self.mean(|d| if d < threshold { 1.0 } else { 0.0 })
    }
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    values.sum::<f64>() / count
}

/// Distances between two surfaces, both ways, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Distances {
    /// **Sum** of the two mean squared distances, mm².
    pub chamfer_squared_mm2: f64,
    /// **Half** the sum of the two mean distances, mm.
    pub chamfer_mean_mm: f64,
    /// Mean distance of the prediction to the truth, mm.
    pub accuracy_mm: f64,
    /// Mean distance of the truth to the prediction, mm.
    pub completeness_mm: f64,
    /// The larger of the two 95 % quantiles of distance, mm.
    pub hausdorff95_mm: f64,
    /// Mean dot product of the normals at nearest points, mean of both ways: 1 = parallel, −1 = inside out. Where the nearest
    /// point lies on an edge, either face may give the normal: on coarse meshes it is no invariant of rigid motion.
    pub normal_consistency: f64,
    /// Harmonic mean of the shares of both surfaces within 1 mm of the other.
    pub f_score_1mm: f64,
    /// The same within 2 mm.
    pub f_score_2mm: f64,
    /// The same within 5 mm.
    pub f_score_5mm: f64,
}

impl Distances {
    /// Sums up both ways: samples of the prediction against the truth, and of the truth against the prediction.
    ///
    /// `None` if either way has no sample. F-score: Knapitsch et al., *Tanks and Temples*, ACM ToG 2017, §4.
    pub fn new(predicted: &SampleDistances, truth: &SampleDistances) -> Option<Self> {
        if predicted.distances.is_empty() || truth.distances.is_empty() {
            return None;
        }
        let (accuracy, completeness) = (predicted.mean(|d| d) * 1e3, truth.mean(|d| d) * 1e3);
        let f_score = |threshold_mm: f64| {
            let (p, r) = (predicted.share_within(threshold_mm * 1e-3), truth.share_within(threshold_mm * 1e-3));
            if p + r > 0.0 { 2.0 * p * r / (p + r) } else { 0.0 }
        };
        let q95 = |s: &SampleDistances| quantile(&s.distances, 0.95).unwrap_or(0.0);
        let normals = |s: &SampleDistances| mean(s.normal_dots.iter().copied());
        Some(Self {
            chamfer_squared_mm2: (predicted.mean(|d| d * d) + truth.mean(|d| d * d)) * 1e6,
            chamfer_mean_mm: 0.5 * (accuracy + completeness),
            accuracy_mm: accuracy,
            completeness_mm: completeness,
            hausdorff95_mm: q95(predicted).max(q95(truth)) * 1e3,
            normal_consistency: 0.5 * (normals(predicted) + normals(truth)),
            f_score_1mm: f_score(1.0),
            f_score_2mm: f_score(2.0),
            f_score_5mm: f_score(5.0),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(distances: &[f64], normal_dot: f64) -> SampleDistances {
        SampleDistances { distances: distances.to_vec(), normal_dots: vec![normal_dot; distances.len()] }
    }

    #[test]
    fn formulas_by_hand() {
        // mm: 0.5, 1.5 against 3, 3, 3, 6.
        let d = Distances::new(&samples(&[0.5e-3, 1.5e-3], 1.0), &samples(&[3e-3, 3e-3, 3e-3, 6e-3], 0.5));
        let d = d.expect("both ways have samples");
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-9, "{a} is not {b}");
        close(d.chamfer_squared_mm2, f64::midpoint(0.25, 2.25) + (27.0 + 36.0) / 4.0);
        close(d.chamfer_mean_mm, f64::midpoint(1.0, 3.75));
        close(d.accuracy_mm, 1.0);
        close(d.completeness_mm, 3.75);
        close(d.hausdorff95_mm, 3.0 + 0.85 * 3.0);
        close(d.normal_consistency, 0.75);
        close(d.f_score_1mm, 0.0);
        close(d.f_score_5mm, 2.0 * 0.75 / 1.75);
    }

    #[test]
    fn nothing_to_compare_is_none() {
        assert!(Distances::new(&samples(&[], 1.0), &samples(&[1.0], 1.0)).is_none());
    }
}
