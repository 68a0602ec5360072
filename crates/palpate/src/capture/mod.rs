//! Touches out of a stream of tactile images: which frames show a contact that has settled.

mod watcher;

pub use watcher::{ContactWatcher, WatchError, WatchParams, Watched};
