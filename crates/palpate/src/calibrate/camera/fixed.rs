use nalgebra::DMatrix;

/// Which parameters keep their value: 0 for the distortion, the image's middle for the principal point, the start's otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Fixed {
    /// fx = fy (or the start's ratio).
    pub aspect: bool,
    /// cx and cy.
    pub principal_point: bool,
    /// fx and fy.
    pub focal: bool,
    /// k1.
    pub k1: bool,
    /// k2.
    pub k2: bool,
    /// p1 and p2.
    pub tangential: bool,
    /// k3.
    pub k3: bool,
}

impl Fixed {
    /// All intrinsic parameters: only the poses are sought.
    pub const ALL: Self =
        Self { aspect: false, principal_point: true, focal: true, k1: true, k2: true, tangential: true, k3: true };

    /// fx, fy, cx, cy, k1, k2, p1, p2, k3 as a linear map of the free parameters.
    ///
    /// * `ratio` – fy / fx
    pub(super) fn free(self, ratio: f64) -> DMatrix<f64> {
        let mut columns: Vec<[f64; 9]> = Vec::new();
        let mut free = |parameter: usize| {
            let mut column = [0.0; 9];
            column[parameter] = 1.0;
            columns.push(column);
        };
        let keep = [
            self.focal || self.aspect,
            self.focal || self.aspect,
            self.principal_point,
            self.principal_point,
            self.k1,
            self.k2,
            self.tangential,
            self.tangential,
            self.k3,
        ];
        (0..9).filter(|&i| !keep[i]).for_each(&mut free);
        if self.aspect && !self.focal {
            let mut column = [0.0; 9];
            (column[0], column[1]) = (1.0, ratio);
            columns.push(column);
        }
        DMatrix::from_fn(9, columns.len(), |r, c| columns[c][r])
    }
}
