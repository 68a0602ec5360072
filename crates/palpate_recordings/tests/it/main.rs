//! One integration binary: linking is what costs.

mod bag;
mod folders;
mod hostile;
mod recording;
