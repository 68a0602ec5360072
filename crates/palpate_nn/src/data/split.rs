use super::{DataError, Samples};
use palpate::io::read_text;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::path::Path;

/// Use of an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// Seen by the optimizer.
    Train,
    /// Decides which weights are kept.
    Validation,
    /// Seen by neither.
    Test,
}

impl Part {
    fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

/// Which objects are for training, validation and test: all presses of an object are on the same side.
///
/// An entry is an object's name (`004_sugar_box`), what stands before its first underscore (`004`, `072-a`), a prefix ending in a star
/// (`primitive:*`), or `*` for all objects that no other entry names.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Split {
    /// Name, for weight files.
    pub name: String,
    /// Objects seen by the optimizer.
    pub train: Vec<String>,
    /// Objects that decide which weights are kept.
    pub validation: Vec<String>,
    /// Objects seen by neither.
    #[serde(default)]
    pub test: Vec<String>,
}

/// Indices of the presses of each part.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Parts {
    /// Presses for training.
    pub train: Vec<usize>,
    /// Presses for validation.
    pub validation: Vec<usize>,
    /// Presses for the test.
    pub test: Vec<usize>,
}

impl Split {
    /// Reads a TOML file and checks it.
    ///
    /// # Errors
    /// [`DataError::Io`], [`DataError::Split`], [`DataError::Overlap`].
    pub fn open(path: &Path) -> Result<Self, DataError> {
        Self::parse(&read_text(path)?, path)
    }

    /// [`Self::open`] of a text; `path` names it in messages.
    ///
    /// # Errors
    /// Those of [`Self::open`] but the first.
    pub fn parse(text: &str, path: &Path) -> Result<Self, DataError> {
        let split: Self = toml::from_str(text)
            .map_err(|e| DataError::Split { path: path.to_owned(), reason: e.to_string().trim_end().to_owned() })?;
        let parts = split.entries();
        for (i, (first, a)) in parts.iter().enumerate() {
            for (second, b) in &parts[i + 1..] {
                if let Some(object) = a.iter().find(|x| b.iter().any(|y| same_object(x, y))) {
                    let (path, object) = (path.to_owned(), object.clone());
                    return Err(DataError::Overlap { path, object, first: first.name(), second: second.name() });
                }
            }
        }
        Ok(split)
    }

    fn entries(&self) -> [(Part, &[String]); 3] {
        [(Part::Train, &self.train), (Part::Validation, &self.validation), (Part::Test, &self.test)]
    }

    /// Where an object belongs.
    ///
    /// # Errors
    /// [`DataError::Unassigned`].
    pub fn part(&self, object: &str) -> Result<Part, DataError> {
        // The most particular entry decides: name or its number, then prefix, then star.
        let ranks: [fn(&str, &str) -> bool; 3] =
            [same_object, |e, o| e.len() > 1 && e.strip_suffix('*').is_some_and(|p| o.starts_with(p)), |e, _| e == "*"];
        for matches in ranks {
            for (part, entries) in self.entries() {
                if entries.iter().any(|entry| matches(entry, object)) {
                    return Ok(part);
                }
            }
        }
        Err(DataError::Unassigned { split: self.name.clone(), object: object.to_owned() })
    }

    /// The presses of each part; train and validation are not empty.
    ///
    /// # Errors
    /// [`DataError::Empty`], [`DataError::Unassigned`], [`DataError::EmptyPart`].
    pub fn apply(&self, samples: &dyn Samples) -> Result<Parts, DataError> {
        if samples.is_empty() {
            return Err(DataError::Empty { name: samples.name() });
        }
        let mut parts = Parts::default();
        for index in 0..samples.len() {
            match self.part(samples.object(index))? {
                Part::Train => parts.train.push(index),
                Part::Validation => parts.validation.push(index),
                Part::Test => parts.test.push(index),
            }
        }
        for (part, indices) in [("train", &parts.train), ("validation", &parts.validation)] {
            if indices.is_empty() {
                let objects = (0..samples.len()).map(|i| samples.object(i)).collect::<BTreeSet<_>>().len();
                return Err(DataError::EmptyPart { split: self.name.clone(), part, presses: samples.len(), objects });
            }
        }
        Ok(parts)
    }
}

/// Equal names, or one is what stands before the other's first underscore.
fn same_object(a: &str, b: &str) -> bool {
    let number = |name: &str, object: &str| object.split_once('_').is_some_and(|(n, _)| n == name);
    a == b || number(a, b) || number(b, a)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_prefixes_and_the_star_find_their_part() {
        let text = "name = 'x'\ntrain = ['primitive:*', '*']\nvalidation = ['002']\ntest = ['004_sugar_box']\n";
        let split = Split::parse(text, Path::new("x.toml")).expect("valid");
        let part = |o| split.part(o).expect("assigned");
        assert_eq!(part("002_master_chef_can"), Part::Validation);
        assert_eq!(part("004_sugar_box"), Part::Test);
        assert_eq!([part("primitive:cone"), part("005_tomato_soup_can")], [Part::Train; 2]);
    }

    #[test]
    fn an_object_in_two_parts_is_refused_by_number_too() {
        let text = "name = 'x'\ntrain = ['004_sugar_box']\nvalidation = ['002']\ntest = ['004']\n";
        let error = Split::parse(text, Path::new("x.toml")).expect_err("overlap").to_string();
        assert!(error.contains("004_sugar_box") && error.contains("train") && error.contains("test"), "{error}");
    }
}
