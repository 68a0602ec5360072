use super::WeightedSample;
use super::level::Level;

/// [`clean`] of a part of a grid that was clean: what reaches the part's border is taken to go on beyond it.
///
/// * `needed` – weight of samples from which an isolated component is kept
pub(super) fn clean_part(level: &mut Level, samples: &[WeightedSample], needed: f64) {
    let labels = Labels::new(level, true);
    let (open, held) = (labels.open(level), labels.held(level, samples));
    labels.drop_unless(level, |c| open[c] || held[c] > needed);
    fill_cavities(level);
}

/// Removes what no evidence asks for: negative components without samples and enclosed positive cavities.
///
/// Keeps the largest negative component and those that carry more than `share` of the weight of the `samples`; everything else becomes
/// outside and every positive region that does not reach the border becomes inside. Works on runs along x with union–find: O(nodes).
pub(super) fn clean(level: &mut Level, samples: &[WeightedSample], share: f64) {
    drop_small_solids(level, samples, share);
    fill_cavities(level);
}

fn drop_small_solids(level: &mut Level, samples: &[WeightedSample], share: f64) {
    let labels = Labels::new(level, true);
    if labels.count() < 2 {
        return;
    }
    let held = labels.held(level, samples);
    let total = held.iter().sum::<f64>();
    let largest = (0..labels.count()).max_by_key(|&c| (labels.sizes[c], usize::MAX - c));
    labels.drop_unless(level, |c| Some(c) == largest || (total > 0.0 && held[c] > share * total));
}

fn fill_cavities(level: &mut Level) {
    let labels = Labels::new(level, false);
    let open = labels.open(level);
    for (run, &label) in labels.runs.iter().zip(&labels.label) {
        if !open[label] {
            level.values[run.start..run.end].iter_mut().for_each(|v| *v = -v.abs().max(0.05));
        }
    }
}

struct Run {
    start: usize,
    end: usize,
}

/// Face-connected components of the negative (or the non-negative) nodes.
struct Labels {
    runs: Vec<Run>,
    /// First run of each row (j, k); one more entry at the end.
    rows: Vec<usize>,
    label: Vec<usize>,
    sizes: Vec<usize>,
}

impl Labels {
    fn new(level: &Level, negative: bool) -> Self {
        let nx = level.dims[0];
        let mut runs = Vec::new();
        let mut rows = Vec::with_capacity(level.dims[1] * level.dims[2] + 1);
        for (row, values) in level.values.chunks(nx).enumerate() {
            rows.push(runs.len());
            let mut i = 0;
            while i < nx {
                if (values[i] < 0.0) == negative {
                    let start = i;
                    while i < nx && (values[i] < 0.0) == negative {
                        i += 1;
                    }
                    runs.push(Run { start: row * nx + start, end: row * nx + i });
                } else {
                    i += 1;
                }
            }
        }
        rows.push(runs.len());
        let mut parent: Vec<usize> = (0..runs.len()).collect();
        let ny = level.dims[1];
        for row in 0..rows.len() - 1 {
            if row % ny > 0 {
                join_rows(&runs, &rows, row, row - 1, nx, &mut parent);
            }
            if row >= ny {
                join_rows(&runs, &rows, row, row - ny, nx, &mut parent);
            }
        }
        let mut number = vec![usize::MAX; runs.len()];
        let mut sizes = Vec::new();
        let label = (0..runs.len())
            .map(|r| {
                let root = find(&mut parent, r);
                if number[root] == usize::MAX {
                    number[root] = sizes.len();
                    sizes.push(0);
                }
                sizes[number[root]] += runs[r].end - runs[r].start;
                number[root]
            })
            .collect();
        Self { runs, rows, label, sizes }
    }

    fn count(&self) -> usize {
        self.sizes.len()
    }

    /// Which components reach the border of the grid.
    fn open(&self, level: &Level) -> Vec<bool> {
        let [nx, ny, nz] = level.dims;
        let mut open = vec![false; self.count()];
        for (run, &label) in self.runs.iter().zip(&self.label) {
            let (j, k) = (run.start / nx % ny, run.start / (nx * ny));
            let at_end = run.start % nx == 0 || run.end % nx == 0;
            open[label] |= at_end || j == 0 || k == 0 || j + 1 == ny || k + 1 == nz;
        }
        open
    }

    /// What the samples weigh that each component carries.
    fn held(&self, level: &Level, samples: &[WeightedSample]) -> Vec<f64> {
        let mut held = vec![0.0; self.count()];
        for s in samples {
            // The sample lies on the surface: any inside corner of its cell tells the component.
            let Some((b, _)) = level.locate(&s.position) else { continue };
            let corner = (0..8).map(|c| level.index(b[0] + (c & 1), b[1] + (c >> 1 & 1), b[2] + (c >> 2)));
            if let Some(label) = corner.filter(|&n| level.values[n] < 0.0).find_map(|n| self.of(level, n)) {
                held[label] += s.weight;
            }
        }
        held
    }

    /// Makes the other components outside.
    fn drop_unless(&self, level: &mut Level, keep: impl Fn(usize) -> bool) {
        let keep: Vec<bool> = (0..self.count()).map(keep).collect();
        for (run, &label) in self.runs.iter().zip(&self.label) {
            if !keep[label] {
                level.values[run.start..run.end].iter_mut().for_each(|v| *v = v.abs().max(0.05));
            }
        }
    }

    fn of(&self, level: &Level, node: usize) -> Option<usize> {
        let row = node / level.dims[0];
        (self.rows[row]..self.rows[row + 1])
            .find(|&r| self.runs[r].start <= node && node < self.runs[r].end)
            .map(|r| self.label[r])
    }
}

fn join_rows(runs: &[Run], rows: &[usize], a: usize, b: usize, nx: usize, parent: &mut [usize]) {
    let (mut i, mut j) = (rows[a], rows[b]);
    while i < rows[a + 1] && j < rows[b + 1] {
        let (ra, rb) = (&runs[i], &runs[j]);
        let (sa, ea, sb, eb) = (ra.start - a * nx, ra.end - a * nx, rb.start - b * nx, rb.end - b * nx);
        if sa < eb && sb < ea {
            let (x, y) = (find(parent, i), find(parent, j));
            parent[x.max(y)] = x.min(y);
        }
        if ea < eb {
            i += 1;
        } else {
            j += 1;
        }
    }
}

fn find(parent: &mut [usize], mut x: usize) -> usize {
    while parent[x] != x {
        parent[x] = parent[parent[x]];
        x = parent[x];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Point, Vector};

    #[test]
    fn keeps_the_anchored_solid_and_fills_the_hole_in_it() {
        let mut l = Level::covering(&Aabb { min: Point::origin(), max: Point::new(19.0, 9.0, 9.0) }, 1.0);
        let set = |l: &mut Level, x: std::ops::Range<usize>, yz: std::ops::Range<usize>, v: f32| {
            for k in yz.clone() {
                for j in yz.clone() {
                    for i in x.clone() {
                        let n = l.index(i, j, k);
                        l.values[n] = v;
                    }
                }
            }
        };
        set(&mut l, 2..9, 2..9, -1.0);
        set(&mut l, 5..6, 5..6, 1.0); // a hidden bubble
        set(&mut l, 14..16, 3..5, -1.0); // a ghost
        let sample = |x: f64, weight: f64| WeightedSample {
            position: Point::new(x, 4.0, 4.0),
            normal: Vector::x(),
            weight,
            orientation: weight,
        };
        let mut touched = l.clone();
        clean(&mut touched, &[sample(2.0, 100.0), sample(14.0, 5.0)], 0.02);
        assert!(touched.values[touched.index(14, 3, 3)] < 0.0, "what was felt is no ghost");
        clean(&mut l, &[sample(2.0, 100.0), sample(14.0, 1.0)], 0.02);
        assert!(l.values[l.index(5, 5, 5)] < 0.0);
        assert!(l.values[l.index(14, 3, 3)] > 0.0);
        assert!(l.values[l.index(2, 2, 2)] < 0.0);
    }
}
