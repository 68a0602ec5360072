//! One integration binary: linking is what costs.

mod layering;
mod metrics;
mod poisson;
mod readers;
mod segment;
mod touch;
