//! The first byte picks the format, the rest is the file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some((pick, file)) = data.split_first() else { return };
    let name = ["c.pcd", "c.ply"][usize::from(pick % 2)];
    if let Ok(read) = palpate::io::parse_cloud(Path::new(name), file) {
        assert!(read.cloud.points.iter().all(|p| p.iter().all(|x| x.is_finite())));
    }
});
