//! Compares a model with a campaign: fitted on one half of the frames, judged on the other.
//!
//! Halves alternate from set to set: each has the first frames after some changes of level. Whole frames go
//! to one half, so that noise that runs from frame to frame within a chunk stays on one side.

use super::fit::{Fitted, fit_half, halves};
use super::free::Common;
use super::iteration::FAR_SQUARE;
use super::layout::{Layout, State};
use super::slopes::Slopes;
use super::system::System;
use super::white::White;
use super::{photon_transfer, settings};
use crate::agreement::{Agreement, P_LIMIT};
use crate::data_faults::DataFault;
use crate::observables::{
    Expected, Half, Observable, Observations, Statistic, lightened, mean, settling, variance,
};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::borrow::Cow;
use std::collections::BTreeMap;

/// One residual on held-out frames.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Residual {
    /// Name of the observable.
    pub observable: String,
    /// Number of the set; null for the whole campaign.
    pub set: Option<u32>,
    /// Measured value.
    pub measured: f64,
    /// Expected value.
    pub predicted: f64,
    /// Standard error of the difference.
    pub std_err: f64,
    /// Difference over its standard error.
    pub z: f64,
    /// Whitened `z`: the common part of the statistics of the same frames counts once.
    pub independent_z: f64,
    /// Mean of the set above the black level, DN.
    pub level_dn: f64,
    /// Identifier of the statistic, shared by observables of one kind.
    pub statistic: Cow<'static, str>,
    /// Meaning of a deviation, in words.
    pub meaning: Cow<'static, str>,
    /// Unit of the measured value; none for ratios.
    pub unit: Cow<'static, str>,
}

impl Residual {
    /// Returns true if the residual depends on the frames before, not on the level of its set.
    pub fn is_of_first_frames(&self) -> bool {
        self.statistic == settling::Settling.id()
    }
}

/// Comparison of a model with a campaign.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Comparison {
    /// Root mean square of the standardised residuals; 1 is agreement.
    pub error: f64,
    /// Chance of residuals as large as these, corrected for multiple comparisons.
    pub p_value: f64,
    /// True if the model describes the campaign.
    pub consistent: bool,
    /// Agreement grade, with a grade for doubt.
    pub agreement: Agreement,
    /// Name of the test with the smallest chance; `p_value` corrects for several tests. None without
    /// residuals, or if the test of all residuals together has the smallest chance.
    #[serde(default)]
    pub largest: Option<String>,
    /// Every residual.
    pub residuals: Vec<Residual>,
    /// Faults of the data.
    #[serde(default)]
    pub data_faults: Vec<DataFault>,
    /// Items that could not be tested.
    pub not_looked_at: Vec<String>,
}

/// Fits a model on each half of the frames and judges it on the other.
pub fn compare(all: &Observations, model: &Fitted) -> Comparison {
    let (of, known) = model.compared.get_or_init(|| (all.identity.value(), compared(all, model)));
    if *of == all.identity.value() { known.clone() } else { compared(all, model) }
}

fn compared(all: &Observations, model: &Fitted) -> Comparison {
    let of = |half| fit_half(all, half, model);
    let (first, second) = rayon::join(|| of(Half::First), || of(Half::Second));
    let mut residuals = Vec::new();
    for (fitted, half) in [(&first, Half::First), (&second, Half::Second)] {
        residuals.extend(judged(all, fitted, half));
    }
    let n = residuals.len() as f64;
    let error = (residuals.iter().map(|r| r.z * r.z).sum::<f64>() / n.max(1.0)).sqrt();
    let levels = levels(all, model.base.offset_dn);
    let tests = settings::tests(all, model, &levels).into_iter().map(|t| of_all_sets(t, &mean::Mean));
    let of_noise =
        photon_transfer::tests(all, model, &levels).into_iter().map(|t| of_all_sets(t, &variance::Variance));
    let orders: Vec<Residual> = tests.chain(of_noise).collect();
    // Smallest chance of these few tests, times their number plus one for all other residuals.
    let by_order = orders.iter().map(|r| two_sided(r.z)).fold(1.0, f64::min) * (orders.len() + 1) as f64;
    let (p_value, largest) = match p_value(&residuals) {
        (chance, _) if by_order < chance => (
            by_order,
            orders.iter().max_by(|a, b| a.z.abs().total_cmp(&b.z.abs())).map(|r| r.observable.clone()),
        ),
        of_residuals => of_residuals,
    };
    residuals.extend(orders);
    Comparison {
        error,
        p_value,
        consistent: p_value >= P_LIMIT,
        agreement: Agreement::of(p_value),
        largest,
        residuals,
        data_faults: all.data_faults.clone(),
        not_looked_at: all.missing.clone(),
    }
}

/// Converts a test of all sets together to a residual of a statistic.
fn of_all_sets(test: settings::Test, statistic: &dyn Statistic) -> Residual {
    Residual {
        observable: test.name,
        set: None,
        measured: test.measured,
        predicted: test.predicted,
        std_err: test.std_err,
        z: test.z,
        independent_z: test.z,
        level_dn: 0.0,
        statistic: statistic.id().into(),
        meaning: statistic.meaning(0).into(),
        unit: "".into(),
    }
}

/// Computes the mean of every set above a zero, DN.
fn levels(all: &Observations, zero_dn: f64) -> Vec<f64> {
    let mut sums = vec![(0.0, 0.0); all.campaign.sets.len()];
    for o in all.of(&mean::Mean) {
        if let Some(s) = o.set {
            sums[s] = (sums[s].0 + o.measured.value, sums[s].1 + 1.0);
        }
    }
    sums.iter().map(|(sum, n)| if *n > 0.0 { sum / n - zero_dn } else { 0.0 }).collect()
}

/// Computes the residuals of the other half under a fit to this one; their errors include that of the fit.
fn judged(all: &Observations, fitted: &Fitted, half: Half) -> Vec<Residual> {
    let unseen = Unseen::new(all, fitted, half);
    let levels = levels(all, fitted.base.offset_dn);
    let (mut out, mut places) = (Vec::new(), Vec::new());
    let mut z = vec![0.0; unseen.layout.rows.len()];
    let mut wider_by = vec![1.0; z.len()];
    for (r, (o, e)) in unseen.layout.rows.iter().zip(&unseen.state.expected).enumerate() {
        let Some(Own { z: own_z, wider, shift }) = unseen.judged(r, o, e).filter(|own| own.z.is_finite())
        else {
            continue;
        };
        out.push(residual(all, o, e.value + shift, e.std_err * wider, own_z, &levels));
        places.push(r);
        (z[r], wider_by[r]) = (own_z, wider);
    }
    White::new(&unseen.layout, &unseen.state.expected, |r| wider_by[r]).apply(&mut z, 1);
    places.iter().zip(&mut out).for_each(|(r, residual)| residual.independent_z = z[*r]);
    out
}

/// Judged row of the held-out half.
struct Own {
    /// Standardised residual.
    z: f64,
    /// Ratio of its error to that of the expectation.
    wider: f64,
    /// Shift of the expectation by the light's setting, which the other half tells, in its unit.
    shift: f64,
}

/// A fit to one half, and its expectations of the other.
struct Unseen<'a> {
    all: &'a Observations,
    fitted: &'a Fitted,
    layout: Layout<'a>,
    state: State,
    /// Slopes of the held-out rows with the fitted values, over the errors of these rows.
    slopes: Vec<f64>,
    /// Index of the light of all levels among the common values.
    light: usize,
    /// True for light levels in the fitted half.
    lights: Vec<bool>,
    /// Row of the mean of each set.
    means: Vec<Option<usize>>,
    /// Settings of the light in the fitted half: deviation and its remaining variance, in units of the light
    /// and of its square.
    told: BTreeMap<usize, (f64, f64)>,
    /// Variance of a light setting that the fit did not use, in units of the light squared; by set.
    scatter: Vec<f64>,
    /// True for sets whose level the fit leaves open.
    open: Vec<bool>,
    /// True for sets whose noise the fit leaves open.
    open_noise: Vec<bool>,
}

/// Minimum error of an open level, as a part of a code and of the signal (named choices). The noise of a
/// digitised signal follows the place between two codes, so linear error propagation fails that far off
/// (Widrow and Kollar 2008, ch. 4).
const OPEN: (f64, f64) = (0.25, 0.05);

/// Minimum error of an open variance, as a part of it (a named choice): every other statistic of the set
/// scatters by the noise, and a half of the frames without flats tells no gain.
const OPEN_NOISE: f64 = 0.25;

impl<'a> Unseen<'a> {
    fn new(all: &'a Observations, fitted: &'a Fitted, half: Half) -> Self {
        let layout = Layout::to_judge(all, half.other(), fitted.free.effects.iter());
        let state = layout.at(&fitted.free, &fitted.point);
        // Slopes that only served the fit are not exact enough, unless the fit is so far off that the errors
        // of its values hardly count.
        let served = Some(&*fitted.slopes).filter(|_| fitted.mean_square > FAR_SQUARE);
        let slopes = Slopes::beside(served, &layout, &fitted.free, &fitted.point, &state).over_errors(&state);
        let (light, n) = (fitted.free.place(Common::Light).unwrap_or(0), fitted.free.common.len());
        // Setting scatter: a variance of the mean in DN^2, over the squared slope of the mean with the light.
        let settings: Vec<f64> = fitted.predict(all).sets.iter().map(|s| s.setting).collect();
        let mut scatter = vec![0.0; settings.len()];
        for (r, (o, e)) in layout.rows.iter().zip(&state.expected).enumerate() {
            if let Some(set) = o.set.filter(|_| o.is(&mean::Mean)) {
                scatter[set] = settings[set] / (slopes[r * n + light] * e.normal.2).powi(2).max(1e-30);
            }
        }
        let told = settings_told(all, fitted, half);
        let lights = lights_seen(all, half);
        let (open, open_noise) = (vec![false; settings.len()], vec![false; settings.len()]);
        let mut means = vec![None; settings.len()];
        for (r, o) in layout.rows.iter().enumerate().filter(|(_, o)| o.is(&mean::Mean)) {
            o.set.into_iter().for_each(|set| means[set] = Some(r));
        }
        let mut out = Self {
            all,
            fitted,
            layout,
            state,
            slopes,
            light,
            lights,
            means,
            told,
            scatter,
            open,
            open_noise,
        };
        out.find_open();
        out
    }

    /// Finds the sets whose level or noise the fit leaves open, for example a long dark that only the other
    /// half has.
    fn find_open(&mut self) {
        let step = self.fitted.predict(self.all).code_step_dn;
        for (r, (o, e)) in self.layout.rows.iter().zip(&self.state.expected).enumerate() {
            let Some(set) = o.set.filter(|_| o.is(&mean::Mean)) else { continue };
            let signal_dn = (e.value - self.fitted.base.offset_dn).abs();
            // Error of the fit, without the scatter of the frames.
            let of_fit = |own: Own| (own.wider * own.wider - 1.0).max(0.0).sqrt();
            let error_dn = self.judged(r, o, e).map_or(0.0, of_fit) * e.std_err;
            self.open[set] |= error_dn > OPEN.0 * step && error_dn > OPEN.1 * signal_dn;
        }
        let is_open = |r: usize, o: &Observable, e: &Expected| {
            let own = self.judged(r, o, e).filter(|own| own.wider.is_finite())?;
            let error_dn2 = (own.wider * own.wider - 1.0).max(0.0).sqrt() * e.std_err;
            (error_dn2 > OPEN_NOISE * o.measured.value.abs()).then_some(o.set?)
        };
        let rows = self.layout.rows.iter().zip(&self.state.expected).enumerate();
        let variances = rows.filter(|(_, (o, _))| o.is(&variance::Variance));
        let open: Vec<usize> = variances.filter_map(|(r, (o, e))| is_open(r, o, e)).collect();
        open.into_iter().for_each(|set| self.open_noise[set] = true);
    }

    /// Computes the standardised residual of a row; `None` for means that alone tell the light of their
    /// level, and for sets whose level or noise is open.
    fn judged(&self, r: usize, o: &Observable, e: &Expected) -> Option<Own> {
        if o.set.is_some_and(|s| self.open_noise[s]) && !o.is(&mean::Mean) {
            return None;
        }
        let level = o.set.and_then(|s| self.all.campaign.sets[s].light);
        let sees_light = o.statistic.sees_light();
        let factor = level.and_then(|l| self.fitted.free.light_of_level.get(l).copied().flatten());
        if let Some(set) = o.set.filter(|_| level.is_some_and(|l| !self.lights[l])) {
            let is_mean = o.is(&mean::Mean);
            let means = if is_mean { self.means_before(r, set) } else { vec![(self.means[set]?, 0.0)] };
            if !means.is_empty() {
                // Under the setting of another set, a set adds no scatter of its own.
                let own = if is_mean && means.iter().all(|m| m.1 > 0.0) { self.scatter[set] } else { 0.0 };
                return self.judged_beside(r, e, &means, own);
            }
            if factor.is_none_or(|k| self.fitted.free.lights[k].known.is_none()) {
                return None;
            }
        }
        if o.set.is_some_and(|s| self.open[s]) {
            return None;
        }
        let row = self.slopes_of(r);
        let by_light = row[self.light];
        let mut variance = 1.0 + self.fitted.covariance.of(row, factor.map(|k| (k, by_light))).max(0.0);
        let (mut z, mut by_setting) = (e.z(), 0.0);
        if let Some(set) = o.set.filter(|s| sees_light && self.scatter[*s] > 0.0) {
            // The fitted frames of the set tell its setting; without them it is nominal.
            let (shift, left) =
                self.told.get(&self.layout.setting_of(set)).copied().unwrap_or((0.0, self.scatter[set]));
            z -= by_light * shift;
            by_setting = by_light * shift * e.std_err;
            variance += by_light * by_light * left;
        }
        Some(Own::new(z, variance, by_setting, e))
    }

    /// Lists the earlier means of the same light level, each with the variance of its setting in units of the
    /// light squared; 0 under the same setting.
    fn means_before(&self, r: usize, set: usize) -> Vec<(usize, f64)> {
        let sets = &self.all.campaign.sets;
        let of = |other: usize| {
            let mean = self.means[other].filter(|m| *m < r && sets[other].light == sets[set].light)?;
            let is_same = self.layout.setting_of(other) == self.layout.setting_of(set);
            Some((mean, if is_same { 0.0 } else { self.scatter[other] }))
        };
        (0..sets.len()).filter_map(of).collect()
    }

    /// Computes the standardised residual of a row at a light level that the fit did not see: means of the
    /// half tell its light. Each mean of a level is judged beside those before it, so that the residuals are
    /// independent (recursive residuals: Brown, Durbin and Evans 1975, J. R. Statist. Soc. B 37, 149, eq. 2).
    /// `own`: variance of the setting of its own set.
    fn judged_beside(&self, r: usize, e: &Expected, means: &[(usize, f64)], own: f64) -> Option<Own> {
        let by_light = self.slopes_of(r)[self.light];
        let mut slopes = self.slopes_of(r).to_vec();
        let of_light = |mean: usize| self.slopes_of(mean)[self.light];
        let weights: Vec<f64> =
            means.iter().map(|(mean, setting)| (of_light(*mean).powi(-2) + setting).recip()).collect();
        let all: f64 = weights.iter().sum();
        let mut shift = 0.0;
        for ((mean, _), weight) in means.iter().zip(&weights) {
            let follows = by_light * weight / all / of_light(*mean);
            shift += follows * self.state.expected[*mean].z();
            slopes.iter_mut().zip(self.slopes_of(*mean)).for_each(|(own, of_mean)| *own -= follows * of_mean);
        }
        let told = by_light * by_light * (all.recip() + own);
        let variance = 1.0 + told + self.fitted.covariance.of(&slopes, None).max(0.0);
        shift.is_finite().then(|| Own::new(e.z() - shift, variance, shift * e.std_err, e))
    }

    fn slopes_of(&self, r: usize) -> &[f64] {
        let n = self.fitted.free.common.len();
        &self.slopes[r * n..][..n]
    }
}

impl Own {
    /// Computes the row from a residual over the error of its expectation, and its variance.
    fn new(z: f64, variance: f64, shift: f64, e: &Expected) -> Self {
        let own = z / variance.sqrt();
        let z = if e.heavy { lightened(own) } else { own };
        Self { z, wider: variance.sqrt(), shift }
    }
}

/// Estimates the settings of sets from the frames of the fitted half.
fn settings_told(all: &Observations, fitted: &Fitted, half: Half) -> BTreeMap<usize, (f64, f64)> {
    let own = Layout::new(all, &halves(Some(half)), fitted.free.effects.iter());
    let state = own.at(&fitted.free, &fitted.point);
    let slopes = Slopes::beside(Some(&fitted.slopes), &own, &fitted.free, &fitted.point, &state);
    let settings = System::new(&own, &fitted.free, &fitted.point, &state, &slopes).settings();
    settings.into_iter().map(|(setting, shift, left)| (setting, (shift, left))).collect()
}

fn residual(
    all: &Observations,
    o: &Observable,
    predicted: f64,
    std_err: f64,
    z: f64,
    levels: &[f64],
) -> Residual {
    Residual {
        observable: o.name(),
        set: o.set.map(|s| all.set_numbers[s]),
        measured: o.measured.value,
        predicted,
        std_err,
        z,
        independent_z: z,
        level_dn: o.set.map_or(0.0, |s| levels[s]),
        statistic: o.statistic.id().into(),
        meaning: o.statistic.meaning(o.index).into(),
        unit: o.statistic.unit().into(),
    }
}

/// Computes the residuals of all observables under a fit to all.
pub(crate) fn residuals_of(all: &Observations, fitted: &Fitted) -> Vec<Residual> {
    let layout = Layout::new(all, &halves(None), fitted.free.effects.iter());
    let state = layout.at(&fitted.free, &fitted.point);
    let slopes = Slopes::beside(Some(&fitted.slopes), &layout, &fitted.free, &fitted.point, &state);
    let system = System::new(&layout, &fitted.free, &fitted.point, &state, &slopes);
    let levels = levels(all, fitted.base.offset_dn);
    let rows = layout.rows.iter().zip(&state.expected).zip(&system.z);
    rows.filter(|(_, z)| z.is_finite())
        .map(|((o, e), z)| residual(all, o, e.value, e.std_err, *z, &levels))
        .collect()
}

/// Returns true for each light level that has a mean in a half.
fn lights_seen(all: &Observations, half: Half) -> Vec<bool> {
    let levels = all.campaign.sets.iter().filter_map(|s| s.light).max().map_or(0, |l| l + 1);
    let mut seen = vec![false; levels];
    for o in all.of(&mean::Mean).filter(|o| o.half == half || o.half == Half::Both) {
        if let Some(l) = o.set.and_then(|s| all.campaign.sets[s].light) {
            seen[l] = true;
        }
    }
    seen
}

/// Joint evidence of the residuals of one statistic.
#[derive(Debug, Clone)]
pub struct OfStatistic {
    /// Name of the statistic.
    pub name: String,
    /// Chance of a sum of squares, or of a sum, as large as theirs.
    pub chance: f64,
    /// Excess over chance of the sum of squares, or of the squared sum over n, whichever is larger.
    pub excess: f64,
}

/// Allowed excess of a statistic's standardised residuals over chance, since errors are predicted to some per
/// cent and parameters were fitted: the sum of their squares by a quarter, their mean by a fifth of its
/// deviation.
pub(super) const SLACK_OF_SQUARES: f64 = 1.25;
/// See [`SLACK_OF_SQUARES`].
pub(super) const SLACK_OF_MEAN: f64 = 1.2;

/// Groups the residuals by statistic.
pub fn by_statistic(residuals: &[Residual]) -> Vec<OfStatistic> {
    by(residuals, |r| r.observable.as_str())
}

/// Groups the residuals by the name that `name` gives them.
pub(crate) fn by<'r>(residuals: &'r [Residual], name: impl Fn(&'r Residual) -> &'r str) -> Vec<OfStatistic> {
    let mut of: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    residuals.iter().for_each(|r| of.entry(name(r)).or_default().push(r.independent_z));
    let together = |(name, z): (&str, Vec<f64>)| {
        let n = z.len() as f64;
        let squares: f64 = z.iter().map(|z| z * z).sum();
        let sum: f64 = z.iter().sum();
        let chi2 = ChiSquared::new(n).map_or(1.0, |c| c.sf(squares / SLACK_OF_SQUARES));
        // Small deviations to one side in every set.
        let aside = two_sided(sum / n.sqrt() / SLACK_OF_MEAN);
        OfStatistic {
            name: name.to_string(),
            chance: (2.0 * chi2.min(aside)).min(1.0),
            excess: (squares - n).max(sum * sum / n - 1.0).max(0.0),
        }
    };
    of.into_iter().map(together).collect()
}

/// Computes the two-sided chance of a normal number at least so far off.
fn two_sided(z: f64) -> f64 {
    statrs::function::erf::erfc(z.abs() / std::f64::consts::SQRT_2)
}

/// Computes the chance of residuals as large as these: the smallest of the chances of their sum of squares,
/// of the largest one, and of those of any one statistic, times the number of these tests. Also returns the
/// name of the test with the smallest chance; none for all residuals together.
fn p_value(residuals: &[Residual]) -> (f64, Option<String>) {
    let n = residuals.len() as f64;
    if n < 1.0 {
        return (f64::NAN, None);
    }
    // Errors are known to some per cent and parameters are fitted: the squares scatter a little more than a
    // chi-square.
    let squares: f64 = residuals.iter().map(|r| r.independent_z * r.independent_z).sum();
    let z = (squares - n * 1.05) / (2.0 * n * 1.3).sqrt();
    let whole = 0.5 * statrs::function::erf::erfc(z / std::f64::consts::SQRT_2);
    let largest = residuals.iter().max_by(|a, b| a.independent_z.abs().total_cmp(&b.independent_z.abs()));
    let single = largest.map_or(1.0, |r| (n * two_sided(r.independent_z.abs() / 1.1)).min(1.0));
    let groups = by_statistic(residuals);
    let worst = groups.iter().min_by(|a, b| a.chance.total_cmp(&b.chance));
    let group = worst.map_or(1.0, |g| g.chance) * groups.len() as f64;
    let name = match worst {
        Some(worst) if group <= single && group <= whole => Some(worst.name.clone()),
        _ if single <= whole => largest.map(|r| r.observable.clone()),
        _ => None,
    };
    ((3.0 * whole.min(single).min(group)).min(1.0), name)
}
