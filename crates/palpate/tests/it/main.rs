//! One integration binary: linking is what costs.

mod claims;
mod layering;
mod metrics;
mod optics;
mod photometry;
mod poisson;
mod property;
mod readers;
mod robust;
mod segment;
mod touch;
mod workshop;
