//! Score tests: rank candidate effects without refitting.

use super::direction::Direction;
use super::fit::{Fitted, halves};
use super::free::Free;
use super::layout::{Layout, State};
use super::model::{as_given, listed};
use super::slopes::Slopes;
use super::system::System;
use crate::observables::Observations;
use radcam_sim::effects::{self, Chain, Effect};

/// Sizes, relative to an effect's own start, at which its shape is tested: many shapes change with the size.
const SIZES: [f64; 3] = [1.0, 0.1, 10.0];
/// Minimum promised gain, as a share of the needed gain or of that of another start of the same form. Below
/// it other sizes are not tried (a named choice).
const TOO_LITTLE: f64 = 0.1;
/// Minimum share of the best gain of a proportional move for a move to count as proportional.
const IN_PROPORTION: f64 = 0.9;

/// A start with its promised gain.
#[derive(Debug, Clone)]
pub struct Scored {
    /// Values of the effect's parameters.
    pub values: Vec<f64>,
    /// Predicted drop of the sum of squares; infinite if only a fit can tell it.
    pub gain: f64,
}

/// Multiplies the sizes among some values, within their ranges.
fn sized(effect: &dyn Effect, given: &[Option<f64>], values: &[f64], by: f64) -> Vec<f64> {
    let of = |(v, p): (&f64, &effects::Parameter)| {
        if p.is_size() { (v * by).clamp(p.min, p.max) } else { *v }
    };
    as_given(&values.iter().zip(effect.parameters()).map(of).collect::<Vec<_>>(), given)
}

/// Returns the best multiple of a size for a move in proportion to it, and for a move in proportion to its
/// square. A sign that the effect cannot have is left out.
fn multiples(effect: &dyn Effect, in_proportion: f64) -> Vec<f64> {
    let crosses = !effect.keeps_sign() && effect.parameters().iter().any(|p| p.is_size() && p.min < 0.0);
    let all = [in_proportion, in_proportion.abs().sqrt()];
    let possible = |by: &f64| if in_proportion < 0.0 { *by < 0.0 && crosses } else { *by > 0.0 };
    all.into_iter().filter(possible).map(|by| by.clamp(-1e4, 1e4)).collect()
}

/// Returns the better of two starts.
fn better(best: Option<Scored>, values: Vec<f64>, gain: f64) -> Option<Scored> {
    if best.as_ref().is_none_or(|b| gain > b.gain) { Some(Scored { values, gain }) } else { best }
}

/// A fit, prepared for score tests of many effects.
pub struct Screen<'a> {
    now: &'a Fitted,
    layout: Layout<'a>,
    free: Free,
    point: super::free::Point,
    state: State,
    slopes: Slopes,
    chain: Chain<'a>,
    needed: f64,
}

impl<'a> Screen<'a> {
    /// Prepares a fit. `needed`: gain far below which a start is of no use, if its size is not far off.
    pub fn new(all: &'a Observations, now: &'a Fitted, needed: f64) -> Self {
        let layout = Layout::new(all, &halves(None), now.effects.iter().map(|(e, _)| e));
        let (free, point) = Free::new(all, &now.base, &now.effects);
        let state = layout.at(&free, &point);
        let slopes = Slopes::new(&layout, &free, &point, &state);
        let chain = Chain::new(&all.campaign, &now.base, &listed(&now.effects));
        Self { now, layout, free, point, state, slopes, chain, needed }
    }

    /// Returns the slopes at the fit.
    pub(crate) fn slopes(&self) -> &Slopes {
        &self.slopes
    }

    /// Returns starts of one more effect, the most promising first, without those that move nothing. `given`:
    /// known values.
    pub fn starts(
        &self,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        hinted: &[Vec<f64>],
    ) -> Vec<Scored> {
        let system = System::new(&self.layout, &self.free, &self.point, &self.state, &self.slopes);
        Direction::new(&system).map_or_else(Vec::new, |d| self.starts_in(&d, effect, given, hinted))
    }

    /// Returns the same starts for a prepared score test.
    fn starts_in(
        &self,
        direction: &Direction<'_, '_>,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        hinted: &[Vec<f64>],
    ) -> Vec<Scored> {
        let mut out: Vec<Scored> = Vec::new();
        for values in self.signed(effect, hinted) {
            let same = out.iter().filter(|s| effect.form(&s.values) == effect.form(&values));
            let promised = same.map(|s| s.gain).filter(|g| g.is_finite()).fold(0.0, f64::max);
            let needed = self.needed.max(promised);
            let Some(best) = self.best_size(direction, effect, given, &values, needed) else { continue };
            let more = if best.gain < TOO_LITTLE * needed {
                None
            } else {
                self.refined(direction, effect, given, &best)
            };
            out.push(more.unwrap_or(best));
        }
        out.sort_by(|a, b| b.gain.total_cmp(&a.gain));
        out
    }

    /// Multiplies the sizes of a start for the largest promised gain. If the first size promises far less
    /// than `needed`, its result stays.
    fn best_size(
        &self,
        direction: &Direction<'_, '_>,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        values: &[f64],
        needed: f64,
    ) -> Option<Scored> {
        let has_size = effect.parameters().iter().any(effects::Parameter::is_size);
        let mut best: Option<Scored> = None;
        for size in if has_size { &SIZES[..] } else { &SIZES[..1] } {
            let values = sized(effect, given, values, *size);
            let there = self.at(effect, &values);
            if there.setting_widens(&self.state) {
                best = better(best, values, f64::INFINITY);
                continue;
            }
            let Some(moved) = self.left(direction, &there).and_then(|l| direction.gain(&l)) else { continue };
            best = better(best, values.clone(), moved.whole);
            if !has_size || !moved.multiple.is_finite() || moved.multiple == 0.0 {
                continue;
            }
            let mut reached = moved.whole;
            for multiple in multiples(effect, moved.multiple) {
                let values = sized(effect, given, &values, multiple);
                let there = self.left(direction, &self.at(effect, &values));
                if let Some(there) = there.and_then(|l| direction.gain(&l)) {
                    best = better(best, values, there.whole);
                    reached = reached.max(there.whole);
                }
                if reached > IN_PROPORTION * moved.best {
                    break;
                }
            }
            // A shape that does not change with the size has shown all.
            if reached > IN_PROPORTION * moved.best || moved.best.max(reached) < TOO_LITTLE * needed {
                break;
            }
        }
        best
    }

    fn left(&self, direction: &Direction<'_, '_>, there: &State) -> Option<Vec<f64>> {
        direction.left_of(&self.state, there)
    }

    /// Optimises several sizes of an effect jointly, in one step from a start.
    fn refined(
        &self,
        direction: &Direction<'_, '_>,
        effect: &'static dyn Effect,
        given: &[Option<f64>],
        start: &Scored,
    ) -> Option<Scored> {
        let parameters = effect.parameters();
        let known = |k: usize| given.get(k).copied().flatten().is_some();
        let free: Vec<usize> = (0..parameters.len())
            .filter(|k| parameters[*k].is_size() && effect.uses(&start.values, *k) && !known(*k))
            .collect();
        if free.len() < 2 || !start.gain.is_finite() {
            return None;
        }
        let from = self.left(direction, &self.at(effect, &start.values))?;
        let step = |k: usize| 0.01 * start.values[k].abs().max(1e-3 * parameters[k].max.abs().min(1.0));
        let moves: Option<Vec<Vec<f64>>> = free
            .iter()
            .map(|&k| {
                let mut values = start.values.clone();
                values[k] += step(k);
                let mut left = self.left(direction, &self.at(effect, &values))?;
                left.iter_mut().zip(&from).for_each(|(l, f)| *l -= f);
                Some(left)
            })
            .collect();
        let multiples = direction.together(&from, &moves?)?;
        let mut values = start.values.clone();
        for (&k, m) in free.iter().zip(multiples) {
            let p = parameters[k];
            let moved = (values[k] + m * step(k)).clamp(p.min, p.max);
            // A fit that keeps signs does not pass through 0.
            values[k] = if effect.keeps_sign() && moved * values[k] <= 0.0 { 0.1 * values[k] } else { moved };
        }
        let gain = direction.gain(&self.left(direction, &self.at(effect, &values))?)?.whole;
        (gain > start.gain).then_some(Scored { values, gain })
    }

    /// Returns the starts with every combination of signs, for an effect whose fit keeps signs. Other fits
    /// pass from one sign to the other.
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
        let mut list = listed(&self.now.effects);
        list.push((effect, values));
        let prediction = self.chain.predict(&self.now.base, &list);
        self.layout.state_beside(&prediction, Some((self.chain.prediction(), &self.state)))
    }
}
