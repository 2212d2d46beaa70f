//! Temporal filter: the camera averages successive frames.

use crate::normal::{AROUND, PLACES as SHARES};
use crate::predict::{Before, SetPrediction};
use crate::quantize::Correction;

use std::collections::VecDeque;

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};

/// Running average with weight 1 - alpha for the new frame, or mean of the last few frames.
pub struct TemporalFilter;

/// Memory names of the earlier frames of a mean of the last frames, the newest first.
const FRAMES: [&str; 7] = [
    "temporal-filter 1",
    "temporal-filter 2",
    "temporal-filter 3",
    "temporal-filter 4",
    "temporal-filter 5",
    "temporal-filter 6",
    "temporal-filter 7",
];
/// Maximum number of frames of that mean.
const MOST_FRAMES: usize = FRAMES.len() + 1;
/// Maximum mean, in frames, for which the noise after a change of level is predicted.
const FOLLOWED: usize = 3;
/// Relative error of the noise of larger means (a named choice: in the standard plan a mean of four changes
/// the gain by 7 %).
const UNSURE_NOISE: f64 = 0.3;
/// Value of `kept` for the mean of the last frames.
const MEAN_OF_LAST: f64 = 3.0;
/// Minimum correlation of successive frames at which a mean of the last frames is tried: a mean of two has
/// 1/2, and few frames show less (a named choice).
const LEAST_CORRELATION: f64 = 0.3;

/// Minimum weight of the earlier frames (a named choice). Cameras set it in 256ths or tenths, and a filter
/// that reduces noise has much more. A smaller remainder of a level is charge.
const LEAST: f64 = 1.0 / 256.0;

/// Returns the relative variance of independent noise after y_t = (1 - a) x_t + a y_(t-1), and its
/// correlations over 1, 2, ... frames (an autoregression of the first order: Box and Jenkins 1976, 3.2.3).
pub(super) fn running_average(a: f64) -> (f64, Vec<f64>) {
    ((1.0 - a) / (1.0 + a), (1..=8).map(|k| libm::pow(a, f64::from(k))).collect())
}

/// Returns true if the camera keeps the running mean finer than whole codes.
fn fine(p: &[f64]) -> bool {
    p[1] >= 0.5
}

/// Returns true if the input of the filter is finer than whole codes too.
fn sees_more(p: &[f64]) -> bool {
    p[1] >= 1.5 && frames_of_mean(p).is_none()
}

/// Returns the number of frames averaged with equal weights; `None` for a running average.
fn frames_of_mean(p: &[f64]) -> Option<usize> {
    (p[1] >= MEAN_OF_LAST - 0.5).then(|| (p[2].round() as usize).clamp(2, MOST_FRAMES))
}

/// Returns the relative variance of the mean of the last n frames of independent noise, and its correlations
/// over 1, 2, ... frames (a moving average: Box and Jenkins 1976, 3.3).
fn moving_average(n: usize) -> (f64, Vec<f64>) {
    let n = n as f64;
    (n.recip(), (1..=8).map(|k| (1.0 - f64::from(k) / n).max(0.0)).collect())
}

/// Applies a mean of the last n frames, rounded to whole codes.
fn average_last(n: usize, c: &Campaign, out: &mut Prediction) {
    let (less, memory) = moving_average(n);
    for s in &mut out.sets {
        // Noise statistics leave out two frames after a change of level. With larger means, later frames
        // still have noise of the previous level, which is not predicted.
        let unsure = if n > FOLLOWED { UNSURE_NOISE * less * s.pixels() } else { 0.0 };
        s.unsure_var = libm::hypot(s.unsure_var, unsure);
        s.mix_in_time(less, &memory);
        // Means of whole codes lie 1/n of a code apart before rounding.
        s.add_rounding((1.0 - less * less) / 12.0);
    }
    let mut last: VecDeque<f64> = VecDeque::new();
    let past = out.base.past_e.map(|past| past * out.base.gain_dn_per_e);
    for (k, (m, frame)) in out.frame_signal.iter_mut().zip(&c.frames).enumerate() {
        let filled = |level: f64| std::iter::repeat_n(level, n - 1).collect();
        match frame.before {
            _ if k == 0 => last = filled(past.unwrap_or(*m)),
            Before::Frame => {}
            Before::Level => last = filled(*m),
            Before::Dark => last = filled(0.0),
            Before::Discarded(count) => (0..count).for_each(|_| {
                last.push_front(*m);
                last.truncate(n - 1);
            }),
        }
        let own = *m;
        *m = (own + last.iter().sum::<f64>()) / n as f64;
        last.push_front(own);
        last.truncate(n - 1);
    }
    out.whole = true;
}

/// Change of level between two frames, DN.
struct Change<'a> {
    /// Level of the last frame minus that of this one.
    away: f64,
    /// Standard deviation of this difference over the pixels, whose levels are in nine groups (`places`).
    across: f64,
    places: &'a [f64; SHARES.len()],
    /// Standard deviation of the noise of both frames together.
    noise: f64,
}

impl Change<'_> {
    /// Returns the addition to the mean by a filter that keeps whole codes, if the change is larger by
    /// `more`: floor(a u + 1/2) over the pixels.
    fn step(&self, a: f64, more: f64) -> f64 {
        let correction = Correction::new(a, libm::hypot(self.noise, AROUND * self.across), 0.0);
        let at = |(x, share): (&f64, f64)| share * correction.mean(self.away + more + self.across * x);
        self.places.iter().zip(SHARES).map(at).sum()
    }

    /// Returns the uncertainty of this step. The pixels' levels are represented by nine groups, with an error
    /// of a seventh of their standard deviation (a named choice). A step in proportion to the change is not
    /// affected.
    fn unsure(&self, a: f64) -> f64 {
        let by = libm::hypot(self.noise, self.across) / 7.0;
        let away = 0.5 * (self.step(a, by) - self.step(a, -by)) - a * by;
        // With little noise, the position of whole codes relative to a threshold is unknown too.
        let whole = libm::exp(-0.5 * libm::pow(std::f64::consts::TAU, 2.0) * self.noise * self.noise);
        libm::hypot(away, whole / libm::sqrt(12.0))
    }
}

/// Returns the pixel-to-pixel deviation of the change from one set's level to another's, DN.
fn across(c: &Campaign, from: usize, from_dn: f64, to: usize, to_dn: f64) -> f64 {
    (c.sets[from].spread * from_dn - c.sets[to].spread * to_dn).abs()
}

/// Correction that a filter of whole codes adds to the frames of a set.
struct Added {
    /// Slope on the noise.
    slope: f64,
    /// Variance of the remainder.
    noise: f64,
    /// Share of the new frame's noise in that of its difference from the kept mean.
    share: f64,
    correction: Correction,
}

/// First frames of a set.
#[derive(Clone, Default)]
struct First {
    /// True if the level still moves after the first frame.
    moves: bool,
    /// Model uncertainty of the mean of the first frame, DN.
    unsure_dn: f64,
}

impl Added {
    fn to(s: &SetPrediction, p: &[f64]) -> Self {
        let (a, x) = (p[0], s.pixels());
        let with = |before: f64| {
            let correction = Correction::new(a, libm::sqrt(x + before), 0.0);
            let (slope, noise) = correction.linear();
            Self { slope, noise, share: x / (x + before).max(f64::MIN_POSITIVE), correction }
        };
        if fine(p) {
            // The running mean itself is kept in fractions of a code; only the output is rounded.
            return with(x * running_average(a).0);
        }
        // The kept mean has the noise of the output.
        let mut all = with(x);
        for _ in 0..7 {
            let square = all.slope * all.slope;
            all = with(x * (1.0 - all.slope) / (1.0 + all.slope) + all.noise / (1.0 - square));
        }
        all
    }

    /// Applies the correction to the noise of a set.
    fn change(&self, s: &mut SetPrediction, p: &[f64], first: &First) {
        let (a, slope) = (p[0], self.slope);
        if fine(p) {
            // o_t = (1 - s) x_t + s y_(t-1) and noise, y the running mean with variance v; cov(o_t, y_t) is
            // carried on by s a^(k-1).
            let (v, _) = running_average(a);
            let less = (1.0 - slope) * (1.0 - slope) + slope * slope * v;
            let carried = slope * ((1.0 - slope) * (1.0 - a) + slope * a * v) / less;
            let memory: Vec<f64> = (0..8).map(|k| carried * libm::pow(a, f64::from(k))).collect();
            s.mix_in_time(less, &memory);
            s.add_rounding(self.noise);
        } else {
            let (less, memory) = running_average(slope);
            s.mix_in_time(less, &memory);
            s.read.add_white(self.noise / (1.0 - slope * slope));
        }
        s.moved = s.moved.max(self.correction.moves());
        if first.moves {
            // While the level changes, pixels lie at a threshold of the correction floor(alpha u + 1/2).
            // There its slope equals the density of u, up to 1 / (root(2 pi) sd) with sd the noise of u,
            // instead of alpha. The variance changes by twice this slope, in about one frame of three.
            let x = s.pixels();
            let slope = 1.0 / libm::sqrt(std::f64::consts::TAU * x.max(1.0));
            s.unsure_moving = libm::hypot(s.unsure_moving, 2.0 * slope * x / 3.0);
        }
        s.unsure_first = libm::hypot(s.unsure_first, first.unsure_dn);
        // Only samples far from the mean are changed, and towards it: the tails become short. If the mean is
        // kept in fractions of a code, the previous frame is not the kept mean; the fourth cumulants that
        // both share are not predicted and are as large again.
        let [fourth, shared @ ..] = self.correction.fourth(self.share);
        s.fourth += fourth;
        let of_frames = if fine(p) {
            0.8
        } else {
            s.fourth_next = shared;
            0.2
        };
        // The position of whole codes relative to a threshold differs from pixel to pixel.
        s.unsure_fourth = libm::hypot(s.unsure_fourth, of_frames * fourth);
        s.unsure = libm::hypot(s.unsure, 0.2 * fourth);
    }
}

/// Remainder of the previous set's level in the running mean.
struct Carried<'a> {
    /// Standard deviation of the remainder over the pixels (level groups `places`), DN.
    across: f64,
    places: &'a [f64; SHARES.len()],
    /// Variance of its noise, DN^2.
    before: f64,
}

/// Standard deviation of the remainder of a change, times alpha, in codes, below which the remainder no
/// longer affects rounding: a rounded mean keeps 0.95 of its sawtooth, exp(-2 pi^2 0.05^2) (Widrow and Kollar
/// 2008, ch. 4).
const FORGOTTEN: f64 = 0.05;

/// Moves the means of all frames in the order of time; returns the changes of the first frames of each set.
fn move_frames(p: &[f64], c: &Campaign, out: &mut Prediction, added: &[Added]) -> Vec<First> {
    let a = p[0];
    let mut firsts = vec![First::default(); added.len()];
    let mut last = out.base.past_e.map(|past| past * out.base.gain_dn_per_e);
    let mut set = None;
    let mut carried: Option<Carried<'_>> = None;
    let sets = &out.sets;
    for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
        let (Some(of_set), Some(first)) = (added.get(frame.set), firsts.get_mut(frame.set)) else { continue };
        match frame.before {
            Before::Frame => {}
            Before::Level => (last, set, carried) = (None, Some(frame.set), None),
            Before::Dark => (last, set, carried) = (Some(0.0), None, None),
            Before::Discarded(n) => {
                let left = |after: u8| libm::pow(a, f64::from(after));
                let (from, before) = (set.unwrap_or(frame.set), last.unwrap_or(*m));
                carried = (!fine(p)).then(|| Carried {
                    across: left(n.saturating_sub(1)) * across(c, from, before, frame.set, *m),
                    before: libm::pow(left(n.saturating_sub(1)), 2.0)
                        * (added[from].noise + sets[from].pixels()),
                    places: &c.sets[if before > *m { from } else { frame.set }].places,
                });
                (last, set) = (Some(*m + left(n) * (before - *m)), Some(frame.set));
            }
        }
        let before = last.unwrap_or(*m);
        let away = before - *m;
        let own = of_set.noise + sets[frame.set].pixels();
        let step = if set == Some(frame.set) {
            let step = match &mut carried {
                // The remainder varies over the pixels as the change did, and has the noise of the previous
                // level. Neither matters if the set's own noise spans many thresholds.
                Some(left) if of_set.correction.narrow() > 0.0 => {
                    (left.across, left.before) = (a * left.across, a * a * left.before);
                    let noise = libm::sqrt(of_set.correction.variance() + left.before);
                    Change { away, across: left.across, noise, places: left.places }.step(a, 0.0)
                }
                _ => of_set.correction.mean(away),
            };
            carried =
                carried.filter(|left| a * libm::hypot(left.across, libm::sqrt(left.before)) > FORGOTTEN);
            // The first frame of a set has a statistic of its own.
            first.moves |= step.abs() > 0.25;
            step
        } else {
            let from = set.unwrap_or(frame.set);
            let before_var = added[from].noise + sets[from].pixels();
            let change = Change {
                away,
                across: across(c, from, before, frame.set, *m),
                noise: libm::sqrt(before_var + own),
                places: &c.sets[if away > 0.0 { from } else { frame.set }].places,
            };
            first.unsure_dn = libm::hypot(first.unsure_dn, change.unsure(a));
            // A mean kept in fractions of a code is not rounded from frame to frame.
            carried = (!fine(p)).then_some(Carried {
                across: change.across,
                before: before_var,
                places: change.places,
            });
            change.step(a, 0.0)
        };
        last = Some(*m + if fine(p) { a * away } else { step });
        *m += step;
        set = Some(frame.set);
    }
    firsts
}

impl Effect for TemporalFilter {
    fn id(&self) -> &'static str {
        "temporal-filter"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["frame averaging", "3d noise reduction", "recursive filter"]
    }

    fn stage(&self) -> Stage {
        Stage::Firmware
    }

    fn stage_with(&self, p: &[f64]) -> Stage {
        if sees_more(p) { Stage::Converter } else { Stage::Firmware }
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "alpha",
                meaning: "weight of the frames before",
                unit: "1",
                min: 0.0,
                max: 0.9,
                starts: &[0.05],
            },
            // Mean in whole codes; in fractions of a code; in fractions of a code from samples with more bits
            // than the output; mean of the last frames.
            Parameter {
                name: "kept",
                meaning: "0: the mean is kept in whole codes, 1: in parts of a code, 2: of samples with more bits than are sent; 3: the mean of the \
                          last frames, in equal parts",
                unit: "choice",
                min: 0.0,
                max: MEAN_OF_LAST,
                starts: &[0.0, 1.0, 2.0],
            },
            Parameter {
                name: "frames",
                meaning: "number of frames of the mean, the new one among them (kept = 3)",
                unit: "1",
                min: 2.0,
                max: MOST_FRAMES as f64,
                starts: &[2.0],
            },
        ]
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let running = [0.0, 1.0, 2.0].map(|kept| vec![0.05, kept, 2.0]).into_iter();
        let correlated = seen.successive.is_some_and(|c| c > LEAST_CORRELATION);
        let most = if correlated { MOST_FRAMES } else { 0 };
        let last = (2..=most).map(|n| vec![0.05, MEAN_OF_LAST, n as f64]);
        running.chain(last).collect()
    }

    fn is_whole(&self, parameter: usize) -> bool {
        parameter == 2
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        match parameter {
            0 => frames_of_mean(p).is_none(),
            2 => frames_of_mean(p).is_some(),
            _ => true,
        }
    }

    /// Default of models written before the parameter existed.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter == 2).then_some(2.0)
    }

    /// A smaller weight indicates image lag (charge kept in the pixel).
    fn is_another(&self, p: &[f64], _: &Seen) -> bool {
        frames_of_mean(p).is_none() && p[0] < LEAST
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        if frames_of_mean(p).is_some() {
            return Some("the mean of the last frames, in equal parts");
        }
        Some(match (fine(p), sees_more(p)) {
            (_, true) => "before codes are rounded",
            (true, _) => "the mean is kept in parts of a code",
            _ => "the mean is kept in whole codes",
        })
    }

    /// The kinds of rounding move means alike, and take different shares of the noise.
    fn forms_with_same_means(&self, p: &[f64]) -> Vec<Vec<f64>> {
        if frames_of_mean(p).is_some() {
            return Vec::new();
        }
        let others = [0.0, 1.0, 2.0].into_iter().filter(|kept| *kept != p[1]);
        others.map(|kept| vec![p[0], kept, p[2]]).collect()
    }

    fn has_memory(&self) -> bool {
        true
    }

    fn forgets_after(&self, p: &[f64]) -> Option<usize> {
        frames_of_mean(p).map(|n| n - 1)
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.03, 0.0, 2.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "Firmware noise reduction mixes each frame with the ones before.",
            equation: "y_t = (1 - alpha) v_t + alpha y_(t-1), rounded to whole codes before it is kept, after, or v is not rounded yet; variance times (1 - alpha) / (1 + alpha), correlation alpha^k over k frames; kept = 3: y_t is the mean of v_t and the n - 1 frames before, variance over n, correlation 1 - k / n",
            signature: "successive frames correlated, darks too; variance down in darks and flats; first frames after a change carry the \
                        old level",
            look_alikes: "image lag carries charge only: read noise of darks is uncorrelated in time",
            remedy: "switch it off (TemporalNoiseReduction, 3DNR); it also smears what moves",
            measure: "a long run of darks: their correlation from frame to frame",
            sets: takes::TRANSITIONS,
            source: "EMVA 1288 release 4, section 2; GenICam SFNC",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let a = p[0];
        if let Some(n) = frames_of_mean(p) {
            return average_last(n, c, out);
        }
        if sees_more(p) {
            let (less, memory) = running_average(a);
            out.sets.iter_mut().for_each(|s| s.mix_in_time(less, &memory));
            let mut last = out.base.past_e.map(|past| past * out.base.gain_dn_per_e);
            for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
                match frame.before {
                    Before::Frame => {}
                    Before::Level => last = None,
                    Before::Dark => last = Some(0.0),
                    Before::Discarded(n) => {
                        last = last.map(|last| *m + libm::pow(a, f64::from(n)) * (last - *m));
                    }
                }
                *m += last.map_or(0.0, |last| a * (last - *m));
                last = Some(*m);
            }
            return;
        }
        // Each code is changed by floor(alpha (last - now) + 1/2), whether the kept mean is rounded or not.
        let added: Vec<Added> = out.sets.iter().map(|s| Added::to(s, p)).collect();
        let firsts = move_frames(p, c, out, &added);
        for ((s, added), first) in out.sets.iter_mut().zip(&added).zip(&firsts) {
            added.change(s, p, first);
        }
        // The input is whole codes, and so is the correction.
        out.whole = true;
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        if let Some(n) = frames_of_mean(p) {
            let mut kept = d.image.clone();
            let mut sum = d.image.clone();
            for name in &FRAMES[..n - 1] {
                // The buffer starts with the first frame.
                let before = d.memory.insert(name, kept).filter(|m| m.dim() == d.image.dim());
                kept = before.unwrap_or_else(|| d.image.clone());
                sum += &kept;
            }
            d.image = sum.mapv(|v| libm::floor(v / n as f64 + 0.5));
            return;
        }
        if let Some(last) = d.memory.get(self.id()).filter(|m| m.dim() == d.image.dim()) {
            d.image = &d.image * (1.0 - p[0]) + last * p[0];
        }
        if !fine(p) {
            d.image.mapv_inplace(|v| libm::floor(v + 0.5));
        }
        d.memory.insert(self.id(), d.image.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::normal::NORMAL;
    use crate::rng::{PixelRng, Stream};

    /// Compared with 10^6 drawn pixels each; tolerance: the stated uncertainty and five standard errors.
    #[test]
    fn a_change_of_level_is_what_pixels_show() {
        let n = 1_000_000;
        let normal = |i: u32, k: u64| PixelRng::new(3, Stream::Effect, k, i, 0).normal();
        // Alpha times the change: below the first threshold, at it, above it, and at several.
        for (a, away, across, noise) in [
            (1e-4, 3400.0, 150.0, 40.0),
            (1.46e-4, 3430.0, 150.0, 40.0),
            (2e-4, 3400.0, 60.0, 20.0),
            (2e-3, -3000.0, 200.0, 30.0),
        ] {
            let change = Change { away, across, places: &NORMAL, noise };
            let drawn = |i: u32| {
                let u = f64::round(away + across * normal(i, 0) + noise * normal(i, 1));
                f64::floor(a * u + 0.5)
            };
            let (sum, square) = (0..n).map(drawn).fold((0.0, 0.0), |(s, q), v| (s + v, q + v * v));
            let mean = sum / f64::from(n);
            let std_err = ((square / f64::from(n) - mean * mean).max(0.0) / f64::from(n)).sqrt();
            let (step, unsure) = (change.step(a, 0.0), change.unsure(a));
            assert!(
                (step - mean).abs() < unsure + 5.0 * std_err + 1e-3,
                "alpha {a}: {step} +- {unsure} DN, drawn {mean} +- {std_err}"
            );
        }
    }
}
