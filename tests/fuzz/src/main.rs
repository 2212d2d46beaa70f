//! libFuzzer over one of the targets, which the variable FUZZ_TARGET names.

#![no_main]

#[path = "../../it/fuzz/targets.rs"]
mod targets;

use std::sync::OnceLock;

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    static TARGET: OnceLock<fn(&[u8])> = OnceLock::new();
    let target = TARGET.get_or_init(|| {
        let name = std::env::var("FUZZ_TARGET").expect("FUZZ_TARGET names the target");
        targets::TARGETS.iter().find(|(n, _)| *n == name).expect("no such target").1
    });
    target(data);
});
