//! Slopes (Jacobian) of the expectations with the fitted values: computed by differences, and handed from fit
//! to fit as long as they serve.

use super::free::{Common, Free, Key, Point};
use super::layout::{Layout, State};
use super::model::listed;
use crate::observables::monitor;
use radcam_sim::effects::Chain;
use rayon::prelude::*;

/// Slopes of the expectations with the common values, at some point.
#[derive(Clone)]
pub struct Slopes {
    /// Key of each value; `None` if its slopes are not known.
    keys: Vec<Option<Key>>,
    /// Places of the rows in [`Observations::list`], and sets of the blocks.
    rows: Vec<usize>,
    sets: Vec<usize>,
    /// Slopes per unit of [`Point::x`], row by row.
    expected: Vec<f64>,
    /// Change of the logarithm of the error of rows whose error is fitted, per unit of [`Point::x`].
    pub(super) scatter: Vec<(usize, Vec<f64>)>,
    /// Change of [`State::setting`], block by block.
    pub(super) setting: Vec<f64>,
    scale: Vec<f64>,
}

impl Slopes {
    /// Computes the slopes at a point.
    pub fn new(layout: &Layout<'_>, free: &Free, point: &Point, now: &State) -> Self {
        Self::beside(None, layout, free, point, now)
    }

    /// Returns the approximate memory use, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.expected.as_slice()) + size_of_val(self.setting.as_slice())
    }

    /// Computes the slopes at a point near one where they are known, perhaps of another model or other
    /// halves. Only slopes that are not known there are computed.
    pub fn beside(
        known: Option<&Self>,
        layout: &Layout<'_>,
        free: &Free,
        point: &Point,
        now: &State,
    ) -> Self {
        let mut out = Self::of_nothing(layout, free);
        let serves = known.filter(|k| k.has_all(&out.rows, &out.sets));
        let place = |i: usize| serves?.keys.iter().position(|k| k.is_some() && *k == out.keys[i]);
        let places: Vec<Option<usize>> = (0..free.common.len()).map(place).collect();
        let fresh = |i: &usize| !free.fixed[*i] && places[*i].is_none();
        let fresh: Vec<usize> = (0..places.len()).filter(fresh).collect();
        let (base, effects) = free.unpack(point);
        let effects = listed(&effects);
        let of_effects = fresh.iter().filter(|i| matches!(free.common[**i], Common::Of(..))).count();
        let chain = (of_effects > 1).then(|| Chain::new(&layout.all.campaign, &base, &effects));
        let moved = fresh.into_par_iter().map(|i| (i, moved(layout, free, point, now, chain.as_ref(), i)));
        for (i, (step, there)) in moved.collect::<Vec<_>>() {
            out.put(i, step, now, &there);
        }
        if let Some(known) = serves {
            out.take(known, &places);
        }
        out
    }

    /// Returns slopes of 0 for the rows of a layout.
    fn of_nothing(layout: &Layout<'_>, free: &Free) -> Self {
        let (n, rows, blocks) = (free.common.len(), layout.rows.len(), layout.blocks.len());
        let monitors = (0..rows).filter(|r| layout.rows[*r].is(&monitor::Monitor));
        Self {
            keys: (0..n).map(|i| (!free.fixed[i]).then(|| free.key(i))).collect(),
            rows: layout.places.clone(),
            sets: layout.blocks.iter().map(|(set, _)| *set).collect(),
            expected: vec![0.0; rows * n],
            scatter: monitors.map(|r| (r, vec![0.0; n])).collect(),
            setting: vec![0.0; blocks * n],
            scale: free.scale.clone(),
        }
    }

    /// Computes the slopes with one value again, at this point.
    pub fn take_again(&mut self, i: usize, layout: &Layout<'_>, free: &Free, point: &Point, now: &State) {
        let (step, there) = moved(layout, free, point, now, None, i);
        self.put(i, step, now, &there);
    }

    /// Sets the slopes with one value from the states before and after a step of it.
    fn put(&mut self, i: usize, step: f64, now: &State, there: &State) {
        let n = self.scale.len();
        for (r, (a, b)) in now.expected.iter().zip(&there.expected).enumerate() {
            self.expected[r * n + i] = (b.normal.1 - a.normal.1) / step;
        }
        for (r, slopes) in &mut self.scatter {
            slopes[i] = (there.expected[*r].normal.2 / now.expected[*r].normal.2).ln() / step;
        }
        for (b, (was, is)) in now.setting.iter().zip(&there.setting).enumerate() {
            self.setting[b * n + i] = (is - was) / step;
        }
    }

    /// Returns true if these rows and sets are among its own; rows are in ascending order.
    fn has_all(&self, rows: &[usize], sets: &[usize]) -> bool {
        let among = |few: &[usize], all: &[usize]| few.iter().all(|x| all.binary_search(x).is_ok());
        among(rows, &self.rows) && sets.iter().all(|s| self.sets.contains(s))
    }

    /// Copies known slopes, each from its place there.
    fn take(&mut self, known: &Self, places: &[Option<usize>]) {
        let (n, m) = (self.scale.len(), known.scale.len());
        let own = |r: usize| known.rows.binary_search(&r).unwrap_or(0);
        let row_of: Vec<usize> = self.rows.iter().map(|r| own(*r)).collect();
        let block = |set: &usize| known.sets.iter().position(|s| s == set).unwrap_or(0);
        let block_of: Vec<usize> = self.sets.iter().map(block).collect();
        for (i, k) in places.iter().enumerate() {
            let Some(k) = *k else { continue };
            let by = self.scale[i] / known.scale[k];
            for (r, from) in row_of.iter().enumerate() {
                self.expected[r * n + i] = by * known.expected[from * m + k];
            }
            for (b, from) in block_of.iter().enumerate() {
                self.setting[b * n + i] = by * known.setting[from * m + k];
            }
            for (r, slopes) in &mut self.scatter {
                let from = known.scatter.iter().find(|(row, _)| *row == row_of[*r]);
                slopes[i] = from.map_or(0.0, |(_, of)| by * of[k]);
            }
        }
    }

    /// Updates the slopes so that they reproduce a step, without a prediction (Broyden 1965; Madsen, Nielsen
    /// and Tingleff 2004, section 3.5). Their error is distributed over the values in proportion to the move
    /// of each, in the metric of `weights`, the diagonal of the normal matrix. `predicted`: effect of the
    /// step by the old slopes, row by row.
    pub fn follow(&mut self, moved: &[f64], weights: &[f64], predicted: &[f64], from: &State, to: &State) {
        let weighted: Vec<f64> = moved.iter().zip(weights).map(|(x, w)| x * w).collect();
        let square: f64 = weighted.iter().zip(moved).map(|(w, x)| w * x).sum();
        if square <= 0.0 || !square.is_finite() {
            return;
        }
        let rows = self.expected.chunks_exact_mut(moved.len()).zip(predicted);
        for ((row, predicted), (a, b)) in rows.zip(from.expected.iter().zip(&to.expected)) {
            let missed = (b.normal.1 - a.normal.1 - predicted) / square;
            if missed != 0.0 && missed.is_finite() {
                row.iter_mut().zip(&weighted).for_each(|(s, w)| *s += missed * w);
            }
        }
    }

    /// Predicts the effect of a step of the common values and of the factor of each row's light. The slope of
    /// that factor is the slope of the value `light`.
    pub fn predicted(&self, moved: &[f64], light: Option<usize>, factors: impl Fn(usize) -> f64) -> Vec<f64> {
        let of = |(r, row): (usize, &[f64])| {
            let common: f64 = row.iter().zip(moved).map(|(s, x)| s * x).sum();
            common + light.map_or(0.0, |i| row[i] * factors(r))
        };
        self.expected.chunks_exact(moved.len()).enumerate().map(of).collect()
    }

    /// Returns the slopes over the errors of the expectations.
    pub fn over_errors(&self, now: &State) -> Vec<f64> {
        let n = self.scale.len();
        let mut out = Vec::with_capacity(self.expected.len());
        for (row, e) in self.expected.chunks_exact(n).zip(&now.expected) {
            out.extend(row.iter().map(|s| s / e.normal.2));
        }
        out
    }
}

/// Takes a small step of one value, within its bounds; returns the step and the state there.
fn moved(
    layout: &Layout<'_>,
    free: &Free,
    point: &Point,
    now: &State,
    chain: Option<&Chain<'_>>,
    i: usize,
) -> (f64, State) {
    let step = 1e-5 * point.x[i].abs().max(1e-2);
    let step = if point.x[i] + step > free.bounds[i].1 { -step } else { step };
    let mut moved = point.clone();
    moved.x[i] += step;
    (step, layout.at_from(free, &moved, now, point, chain))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observables::Expected;

    fn state(values: &[f64]) -> State {
        let expected =
            |v: &f64| Expected { value: *v, std_err: 1.0, common: 0.0, normal: (0.0, *v, 1.0), heavy: false };
        State { expected: values.iter().map(expected).collect(), setting: Vec::new() }
    }

    /// Definition of the update: after a step the slopes reproduce it; across the step (in the metric of the
    /// weights) they predict what they did before.
    #[test]
    fn slopes_follow_a_step_and_stay_across_it() {
        let before = vec![1.0, 2.0, -0.5, 3.0];
        let mut slopes = Slopes {
            keys: vec![None, None],
            rows: vec![0, 1],
            sets: Vec::new(),
            expected: before.clone(),
            scatter: Vec::new(),
            setting: Vec::new(),
            scale: vec![1.0, 1.0],
        };
        let (moved, weights) = ([0.2, -0.1], [4.0, 9.0]);
        let (from, to) = (state(&[0.0, 5.0]), state(&[0.7, 4.2]));
        let predicted = slopes.predicted(&moved, None, |_| 0.0);
        slopes.follow(&moved, &weights, &predicted, &from, &to);
        for (now, did) in slopes.predicted(&moved, None, |_| 0.0).iter().zip([0.7, -0.8]) {
            assert!((now - did).abs() < 1e-12, "{now}, not {did}");
        }
        // sum of weights * moved * across = 0.
        let across = [weights[1] * moved[1], -weights[0] * moved[0]];
        let now = slopes.predicted(&across, None, |_| 0.0);
        for (row, now) in before.chunks(2).zip(now) {
            let was = row[0] * across[0] + row[1] * across[1];
            assert!((now - was).abs() < 1e-12, "{now}, was {was}");
        }
    }
}
