//! One integration binary: linking is what costs.

mod layering;
mod metrics;
mod poisson;
//! Integration tests: what holds across modules. One binary, one file per subject.

mod touch;
