use super::{DataError, Samples};
use palpate::io::{ObjectSplit, SplitPart};
use std::collections::BTreeSet;

/// Indices of the presses of each part of a split.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Parts {
    /// Presses for training.
    pub train: Vec<usize>,
    /// Presses for validation.
    pub validation: Vec<usize>,
    /// Presses for the test.
    pub test: Vec<usize>,
}

impl Parts {
    /// The presses of each part; train and validation are not empty.
    ///
    /// # Errors
    /// [`DataError::Empty`], [`DataError::Unassigned`], [`DataError::EmptyPart`].
    pub fn of(samples: &dyn Samples, split: &ObjectSplit) -> Result<Self, DataError> {
        if samples.is_empty() {
            return Err(DataError::Empty { name: samples.name() });
        }
        let mut parts = Self::default();
        for index in 0..samples.len() {
            let object = samples.object(index);
            match split.part(object) {
                Some(SplitPart::Train) => parts.train.push(index),
                Some(SplitPart::Validation) => parts.validation.push(index),
                Some(SplitPart::Test) => parts.test.push(index),
                None => {
                    return Err(DataError::Unassigned { split: split.name.clone(), object: object.to_owned() });
                }
            }
        }
        for (part, indices) in [("train", &parts.train), ("validation", &parts.validation)] {
            if indices.is_empty() {
                let objects = (0..samples.len()).map(|i| samples.object(i)).collect::<BTreeSet<_>>().len();
                return Err(DataError::EmptyPart { split: split.name.clone(), part, presses: samples.len(), objects });
            }
        }
        Ok(parts)
    }
}
