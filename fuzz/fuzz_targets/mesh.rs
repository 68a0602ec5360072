//! The first byte picks the format, the rest is the file.
#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let Some((pick, file)) = data.split_first() else { return };
    let name = ["m.ply", "m.obj", "m.off", "m.stl"][usize::from(pick % 4)];
    if let Ok(mesh) = palpate::io::parse_mesh(Path::new(name), file) {
        assert!(mesh.faces.iter().flatten().all(|&i| (i as usize) < mesh.vertices.len()));
    }
});
