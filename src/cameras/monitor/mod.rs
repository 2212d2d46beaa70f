//! Whether a calibrated camera is still the camera that was calibrated.
//!
//! From time to time a [`Check`] takes some darks and some frames of a reference flat. Sequential tests
//! ([`chart`], [`cusum`]) follow what they say, and an [`Alarm`] says what changed, since when, by how much, and
//! what that costs. All tests together raise at most one false alarm in [`FALSE_ALARM_EVERY`] checks.
//!
//! The state is a function of the history: it is made anew from the checks that a store kept.

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

/// Checks among which one false alarm is allowed.
pub const FALSE_ALARM_EVERY: f64 = 1e4;
/// Sums that run at once: two for each of six readings, one each for flicker and lost frames.
const SUMS: usize = 14;
/// Checks from which the usual flicker is taken: 40 of 7 degrees of freedom know a variance to 8 %, which a
/// ratio of 4 bears.
const LEARN_FLICKER: usize = 40;
/// Standard errors that exclude an explanation.
const EXCLUDED: f64 = 3.0;
/// By this factor the variance of frame means is larger where the light flickers.
const FLICKER_RATIO: f64 = 4.0;
/// Frames lost for each that came: usual, and after a fault.
const LOST: (f64, f64) = (1e-4, 1e-2);

/// Changes that matter: the tests are made for them.
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
    /// What K leaves of the pattern, standard deviation relative to the signal.
    pub pattern: f64,
}

impl Default for Limits {
    /// 1 % of gain, 0.5 DN, 2 % of light, a quarter of the dark current, 5 % of noise, a pattern of 0.3 %: named
    /// choices.
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
    /// The change that matters of a reading whose usual value this is.
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

/// Whether there was light enough to read the gain by.
fn is_lit(check: &Check) -> bool {
    check.readings.contains_key(&Followed::Gain)
}

/// What an alarm names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Changed {
    /// DN per electron.
    Gain,
    /// Lamp, optics, or the sensor's sensitivity: electrons of the reference flat.
    Light,
    /// There is hardly any light.
    NoLight,
    /// The reference flat changed, and it cannot be said yet whether by light or by gain.
    LightOrGain,
    /// DN without light and without dark current.
    BlackLevel,
    /// Dark current.
    DarkCurrent,
    /// Noise of darks.
    DarkNoise,
    /// K no longer takes the pattern off.
    Pattern,
    /// New hot pixels.
    HotPixels,
    /// New dead pixels.
    DeadPixels,
    /// The light is not steady.
    Flicker,
    /// Frames are lost on the way.
    LostFrames,
}

/// A change that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Alarm {
    /// What changed.
    pub what: Changed,
    /// Time of the check that found it, seconds since 1970.
    pub time_s: f64,
    /// Time of the check since which it most likely is so, seconds since 1970.
    pub since_s: f64,
    /// Checks that it took.
    pub checks: u64,
    /// By how much; of pixels their number.
    pub change: Reading,
    /// One line: what, how much, since when, what it costs, what to do.
    pub sentence: String,
}

/// A reading that does not scatter as a normal one does: its usual value, and the sum.
#[derive(Debug, Clone, Default)]
struct Rate {
    learned: Chart,
    sum: Cusum,
    /// Which check each reading in the sum is of.
    checks: Vec<usize>,
}

impl Rate {
    /// `true`: the sum passed the limit.
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
        // Only those since the sum was 0 are asked for.
        self.checks.drain(..self.checks.len() - self.sum.age.min(self.checks.len() as u64) as usize);
        self.sum.sum > limit
    }

    fn since(&self) -> Option<usize> {
        self.checks.first().copied()
    }
}

/// What a camera was like, is like, and what changed.
#[derive(Debug, Clone)]
pub struct Monitor {
    limits: Limits,
    limit: f64,
    charts: BTreeMap<Followed, Chart>,
    rates: BTreeMap<Followed, Rate>,
    history: Vec<Check>,
    /// Hot and dead pixels of the last check, and those that were told.
    suspects: [BTreeSet<(u32, u32)>; 2],
    told: [BTreeSet<(u32, u32)>; 2],
    /// A change of the reference flat that is not told apart yet: the check at which it left what was usual, and
    /// that since which it is what it is.
    open: Option<(usize, usize)>,
    /// There is too little light to read the gain by, which was told.
    dark: bool,
}

impl Monitor {
    /// Begins without a history.
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

    /// Checks so far.
    pub fn history(&self) -> &[Check] {
        &self.history
    }

    /// The readings whose usual value is not known well enough yet: to find the change that matters would take
    /// over a quarter more checks, and one, than once it is known.
    pub fn learning(&self) -> Vec<Followed> {
        let slow = self.charts.iter().filter(|(what, chart)| {
            let (known, now) = chart.needed(|usual| self.limits.of(**what, usual), self.limit);
            chart.len() < chart::BEFORE || now > 1.25 * known + 1.0
        });
        let young =
            self.rates.iter().filter(|(w, r)| **w == Followed::Flicker && r.learned.len() < LEARN_FLICKER);
        slow.map(|(what, _)| *what).chain(young.map(|(what, _)| *what)).collect()
    }

    /// Checks after which the change that matters is found, on average: of each reading whose usual value is
    /// known.
    pub fn checks_needed(&self) -> BTreeMap<Followed, f64> {
        let needed = |(what, chart): (&Followed, &Chart)| {
            let (_, now) = chart.needed(|usual| self.limits.of(*what, usual), self.limit);
            now.is_finite().then_some((*what, now))
        };
        self.charts.iter().filter_map(needed).collect()
    }

    /// Takes a check and says what it finds. What was told is not told again: what a reading now is becomes its
    /// usual value.
    pub fn add(&mut self, check: Check) -> Vec<Alarm> {
        let at = self.history.len();
        let mut changed: BTreeMap<Followed, usize> = BTreeMap::new();
        // Signal without gain: too little light. It is told once, and the usual value is kept for when there is
        // light again.
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
        // The signal is read better than the gain: its beginning holds for both.
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

    /// Since when the reference flat is another than it was since a change that is still open.
    fn changed_again(&self, since: usize) -> Option<usize> {
        let chart = self.chart_since(Followed::Signal, since);
        chart.changed(|usual| self.limits.of(Followed::Signal, usual), self.limit)
    }

    /// The readings since a check.
    fn chart_since(&self, what: Followed, since: usize) -> Chart {
        self.chart_of(what, since..self.history.len())
    }

    /// The readings of some checks; of the signal those with light.
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

    /// A change of the reference flat or of the gain: by light, where the gain is what it was; by gain, where it
    /// changed as the flat did; else it is not known yet, which is said once.
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
            // It is as it was again: the usual value stands, and what was between is told and does not count.
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
                // Of a variance half is the standard deviation's.
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

    /// What a reading is since a check becomes its usual value.
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

    /// Pixels that two checks in a row flag and that were not told yet.
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

/// A time as people read it, UTC.
pub fn clock(time_s: f64) -> String {
    let time = jiff::Timestamp::from_second(time_s as i64);
    time.map_or_else(|_| format!("{time_s} s"), |t| t.strftime("%Y-%m-%d %H:%M:%S UTC").to_string())
}

/// What changed, by how much, since when, what it costs, what to do.
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
