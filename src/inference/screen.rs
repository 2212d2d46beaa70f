//! A quick look at what an effect would bring: by score tests, before anything is fitted.

use super::fit::{Fitted, as_given, halves};
use super::free::Free;
use super::system::{Direction, Layout, State, System};
use crate::observables::Observations;
use radcam_sim::effects::{self, Effect};

/// Sizes, relative to an effect's own start, at which its shape is looked at: many shapes change with the size.
const SIZES: [f64; 3] = [1.0, 0.1, 10.0];

/// A start with what it promises.
#[derive(Debug, Clone)]
pub struct Scored {
    /// Values of the effect's parameters.
    pub values: Vec<f64>,
    /// By how much the sum of squares would fall; infinite where that cannot be told without a fit.
    pub gain: f64,
}

/// The place of a fit, ready for looks in many directions.
pub struct Screen<'a> {
    now: &'a Fitted,
    all: &'a Observations,
    layout: Layout<'a>,
    free: Free,
    point: super::free::Point,
}

impl<'a> Screen<'a> {
    /// At a fit.
    pub fn new(all: &'a Observations, now: &'a Fitted) -> Self {
        let layout = Layout::new(all, &halves(None));
        let (free, point) = Free::new(all, &now.base, &now.effects);
        Self { now, all, layout, free, point }
    }

    /// Starts of one more effect, the most promising first; those that move nothing are left out. `given`: values that are known.
    pub fn starts(
        &self,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        hinted: &[Vec<f64>],
    ) -> Vec<Scored> {
        let state = self.layout.at(&self.free, &self.point);
        let system = System::new(&self.layout, &self.free, &self.point, &state);
        let direction = Direction::new(&system);
        self.starts_in(&state, &direction, effect, given, hinted)
    }

    /// The same with the slopes at hand.
    fn starts_in(
        &self,
        state: &State,
        direction: &Direction<'_, '_>,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        hinted: &[Vec<f64>],
    ) -> Vec<Scored> {
        let parameters = effect.parameters();
        let sized = |values: &[f64], size: f64| -> Vec<f64> {
            let of = |(v, p): (&f64, &effects::Parameter)| {
                if p.is_size() { (v * size).clamp(p.min, p.max) } else { *v }
            };
            as_given(&values.iter().zip(parameters).map(of).collect::<Vec<_>>(), given)
        };
        let has_size = parameters.iter().any(effects::Parameter::is_size);
        let crosses = !effect.keeps_sign() && parameters.iter().any(|p| p.is_size() && p.min < 0.0);
        let mut out: Vec<Scored> = Vec::new();
        for values in self.signed(effect, hinted) {
            let mut best: Option<Scored> = None;
            let mut take = |values: Vec<f64>, gain: f64| {
                if best.as_ref().is_none_or(|b| gain > b.gain) {
                    best = Some(Scored { values, gain });
                }
            };
            for size in if has_size { &SIZES[..] } else { &SIZES[..1] } {
                let values = sized(&values, *size);
                let there = self.at(effect, &values);
                if there.setting_widens(state) {
                    take(values, f64::INFINITY);
                    continue;
                }
                let Some((whole, multiple)) = direction.gain(state, &there) else { continue };
                take(values.clone(), whole);
                if !has_size || !multiple.is_finite() || multiple == 0.0 {
                    continue;
                }
                // The best multiple, if the move is in proportion to the size, and if it is so to its square.
                for by in [multiple, multiple.abs().sqrt()] {
                    if by < 0.0 && !crosses || multiple < 0.0 && by > 0.0 {
                        continue;
                    }
                    let values = sized(&values, by.clamp(-1e4, 1e4));
                    if let Some((whole, _)) = direction.gain(state, &self.at(effect, &values)) {
                        take(values, whole);
                    }
                }
            }
            out.extend(best);
        }
        out.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        out
    }

    /// A fit that keeps signs begins at every combination of them; another passes from one to the other.
    fn signed(&self, effect: &dyn Effect, hinted: &[Vec<f64>]) -> Vec<Vec<f64>> {
        if !effect.keeps_sign() {
            return hinted.to_vec();
        }
        let sizes: Vec<usize> =
            effect.parameters().iter().enumerate().filter(|(_, p)| p.is_size()).map(|(k, _)| k).collect();
        let flip = |values: &Vec<f64>, which: u32| -> Vec<f64> {
            let mut out = values.clone();
            sizes.iter().enumerate().filter(|(i, _)| which >> i & 1 == 1).for_each(|(_, k)| out[*k] *= -1.0);
            out
        };
        hinted.iter().flat_map(|v| (0..1 << sizes.len().min(4)).map(|which| flip(v, which))).collect()
    }

    fn at(&self, effect: &'static dyn Effect, values: &[f64]) -> State {
        let mut list: Vec<(&dyn Effect, &[f64])> =
            self.now.effects.iter().map(|(e, p)| (*e as &dyn Effect, p.as_slice())).collect();
        list.push((effect, values));
        self.layout.state(&effects::predict(&self.all.campaign, &self.now.base, &list))
    }
}
