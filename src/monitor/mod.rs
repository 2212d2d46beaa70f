//! Whether a calibrated camera is still the camera that was calibrated.
//!
//! From time to time a [`Check`] takes some darks and some frames of a reference flat. Sequential tests ([`cusum`]) follow what they say, and an
//! [`Alarm`] says what changed, since when, by how much, and what that costs. All tests together raise at most one false alarm in
//! [`FALSE_ALARM_EVERY`] checks.
//!
//! The state is a function of the history: it is made anew from the checks that a store kept.

pub mod check;
pub mod cusum;
#[cfg(feature = "cli")]
pub mod metrics;
#[cfg(feature = "cli")]
pub mod store;
mod take;

pub use check::{Check, Followed, Reading, Stack, Taken};
pub use take::{Plan, TakeError, take};

use cusum::Cusum;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Checks among which one false alarm is allowed.
pub const FALSE_ALARM_EVERY: f64 = 1e4;
/// Sums that run at once: two for each of six readings, one each for flicker and lost frames.
const SUMS: usize = 14;
/// Fewest checks from which the usual value is taken.
const LEARN: usize = 8;
/// The usual value must be known to this share of the change that is looked for: its error adds to every later reading alike.
const KNOWN: f64 = 1.0 / 6.0;
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
    /// 1 % of gain, 0.5 DN, 2 % of light, a quarter of the dark current, 5 % of noise, a pattern of 0.3 %: named choices.
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
    fn of(&self, what: Followed, usual: f64) -> Option<f64> {
        match what {
            Followed::Gain => Some(self.gain * usual),
            Followed::BlackLevel => Some(self.black_level_dn),
            Followed::Signal => Some(self.signal * usual),
            Followed::DarkCurrent => Some(self.dark_current * usual.abs()),
            Followed::DarkNoise => Some(((1.0 + self.dark_noise).powi(2) - 1.0) * usual),
            Followed::Pattern => Some(self.pattern * self.pattern),
            Followed::Flicker | Followed::LostFrames => None,
        }
    }
}

/// What an alarm names.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Changed {
    /// DN per electron.
    Gain,
    /// Lamp, optics, or the sensor's sensitivity: electrons of the reference flat.
    Light,
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

/// A followed reading: its usual value, and the sums.
#[derive(Debug, Clone, Default)]
struct Chart {
    /// Readings from which the usual value is taken.
    learned: Vec<Reading>,
    usual: Option<Usual>,
    up: Cusum,
    down: Cusum,
}

#[derive(Debug, Clone, Copy)]
struct Usual {
    value: f64,
    /// Of one reading.
    std_err: f64,
    /// The change that matters.
    step: f64,
}

impl Chart {
    /// Learns the usual value, and then follows it. `true`: a sum passed the limit.
    fn follow(
        &mut self,
        what: Followed,
        reading: Reading,
        check: &Check,
        limits: &Limits,
        limit: f64,
    ) -> bool {
        match what {
            Followed::LostFrames => {
                let usual = LOST.0 * check.frames as f64;
                self.up.add(cusum::of_count(reading.value, usual, LOST.1 / LOST.0));
                return self.up.sum > limit;
            }
            Followed::Flicker => {
                let Some(usual) = self.usual else {
                    self.learned.push(reading);
                    // 40 checks of 7 degrees of freedom know a variance to 8 %, which a ratio of 4 bears.
                    if self.learned.len() >= 5 * LEARN {
                        let n = self.learned.len() as f64;
                        let value = self.learned.iter().map(|r| r.value).sum::<f64>() / n;
                        self.usual = Some(Usual { value, std_err: 0.0, step: 0.0 });
                    }
                    return false;
                };
                let dof = check.flats.saturating_sub(1) as f64;
                self.up.add(cusum::of_variance(reading.value / usual.value, dof, FLICKER_RATIO));
                return self.up.sum > limit;
            }
            _ => {}
        }
        let Some(usual) = self.usual else {
            self.learned.push(reading);
            self.usual = self.learn(what, limits);
            return false;
        };
        let z = (reading.value - usual.value) / usual.std_err;
        let shift = usual.step / usual.std_err;
        self.up.add(cusum::of_shift(z, shift));
        self.down.add(cusum::of_shift(-z, shift));
        self.up.sum > limit || self.down.sum > limit
    }

    /// The usual value, once it is known well enough.
    fn learn(&self, what: Followed, limits: &Limits) -> Option<Usual> {
        let n = self.learned.len() as f64;
        if self.learned.len() < LEARN {
            return None;
        }
        let value = self.learned.iter().map(|r| r.value).sum::<f64>() / n;
        let scatter = self.learned.iter().map(|r| (r.value - value).powi(2)).sum::<f64>() / (n - 1.0);
        let stated = self.learned.iter().map(|r| r.std_err.powi(2)).sum::<f64>() / n;
        // What checks scatter beyond their stated errors is the camera's and the room's.
        let std_err = scatter.max(stated).sqrt().max(f64::MIN_POSITIVE);
        let step = limits.of(what, value)?.max(1e-12);
        (std_err / n.sqrt() <= KNOWN * step).then_some(Usual { value, std_err, step })
    }

    /// Readings since the change, by the sum that passed.
    fn age(&self) -> u64 {
        if self.up.sum >= self.down.sum { self.up.age } else { self.down.age }
    }
}

/// What a camera was like, is like, and what changed.
#[derive(Debug, Clone)]
pub struct Monitor {
    limits: Limits,
    limit: f64,
    charts: BTreeMap<Followed, Chart>,
    history: Vec<Check>,
    /// Hot and dead pixels of the last check, and those that were told.
    suspects: [BTreeSet<(u32, u32)>; 2],
    told: [BTreeSet<(u32, u32)>; 2],
    /// A change of the reference flat that is not told apart yet, since this check.
    open: Option<usize>,
}

impl Monitor {
    /// Begins without a history.
    pub fn new(limits: Limits) -> Self {
        Self {
            limits,
            limit: cusum::limit(SUMS, FALSE_ALARM_EVERY),
            charts: BTreeMap::new(),
            history: Vec::new(),
            suspects: Default::default(),
            told: Default::default(),
            open: None,
        }
    }

    /// Checks so far.
    pub fn history(&self) -> &[Check] {
        &self.history
    }

    /// The readings whose usual value is not known well enough yet.
    pub fn learning(&self) -> Vec<Followed> {
        let learning = self.charts.iter().filter(|(w, c)| **w != Followed::LostFrames && c.usual.is_none());
        learning.map(|(what, _)| *what).collect()
    }

    /// Checks after which the change that matters is found, on average: of each reading whose usual value is known.
    pub fn checks_needed(&self) -> BTreeMap<Followed, f64> {
        let needed = |chart: &Chart| {
            let usual = chart.usual.filter(|u| u.step > 0.0)?;
            Some(cusum::readings_needed(self.limit, usual.step / usual.std_err))
        };
        self.charts.iter().filter_map(|(what, chart)| Some((*what, needed(chart)?))).collect()
    }

    /// Takes a check and says what it finds. What was told is not told again: what a reading now is becomes its usual value.
    pub fn add(&mut self, check: Check) -> Vec<Alarm> {
        let passed: Vec<Followed> = check
            .readings
            .iter()
            .filter(|(what, reading)| {
                let chart = self.charts.entry(**what).or_default();
                chart.follow(**what, **reading, &check, &self.limits, self.limit)
            })
            .map(|(what, _)| *what)
            .collect();
        self.history.push(check);
        let mut alarms = self.pixels();
        if let Some(since) = self.open {
            alarms.extend(self.light_or_gain(since, false));
        }
        let of_flat = |w: &Followed| [Followed::Gain, Followed::Signal].contains(w);
        if self.open.is_none() && passed.iter().any(of_flat) {
            let ages = passed.iter().filter(|w| of_flat(w)).filter_map(|w| Some(self.charts.get(w)?.age()));
            let since = self.history.len().saturating_sub(ages.max().unwrap_or(1) as usize);
            alarms.extend(self.light_or_gain(since, true));
        }
        for what in passed.into_iter().filter(|w| !of_flat(w)) {
            alarms.extend(self.alone(what));
        }
        alarms
    }

    /// Mean of a reading since a check, and its error; with the usual value.
    fn since(&self, what: Followed, since: usize) -> Option<(Reading, Usual)> {
        let usual = self.charts.get(&what)?.usual?;
        let values: Vec<f64> =
            self.history[since..].iter().filter_map(|c| Some(c.readings.get(&what)?.value)).collect();
        let n = values.len().max(1) as f64;
        let value = values.iter().sum::<f64>() / n;
        Some((Reading { value, std_err: usual.std_err / n.sqrt() }, usual))
    }

    /// Relative change since a check, with the error of the usual value in it.
    fn relative(&self, what: Followed, since: usize) -> Option<Reading> {
        let (now, usual) = self.since(what, since)?;
        let learned = usual.std_err / (self.charts[&what].learned.len() as f64).sqrt();
        let value = now.value / usual.value - 1.0;
        Some(Reading { value, std_err: now.std_err.hypot(learned) / usual.value })
    }

    /// A change of the reference flat or of the gain: by light, where the gain is what it was; by gain, where it changed as the flat did; else it
    /// is not known yet, which is said once.
    fn light_or_gain(&mut self, since: usize, first: bool) -> Option<Alarm> {
        let gain = self.relative(Followed::Gain, since);
        let signal = self.relative(Followed::Signal, since)?;
        let (mut by_light, mut by_gain) = (true, true);
        if let Some(gain) = gain {
            by_light = gain.value.abs() < EXCLUDED * gain.std_err;
            by_gain = (gain.value - signal.value).abs() < EXCLUDED * gain.std_err.hypot(signal.std_err);
        }
        let gain = gain.unwrap_or(Reading { value: f64::NAN, std_err: f64::NAN });
        let (what, change) = match (by_light, by_gain) {
            (true, false) => (Changed::Light, signal),
            (false, true) => (Changed::Gain, gain),
            // Both: the gain changed, and the light beside it.
            (false, false) => (Changed::Gain, gain),
            (true, true) if first => {
                self.open = Some(since);
                return Some(self.alarm(Changed::LightOrGain, since, signal));
            }
            (true, true) => return None,
        };
        let alarm = self.alarm(what, since, change);
        self.open = None;
        self.anew(&[Followed::Gain, Followed::Signal, Followed::Flicker], since);
        Some(alarm)
    }

    fn alone(&mut self, what: Followed) -> Option<Alarm> {
        let chart = self.charts.get(&what)?;
        let since = self.history.len().saturating_sub(chart.age().max(1) as usize);
        let (changed, change) = match what {
            Followed::BlackLevel => (Changed::BlackLevel, self.difference(what, since)?),
            Followed::DarkCurrent => (Changed::DarkCurrent, self.relative(what, since)?),
            Followed::DarkNoise => {
                // Of a variance half is the standard deviation's.
                let r = self.relative(what, since)?;
                let value = (1.0 + r.value).max(0.0).sqrt() - 1.0;
                (Changed::DarkNoise, Reading { value, std_err: 0.5 * r.std_err })
            }
            Followed::Pattern => {
                let d = self.difference(what, since)?;
                let value = d.value.abs().sqrt();
                (Changed::Pattern, Reading { value, std_err: 0.5 * d.std_err / value.max(1e-12) })
            }
            Followed::Flicker => {
                let checks = &self.history[since..];
                let n = checks.len().max(1) as f64;
                let now = checks.iter().map(|c| c.readings[&what].value).sum::<f64>() / n;
                let dof = n * checks.first().map_or(1.0, |c| c.flats.saturating_sub(1).max(1) as f64);
                let value = now.sqrt();
                (Changed::Flicker, Reading { value, std_err: value / (2.0 * dof).sqrt() })
            }
            Followed::LostFrames => {
                let lost: f64 = self.history[since..].iter().map(|c| c.readings[&what].value).sum();
                (Changed::LostFrames, Reading { value: lost, std_err: lost.sqrt() })
            }
            Followed::Gain | Followed::Signal => return None,
        };
        let alarm = self.alarm(changed, since, change);
        self.anew(&[what], since);
        Some(alarm)
    }

    fn difference(&self, what: Followed, since: usize) -> Option<Reading> {
        let (now, usual) = self.since(what, since)?;
        let learned = usual.std_err / (self.charts[&what].learned.len() as f64).sqrt();
        Some(Reading { value: now.value - usual.value, std_err: now.std_err.hypot(learned) })
    }

    /// What a reading is since a check becomes its usual value.
    fn anew(&mut self, readings: &[Followed], since: usize) {
        for what in readings {
            let learned: Vec<Reading> =
                self.history[since..].iter().filter_map(|c| c.readings.get(what).copied()).collect();
            let mut chart = Chart { learned, ..Chart::default() };
            chart.usual = chart.learn(*what, &self.limits);
            self.charts.insert(*what, chart);
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
        Changed::Pattern => format!(
            "The calibration leaves {} pattern of {percent} of the signal between neighbours {since}. Look for dust; calibrate again.",
            if value > 0.0 { "a new" } else { "another" }
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
