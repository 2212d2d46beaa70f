//! Drift monitor for a calibrated camera.
//!
//! A [`Check`] takes some darks and some frames of a reference flat at intervals. Sequential tests
//! ([`chart`], [`cusum`]) follow its readings. An [`Alarm`] states what changed, since when, by how much, and
//! its cost. All tests together raise at most one false alarm in [`FALSE_ALARM_EVERY`] checks.
//!
//! The state is a function of the history: it is rebuilt from the stored checks.

pub mod chart;
pub mod check;
pub mod cusum;
#[cfg(feature = "cli")]
pub mod keeper;
#[cfg(feature = "cli")]
pub mod metrics;
#[cfg(feature = "cli")]
pub mod store;
mod take;

pub use check::{Check, Followed, Reading, Stack, Taken};
pub use take::{Plan, TakeError, take};

use chart::{Chart, Split};
use cusum::Cusum;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Number of checks per allowed false alarm.
pub const FALSE_ALARM_EVERY: f64 = 1e4;
/// Number of concurrent sequential tests: two for each of six readings, one each for flicker and lost frames.
const SUMS: usize = 14;
/// Number of checks to learn the flicker baseline. 40 checks of 7 degrees of freedom give the variance to 8
/// %, accurate enough for a ratio of 4.
const LEARN_FLICKER: usize = 40;
/// Standard errors that exclude a hypothesis.
const EXCLUDED: f64 = 3.0;
/// Factor by which flicker raises the variance of frame means.
const FLICKER_RATIO: f64 = 4.0;
/// Lost frames per received frame: normal, and after a fault.
const LOST: (f64, f64) = (1e-4, 1e-2);

/// Relevant changes, for which the tests are designed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Limits {
    /// Gain, relative.
    pub gain: f64,
    /// Black level, DN.
    pub black_level_dn: f64,
    /// Reference flat, relative.
    pub signal: f64,
    /// Dark current, relative.
    pub dark_current: f64,
    /// Temporal noise of darks, as a standard deviation, relative.
    pub dark_noise: f64,
    /// Pattern left after correction with K, standard deviation relative to the signal.
    pub pattern: f64,
}

impl Default for Limits {
    /// Returns named choices: 1 % of gain, 0.5 DN, 2 % of light, a quarter of the dark current, 5 % of noise,
    /// a pattern of 0.3 %.
    fn default() -> Self {
        Self {
            gain: 0.01,
            black_level_dn: 0.5,
            signal: 0.02,
            dark_current: 0.25,
            dark_noise: 0.05,
            pattern: 0.003,
        }
    }
}

impl Limits {
    /// Returns the relevant change of a reading with this baseline.
    fn of(&self, what: Followed, usual: f64) -> f64 {
        match what {
            Followed::Gain => self.gain * usual,
            Followed::BlackLevel => self.black_level_dn,
            Followed::Signal => self.signal * usual,
            Followed::DarkCurrent => self.dark_current * usual.abs(),
            Followed::DarkNoise => ((1.0 + self.dark_noise).powi(2) - 1.0) * usual,
            Followed::Pattern => self.pattern * self.pattern,
            Followed::Flicker | Followed::LostFrames => f64::INFINITY,
        }
    }
}

/// Returns true if the light sufficed to read the gain.
fn is_lit(check: &Check) -> bool {
    check.readings.contains_key(&Followed::Gain)
}

/// Kind of change named by an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Changed {
    /// DN per electron.
    Gain,
    /// Lamp, optics, or the sensor's sensitivity: electrons of the reference flat.
    Light,
    /// Hardly any light.
    NoLight,
    /// Change of the reference flat, not yet attributed to light or gain.
    LightOrGain,
    /// Black level: DN without light and without dark current.
    BlackLevel,
    /// Dark current.
    DarkCurrent,
    /// Noise of darks.
    DarkNoise,
    /// Pattern no longer removed by K.
    Pattern,
    /// New hot pixels.
    HotPixels,
    /// New dead pixels.
    DeadPixels,
    /// Unsteady light.
    Flicker,
    /// Frames lost in transfer.
    LostFrames,
}

/// A detected change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// Kind of change.
    pub what: Changed,
    /// Time of the detecting check, seconds since 1970.
    pub time_s: f64,
    /// Time of the check since which the change most likely exists, seconds since 1970.
    pub since_s: f64,
    /// Checks from the change to its detection.
    pub checks: u64,
    /// Size of the change; for pixels, their number.
    pub change: Reading,
    /// One line: what, how much, since when, its cost, what to do.
    pub sentence: String,
}

/// Test of a reading that is not normally distributed: its baseline, and its CUSUM.
#[derive(Debug, Clone, Default)]
struct Rate {
    learned: Chart,
    sum: Cusum,
    /// Check of each reading in the sum.
    checks: Vec<usize>,
}

impl Rate {
    /// Adds a reading. Returns true if the sum passed the limit.
    fn add(&mut self, at: usize, what: Followed, reading: Reading, check: &Check, limit: f64) -> bool {
        let ratio = if what == Followed::LostFrames {
            let usual = LOST.0 * check.frames as f64;
            cusum::of_count(reading.value, usual, LOST.1 / LOST.0)
        } else {
            if self.learned.len() < LEARN_FLICKER {
                self.learned.add(at, reading);
                return false;
            }
            let usual = self.learned.mean().unwrap_or(f64::NAN);
            let dof = check.flats.saturating_sub(1) as f64;
            cusum::of_variance(reading.value / usual, dof, FLICKER_RATIO)
        };
        self.sum.add(ratio);
        self.checks.push(at);
        // Only checks since the last reset are needed.
        self.checks.drain(..self.checks.len() - self.sum.age.min(self.checks.len() as u64) as usize);
        self.sum.sum > limit
    }

    fn since(&self) -> Option<usize> {
        self.checks.first().copied()
    }
}

/// Baselines, tests and history of one camera.
#[derive(Debug, Clone)]
pub struct Monitor {
    limits: Limits,
    limit: f64,
    charts: BTreeMap<Followed, Chart>,
    rates: BTreeMap<Followed, Rate>,
    history: Vec<Check>,
    /// Hot and dead pixels of the last check, and those already reported.
    suspects: [BTreeSet<(u32, u32)>; 2],
    told: [BTreeSet<(u32, u32)>; 2],
    /// Unresolved change of the reference flat: the check at which it left the baseline, and the check since
    /// which the present level holds.
    open: Option<(usize, usize)>,
    /// Too little light to read the gain; already reported.
    dark: bool,
}

impl Monitor {
    /// Creates a monitor without a history.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            limit: cusum::limit(SUMS, FALSE_ALARM_EVERY),
            charts: BTreeMap::new(),
            rates: BTreeMap::new(),
            history: Vec::new(),
            suspects: Default::default(),
            told: Default::default(),
            open: None,
            dark: false,
        }
    }

    /// Returns the checks so far.
    pub fn history(&self) -> &[Check] {
        &self.history
    }

    /// Returns the readings whose baseline is still being learned: detecting the relevant change would take
    /// over a quarter more checks, plus one, than with a known baseline.
    pub fn learning(&self) -> Vec<Followed> {
        let slow = self.charts.iter().filter(|(what, chart)| {
            let (known, now) = chart.needed(|usual| self.limits.of(**what, usual), self.limit);
            chart.len() < chart::BEFORE || now > 1.25 * known + 1.0
        });
        let young =
            self.rates.iter().filter(|(w, r)| **w == Followed::Flicker && r.learned.len() < LEARN_FLICKER);
        slow.map(|(what, _)| *what).chain(young.map(|(what, _)| *what)).collect()
    }

    /// Returns the mean number of checks to detect the relevant change, for each reading with a known
    /// baseline.
    pub fn checks_needed(&self) -> BTreeMap<Followed, f64> {
        let needed = |(what, chart): (&Followed, &Chart)| {
            let (_, now) = chart.needed(|usual| self.limits.of(*what, usual), self.limit);
            now.is_finite().then_some((*what, now))
        };
        self.charts.iter().filter_map(needed).collect()
    }

    /// Adds a check and returns its alarms. Each change is reported once: the new level becomes the baseline.
    pub fn add(&mut self, check: Check) -> Vec<Alarm> {
        let at = self.history.len();
        let mut changed: BTreeMap<Followed, usize> = BTreeMap::new();
        // Signal without gain: too little light. Reported once; the baseline is kept until light returns.
        let failed = !is_lit(&check) && self.charts.get(&Followed::Gain).is_some_and(|c| !c.is_empty());
        for (what, reading) in &check.readings {
            if *what == Followed::Signal && !is_lit(&check) {
                continue;
            }
            if matches!(what, Followed::Flicker | Followed::LostFrames) {
                let rate = self.rates.entry(*what).or_default();
                if rate.add(at, *what, *reading, &check, self.limit) {
                    changed.insert(*what, rate.since().unwrap_or(at));
                }
            } else {
                let chart = self.charts.entry(*what).or_default();
                chart.add(at, *reading);
                let since = chart.changed(|usual| self.limits.of(*what, usual), self.limit);
                changed.extend(since.map(|since| (*what, since)));
            }
        }
        let signal = check.readings.get(&Followed::Signal).copied();
        self.history.push(check);
        let mut alarms = self.pixels();
        if failed && !self.dark {
            let usual = self.charts.get(&Followed::Signal).and_then(Chart::mean);
            let change = signal
                .zip(usual)
                .map(|(now, usual)| Reading { value: now.value / usual - 1.0, std_err: now.std_err / usual });
            alarms.extend(change.map(|change| self.alarm(Changed::NoLight, at, change)));
        }
        self.dark = failed;
        for (what, since) in &changed {
            alarms.extend(self.alone(*what, *since));
        }
        // The signal is more precise than the gain: its change point holds for both.
        let of_flat = changed.get(&Followed::Signal).or_else(|| changed.get(&Followed::Gain));
        match (self.open, of_flat) {
            (Some((before, since)), _) => {
                let newer = self.changed_again(since);
                alarms.extend(self.light_or_gain(before, newer.unwrap_or(since), newer.is_some()));
            }
            (None, Some(since)) => alarms.extend(self.light_or_gain(*since, *since, true)),
            (None, None) => {}
        }
        alarms
    }

    /// Returns the check at which the reference flat changed again after an unresolved change.
    fn changed_again(&self, since: usize) -> Option<usize> {
        let chart = self.chart_since(Followed::Signal, since);
        chart.changed(|usual| self.limits.of(Followed::Signal, usual), self.limit)
    }

    /// Builds the chart of the readings since a check.
    fn chart_since(&self, what: Followed, since: usize) -> Chart {
        self.chart_of(what, since..self.history.len())
    }

    /// Builds the chart of the readings of some checks; for the signal, only checks with light.
    fn chart_of(&self, what: Followed, checks: impl Iterator<Item = usize>) -> Chart {
        let mut chart = Chart::default();
        for (at, check) in checks.filter_map(|at| Some((at, self.history.get(at)?))) {
            let counts = what != Followed::Signal || is_lit(check);
            if let Some(reading) = check.readings.get(&what).filter(|_| counts) {
                chart.add(at, *reading);
            }
        }
        chart
    }

    fn split(&self, what: Followed, since: usize) -> Option<Split> {
        self.charts.get(&what)?.apart(since, since)
    }

    /// Attributes a change of the reference flat or the gain: to light if the gain is unchanged, to gain if
    /// both changed alike, to both if both changed differently. An undecided change is reported once.
    fn light_or_gain(&mut self, before: usize, since: usize, first: bool) -> Vec<Alarm> {
        let relative = |what| Some(self.charts.get(&what)?.apart(before, since)?.relative());
        let Some(signal) = relative(Followed::Signal) else { return Vec::new() };
        let gain = relative(Followed::Gain);
        let far = |r: Reading| r.value.abs() >= EXCLUDED * r.std_err;
        let less = |a: Reading, b: Reading| Reading {
            value: (1.0 + a.value) / (1.0 + b.value) - 1.0,
            std_err: a.std_err.hypot(b.std_err),
        };
        let alarms = match gain {
            Some(gain) if far(gain) && far(less(signal, gain)) => vec![
                self.alarm(Changed::Gain, since, gain),
                self.alarm(Changed::Light, since, less(signal, gain)),
            ],
            Some(gain) if far(gain) => vec![self.alarm(Changed::Gain, since, gain)],
            Some(gain) if far(less(signal, gain)) => vec![self.alarm(Changed::Light, since, signal)],
            // The flat is back at its baseline. The baseline stays; the readings in between, already
            // reported, are removed.
            _ if !far(signal) && self.open.is_some() => {
                self.open = None;
                for what in [Followed::Gain, Followed::Signal] {
                    let checks: Vec<usize> =
                        self.charts.get(&what).map_or_else(Vec::new, |c| c.checks().to_vec());
                    let stay = checks.into_iter().filter(|at| *at < before || *at >= since);
                    let chart = self.chart_of(what, stay);
                    self.charts.insert(what, chart);
                }
                return Vec::new();
            }
            _ if first => {
                self.open = Some((before, since));
                return vec![self.alarm(Changed::LightOrGain, since, signal)];
            }
            _ => return Vec::new(),
        };
        self.open = None;
        self.anew(&[Followed::Gain, Followed::Signal, Followed::Flicker], since);
        alarms
    }

    fn alone(&mut self, what: Followed, since: usize) -> Option<Alarm> {
        let (changed, change) = match what {
            Followed::BlackLevel => (Changed::BlackLevel, self.split(what, since)?.difference()),
            Followed::DarkCurrent => (Changed::DarkCurrent, self.split(what, since)?.relative()),
            Followed::DarkNoise => {
                // The relative error of a standard deviation is half that of its variance.
                let r = self.split(what, since)?.relative();
                let value = (1.0 + r.value).max(0.0).sqrt() - 1.0;
                (Changed::DarkNoise, Reading { value, std_err: 0.5 * r.std_err })
            }
            Followed::Pattern => {
                let d = self.split(what, since)?.difference();
                let size = d.value.abs().sqrt();
                let change =
                    Reading { value: size.copysign(d.value), std_err: 0.5 * d.std_err / size.max(1e-12) };
                (Changed::Pattern, change)
            }
            Followed::Flicker => {
                let checks = &self.history[since..];
                let values = checks.iter().filter_map(|c| Some((c.readings.get(&what)?.value, c.flats)));
                let (sum, dof, n) = values.fold((0.0, 0.0, 0.0), |(sum, dof, n), (value, flats)| {
                    (sum + value, dof + flats.saturating_sub(1).max(1) as f64, n + 1.0)
                });
                let value = (sum / f64::max(n, 1.0)).sqrt();
                (Changed::Flicker, Reading { value, std_err: value / (2.0 * f64::max(dof, 1.0)).sqrt() })
            }
            Followed::LostFrames => {
                let checks = self.history[since..].iter();
                let lost: f64 = checks.filter_map(|c| Some(c.readings.get(&what)?.value)).sum();
                (Changed::LostFrames, Reading { value: lost, std_err: lost.sqrt() })
            }
            Followed::Gain | Followed::Signal => return None,
        };
        let alarm = self.alarm(changed, since, change);
        self.anew(&[what], since);
        Some(alarm)
    }

    /// Starts new baselines from the readings since a check.
    fn anew(&mut self, readings: &[Followed], since: usize) {
        for what in readings {
            let chart = self.chart_since(*what, since);
            match what {
                Followed::LostFrames => drop(self.rates.remove(what)),
                Followed::Flicker => {
                    self.rates.insert(*what, Rate { learned: chart, ..Rate::default() });
                }
                _ => {
                    self.charts.insert(*what, chart);
                }
            }
        }
    }

    /// Reports pixels that two consecutive checks flag and that were not reported yet.
    fn pixels(&mut self) -> Vec<Alarm> {
        let Some(check) = self.history.last() else { return Vec::new() };
        let now = [&check.hot, &check.dead].map(|list| list.iter().copied().collect::<BTreeSet<_>>());
        let mut alarms = Vec::new();
        for (i, what) in [Changed::HotPixels, Changed::DeadPixels].into_iter().enumerate() {
            let twice: BTreeSet<_> = now[i]
                .intersection(&self.suspects[i])
                .filter(|p| !self.told[i].contains(p))
                .copied()
                .collect();
            if !twice.is_empty() {
                let value = twice.len() as f64;
                let since = self.history.len().saturating_sub(2);
                let mut alarm = self.alarm(what, since, Reading { value, std_err: 0.0 });
                let shown: Vec<String> = twice.iter().take(3).map(|(x, y)| format!("x {x} y {y}")).collect();
                let more = if twice.len() > 3 { ", ..." } else { "" };
                alarm.sentence = alarm.sentence.replace("PIXELS", &(shown.join(", ") + more));
                alarms.push(alarm);
                self.told[i].extend(twice);
            }
        }
        self.suspects = now;
        alarms
    }

    fn alarm(&self, what: Changed, since: usize, change: Reading) -> Alarm {
        let last = self.history.last();
        let time_s = last.map_or(0.0, |c| c.time_s);
        let since_s = self.history.get(since).map_or(time_s, |c| c.time_s);
        let checks = (self.history.len() - since) as u64;
        let sentence = sentence(what, change, since_s);
        Alarm { what, time_s, since_s, checks, change, sentence }
    }
}

/// Formats a time, UTC.
pub fn clock(time_s: f64) -> String {
    let time = jiff::Timestamp::from_second(time_s as i64);
    time.map_or_else(|_| format!("{time_s} s"), |t| t.strftime("%Y-%m-%d %H:%M:%S UTC").to_string())
}

/// Returns the sentence of an alarm: what changed, by how much, since when, its cost, what to do.
fn sentence(what: Changed, change: Reading, since_s: f64) -> String {
    let since = format!("since {}", clock(since_s));
    let (value, error) = (change.value, change.std_err);
    let percent = format!("{:.2} ± {:.2} %", 100.0 * value.abs(), 100.0 * error);
    let (higher, large) = if value > 0.0 { ("higher", "high") } else { ("lower", "low") };
    match what {
        Changed::Gain => format!(
            "Gain is {percent} {higher} {since}: intensities read {:.1} % too {large}. Set the gain back, or calibrate again.",
            100.0 * value.abs()
        ),
        Changed::Light => format!(
            "The reference flat is {percent} {} {since}, and the gain is as it was: lamp, optics or the sensor's sensitivity. Look \
             at lamp and window.",
            if value > 0.0 { "brighter" } else { "darker" }
        ),
        Changed::NoLight => format!(
            "The reference flat is {:.0} % darker {since}: there is too little light to read the gain by. Look at lamp, shutter and lens cap.",
            100.0 * value.abs()
        ),
        Changed::LightOrGain => format!(
            "The reference flat is {percent} {} {since}: by the light or by the gain, which further checks will tell apart.",
            if value > 0.0 { "brighter" } else { "darker" }
        ),
        Changed::BlackLevel => format!(
            "Black level is {:.2} ± {:.2} DN {higher} {since}: every corrected value is {:.2} DN too {large}. Set it back, or take \
             new darks.",
            value.abs(),
            error,
            value.abs()
        ),
        Changed::DarkCurrent => format!(
            "Dark current is {percent} {higher} {since}: the sensor is {} than it was, or ages. Look at its temperature, or take new \
             darks.",
            if value > 0.0 { "warmer" } else { "cooler" }
        ),
        Changed::DarkNoise => {
            format!(
                "Noise of dark frames is {percent} {higher} {since}. Look at supply, grounding and cable."
            )
        }
        Changed::Pattern if value > 0.0 => format!(
            "The calibration leaves a new pattern of {percent} of the signal between neighbours {since}. Look for dust; calibrate again."
        ),
        Changed::Pattern => format!(
            "A pattern of {percent} of the signal between neighbours, which the calibration left, is gone {since}: dust that moved, or another \
             exposure. Calibrate again."
        ),
        Changed::HotPixels => {
            format!("{value:.0} new hot pixels {since} (PIXELS). Take new darks with `radcam calibrate`.")
        }
        Changed::DeadPixels => {
            format!(
                "{value:.0} new dead pixels {since} (PIXELS): dust on the window, or defects. Clean it; calibrate again."
            )
        }
        Changed::Flicker => format!(
            "The light flickers by {percent} from frame to frame {since}. Look at the lamp's supply; make exposures whole periods of \
             the mains."
        ),
        Changed::LostFrames => {
            format!("{value:.0} frames were lost on the way {since}. Look at cable, switch and packet size.")
        }
    }
}
