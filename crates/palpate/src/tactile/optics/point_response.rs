//! What the whole gel does when one spot of it is moved.

/// Motion of a spot of the gel per unit motion of a loaded spot: z by a press; x and y by a press and by drags along x and y.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Influence {
    pub(super) zz: f64,
    pub(super) xz: f64,
    pub(super) yz: f64,
    pub(super) xx: f64,
    /// Of x by y and of y by x: the two are equal.
    pub(super) xy: f64,
    pub(super) yy: f64,
}

/// The gel's answer to a load on one spot, by distance: four profiles, 0.05 mm apart.
///
/// A press moves by (R cos t, R sin t, N) at angle t; a drag along x by A cos t outward and −B sin t across.
#[derive(Debug, Clone)]
pub(super) struct PointResponse {
    /// (N, R, A, B) at each distance.
    profiles: Vec<[f64; 4]>,
}

impl PointResponse {
    const STEP_MM: f64 = 0.05;

    pub(super) fn taxim() -> Self {
        const PACKED: &[u8] = include_bytes!("../../../assets/taxim/markers.bin");
        let count = PACKED.len() / 16;
        let value = |i: usize| {
            let bytes = &PACKED[4 * i..4 * i + 4];
            f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
        };
        Self { profiles: (0..count).map(|i| [0, 1, 2, 3].map(|p| value(p * count + i))).collect() }
    }

    /// At offset (x, y) from the load, millimetres; nothing beyond the gel's clamped edge.
    fn at(&self, x: f64, y: f64) -> Influence {
        let r = x.hypot(y);
        let (low, share) = ((r / Self::STEP_MM) as usize, (r / Self::STEP_MM).fract());
        let (Some(below), Some(above)) = (self.profiles.get(low), self.profiles.get(low + 1)) else {
            return Influence::default();
        };
        let [n, radial, along, across] = [0, 1, 2, 3].map(|p| below[p] + share * (above[p] - below[p]));
        let (cos, sin) = if r > 0.0 { (x / r, y / r) } else { (1.0, 0.0) };
        Influence {
            zz: n,
            xz: radial * cos,
            yz: radial * sin,
            xx: along * cos * cos + across * sin * sin,
            xy: (along - across) * sin * cos,
            yy: along * sin * sin + across * cos * cos,
        }
    }

    /// [`Self::at`] for a load spread over a square cell: what makes the loads' size fall with the cell's area.
    fn averaged(&self, x: f64, y: f64, cell: f64) -> Influence {
        const SAMPLES: usize = 4;
        if x.hypot(y) > 4.0 * cell {
            return self.at(x, y);
        }
        let place = |i: usize| ((i as f64 + 0.5) / SAMPLES as f64 - 0.5) * cell;
        let mut sum = Influence::default();
        for i in 0..SAMPLES * SAMPLES {
            let one = self.at(x - place(i % SAMPLES), y - place(i / SAMPLES));
            sum.zz += one.zz;
            sum.xz += one.xz;
            sum.yz += one.yz;
            sum.xx += one.xx;
            sum.xy += one.xy;
            sum.yy += one.yy;
        }
        let n = (SAMPLES * SAMPLES) as f64;
        Influence { zz: sum.zz / n, xz: sum.xz / n, yz: sum.yz / n, xx: sum.xx / n, xy: sum.xy / n, yy: sum.yy / n }
    }
}

/// Averaged influences at whole steps of a lattice; the other quadrants follow by symmetry.
pub(super) struct InfluenceTable {
    cols: usize,
    quadrant: Vec<Influence>,
}

impl InfluenceTable {
    pub(super) fn new(response: &PointResponse, (rows, cols): (usize, usize), step_mm: f64, cell_mm: f64) -> Self {
        let at = |i: usize| response.averaged((i % cols) as f64 * step_mm, (i / cols) as f64 * step_mm, cell_mm);
        Self { cols, quadrant: (0..rows * cols).map(at).collect() }
    }

    pub(super) fn at(&self, rows: isize, cols: isize) -> Influence {
        let mut influence = self.quadrant[rows.unsigned_abs() * self.cols + cols.unsigned_abs()];
        if cols < 0 {
            influence.xz = -influence.xz;
            influence.xy = -influence.xy;
        }
        if rows < 0 {
            influence.yz = -influence.yz;
            influence.xy = -influence.xy;
        }
        influence
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loaded_spot_moves_as_it_is_moved_and_the_edge_of_the_gel_does_not() {
        let response = PointResponse::taxim();
        let t = response.at(0.0, 0.0);
        assert_eq!((t.zz, t.xx, t.yy, t.xy, t.xz, t.yz), (1.0, 1.0, 1.0, 0.0, 0.0, 0.0));
        let t = response.at(-14.0, 11.0);
        assert_eq!((t.zz, t.xx, t.yy), (0.0, 0.0, 0.0));
        assert!(response.at(1.0, 0.0).zz > response.at(2.0, 0.0).zz);
    }

    #[test]
    fn every_quadrant_of_the_table_is_the_response_itself() {
        let response = PointResponse::taxim();
        let table = InfluenceTable::new(&response, (9, 9), 0.3, 0.6);
        for (row, col) in [(3, 5), (-3, 5), (3, -5), (-3, -5), (-8, 0), (0, -8), (0, 0)] {
            let (a, b) = (table.at(row, col), response.averaged(col as f64 * 0.3, row as f64 * 0.3, 0.6));
            let pairs = [(a.zz, b.zz), (a.xz, b.xz), (a.yz, b.yz), (a.xx, b.xx), (a.xy, b.xy), (a.yy, b.yy)];
            assert!(pairs.iter().all(|(a, b)| (a - b).abs() < 1e-12), "{row} {col}: {a:?} {b:?}");
        }
    }
}
