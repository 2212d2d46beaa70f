//! Dark current drift: the sensor warms up or cools down.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::drift;

/// Dark charge per second times 1 + rate * time.
pub struct DarkCurrentDrift;

/// Returns the spatial deviation of the dark charge over its mean, from the longest darks less the shortest;
/// 0 if they do not show it.
fn dark_spread(c: &Campaign, dark_dn_per_s: f64) -> f64 {
    let darks = || c.sets.iter().filter(|s| s.light.is_none());
    let long = darks().max_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
    let short = darks().min_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
    let (Some(long), Some(short)) = (long, short) else { return 0.0 };
    let charge_dn = dark_dn_per_s * (long.exposure_s - short.exposure_s);
    let var_dn2 = long.spread_dn.powi(2) - short.spread_dn.powi(2);
    if charge_dn > 0.0 { var_dn2.max(0.0).sqrt() / charge_dn } else { 0.0 }
}

impl Effect for DarkCurrentDrift {
    fn id(&self) -> &'static str {
        "dark-current-drift"
    }

    fn stage(&self) -> Stage {
        Stage::Light
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            drift::SHAPE,
            Parameter {
                name: "rel_per_s",
                meaning: "shape 0: change of the dark current per second, relative to its value at the start",
                unit: "1/s",
                min: -0.05,
                max: 0.2,
                starts: &[1e-3],
            },
            Parameter {
                name: "rel",
                meaning: "shape 1: excess of the dark current at the start, relative to its value late",
                unit: "1",
                min: -1.0,
                max: 100.0,
                starts: &[0.1],
            },
            drift::TAU,
        ]
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        drift::starts(&[1e-3], 0.1, seen)
    }

    drift::in_time!();

    fn shows_in_darks(&self) -> bool {
        true
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        // About 0.3 DN of the long darks at the end, or a tenth of the noise.
        let rel = (0.1 * plain.noise_e * plain.gain_dn_per_e).max(0.3)
            / (plain.long_dark_e * plain.gain_dn_per_e).max(0.1);
        Some(vec![0.0, rel.min(3.0) / (300.0 * plain.frame_s), 0.0, 60.0 * plain.frame_s])
    }

    fn page(&self) -> Page {
        Page {
            what: "The sensor's temperature changes during the campaign, and its dark current with it.",
            equation: "dark charge = dark current * exposure * (1 + rate t); or (1 + rel exp(-t / tau)) of the dark current late",
            signature: "darks of long exposure move with time, in proportion to the exposure; short ones stand still",
            look_alikes: "offset drift moves darks of all exposures alike; light drift leaves darks alone",
            remedy: "let the camera warm up; record the sensor's temperature; take darks close to the frames they serve",
            measure: "darks of long exposure at start, middle and end",
            sets: takes::LONG,
            source: "EMVA 1288 release 4, section 7 (dark current and its doubling temperature)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let dark = out.base.dark_e_per_s;
        let mut of_set = vec![(0.0, 0.0, 0.0); c.sets.len()];
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            let Some(info) = c.sets.get(frame.set) else { continue };
            let more = drift::change(p, frame.time_s) * dark * info.exposure_s;
            *m += more;
            let (sum, square, frames) = of_set[frame.set];
            of_set[frame.set] = (sum + more, square + more * more, frames + 1.0);
        }
        let unequal = dark_spread(c, out.base.gain_dn_per_e * dark).powi(2);
        for (s, (sum, square, frames)) in out.sets.iter_mut().zip(of_set) {
            let frames = f64::max(frames, 1.0);
            let mean = sum / frames;
            s.signal += mean;
            // Each pixel moves by its own dark current. The distribution of its spread, above all of hot
            // pixels, is unknown.
            let moved = (square / frames - mean * mean).max(0.0) * frames / (frames - 1.0).max(1.0);
            s.unsure_moving = s.unsure_moving.hypot(unequal * moved);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.scaled_add(drift::change(p, d.time_s) * d.exposure_s, d.dark_e_per_s);
        d.image.mapv_inplace(|q| q.max(0.0));
    }
}
