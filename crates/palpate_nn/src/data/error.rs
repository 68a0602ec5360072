use palpate::io::IoError;

/// Why training data cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DataError {
    /// A file cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The data set holds nothing.
    #[error("the data set {name} holds no presses; make some first (palpate presses --help)")]
    Empty {
        /// Folder or name of the set.
        name: String,
    },
    /// No press of the set belongs to a part that is needed.
    #[error("split '{split}': none of the {presses} presses ({objects} objects) belongs to its {part} part")]
    EmptyPart {
        /// Name of the split.
        split: String,
        /// Train, validation or test.
        part: &'static str,
        /// Presses in the set.
        presses: usize,
        /// Objects in the set.
        objects: usize,
    },
    /// An object matches no part of the split.
    #[error("split '{split}' does not say where object '{object}' belongs")]
    Unassigned {
        /// Name of the split.
        split: String,
        /// The object.
        object: String,
    },
    /// Rasters of one sample differ in size.
    #[error("press {index} of '{object}': image, height map and mask differ in size: {sizes:?} (rows, cols)")]
    Sizes {
        /// Index in the set.
        index: usize,
        /// Its object.
        object: String,
        /// Rows and columns of the three.
        sizes: [(usize, usize); 3],
    },
}
