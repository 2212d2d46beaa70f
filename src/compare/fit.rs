//! Fits a model's free parameters to observables: generalised least squares with errors that the model itself predicts.

use super::expect::{Expected, expect};
use super::observe::{Observable, Observations, Statistic};
use crate::dataset::Kind;
use crate::fit::cholesky;
use crate::statistics::median::median;
use radcam_sim::effects::{self, Effect, Seen};
use radcam_sim::predict::{BaseParameters, Prediction};

/// From here on the square of a residual says that the model is wrong, and not how large its errors are.
const LARGE: f64 = 16.0;
/// Rounds of Levenberg and Marquardt at most.
const ROUNDS: usize = 40;
/// Rounds after which the better of two starts shows.
const FIRST_ROUNDS: usize = 8;

/// Effects with the values of their parameters.
pub type Effects = Vec<(&'static dyn Effect, Vec<f64>)>;

/// An effect with what is given of its parameters, in their order.
pub type Given = (&'static dyn Effect, Vec<Option<f64>>);

/// A model with values: the paper's parameters and effects.
#[derive(Clone)]
pub struct Fitted {
    /// The paper's.
    pub base: BaseParameters,
    /// Effects with their parameters.
    pub effects: Effects,
    /// Sum of squares plus twice the logarithms of the errors: minus twice the logarithm of the likelihood.
    pub objective: f64,
    /// Standard errors of the effects' parameters.
    pub std_err: Vec<Vec<f64>>,
    /// Standard errors of A, read noise, offset, dark current.
    pub base_std_err: [f64; 4],
    /// The free values and their covariance.
    free: Option<Free>,
}

impl std::fmt::Debug for Fitted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let effects: Vec<_> = self.effects.iter().map(|(e, p)| (e.id(), p)).collect();
        write!(f, "{:?} {effects:?} objective {}", self.base, self.objective)
    }
}

impl Fitted {
    /// The prediction for all sets.
    pub fn predict(&self, all: &Observations) -> Prediction {
        predict(&self.base, &self.effects, all)
    }

    /// Observables with what is expected of them; `half`: only these and the common ones.
    pub fn expected<'a>(&self, all: &'a Observations, half: Option<u8>) -> Vec<(&'a Observable, Expected)> {
        let prediction = self.predict(all);
        chosen(all, half).map(|o| (o, expect(o, &prediction, all))).collect()
    }

    /// The other half's observables with what is expected of them; the error of the fitted parameters is in theirs.
    pub fn judged<'a>(&self, all: &'a Observations, other: u8) -> Vec<(&'a Observable, Expected)> {
        let mut out = self.expected(all, Some(other));
        let Some(free) = &self.free else { return out };
        let n = free.x.len();
        let now: Vec<Expected> = out.iter().map(|o| o.1).collect();
        let slopes: Vec<Vec<[f64; 2]>> =
            (0..n).map(|i| free.slopes(i, &now, &free.x, all, Some(other))).collect();
        for (k, (_, e)) in out.iter_mut().enumerate() {
            let row = |i: usize| (0..n).map(|j| free.covariance[i * n + j] * slopes[j][k][0]).sum::<f64>();
            let of_fit: f64 = (0..n).map(|i| slopes[i][k][0] * row(i)).sum();
            let wider = (1.0 + of_fit.max(0.0)).sqrt();
            e.std_err *= wider;
            e.normal.2 *= wider;
        }
        out.retain(|(o, _)| o.half != 2);
        out
    }
}

/// Observables of a half, and what is known beforehand. Means that give the light are no measurement.
fn chosen(all: &Observations, half: Option<u8>) -> impl Iterator<Item = &Observable> {
    let given = |o: &Observable| all.means_given && o.kind == Statistic::Mean;
    all.all.iter().filter(move |o| !given(o) && half.is_none_or(|h| o.half == h || o.half == 2))
}

fn predict(
    base: &BaseParameters,
    effects: &[(&'static dyn Effect, Vec<f64>)],
    all: &Observations,
) -> Prediction {
    let list: Vec<(&dyn Effect, &[f64])> = effects.iter().map(|(e, p)| (*e, p.as_slice())).collect();
    if !all.means_given {
        return effects::predict(&all.campaign, base, &list);
    }
    // The means are taken as they are: the light is what gives them.
    let mut base = base.clone();
    let mut prediction = effects::predict(&all.campaign, &base, &list);
    for _ in 0..3 {
        for o in all.all.iter().filter(|o| o.kind == Statistic::Mean) {
            let (Some(set), true) = (o.set, o.frames.0 < prediction.frame_signal.len()) else { continue };
            let seen = prediction.frame_signal[o.frames.0];
            let ratio = o.measured.value / seen;
            if ratio.is_finite() && ratio > 0.0 {
                base.flux_e_per_s[set] *= ratio.clamp(0.5, 2.0);
            }
        }
        prediction = effects::predict(&all.campaign, &base, &list);
    }
    prediction
}

/// A first guess of the paper's parameters.
pub fn start(all: &Observations) -> BaseParameters {
    let of = |kind: Statistic, wanted: Option<Kind>| {
        all.all.iter().filter(move |o| o.kind == kind).filter_map(move |o| {
            let set = o.set?;
            (wanted.is_none_or(|k| all.kinds[set] == k)).then_some((set, o.measured.value))
        })
    };
    let level = |set: usize| {
        let (s, n) = of(Statistic::Mean, None)
            .filter(|(i, _)| *i == set)
            .fold((0.0, 0.0), |(s, n), (_, v)| (s + v, n + 1.0));
        s / n
    };
    let darks: Vec<(f64, f64)> =
        of(Statistic::Mean, Some(Kind::Dark)).map(|(s, m)| (all.campaign.sets[s].exposure_s, m)).collect();
    let shortest = darks.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0));
    let longest = darks.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0));
    let offset_dn = shortest.map_or(0.0, |d| d.1);
    let dark_dn_per_s = match (shortest, longest) {
        (Some(a), Some(b)) if b.0 > a.0 => ((b.1 - a.1) / (b.0 - a.0)).max(0.0),
        _ => 0.0,
    };
    let constant = of(Statistic::Variance, Some(Kind::Dark)).map(|v| v.1).fold(f64::INFINITY, f64::min);
    let mut points: Vec<(f64, f64)> =
        of(Statistic::Variance, Some(Kind::Flat)).map(|(s, v)| (level(s) - offset_dn, v)).collect();
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let constant = if constant.is_finite() { constant } else { points.first().map_or(1.0, |p| 0.2 * p.1) };
    let top = points.last().map_or(0.0, |p| p.0);
    let middle = points.get(points.len() / 2).copied().unwrap_or((1.0, 1.0));
    let slope = |p: &(f64, f64)| (p.0, (p.1 - constant) / p.0.max(1e-6));
    let slopes: Vec<_> = points.iter().map(slope).collect();
    let gain = before_the_end(&slopes, top).unwrap_or(slope(&middle).1).max(1e-6);
    let lights = all.campaign.sets.iter().filter_map(|s| s.light).max().map_or(0, |l| l + 1);
    let mut flux: Vec<f64> = (0..lights)
        .map(|l| {
            let of_level = (0..all.campaign.sets.len()).filter(|&s| all.campaign.sets[s].light == Some(l));
            let rates = of_level.map(|s| {
                let above = level(s) - offset_dn;
                (above, above / all.campaign.sets[s].exposure_s / gain)
            });
            let rates: Vec<_> = rates.filter(|r| r.1.is_finite()).collect();
            before_the_end(&rates, top).unwrap_or_else(|| median(rates.iter().map(|r| r.1))).max(1e-6)
        })
        .map(|v| if v.is_finite() { v } else { 1.0 })
        .collect();
    // Where a level has less than its nominal light says, the range may have ended: nothing would draw it up again.
    let flats = || {
        let sets = all.campaign.sets.iter().enumerate().filter(|(s, _)| all.kinds[*s] == Kind::Flat);
        sets.filter_map(|(s, set)| Some((s, set.light?, set.illumination)))
            .filter(|(_, _, light)| *light > 0.0)
    };
    let bright = || flats().filter(|(s, ..)| level(*s) - offset_dn > 0.02 * top);
    let per_light = of_the_largest(bright().map(|(_, l, light)| flux[l] / light));
    if let Some(per_light) = per_light.filter(|_| bright().count() >= 3 && !all.means_given) {
        for (_, l, light) in flats() {
            if flux[l] < 0.97 * per_light * light {
                flux[l] = per_light * light;
            }
        }
    }
    BaseParameters {
        gain_dn_per_e: gain,
        read_noise_e: (constant - 1.0 / 12.0).max(0.01).sqrt() / gain,
        offset_dn,
        dark_e_per_s: dark_dn_per_s / gain,
        flux_e_per_s: flux,
    }
}

/// The usual one of values that fall where the range has ended, of (level, value): where three or more levels lie in the lower half of
/// all up to `top`, their median; where few do, that of the largest. `None` where no level stands out.
fn before_the_end(all: &[(f64, f64)], top: f64) -> Option<f64> {
    let clear = || all.iter().filter(|p| p.0 > 0.02 * top);
    let low = || clear().filter(|p| p.0 <= 0.55 * top).map(|p| p.1);
    if low().count() >= 3 { Some(median(low())) } else { of_the_largest(clear().map(|p| p.1)) }
}

/// Median of the values that are not far below the largest; `None` without any.
fn of_the_largest(values: impl Iterator<Item = f64>) -> Option<f64> {
    let all: Vec<f64> = values.filter(|v| v.is_finite()).collect();
    let largest = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (!all.is_empty()).then(|| median(all.into_iter().filter(|v| *v >= 0.7 * largest)))
}

/// Everything that is free, as one list of values over their scales.
#[derive(Clone)]
struct Free {
    effects: Vec<&'static dyn Effect>,
    /// Light levels that take part.
    lights: Vec<usize>,
    template: BaseParameters,
    scale: Vec<f64>,
    /// What the campaign says nothing of.
    fixed: Vec<bool>,
    /// What began below zero.
    below: Vec<bool>,
    /// The values and their covariance, row by row, once fitted.
    x: Vec<f64>,
    covariance: Vec<f64>,
}

impl Free {
    fn unpack(&self, x: &[f64]) -> (BaseParameters, Effects) {
        let mut base = self.template.clone();
        let v = |i: usize| x[i] * self.scale[i];
        base.gain_dn_per_e = v(0);
        base.read_noise_e = v(1);
        base.offset_dn = v(2);
        base.dark_e_per_s = v(3);
        for (k, &l) in self.lights.iter().enumerate() {
            base.flux_e_per_s[l] = v(4 + k);
        }
        let mut at = 4 + self.lights.len();
        let effects = self
            .effects
            .iter()
            .map(|e| {
                let values = (0..e.parameters().len()).map(|k| v(at + k)).collect();
                at += e.parameters().len();
                (*e, values)
            })
            .collect();
        (base, effects)
    }

    fn clamp(&self, x: &mut [f64]) {
        x[0] = x[0].max(1e-6);
        x[1] = x[1].max(0.0);
        for k in 0..self.lights.len() {
            x[4 + k] = x[4 + k].max(1e-9);
        }
        let mut at = 4 + self.lights.len();
        for e in &self.effects {
            for p in e.parameters() {
                let (mut min, mut max) = (p.min, p.max);
                if e.keeps_sign() {
                    if self.below[at] { max = max.min(0.0) } else { min = min.max(0.0) }
                }
                x[at] = x[at].clamp(min / self.scale[at], max / self.scale[at]);
                at += 1;
            }
        }
    }

    fn expected(&self, x: &[f64], all: &Observations, half: Option<u8>) -> Vec<Expected> {
        let (base, effects) = self.unpack(x);
        let prediction = predict(&base, &effects, all);
        chosen(all, half).map(|o| expect(o, &prediction, all)).collect()
    }

    /// Slope with parameter `i` of every expectation, over its error, and of the logarithm of its error; in the space in which
    /// the noise is normal.
    fn slopes(
        &self,
        i: usize,
        now: &[Expected],
        x: &[f64],
        all: &Observations,
        half: Option<u8>,
    ) -> Vec<[f64; 2]> {
        if self.fixed[i] {
            return vec![[0.0; 2]; now.len()];
        }
        let mut moved = x.to_vec();
        let mut step = 1e-5 * moved[i].abs().max(1e-2);
        moved[i] += step;
        self.clamp(&mut moved);
        if (moved[i] - x[i]).abs() < 0.5 * step {
            step = -step;
            moved[i] = x[i] + step;
        }
        let there = self.expected(&moved, all, half);
        let of = |(a, b): (&Expected, &Expected)| {
            [(b.normal.1 - a.normal.1) / step / a.normal.2, (b.normal.2 / a.normal.2).ln() / step]
        };
        now.iter().zip(&there).map(of).collect()
    }
}

fn objective(e: &[Expected]) -> f64 {
    let sum: f64 = e.iter().map(|e| e.z().powi(2) + 2.0 * e.normal.2.ln()).sum();
    if sum.is_nan() { f64::INFINITY } else { sum }
}

/// Fits the paper's parameters and those of some effects, from a start. `half`: on these observables only.
pub fn fit(
    all: &Observations,
    half: Option<u8>,
    base: &BaseParameters,
    effects: &[(&'static dyn Effect, Vec<f64>)],
) -> Fitted {
    fit_for(ROUNDS, all, half, base, effects)
}

/// Finds values of effects' parameters that are not given: one effect after the other is added to what is known. What moves nothing
/// that was measured stays at its first start.
pub fn searched(all: &Observations, given: &[Given]) -> Effects {
    let known = |(e, values): &Given| Some((*e, values.iter().copied().collect::<Option<Vec<f64>>>()?));
    if given.iter().all(|g| known(g).is_some()) {
        return given.iter().filter_map(known).collect();
    }
    let certain: Effects = given.iter().filter_map(known).collect();
    let mut now = fit(all, None, &start(all), &certain);
    for (effect, values) in given.iter().filter(|g| known(g).is_none()) {
        now = fit_with(*effect, values, all, &now, true).unwrap_or_else(|| {
            let first = effect.starts(&seen(all, &now.base)).into_iter().next();
            let first = first.unwrap_or_else(|| effect.parameters().iter().map(|p| p.min.max(0.0)).collect());
            let mut still = now.clone();
            still.effects.push((*effect, as_given(&first, values)));
            still
        });
    }
    let place = |e: &&'static dyn Effect| given.iter().position(|g| g.0.id() == e.id());
    now.effects.sort_by_key(|(e, _)| place(e));
    now.effects
}

/// Values with those that are given.
fn as_given(values: &[f64], given: &[Option<f64>]) -> Vec<f64> {
    values.iter().enumerate().map(|(i, v)| given.get(i).copied().flatten().unwrap_or(*v)).collect()
}

/// Adds one more effect to a model and fits all of it, from every start of the effect ([`Effect::starts`]), with what is given of its
/// parameters as a start as well; `None` where none moves anything. `fresh`: from a first guess of the paper's parameters too, since a
/// fit that is far off may have bent what is sound to please what is not.
pub fn fit_with(
    effect: &'static dyn Effect,
    given: &[Option<f64>],
    all: &Observations,
    now: &Fitted,
    fresh: bool,
) -> Option<Fitted> {
    let guess = fresh.then(|| Fitted { base: start(all), ..now.clone() });
    let from = |now: &Fitted| {
        let tries = starts(effect, given, all, now).into_iter().map(|values| {
            let mut effects = now.effects.clone();
            effects.push((effect, values));
            fit_for(FIRST_ROUNDS, all, None, &now.base, &effects)
        });
        let best = tries.min_by(|a, b| a.objective.total_cmp(&b.objective))?;
        Some(fit(all, None, &best.base, &best.effects))
    };
    let fits = std::iter::once(now).chain(&guess).filter_map(from);
    fits.min_by(|a, b| a.objective.total_cmp(&b.objective))
}

fn fit_for(
    rounds: usize,
    all: &Observations,
    half: Option<u8>,
    base: &BaseParameters,
    effects: &[(&'static dyn Effect, Vec<f64>)],
) -> Fitted {
    let lights: Vec<usize> = if all.means_given {
        Vec::new()
    } else {
        let mut lights: Vec<usize> = chosen(all, half)
            .filter(|o| o.kind == Statistic::Mean)
            .filter_map(|o| all.campaign.sets[o.set?].light)
            .collect();
        lights.sort_unstable();
        lights.dedup();
        lights
    };
    let mut values = vec![base.gain_dn_per_e, base.read_noise_e, base.offset_dn, base.dark_e_per_s];
    values.extend(lights.iter().map(|&l| base.flux_e_per_s[l]));
    let mut scale: Vec<f64> = values.iter().map(|v| v.abs().max(1e-3)).collect();
    for (e, p) in effects {
        values.extend(p);
        scale.extend(e.parameters().iter().zip(p).map(|(q, v)| {
            let start = q.starts.iter().copied().find(|s| *s != 0.0).unwrap_or(v.abs().max(1e-3));
            v.abs().max(start.abs())
        }));
    }
    let mut fixed: Vec<bool> = (0..values.len()).map(|i| all.means_given && (i == 2 || i == 3)).collect();
    let parameters = effects.iter().flat_map(|(e, _)| e.parameters());
    let first = values.len() - effects.iter().map(|(e, _)| e.parameters().len()).sum::<usize>();
    fixed[first..].iter_mut().zip(parameters).for_each(|(fixed, p)| *fixed = p.is_choice());
    let mut x: Vec<f64> = values.iter().zip(&scale).map(|(v, s)| v / s).collect();
    let n = x.len();
    let mut free = Free {
        effects: effects.iter().map(|(e, _)| *e).collect(),
        lights,
        template: base.clone(),
        scale,
        below: values.iter().map(|v| *v < 0.0).collect(),
        fixed,
        x: Vec::new(),
        covariance: Vec::new(),
    };
    free.clamp(&mut x);
    let mut now = free.expected(&x, all, half);
    let mut best = objective(&now);
    let mut lambda = 1e-3;
    let mut normal = vec![0.0; n * n];
    for round in 0..rounds {
        // Fisher's scoring (Rao 1973, section 5g): errors that depend on the parameters tell of them as well, by
        // (z^2 - 1) / sqrt 2 of unit variance.
        let columns: Vec<Vec<[f64; 2]>> = (0..n).map(|i| free.slopes(i, &now, &x, all, half)).collect();
        let score = |(c, e): (&[f64; 2], &Expected)| c[0] * e.z() + c[1] * ((e.z() * e.z()).min(LARGE) - 1.0);
        let gradient: Vec<f64> = columns.iter().map(|c| c.iter().zip(&now).map(score).sum()).collect();
        for i in 0..n {
            for j in 0..=i {
                let products =
                    columns[i].iter().zip(&columns[j]).map(|(a, b)| a[0] * b[0] + 2.0 * a[1] * b[1]);
                let dot: f64 = products.sum();
                normal[i * n + j] = dot;
                normal[j * n + i] = dot;
            }
        }
        let mut improved = false;
        let before = best;
        for _ in 0..12 {
            let mut a = normal.clone();
            for i in 0..n {
                a[i * n + i] += lambda * normal[i * n + i] + 1e-12;
            }
            if !cholesky::factor(&mut a, n) {
                lambda *= 10.0;
                continue;
            }
            let mut step = gradient.clone();
            cholesky::solve(&a, &mut step);
            let mut trial: Vec<f64> = x.iter().zip(&step).map(|(x, s)| x + s).collect();
            free.clamp(&mut trial);
            let there = free.expected(&trial, all, half);
            let value = objective(&there);
            if value < best {
                (x, now, best, improved) = (trial, there, value, true);
                lambda = (lambda * 0.2).max(1e-6);
                break;
            }
            lambda *= 6.0;
        }
        if !improved || (round > 2 && before - best < 1e-3) {
            break;
        }
    }
    free.covariance = invert(&normal, n);
    let choice = |i: usize| i >= first && free.fixed[i];
    let error = |i: usize| {
        if choice(i) { 0.0 } else { free.covariance[i * n + i].max(0.0).sqrt() * free.scale[i] }
    };
    let (mut base, effects) = free.unpack(&x);
    if all.means_given {
        // The light that gives the means.
        base.flux_e_per_s = predict(&base, &effects, all).base.flux_e_per_s;
    }
    let mut at = 4 + free.lights.len();
    let std_err = effects
        .iter()
        .map(|(_, p)| {
            let errors = (0..p.len()).map(|k| error(at + k)).collect();
            at += p.len();
            errors
        })
        .collect();
    let base_std_err = [error(0), error(1), error(2), error(3)];
    free.x = x;
    Fitted { base, effects, objective: best, std_err, base_std_err, free: Some(free) }
}

/// Inverse of a symmetric positive matrix; parameters without any hold keep a large error.
fn invert(a: &[f64], n: usize) -> Vec<f64> {
    let mut a = a.to_vec();
    (0..n).for_each(|k| a[k * n + k] += 1e-12 + 1e-10 * a[k * n + k]);
    if !cholesky::factor(&mut a, n) {
        return vec![f64::NAN; n * n];
    }
    let column = |i: usize| {
        let mut b = vec![0.0; n];
        b[i] = 1.0;
        cholesky::solve(&a, &mut b);
        b
    };
    (0..n).flat_map(column).collect()
}

/// Sizes, relative to an effect's own start, at which a search looks before it begins. From far too large a start the first step ends
/// at nothing, where the slope of most effects is nothing too.
const SIZES: [f64; 10] = [30.0, 10.0, 3.0, 1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3];

/// Starts of one more effect's parameters: its own, or what the campaign hints at, each at the size that fits best while all else stays.
fn starts(
    effect: &'static dyn Effect,
    given: &[Option<f64>],
    all: &Observations,
    now: &Fitted,
) -> Vec<Vec<f64>> {
    let parameters = effect.parameters();
    let sized = |values: &[f64], size: f64| -> Vec<f64> {
        let of = |(v, p): (&f64, &radcam_sim::effects::Parameter)| {
            // A size is what may be nothing; places and levels stay.
            let is_size = p.min <= 0.0 && !p.is_choice() && !p.starts.is_empty();
            if is_size { (v * size).clamp(p.min, p.max) } else { *v }
        };
        as_given(&values.iter().zip(parameters).map(of).collect::<Vec<_>>(), given)
    };
    let misfit = |values: Option<&Vec<f64>>| {
        let mut effects = now.effects.clone();
        effects.extend(values.map(|v| (effect, v.clone())));
        let prediction = predict(&now.base, &effects, all);
        objective(&chosen(all, None).map(|o| expect(o, &prediction, all)).collect::<Vec<_>>())
    };
    let without = misfit(None);
    let hinted = effect.starts(&seen(all, &now.base));
    // A fit that keeps signs begins at every combination of them; another passes from one to the other.
    let begin: Vec<Vec<f64>> = if effect.keeps_sign() {
        let flip = |values: &Vec<f64>, which: u32| -> Vec<f64> {
            values.iter().enumerate().map(|(i, v)| if which >> i & 1 == 1 { -v } else { *v }).collect()
        };
        hinted.iter().flat_map(|v| (0..1 << v.len().min(4)).map(|which| flip(v, which))).collect()
    } else {
        hinted
    };
    let crosses = !effect.keeps_sign() && parameters.iter().any(|p| p.min < 0.0);
    let signs: &[f64] = if crosses { &[1.0, -1.0] } else { &[1.0] };
    let best = |values: Vec<f64>| {
        let tries = signs.iter().flat_map(|sign| SIZES.map(|size| sized(&values, sign * size)));
        // What moves nothing that was measured leaves a fit where it is.
        let scored = tries.map(|v| (misfit(Some(&v)), v)).filter(|(score, _)| *score != without);
        scored.min_by(|a, b| a.0.total_cmp(&b.0)).map(|found| found.1)
    };
    let mut out: Vec<Vec<f64>> = begin.into_iter().filter_map(best).collect();
    out.dedup();
    out
}

/// What the campaign shows before any fit.
fn seen(all: &Observations, base: &BaseParameters) -> Seen {
    let means = all.all.iter().filter(|o| o.kind == Statistic::Mean).map(|o| o.measured.value);
    Seen {
        peak_e: (means.fold(0.0, f64::max) - base.offset_dn) / base.gain_dn_per_e,
        dark_noise_dn: base.read_noise_e * base.gain_dn_per_e,
        line_cycles_per_px: all.campaign.line_cycles_per_px,
    }
}
