//! Synthetic objects, depth frames and touches with exact truth.
