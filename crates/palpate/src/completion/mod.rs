//! From what is known to the whole: moved evidence, elimination of contradicted guesses.

mod eliminate;

pub use eliminate::{EliminationParams, contradicted};
