//! One integration binary: linking is what costs.

mod claims;
mod layering;
mod metrics;
mod poisson;
mod readers;
mod segment;
mod property;
mod touch;
mod workshop;
