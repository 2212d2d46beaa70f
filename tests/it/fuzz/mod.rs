//! The corpus of the fuzz targets, and changes of it, replayed: none panics.

mod targets;

use radcam_sim::rng::{PixelRng, Stream};
use std::path::Path;

/// Changes of each file of the corpus.
const CHANGES: u32 = 150;

/// As `tests/fuzz/run` found them, every file of the corpus of every target, cut short, and with bytes
/// changed, doubled and taken out.
#[test]
fn the_corpus_and_changes_of_it_are_taken_or_refused() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus");
    let mut files = 0;
    for (name, target) in targets::TARGETS {
        let found = std::fs::read_dir(root.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
        let mut all: Vec<_> = found.map(|e| e.unwrap().path()).collect();
        all.sort();
        assert!(!all.is_empty(), "{name} has no corpus");
        for path in all {
            let bytes = std::fs::read(&path).unwrap();
            target(&bytes);
            files += 1;
            for change in 0..if *name == "request" { 10 } else { CHANGES } {
                let mut random = PixelRng::new(16, Stream::Effect, files, change, 0);
                let mut pick = |n: usize| (random.uniform() * n.max(1) as f64) as usize;
                let mut changed = bytes.clone();
                for _ in 0..=pick(4) {
                    let at = pick(changed.len());
                    match pick(4) {
                        0 => changed.truncate(at),
                        1 if !changed.is_empty() => changed[at] = pick(256) as u8,
                        2 if !changed.is_empty() => drop(changed.remove(at)),
                        _ => {
                            let piece = changed[at..(at + pick(16)).min(changed.len())].to_vec();
                            changed.splice(at..at, piece);
                        }
                    }
                }
                target(&changed);
            }
        }
    }
    assert!(files > 20, "{files}");
}
