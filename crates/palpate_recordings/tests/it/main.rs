//! One integration binary: linking is what costs.

mod folders;
mod recording;
