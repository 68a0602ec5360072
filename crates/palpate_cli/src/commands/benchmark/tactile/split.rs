//! Which objects a learned decoder has seen.

use anyhow::{Context as _, bail};
use palpate::io::read_text;
use serde::Deserialize;
use std::path::Path;

/// Use of an object in training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Part {
    /// Seen by the optimizer
    Train,
    /// Decided which weights were kept
    Validation,
    /// Seen by neither
    Test,
}

impl Part {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

/// The three lists. An entry is an object's name, what stands before its first underscore, a prefix ending in a star, or `*`.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Split {
    pub(super) name: String,
    train: Vec<String>,
    validation: Vec<String>,
    test: Vec<String>,
}

impl Split {
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let split: Self = toml::from_str(&read_text(path)?).with_context(|| format!("split {}", path.display()))?;
        if split.test.is_empty() {
            bail!("split {}: the list `test` is empty", path.display());
        }
        Ok(split)
    }

    /// Where an object belongs; the most particular entry decides.
    pub(super) fn part(&self, object: &str) -> Option<Part> {
        let same = |e: &str, o: &str| e == o || o.split_once('_').is_some_and(|(number, _)| number == e);
        let prefix = |e: &str, o: &str| e.len() > 1 && e.strip_suffix('*').is_some_and(|p| o.starts_with(p));
        let ranks: [&dyn Fn(&str, &str) -> bool; 3] = [&same, &prefix, &|e, _| e == "*"];
        let parts = [(Part::Test, &self.test), (Part::Validation, &self.validation), (Part::Train, &self.train)];
        ranks.iter().find_map(|matches| {
            parts.iter().find(|(_, entries)| entries.iter().any(|e| matches(e, object))).map(|(part, _)| *part)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_particular_entry_decides() {
        let text =
            "name = 'x'\ntrain = ['primitive:*', '*']\nvalidation = ['072-a']\ntest = ['004', '056_tennis_ball']\n";
        let split: Split = toml::from_str(text).expect("valid");
        let part = |object| split.part(object).expect("a star");
        assert_eq!(part("004_sugar_box"), Part::Test);
        assert_eq!(part("056_tennis_ball"), Part::Test);
        assert_eq!(part("072-a_toy_airplane"), Part::Validation);
        assert_eq!((part("primitive:ball"), part("0041_box")), (Part::Train, Part::Train));
    }
}
