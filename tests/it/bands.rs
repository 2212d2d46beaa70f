//! Light bands of many lamps: frequency and amplitude.

use crate::effects::{observe, with};
use crate::support::{camera, small};
use radcam::capture::Capture;
use radcam::diagnosis::diagnose;
use radcam::plan::Plan;
use radcam_sim::rng::{PixelRng, Stream};

/// 40 sines of amplitude 0.005 to 0.3 and 0.002 to 0.4 cycles a row, of mains lamps or 80 to 1000 Hz. All must
/// be named first; the number within three standard errors is printed (docs/CONFUSION.md).
#[test]
#[ignore = "two minutes; `cargo test --release --test it bands:: -- --ignored --nocapture`"]
fn bands_of_many_lamps() {
    let (mut first, mut both) = (0, 0);
    for seed in 0..40u64 {
        let mut random = PixelRng::new(4000 + seed, Stream::Effect, 0, 0, 0);
        let mut between = |low: f64, high: f64| low * (high / low).powf(random.uniform());
        let (rel, cycles) = (between(0.005, 0.3), between(0.002, 0.4));
        let hz = [100.0, 120.0, between(80.0, 1000.0)][seed as usize % 3];
        let mut model = small("cmos12", 96, 256);
        model.base.seed = seed;
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("c");
        let (mut camera, mut bench) = camera(with(model, "light-banding", &[0.0, rel, cycles, hz, 0.97]));
        Capture::new(&mut camera, &mut bench).run(&Plan::standard(), &root).unwrap();
        let d = diagnose(&observe(&root), None, Vec::new(), &mut |_| {});
        let bands = d.missing.first().filter(|m| m.effect == "light-banding");
        let near = |name: &str, truth: f64| {
            let q = bands.and_then(|m| m.parameters.get(name));
            q.is_some_and(|q| (q.value - truth).abs() < 3.0 * q.std_err)
        };
        let right = near("rel", rel) && near("cycles_per_row", cycles);
        println!("{rel:.4} {cycles:.4} {hz:.0} Hz: {:?} {right}", bands.map(|m| &m.parameters));
        first += usize::from(bands.is_some());
        both += usize::from(right);
    }
    println!("{first} of 40 first, {both} within three standard errors");
    assert!(first == 40 && both >= 28, "{first} first, {both} within three standard errors");
}
