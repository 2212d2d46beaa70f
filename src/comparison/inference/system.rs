//! Residuals and slopes at one point of a fit: common values, and light factors that touch their own sets
//! only.

use super::free::{Common, Free, Point};
use super::layout::{Layout, State};
use super::normal::{LightTerm, Normal};
use super::slopes::Slopes;
use super::white::White;
use crate::observables::{Expected, HEAVY_DOF, Observable, lightened};

/// Maximum squared residual that counts for a fitted scatter; a larger one says that the model is wrong, not
/// how large the scatter is.
const LARGE: f64 = 16.0;

/// Minimum degrees of freedom that tell the scatter of settings (a named choice).
const LEAST_TOLD: f64 = 0.5;
/// Variance of settings, over that of the frames' means, below which it counts as none.
const NO_SETTING: f64 = 1e-6;

/// Rows with their slopes, at one point.
pub struct System<'a> {
    pub(super) layout: &'a Layout<'a>,
    /// Number of common values.
    pub(super) n: usize,
    /// Standardised residuals; after those of the observables, one for each set whose setting scatters.
    pub z: Vec<f64>,
    /// Expected square of each residual.
    expected_square: Vec<f64>,
    /// Slopes of the expectations with the common values over their errors, row by row.
    pub slopes: Vec<f64>,
    /// Slope with the factor of the row's light level.
    pub(super) by_light: Vec<f64>,
    /// Index of that factor.
    pub(super) light: Vec<Option<usize>>,
    /// Rows whose error is a fitted scatter, with the slopes of its logarithm.
    scatter: Vec<(usize, Vec<f64>)>,
    pub(super) blocks: Vec<Block>,
    pub(super) white: White,
    priors: Vec<(usize, f64, f64)>,
    lights: usize,
    /// Information on each open light, without the settings that scatter.
    known_light: Vec<f64>,
}

/// Observables of one set that see its light, for a setting that scatters.
pub(super) struct Block {
    pub(super) rows: Vec<usize>,
    /// Index of the setting.
    setting: usize,
    /// Slope of each row with the light, over its error.
    pub(super) loads: Vec<f64>,
    /// Sum of the squared loads.
    pub(super) weight: f64,
    /// Squared slope of the mean with the light, DN^2.
    pub(super) unit: f64,
    /// Part of a degree of freedom that it contributes to the scatter of settings.
    pub(super) told: f64,
    /// Variance of the setting plus that of the frames' estimate of it, in units of the light squared.
    pub(super) variance: f64,
}

impl Block {
    /// Subtracts the common part of its rows, in proportion to their loads, from rows of n numbers, and
    /// returns it.
    fn take_common_of(&self, values: &mut [f64], n: usize) -> Vec<f64> {
        let mut common = vec![0.0; n];
        for (r, a) in self.rows.iter().zip(&self.loads) {
            common.iter_mut().zip(&values[r * n..][..n]).for_each(|(sum, v)| *sum += a * v);
        }
        common.iter_mut().for_each(|sum| *sum /= self.weight);
        for (r, a) in self.rows.iter().zip(&self.loads) {
            values[r * n..][..n].iter_mut().zip(&common).for_each(|(v, sum)| *v -= a * sum);
        }
        common
    }

    /// Subtracts the common part of its rows from single numbers, and returns it.
    pub(super) fn take_common(&self, values: &mut [f64]) -> f64 {
        let rows = || self.rows.iter().zip(&self.loads);
        let common = rows().map(|(r, a)| a * values[*r]).sum::<f64>() / self.weight;
        rows().for_each(|(r, a)| values[*r] -= a * common);
        common
    }
}

/// Sums of products over all rows: the vectorised part.
struct Products<'s, 'a> {
    system: &'s System<'a>,
    out: &'s mut Normal,
}

impl pulp::NullaryFnOnce for Products<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for r in 0..self.system.z.len() {
            self.system.add_row(self.out, r);
        }
    }
}

/// Replaces residuals with heavy tails by normal ones of the same cost.
fn lighten(z: &mut [f64], at: &State) {
    for (z, _) in z.iter_mut().zip(&at.expected).filter(|(_, e)| e.heavy) {
        *z = lightened(*z);
    }
}

impl<'a> System<'a> {
    /// Builds the system at a point, with slopes there or near.
    pub fn new(layout: &'a Layout<'a>, free: &Free, point: &Point, now: &State, known: &Slopes) -> Self {
        let n = free.common.len();
        let rows = layout.rows.len();
        let white = White::new(layout, &now.expected, |_| 1.0);
        let mut slopes = known.over_errors(now);
        white.apply(&mut slopes, n);
        let mut z: Vec<f64> = now.expected.iter().map(Expected::z).collect();
        white.apply(&mut z, 1);
        // Student's t as weights computed anew in every round (Lange, Little and Taylor 1989).
        for r in (0..rows).filter(|r| now.expected[*r].heavy) {
            let weight = 1.0 / (1.0 + z[r] * z[r] / HEAVY_DOF);
            z[r] *= weight.sqrt();
            slopes[r * n..][..n].iter_mut().for_each(|s| *s *= weight.sqrt());
        }
        // All light together: for the observables of a set this is the slope with their own factor.
        let all_light = free.place(Common::Light).unwrap_or(0);
        let by_light: Vec<f64> = (0..rows).map(|r| slopes[r * n + all_light]).collect();
        let level = |o: &&Observable| o.set.and_then(|s| layout.all.campaign.sets[s].light);
        let factor = |o: &&Observable| level(o).and_then(|l| free.light_of_level.get(l).copied().flatten());
        let priors = free.lights.iter().zip(&point.lights).enumerate();
        let mut system = Self {
            layout,
            n,
            z,
            expected_square: vec![1.0; rows],
            slopes,
            by_light,
            light: layout.rows.iter().map(factor).collect(),
            scatter: Vec::new(),
            blocks: Vec::new(),
            white,
            priors: priors.filter_map(|(k, (l, x))| Some((k, *x, 1.0 / l.known?.powi(2)))).collect(),
            lights: free.lights.len(),
            known_light: Vec::new(),
        };
        system.gather(now, known);
        system.scatter.extend(known.scatter.iter().cloned());
        system
    }

    /// Splits the observables that see the light of a set whose setting scatters into deviations among
    /// themselves and one row for the common deviation.
    fn gather(&mut self, now: &State, known: &Slopes) {
        for b in 0..self.layout.blocks.len() {
            if let Some(block) = self.block(b, now) {
                let by = 0.5 / block.unit / block.variance;
                let scatter = known.setting[b * self.n..][..self.n].iter().map(|s| by * s).collect();
                self.add(block, scatter);
            }
        }
        self.share_out();
    }

    /// Computes the information of each setting on their scatter: the part left once the open light of its
    /// level is fitted (restricted likelihood: Patterson and Thompson 1971, Biometrika 58). The only setting
    /// of an open light tells nothing.
    fn share_out(&mut self) {
        let first = self.layout.rows.len();
        self.known_light = vec![0.0; self.lights];
        for (light, by) in self.light.iter().zip(&self.by_light).take(first) {
            light.iter().for_each(|k| self.known_light[*k] += by * by);
        }
        self.priors.iter().for_each(|(k, _, weight)| self.known_light[*k] += weight);
        let mut squares = self.known_light.clone();
        for (light, block) in self.light[first..].iter().zip(&self.blocks) {
            light.iter().for_each(|k| squares[*k] += block.variance.recip());
        }
        for (b, block) in self.blocks.iter_mut().enumerate() {
            let taken = self.light[first + b].map_or(0.0, |k| 1.0 / block.variance / squares[k].max(1e-300));
            block.told = (1.0 - taken).clamp(0.0, 1.0);
            self.expected_square[first + b] = block.told;
        }
    }

    /// Builds the block of observables that see the light of a set; `None` if its setting does not scatter.
    fn block(&self, b: usize, now: &State) -> Option<Block> {
        let rows = self.layout.blocks[b].1.clone();
        let loads: Vec<f64> = rows.iter().map(|r| self.by_light[*r]).collect();
        let weight: f64 = loads.iter().map(|a| a * a).sum();
        let has_level = self.layout.rows[rows[0]].statistic.is_level();
        if now.setting[b] <= 0.0 || weight <= 0.0 || !has_level {
            return None;
        }
        // Setting scatter: a variance of the mean in DN^2, over the squared slope of the mean with the light.
        let unit = (loads[0] * now.expected[rows[0]].normal.2).powi(2);
        let variance = now.setting[b] / unit + 1.0 / weight;
        Some(Block { rows, setting: self.layout.blocks[b].0, loads, weight, unit, variance, told: 1.0 })
    }

    /// Moves a block's common deviation into a row of its own. `scatter`: slopes of the logarithm of its
    /// error.
    fn add(&mut self, block: Block, scatter: Vec<f64>) {
        let (n, root) = (self.n, block.variance.sqrt());
        let common = block.take_common(&mut self.z);
        let last = block.take_common_of(&mut self.slopes, n).into_iter().map(|s| s / root);
        for (r, a) in block.rows.iter().zip(&block.loads) {
            self.expected_square[*r] = 1.0 - a * a / block.weight;
            self.by_light[*r] = 0.0;
        }
        self.scatter.push((self.z.len(), scatter));
        self.z.push(common / root);
        self.expected_square.push(1.0);
        self.slopes.extend(last);
        self.by_light.push(1.0 / root);
        self.light.push(self.light[block.rows[0]]);
        self.blocks.push(block);
    }

    /// Computes half the gradient and the normal matrix.
    pub fn normal(&self) -> Normal {
        let n = self.n;
        let mut out = Normal {
            n,
            matrix: vec![0.0; n * n],
            gradient: vec![0.0; n],
            held: (0..n).map(|i| self.is_scatter(i)).collect(),
            lights: vec![LightTerm { square: 0.0, gradient: 0.0, with: vec![0.0; n] }; self.lights],
        };
        pulp::Arch::new().dispatch(Products { system: self, out: &mut out });
        // Fisher's scoring (Rao 1973, section 5g): the squared residuals of its rows tell a fitted scatter.
        for (r, slopes) in &self.scatter {
            let (square, expected) = ((self.z[*r] * self.z[*r]).min(LARGE), self.expected_square[*r]);
            for i in (0..n).filter(|i| slopes[*i] != 0.0) {
                out.gradient[i] += slopes[i] * (square - expected);
                for j in 0..=i {
                    out.matrix[i * n + j] += 2.0 * expected * slopes[i] * slopes[j];
                }
            }
        }
        for (k, factor, weight) in &self.priors {
            out.lights[*k].square += weight;
            out.lights[*k].gradient -= weight * factor;
        }
        for i in 0..n {
            for j in 0..i {
                out.matrix[j * n + i] = out.matrix[i * n + j];
            }
        }
        out
    }

    /// Adds a row to the lower half of the matrix, to the gradient and to its light's.
    #[inline(always)]
    fn add_row(&self, out: &mut Normal, r: usize) {
        let (n, z) = (self.n, self.z[r]);
        let row = &self.slopes[r * n..][..n];
        // Loops instead of closures: closures may not be inlined into the vectorised code.
        for (i, by) in row.iter().enumerate() {
            if *by == 0.0 {
                continue;
            }
            out.gradient[i] += by * z;
            for (sum, s) in out.matrix[i * n..][..=i].iter_mut().zip(row) {
                *sum += by * s;
            }
        }
        let Some(light) = self.light[r] else { return };
        if self.by_light[r] == 0.0 {
            return;
        }
        let (a, term) = (self.by_light[r], &mut out.lights[light]);
        term.square += a * a;
        term.gradient += a * z;
        for (w, s) in term.with.iter_mut().zip(row) {
            *w += a * s;
        }
    }

    /// Returns true if a value is a scatter and moves no expectation.
    fn is_scatter(&self, i: usize) -> bool {
        let moves = || self.slopes.iter().skip(i).step_by(self.n).any(|s| *s != 0.0);
        self.scatter.iter().any(|(_, slopes)| slopes[i] != 0.0) && !moves()
    }

    /// Computes the factor of every fitted scatter that makes squared residuals equal their expectation, for
    /// the given residuals. A joint step with values that move expectations overshoots, since each changes
    /// what the other sees.
    pub fn scatter_factors(&self) -> Vec<(usize, f64)> {
        let all = (0..self.n).filter(|i| self.is_scatter(*i));
        all.map(|i| (i, self.factor_of_rows(i).unwrap_or_else(|| self.factor_of_settings()))).collect()
    }

    /// Computes the factor of a scatter of observables; `None` for the scatter of settings.
    fn factor_of_rows(&self, i: usize) -> Option<f64> {
        let (mut square, mut expected) = (0.0, 0.0);
        for (r, _) in self.scatter.iter().filter(|(_, slopes)| slopes[i] != 0.0) {
            if *r >= self.layout.rows.len() {
                return None;
            }
            square += self.z[*r] * self.z[*r];
            expected += self.expected_square[*r];
        }
        Some((square / f64::max(expected, 1e-9)).sqrt().clamp(0.3, 3.0))
    }

    /// Computes the factor of the scatter of settings: of their own variance, without that of the frames.
    fn factor_of_settings(&self) -> f64 {
        let of = |(b, z): (&Block, &f64)| {
            (z * z * b.variance, b.variance - 1.0 / b.weight, 1.0 / b.weight, b.told)
        };
        let parts: Vec<_> = self.blocks.iter().zip(&self.z[self.layout.rows.len()..]).map(of).collect();
        if parts.iter().map(|(.., told)| told).sum::<f64>() < LEAST_TOLD {
            return 1.0;
        }
        let excess =
            |f: f64| parts.iter().map(|(e, own, frames, told)| e / (f * own + frames) - told).sum::<f64>();
        if excess(1e-8) <= 0.0 {
            // The scatter is already negligible beside that of the frames.
            let is_nothing = parts.iter().all(|(_, own, frames, _)| *own < NO_SETTING * frames);
            return if is_nothing { 1.0 } else { 1e-4 };
        }
        let (mut low, mut high) = (1e-8f64, 1e8f64);
        for _ in 0..60 {
            let middle = (low * high).sqrt();
            if excess(middle) > 0.0 { low = middle } else { high = middle }
        }
        low.sqrt().clamp(0.05, 20.0)
    }

    /// Computes minus twice the log likelihood at another point, with the errors of this one except for
    /// fitted scatters.
    pub fn objective(&self, here: &State, there: &State, lights: &[f64]) -> f64 {
        let mut z: Vec<f64> = here
            .expected
            .iter()
            .zip(&there.expected)
            .map(|(a, b)| (b.normal.0 - b.normal.1) / a.normal.2)
            .collect();
        self.white.apply(&mut z, 1);
        lighten(&mut z, here);
        let mut sum = 0.0;
        for (r, _) in self.scatter.iter().filter(|(r, _)| *r < here.expected.len()) {
            let e = &there.expected[*r];
            z[*r] = e.z();
            sum += 2.0 * e.normal.2.ln();
        }
        sum += self.of_blocks(&mut z, there, false);
        sum + z.iter().map(|z| z * z).sum::<f64>() + self.of_priors(lights)
    }

    /// Predicts the drop in the sum of squares for a step, if expectations followed their slopes.
    pub fn promised(&self, step: &[f64], lights: &[f64]) -> f64 {
        let of = |(r, z): (usize, &f64)| {
            let row = &self.slopes[r * self.n..][..self.n];
            let common: f64 = row.iter().zip(step).map(|(s, x)| s * x).sum();
            let left = z - common - self.light[r].map_or(0.0, |k| self.by_light[r] * lights[k]);
            z * z - left * left
        };
        self.z.iter().enumerate().map(of).sum()
    }

    /// Updates slopes so that they reproduce a step.
    pub fn follow(
        &self,
        slopes: &mut Slopes,
        free: &Free,
        moved: &Point,
        from: &State,
        to: &State,
        normal: &Normal,
    ) {
        let light = |r: usize| self.light[r].map_or(0.0, |k| moved.lights[k]);
        let predicted = slopes.predicted(&moved.x, free.place(Common::Light), light);
        let weights: Vec<f64> = (0..self.n).map(|i| normal.matrix[i * self.n + i]).collect();
        slopes.follow(&moved.x, &weights, &predicted, from, to);
    }

    fn of_priors(&self, lights: &[f64]) -> f64 {
        self.priors.iter().map(|(k, _, weight)| weight * lights[*k] * lights[*k]).sum()
    }

    /// Subtracts the common deviation of each block from its rows, and returns minus twice the log restricted
    /// likelihood of the settings.
    fn of_blocks(&self, z: &mut [f64], there: &State, whole: bool) -> f64 {
        let mut sum = 0.0;
        let (mut with, mut without) = (vec![0.0; self.lights], vec![0.0; self.lights]);
        let mut known = self.blocks.iter();
        let mut next = known.next();
        for (b, (_, rows)) in self.layout.blocks.iter().enumerate() {
            let Some(block) = next.filter(|block| block.rows == *rows) else { continue };
            next = known.next();
            let variance = (there.setting[b] / block.unit + 1.0 / block.weight).max(1e-30);
            let common = block.loads.iter().zip(rows).map(|(a, r)| a * z[*r]).sum::<f64>() / block.weight;
            rows.iter().zip(&block.loads).for_each(|(r, a)| z[*r] -= a * common);
            sum += common * common / variance + variance.ln() + if whole { block.weight.ln() } else { 0.0 };
            if let Some(k) = self.light[rows[0]] {
                with[k] += variance.recip();
                without[k] += block.weight;
            }
        }
        // Information on each open light, with and without the scatter of settings.
        let parts = self.known_light.iter().zip(with.iter().zip(&without));
        let open = parts.filter(|(_, (_, without))| **without > 0.0);
        sum + open.map(|(known, (with, without))| ((known + with) / (known + without)).ln()).sum::<f64>()
    }

    /// Returns the logarithm of the information on each open light, whose error is none of the model's: a
    /// level with a light of its own fits its mean whatever the error of that, and a model with larger
    /// errors, of flicker say, would seem the worse for it (restricted likelihood: Patterson and Thompson
    /// 1971).
    fn of_open_lights(&self) -> f64 {
        let mut information = self.known_light.clone();
        for (block, light) in self.blocks.iter().zip(&self.light[self.layout.rows.len()..]) {
            light.iter().for_each(|k| information[*k] += block.weight);
        }
        information.iter().filter(|i| **i > 0.0).map(|i| i.ln()).sum()
    }

    /// Computes minus twice the log likelihood at this point.
    pub fn likelihood(&self, here: &State, lights: &[f64]) -> f64 {
        let mut z: Vec<f64> = here.expected.iter().map(Expected::z).collect();
        self.white.apply(&mut z, 1);
        lighten(&mut z, here);
        let errors: f64 = here.expected.iter().map(|e| 2.0 * e.normal.2.ln()).sum();
        let errors = errors + self.white.log_det();
        let blocks = self.of_blocks(&mut z, here, true);
        let sum = z.iter().map(|z| z * z).sum::<f64>() + errors + blocks + self.of_priors(lights);
        let sum = sum + self.of_open_lights();
        if sum.is_nan() { f64::INFINITY } else { sum }
    }

    /// Returns the standardised deviations of the settings, by set. The only set at an open light tells
    /// nothing.
    pub fn setting_scores(&self) -> Vec<(usize, f64)> {
        /// Minimum part of a degree of freedom for a setting to tell anything (a named choice).
        const MIN_TOLD: f64 = 0.05;
        let blocks = self.blocks.iter().zip(&self.z[self.layout.rows.len()..]);
        let told = blocks.filter(|(block, _)| block.told > MIN_TOLD);
        // Set, deviation, and the setting's part of its variance; the frames' error has the rest.
        let scores: Vec<(usize, f64, f64)> = told
            .filter_map(|(block, z)| {
                let of_setting = 1.0 - 1.0 / (block.weight * block.variance);
                Some((self.layout.rows[block.rows[0]].set?, *z, of_setting.clamp(0.0, 1.0)))
            })
            .collect();
        let of_scores: Vec<(f64, f64)> = scores.iter().map(|(_, z, part)| (*z, *part)).collect();
        let standardised = alike(&of_scores);
        scores.iter().zip(standardised).map(|((set, ..), z)| (*set, z)).collect()
    }

    /// Estimates the settings that scatter from the frames: deviation and its remaining variance, in units of
    /// the light and of its square; by setting.
    pub fn settings(&self) -> Vec<(usize, f64, f64)> {
        let first = self.layout.rows.len();
        let of = |(k, block): (usize, &Block)| {
            let own = block.variance - 1.0 / block.weight;
            let common = self.z[first + k] * block.variance.sqrt();
            // Posterior of the setting, between the frames' estimate and the nominal setting.
            (block.setting, common * own / block.variance, own / block.variance / block.weight)
        };
        self.blocks.iter().enumerate().map(of).collect()
    }
}

/// Returns deviations in units of the scatter that the settings show (method of Paule and Mandel 1982, J.
/// Res. NBS 87, 377, with the mean known to be 0). The stated scatter may be far larger, and deviations of
/// dim and bright sets would then have unequal variances. `scores`: deviation, and the setting's part of its
/// variance as stated.
fn alike(scores: &[(f64, f64)]) -> Vec<f64> {
    /// Halvings of the interval of the ratio.
    const HALVINGS: usize = 60;
    let variance = |part: f64, ratio: f64| (1.0 - part + ratio * part).max(1e-12);
    let square = |ratio: f64| scores.iter().map(|(z, part)| z * z / variance(*part, ratio)).sum::<f64>();
    // Variance of the settings over the stated one, at which the mean square is 1.
    let largest = scores.iter().map(|(z, _)| z * z).fold(1.0, f64::max) * scores.len().max(1) as f64;
    let (mut low, mut high) = (0.0, largest);
    for _ in 0..HALVINGS {
        let middle = 0.5 * (low + high);
        if square(middle) > scores.len() as f64 { low = middle } else { high = middle }
    }
    scores.iter().map(|(z, part)| z / variance(*part, high).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::alike;
    use crate::statistics::step;
    use radcam_sim::rng::{PixelRng, Stream};

    /// A lamp that scatters by a hundredth of its stated scatter, at levels whose errors fall from the stated
    /// scatter to a tenth of it: of 2000 at most four have a step at a chance of 1e-3, and of the deviations
    /// as stated at least five times as many.
    #[test]
    fn a_lamp_better_than_stated_has_no_step() {
        let scores = |seed: u64| -> Vec<(f64, f64)> {
            let mut random = PixelRng::new(seed, Stream::Effect, 0, 0, 0);
            let score = |k: i32| {
                let error = 0.88f64.powi(k).powi(2);
                let variance = 1.0 + error;
                (random.normal() * ((1e-4 + error) / variance).sqrt(), 1.0 / variance)
            };
            (0..18).map(score).collect()
        };
        let has_step = |values: &[f64]| step::largest(values).is_some_and(|s| s.p_value < 1e-3);
        let as_stated = |seed: &u64| has_step(&scores(*seed).iter().map(|s| s.0).collect::<Vec<_>>());
        let standardised = |seed: &u64| has_step(&alike(&scores(*seed)));
        let (before, after) = ((0..2000).filter(as_stated).count(), (0..2000).filter(standardised).count());
        assert!(after <= 4 && before >= 5 * after.max(1), "{before} {after}");
    }

    /// Deviations of settings that scatter as stated, or more, only change their scale.
    #[test]
    fn the_scatter_of_equal_settings_is_1() {
        let of = |z: [f64; 4]| alike(&z.map(|z| (z, 1.0)));
        assert!(of([3.0, -3.0, 3.0, -3.0]).iter().all(|z| (z.abs() - 1.0).abs() < 1e-6));
        assert!(of([0.0; 4]).iter().all(|z| *z == 0.0));
    }
}
