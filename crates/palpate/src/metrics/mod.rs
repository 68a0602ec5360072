//! How far a predicted mesh is from the truth.
