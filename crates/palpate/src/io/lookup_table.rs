//! The colour table of the YCB-Sight release, as two NumPy arrays in a folder.

use super::{IoError, read_npy};
use crate::tactile::LookupTable;
use std::path::Path;

/// Reads `reconstruct_calib_grad_mag.npy` and `reconstruct_calib_grad_dir.npy` (or the same without `reconstruct_calib_`): the
/// arrays of `reconstruct_calib.npz`, unpacked.
///
/// # Errors
/// [`IoError`] with the file, or with the folder if the arrays are no table.
pub fn read_lookup_table(folder: impl AsRef<Path>) -> Result<LookupTable, IoError> {
    let folder = folder.as_ref();
    let read = |name: &str| {
        let long = folder.join(format!("reconstruct_calib_{name}.npy"));
        let short = folder.join(format!("{name}.npy"));
        read_npy(if short.is_file() { short } else { long })
    };
    let (magnitude, direction) = (read("grad_mag")?, read("grad_dir")?);
    LookupTable::from_arrays((&magnitude.shape, &magnitude.values), (&direction.shape, &direction.values))
        .map_err(|error| IoError::content(folder, error.to_string()))
}
