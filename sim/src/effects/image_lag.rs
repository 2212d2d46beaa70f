//! Image lag: charge that stays behind and is read with later frames.

use super::temporal_filter::running_average;
use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::predict::Before;
use crate::rng::PixelRng;

/// Charge carried from frame to frame: a share goes to the next frame, where all of it is read or the same
/// share stays again; or two kinds of traps release it with their own time constants.
pub struct ImageLag;

/// Mechanism that holds charge.
#[derive(Clone, Copy)]
enum Held {
    /// All of it is read with the next frame, or the same share of it stays again.
    Next { share: f64, again: bool },
    /// Shares of the charge, and the time constants of their release, s.
    Traps([(f64, f64); 2]),
}

/// Charge held from frame to frame.
type Store = [f64; 2];

impl Held {
    fn of(p: &[f64]) -> Self {
        match p[0].round() as i32 {
            2 => Self::Traps([(p[1], p[2]), (p[3], p[4])]),
            shape => Self::Next { share: p[1], again: shape == 1 },
        }
    }

    /// Returns the charge read `after_s` after the previous frame, and the charge held after it.
    fn pass(self, charge: f64, store: Store, after_s: f64) -> (f64, Store) {
        match self {
            Self::Next { share, again: false } => ((1.0 - share) * charge + store[0], [share * charge, 0.0]),
            Self::Next { share, again: true } => {
                let all = charge + store[0];
                ((1.0 - share) * all, [share * all, 0.0])
            }
            Self::Traps(traps) => {
                let (mut out, mut next) = (charge, store);
                for ((share, tau_s), held) in traps.iter().zip(&mut next) {
                    let stays = libm::exp(-after_s / tau_s.max(1e-9));
                    out += (1.0 - stays) * *held - share * charge;
                    *held = stays * *held + share * charge;
                }
                (out, next)
            }
        }
    }

    /// Version of [`Self::pass`] that holds or releases each electron at random, with the same means.
    fn pass_by_chance(self, charge: f64, store: Store, after_s: f64, rng: &mut PixelRng) -> (f64, Store) {
        match self {
            Self::Next { share, again } => {
                let all = charge + if again { store[0] } else { 0.0 };
                let stays = binomial(all, share, rng);
                (all - stays + if again { 0.0 } else { store[0] }, [stays, 0.0])
            }
            Self::Traps(traps) => {
                let (mut free, mut left, mut out, mut next) = (charge, 1.0, 0.0, store);
                for ((share, tau_s), held) in traps.iter().zip(&mut next) {
                    let stays = binomial(*held, libm::exp(-after_s / tau_s.max(1e-9)), rng);
                    let caught = binomial(free, share / left, rng);
                    (free, left) = (free - caught, left - share);
                    out += *held - stays;
                    *held = stays + caught;
                }
                (out + free, next)
            }
        }
    }

    /// Returns the charge held after many frames of this charge, one every `every_s`.
    fn settled(self, charge: f64, every_s: f64) -> Store {
        match self {
            Self::Next { share, again: false } => [share * charge, 0.0],
            Self::Next { share, again: true } => [share / (1.0 - share) * charge, 0.0],
            Self::Traps(traps) => traps
                .map(|(share, tau_s)| share * charge / -libm::expm1(-every_s.max(1e-9) / tau_s.max(1e-9))),
        }
    }

    /// Returns the relative variance of shot noise, and its correlations over 1, 2, ... frames. Charge of a
    /// frame is read in parts h0, h1, ...; the variance is the sum of their squares.
    fn noise(self, every_s: f64) -> (f64, Vec<f64>) {
        match self {
            Self::Next { share: f, again: false } => {
                let once = (1.0 - f) * (1.0 - f) + f * f;
                (once, vec![f * (1.0 - f) / once])
            }
            Self::Next { share, again: true } => running_average(share),
            Self::Traps(_) => {
                let (mut parts, mut store, mut charge) = (Vec::new(), [0.0; 2], 1.0);
                for _ in 0..10 {
                    let (out, next) = self.pass(charge, store, every_s);
                    parts.push(out);
                    (store, charge) = (next, 0.0);
                }
                let lag = |k: usize| parts.iter().zip(&parts[k..]).map(|(a, b)| a * b).sum::<f64>();
                (lag(0), (1..8).map(|k| lag(k) / lag(0)).collect())
            }
        }
    }
}

/// Index of the parameter `by_chance`.
const BY_CHANCE: usize = 5;

fn is_by_chance(p: &[f64]) -> bool {
    p[BY_CHANCE].round() as i32 == 1
}

/// Minimum variance of a binomial number that is drawn as a normal one (a named choice: its skewness is then
/// below 0.15).
const MIN_NORMAL_VARIANCE: f64 = 50.0;

/// Draws the binomial number of electrons that are held, each with this chance. A fraction of an electron is
/// split in proportion.
fn binomial(electrons: f64, chance: f64, rng: &mut PixelRng) -> f64 {
    let (p, n) = (chance.clamp(0.0, 1.0), electrons.floor());
    if p > 0.5 {
        return electrons - binomial(electrons, 1.0 - p, rng);
    }
    let part = p * (electrons - n);
    if n <= 0.0 || p <= 0.0 {
        return part;
    }
    let variance = n * p * (1.0 - p);
    if variance > MIN_NORMAL_VARIANCE {
        return part + (n * p + variance.sqrt() * rng.normal()).round().clamp(0.0, n);
    }
    // Electrons skipped until the next one is held have a geometric distribution.
    let (mut taken, mut at, per) = (0.0, 0.0, libm::log1p(-p));
    loop {
        at += 1.0 + (libm::log(1.0 - rng.uniform()) / per).floor();
        if at > n {
            return part + taken;
        }
        taken += 1.0;
    }
}

/// Minimum time constant of a trap, over the time from frame to frame: below it exp(-20) of the charge is
/// left in the next frame.
const MIN_TAU_FRAMES: f64 = 0.05;
/// Ratio of the charges of two kinds of traps below which the smaller kind holds nothing (a named choice).
const NOTHING: f64 = 1e-3;

impl Effect for ImageLag {
    fn id(&self) -> &'static str {
        "image-lag"
    }

    fn also_called(&self) -> &'static [&'static str] {
        &["lag", "ghosting", "persistence", "afterimage"]
    }

    fn stage(&self) -> Stage {
        Stage::Transfer
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "shape",
                meaning: "0: the held charge is read with the next frame, 1: over many frames, 2: two kinds of traps",
                unit: "choice",
                min: 0.0,
                max: 2.0,
                starts: &[0.0, 1.0, 2.0],
            },
            Parameter {
                name: "fraction",
                meaning: "share f of the charge that is held back",
                unit: "1",
                min: 0.0,
                max: 0.5,
                starts: &[0.005],
            },
            Parameter {
                name: "tau_s",
                meaning: "shape 2: time constant of the first kind",
                unit: "s",
                min: 1e-4,
                max: 1e4,
                starts: &[],
            },
            Parameter {
                name: "fraction_2",
                meaning: "shape 2: share that the second kind holds back",
                unit: "1",
                min: 0.0,
                max: 0.5,
                starts: &[0.002],
            },
            Parameter {
                name: "tau_2_s",
                meaning: "shape 2: time constant of the second kind",
                unit: "s",
                min: 1e-4,
                max: 1e4,
                starts: &[],
            },
            Parameter {
                name: "by_chance",
                meaning: "0: the same share of every charge, 1: each electron stays by chance",
                unit: "choice",
                min: 0.0,
                max: 1.0,
                starts: &[0.0, 1.0],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter < 2 || parameter == BY_CHANCE || p[0].round() as i32 == 2
    }

    /// Default of models written before the parameter existed.
    fn usual(&self, parameter: usize) -> Option<f64> {
        (parameter == BY_CHANCE).then_some(0.0)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(match (p[0].round() as i32, is_by_chance(p)) {
            (0, false) => "the held charge is read with the next frame",
            (1, false) => "of what stays, the same share stays again",
            (_, false) => "two time constants",
            (0, true) => "the held charge is read with the next frame; each electron stays by chance",
            (1, true) => "of what stays, the same share stays again; each electron by chance",
            (_, true) => "two time constants; each electron stays by chance",
        })
    }

    fn forms_with_same_means(&self, p: &[f64]) -> Vec<Vec<f64>> {
        let mut other = p.to_vec();
        other[BY_CHANCE] = f64::from(!is_by_chance(p));
        vec![other]
    }

    fn is_in_time(&self, p: &[f64]) -> bool {
        p[0].round() as i32 == 2
    }

    fn has_memory(&self) -> bool {
        true
    }

    fn forgets_after(&self, p: &[f64]) -> Option<usize> {
        (p[0].round() as i32 == 0).then_some(1)
    }

    /// Two kinds of traps are one kind if one of them holds nothing, releases its charge before the frame
    /// ends, or keeps it for longer than the campaign (light that is lost).
    fn is_another(&self, p: &[f64], seen: &Seen) -> bool {
        let holds_all = |tau_s: f64| tau_s > seen.duration_s.max(seen.frame_s);
        let holds_none = |tau_s: f64| tau_s < MIN_TAU_FRAMES * seen.frame_s;
        let one = [p[2], p[4]].into_iter().any(|tau_s| holds_all(tau_s) || holds_none(tau_s));
        p[0].round() as i32 == 2 && (p[1].min(p[3]) < NOTHING * p[1].max(p[3]) || one)
    }

    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let frame = seen.frame_s.max(1e-4);
        let traps = |short: f64, long: f64| [2.0, 0.005, short * frame, 0.002, long * frame];
        let all = [
            [0.0, 0.005, frame, 0.0, frame],
            [1.0, 0.005, frame, 0.0, frame],
            traps(0.7, 6.0),
            traps(2.0, 25.0),
        ];
        let of = |by_chance: f64| all.map(|p| p.into_iter().chain([by_chance]).collect());
        [of(0.0), of(1.0)].concat()
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.003, 0.8 * plain.frame_s, 0.002, 6.0 * plain.frame_s, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "The photodiode is not fully emptied at read-out, or traps hold charge: part of a frame's charge is read with later frames.",
            equation: "q_t is the charge of frame t, out_t what is read of it, f the fraction; shape 0: out_t = (1 - f) q_t + f q_(t-1), so that \
                       the variance is multiplied by (1 - f)^2 + f^2 and successive frames have the covariance f (1 - f) var q; shape 1: \
                       out_t = (1 - f) (q_t + f q_(t-1) + f^2 q_(t-2) + ...); shape 2: two kinds of \
                       traps, i = 1, 2, with f_1 = fraction, tau_1 = tau_s, f_2 = fraction_2, tau_2 = tau_2_s, s_i,t the charge that kind i holds \
                       after frame t: s_i,t = s_i,(t-1) exp(-dt / tau_i) + f_i q_t, out_t = (1 - f_1 - f_2) q_t + sum over i of s_i,(t-1) \
                       (1 - exp(-dt / tau_i)), dt the time from frame to frame; by_chance = 1: each electron is held or let go by itself, with \
                       these shares as its chance, and what is read of a steady light is Poisson's again: variance q, no covariance",
            signature: "the first frames after a change of level contain part of the previous signal, also darks that follow bright \
                        frames; at constant signal the mean is unbiased, and the temporal variance slightly too small where the same share of every charge \
                        stays (a voltage that is not reset), unchanged where each electron stays by chance (charge transfer, traps)",
            look_alikes: "a temporal filter: unlike image lag, it correlates the read noise of darks from frame to frame",
            remedy: "discard the first frames after a change of level, which makes the mean right; to correct a photon-transfer gain, \
                     divide the temporal variance (read noise taken off, over many frames and not from differences of successive ones) by \
                     (1 - f)^2 + f^2 where the held charge is read with the next frame, by (1 - f) / (1 + f) where it is read over many \
                     frames, f being the fraction (nothing is to be divided where each electron stays by chance); use a longer reset or charge \
                     flushing",
            measure: "darks directly after bright flats, and bright flats directly after darks",
            sets: takes::TRANSITIONS,
            source: "Fossum and Hondongwa 2014, IEEE JEDS 2(3); Janesick 2007; persistence: Tulloch 2019, IDW (several time constants)",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let held = Held::of(p);
        let mut last_s = None;
        let past = out.base.past_e.unwrap_or(0.0);
        let first = c.frames.first().map_or(0.0, |f| c.sets.get(f.set).map_or(0.0, |s| s.exposure_s));
        let mut store = held.settled(past, c.frame_s.max(first));
        for (m, frame) in out.frame_signal.iter_mut().zip(&c.frames) {
            let exposure_s = c.sets.get(frame.set).map_or(0.0, |s| s.exposure_s);
            let settled = |charge: f64| held.settled(charge, c.frame_s.max(exposure_s));
            match frame.before {
                Before::Frame => {}
                Before::Level => (store, last_s) = (settled(*m), None),
                Before::Dark => (store, last_s) = (settled(0.0), None),
                Before::Discarded(n) => {
                    for _ in 0..n {
                        store = held.pass(*m, store, c.frame_s.max(exposure_s)).1;
                    }
                }
            }
            // Charge is released until the frame ends.
            let end_s = frame.time_s + exposure_s;
            let after_s = last_s.map_or(c.frame_s, |last: f64| end_s - last);
            (*m, store) = held.pass(*m, store, after_s);
            last_s = Some(end_s);
        }
        // Poisson numbers stay Poisson: the electrons that are held and those that are read are independent
        // (colouring theorem: Kingman 1993, Poisson Processes, section 5.1).
        if is_by_chance(p) {
            return;
        }
        let (less, memory) = held.noise(c.frame_s);
        for s in &mut out.sets {
            s.shot.scale(less);
            s.shot_memory.clone_from(&memory);
        }
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let held = Held::of(p);
        let dim = d.image.dim();
        let mut take = |name: &'static str| {
            let kept = d.memory.remove(name).filter(|m| m.dim() == dim);
            kept.unwrap_or_else(|| ndarray::Array2::zeros(dim))
        };
        let (mut short, mut long) = (take("image-lag"), take("image-lag-2"));
        let end_s = d.time_s + d.exposure_s;
        let last_s = d.memory.get("image-lag-time").map(|t| t[(0, 0)]);
        let after_s = last_s.map_or(d.exposure_s, |last| (end_s - last).max(0.0));
        let (columns, chance) = (dim.1, is_by_chance(p));
        let mut image = std::mem::take(&mut d.image);
        ndarray::Zip::indexed(&mut image).and(&mut short).and(&mut long).for_each(|(r, c), q, a, b| {
            let store = [*a, *b];
            let (out, store) = if chance {
                let mut rng = d.random("image-lag", d.frame, (r * columns + c) as u32);
                held.pass_by_chance(*q, store, after_s, &mut rng)
            } else {
                held.pass(*q, store, after_s)
            };
            (*q, [*a, *b]) = (out, store);
        });
        d.image = image;
        d.memory.insert("image-lag", short);
        d.memory.insert("image-lag-2", long);
        d.memory.insert("image-lag-time", ndarray::Array2::from_elem((1, 1), end_s));
    }
}
