//! What goes to standard error beside errors: one form everywhere.

use std::fmt::Display;

/// A warning as it is printed.
pub(crate) fn warning(text: impl Display) -> String {
    format!("palpate: warning: {text}")
}

/// Prints a warning.
pub(crate) fn warn(text: impl Display) {
    eprintln!("{}", warning(text));
}

/// `1 touch`, `2 touches`.
pub(crate) fn count(number: usize, one: &str, many: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { many })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular() {
        let touches = [0, 1, 2].map(|n| count(n, "touch", "touches"));
        assert_eq!(touches, ["0 touches", "1 touch", "2 touches"]);
    }
}
