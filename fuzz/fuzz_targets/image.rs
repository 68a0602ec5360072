#![no_main]

use libfuzzer_sys::fuzz_target;
use std::path::Path;

fuzz_target!(|data: &[u8]| {
    let name = Path::new("i.png");
    let _ = palpate::io::parse_depth_png(name, data, 0.001);
    let _ = palpate::io::parse_mask(name, data);
    let _ = palpate::io::parse_color(name, data);
});
