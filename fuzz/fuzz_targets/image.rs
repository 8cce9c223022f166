#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| comgs_scene::probe::image(data));
