//! From what is known to the whole: moved evidence, elimination of contradicted guesses.
