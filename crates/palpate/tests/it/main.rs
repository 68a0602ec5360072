//! One integration binary: linking is what costs.

mod claims;
mod explore;
mod layering;
mod metrics;
mod optics;
mod photometry;
mod poisson;
mod property;
mod readers;
mod segment;
mod touch;
mod workshop;
