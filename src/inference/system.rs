//! The normal equations of a fit: common values, and light factors that touch their own sets only.

use super::free::{Common, Free, Key, Point};
use crate::fit::cholesky;
use crate::observables::{Expected, Half, Observable, Observations, expectations, monitor};
use radcam_sim::effects;
use radcam_sim::predict::Prediction;
use rayon::prelude::*;

/// From here on the square of a residual says that the model is wrong, and not how large its scatter is.
const LARGE: f64 = 16.0;

/// Expectations at a place.
pub struct State {
    /// One for each observable that takes part.
    pub expected: Vec<Expected>,
    /// What the settings of sets scatter by, in units of the light, for each of [`Layout::blocks`].
    setting: Vec<f64>,
}

impl State {
    /// Whether the scatter of settings is far larger there: that is no matter of small moves.
    pub fn setting_widens(&self, from: &Self) -> bool {
        self.setting.iter().zip(&from.setting).any(|(a, b)| *a > 4.0 * b)
    }
}

/// Which observables take part, and those that see the light of one set together.
pub struct Layout<'a> {
    /// The campaign.
    pub all: &'a Observations,
    /// Those that take part.
    pub rows: Vec<&'a Observable>,
    /// Their places in [`Observations::list`].
    places: Vec<usize>,
    halves: Vec<Half>,
    /// Set and rows of those of a set that see its light.
    blocks: Vec<(usize, Vec<usize>)>,
}

impl<'a> Layout<'a> {
    /// Of these halves.
    pub fn new(all: &'a Observations, halves: &[Half]) -> Self {
        let (places, rows): (Vec<usize>, Vec<&Observable>) =
            all.list.iter().enumerate().filter(|(_, o)| halves.contains(&o.half)).unzip();
        let mut blocks: Vec<(usize, Vec<usize>)> = Vec::new();
        let mut place = vec![None; all.campaign.sets.len()];
        for (i, o) in rows.iter().enumerate() {
            let Some(set) =
                o.set.filter(|s| o.statistic.sees_light() && all.campaign.sets[*s].light.is_some())
            else {
                continue;
            };
            let at = *place[set].get_or_insert_with(|| {
                blocks.push((set, Vec::new()));
                blocks.len() - 1
            });
            blocks[at].1.push(i);
        }
        Self { all, rows, places, halves: halves.to_vec(), blocks }
    }

    /// What a prediction expects of them.
    pub fn state(&self, prediction: &Prediction) -> State {
        let all = expectations(self.all, prediction, |h| self.halves.contains(&h));
        let setting = self.blocks.iter().map(|(set, _)| prediction.sets[*set].setting).collect();
        State { expected: all.into_iter().map(|(_, e)| e).collect(), setting }
    }

    /// What a model at a place expects of them.
    pub fn at(&self, free: &Free, point: &Point) -> State {
        let (base, effects) = free.unpack(point);
        let list: Vec<_> = effects.iter().map(|(e, p)| (*e as &dyn effects::Effect, p.as_slice())).collect();
        self.state(&effects::predict(&self.all.campaign, &base, &list))
    }
}

/// Rows and what they say of every value, at one place.
pub struct System<'a> {
    layout: &'a Layout<'a>,
    /// Number of common values.
    n: usize,
    /// Standardised residuals; after those of the observables, one for each set whose setting scatters.
    pub z: Vec<f64>,
    /// What each residual's square is expected to be.
    expected_square: Vec<f64>,
    /// Slopes of the expectations with the common values over their errors, row by row.
    pub slopes: Vec<f64>,
    /// Slope with the factor of the row's light level.
    by_light: Vec<f64>,
    /// Which factor that is.
    light: Vec<Option<usize>>,
    /// Rows whose error is a scatter that is fitted, with its logarithm's slopes.
    scatter: Vec<(usize, Vec<f64>)>,
    blocks: Vec<Block>,
    priors: Vec<(usize, f64, f64)>,
    lights: usize,
}

/// Observables of one set that see its light, where its setting scatters.
struct Block {
    rows: Vec<usize>,
    /// Slope of each with the light over its error.
    loads: Vec<f64>,
    /// Sum of their squares.
    weight: f64,
    /// Square of what the light moves the mean by, DN^2.
    unit: f64,
    /// Variance of the setting and of what the frames tell of it, in units of the light.
    variance: f64,
}

/// How expectations change with the common values, at some place.
#[derive(Clone)]
pub struct Slopes {
    /// What each is of; `None` for what is not known.
    keys: Vec<Option<Key>>,
    /// Places of the rows in [`Observations::list`], and sets of the blocks.
    rows: Vec<usize>,
    sets: Vec<usize>,
    /// Per unit of [`Point::x`], row by row.
    expected: Vec<f64>,
    /// Change of the logarithm of the error of rows whose error is fitted, per unit of [`Point::x`].
    scatter: Vec<(usize, Vec<f64>)>,
    /// Change of [`State::setting`], block by block.
    setting: Vec<f64>,
    scale: Vec<f64>,
}

impl Slopes {
    /// At a place.
    pub fn new(layout: &Layout<'_>, free: &Free, point: &Point, now: &State) -> Self {
        Self::beside(None, layout, free, point, now)
    }

    /// At a place near one where they are known, maybe of another model or of other halves: of what is not known there only.
    pub fn beside(
        known: Option<&Self>,
        layout: &Layout<'_>,
        free: &Free,
        point: &Point,
        now: &State,
    ) -> Self {
        let (n, rows, blocks) = (free.common.len(), layout.rows.len(), layout.blocks.len());
        let monitors = (0..rows).filter(|r| layout.rows[*r].is(&monitor::This));
        let mut out = Self {
            keys: (0..n).map(|i| (!free.fixed[i]).then(|| free.key(i))).collect(),
            rows: layout.places.clone(),
            sets: layout.blocks.iter().map(|(set, _)| *set).collect(),
            expected: vec![0.0; rows * n],
            scatter: monitors.map(|r| (r, vec![0.0; n])).collect(),
            setting: vec![0.0; blocks * n],
            scale: free.scale.clone(),
        };
        let place = |i: usize| {
            let known = known.filter(|k| k.has_all(&out.rows, &out.sets))?;
            known.keys.iter().position(|k| k.is_some() && *k == out.keys[i])
        };
        let places: Vec<Option<usize>> = (0..n).map(place).collect();
        let fresh: Vec<usize> = (0..n).filter(|i| !free.fixed[*i] && places[*i].is_none()).collect();
        let step_of = |i: usize| {
            let step = 1e-5 * point.x[i].abs().max(1e-2);
            if point.x[i] + step > free.bounds[i].1 { -step } else { step }
        };
        let moved: Vec<(usize, f64, State)> = fresh
            .into_par_iter()
            .map(|i| {
                let mut moved = point.clone();
                moved.x[i] += step_of(i);
                (i, step_of(i), layout.at(free, &moved))
            })
            .collect();
        for (i, step, there) in &moved {
            for (r, (a, b)) in now.expected.iter().zip(&there.expected).enumerate() {
                out.expected[r * n + i] = (b.normal.1 - a.normal.1) / step;
            }
            for (r, slopes) in &mut out.scatter {
                slopes[*i] = (there.expected[*r].normal.2 / now.expected[*r].normal.2).ln() / step;
            }
            for (b, (was, is)) in now.setting.iter().zip(&there.setting).enumerate() {
                out.setting[b * n + i] = (is - was) / step;
            }
        }
        if let Some(known) = known {
            out.take(known, &places);
        }
        out
    }

    /// Whether these rows and blocks are among its own; all are in order.
    fn has_all(&self, rows: &[usize], sets: &[usize]) -> bool {
        let among = |few: &[usize], all: &[usize]| few.iter().all(|x| all.binary_search(x).is_ok());
        among(rows, &self.rows) && sets.iter().all(|s| self.sets.contains(s))
    }

    /// Takes over what is known elsewhere, each from its place there.
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

    /// Over the errors of the expectations.
    pub fn over_errors(&self, now: &State) -> Vec<f64> {
        let n = self.scale.len();
        let mut out = self.expected.clone();
        for (row, e) in out.chunks_exact_mut(n).zip(&now.expected) {
            row.iter_mut().for_each(|s| *s /= e.normal.2);
        }
        out
    }
}

impl<'a> System<'a> {
    /// At a place, with slopes there or near.
    pub fn new(layout: &'a Layout<'a>, free: &Free, point: &Point, now: &State, known: &Slopes) -> Self {
        let n = free.common.len();
        let rows = layout.rows.len();
        let slopes = known.over_errors(now);
        // All light together: of a set's own observables that is the slope with its own factor.
        let all_light = free.place(Common::Light).unwrap_or(0);
        let by_light: Vec<f64> = (0..rows).map(|r| slopes[r * n + all_light]).collect();
        let level = |o: &&Observable| o.set.and_then(|s| layout.all.campaign.sets[s].light);
        let factor = |o: &&Observable| level(o).and_then(|l| free.light_of_level.get(l).copied().flatten());
        let priors = free.lights.iter().zip(&point.lights).enumerate();
        let mut system = Self {
            layout,
            n,
            z: now.expected.iter().map(Expected::z).collect(),
            expected_square: vec![1.0; rows],
            slopes,
            by_light,
            light: layout.rows.iter().map(factor).collect(),
            scatter: Vec::new(),
            blocks: Vec::new(),
            priors: priors.filter_map(|(k, (l, x))| Some((k, *x, 1.0 / l.known?.powi(2)))).collect(),
            lights: free.lights.len(),
        };
        system.gather(now, known);
        system.scatter.extend(known.scatter.iter().cloned());
        system
    }

    /// Turns what sees the light of a set whose setting scatters into deviations among themselves and one row for their common one.
    fn gather(&mut self, now: &State, known: &Slopes) {
        let n = self.n;
        for (b, (_, rows)) in self.layout.blocks.iter().enumerate() {
            let loads: Vec<f64> = rows.iter().map(|r| self.by_light[*r]).collect();
            let weight: f64 = loads.iter().map(|a| a * a).sum();
            if now.setting[b] <= 0.0 || weight <= 0.0 {
                continue;
            }
            // The setting's scatter is a variance of the mean in DN^2: over the square of what the light moves the mean by.
            let unit = (loads[0] * now.expected[rows[0]].normal.2).powi(2);
            let own = now.setting[b] / unit;
            let variance = own + 1.0 / weight;
            let project = |values: &[f64]| loads.iter().zip(values).map(|(a, v)| a * v).sum::<f64>() / weight;
            let z: Vec<f64> = rows.iter().map(|r| self.z[*r]).collect();
            let common = project(&z);
            for ((r, a), z) in rows.iter().zip(&loads).zip(&z) {
                self.z[*r] = z - a * common;
                self.expected_square[*r] = 1.0 - a * a / weight;
            }
            let root = variance.sqrt();
            let mut last = vec![0.0; n];
            for (i, out) in last.iter_mut().enumerate() {
                let of: Vec<f64> = rows.iter().map(|r| self.slopes[r * n + i]).collect();
                let common = project(&of);
                for ((r, a), s) in rows.iter().zip(&loads).zip(&of) {
                    self.slopes[r * n + i] = s - a * common;
                }
                *out = common / root;
            }
            let level = self.light[rows[0]];
            rows.iter().for_each(|r| self.by_light[*r] = 0.0);
            let scatter = known.setting[b * n..][..n].iter().map(|s| 0.5 * s / unit / variance).collect();
            self.scatter.push((self.z.len(), scatter));
            self.z.push(common / root);
            self.expected_square.push(1.0);
            self.slopes.extend(last);
            self.by_light.push(1.0 / root);
            self.light.push(level);
            self.blocks.push(Block { rows: rows.clone(), loads, weight, unit, variance });
        }
    }

    /// Half the gradient and the normal matrix.
    pub fn normal(&self) -> Normal {
        let n = self.n;
        let mut out = Normal {
            n,
            matrix: vec![0.0; n * n],
            gradient: vec![0.0; n],
            scatter: (0..n).map(|i| self.is_scatter(i)).collect(),
            lights: vec![LightTerm { square: 0.0, gradient: 0.0, with: vec![0.0; n] }; self.lights],
        };
        for (r, z) in self.z.iter().enumerate() {
            let row = &self.slopes[r * n..][..n];
            for i in 0..n {
                if row[i] == 0.0 {
                    continue;
                }
                out.gradient[i] += row[i] * z;
                for j in 0..=i {
                    out.matrix[i * n + j] += row[i] * row[j];
                }
            }
            if let Some(light) = self.light[r] {
                let (a, term) = (self.by_light[r], &mut out.lights[light]);
                if a != 0.0 {
                    term.square += a * a;
                    term.gradient += a * z;
                    term.with.iter_mut().zip(row).for_each(|(w, s)| *w += a * s);
                }
            }
        }
        // Fisher's scoring (Rao 1973, section 5g): a scatter that is fitted is told by the squares of the residuals that have it.
        for (r, slopes) in &self.scatter {
            let (square, expected) = ((self.z[*r] * self.z[*r]).min(LARGE), self.expected_square[*r]);
            for i in 0..n {
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

    /// Whether a value is a scatter and moves no expectation.
    fn is_scatter(&self, i: usize) -> bool {
        let moves = || self.slopes.iter().skip(i).step_by(self.n).any(|s| *s != 0.0);
        self.scatter.iter().any(|(_, slopes)| slopes[i] != 0.0) && !moves()
    }

    /// By what every value that is a scatter is to be multiplied, the residuals given: so that their squares are what is expected of them.
    /// A joint step with what moves expectations overshoots, since each changes what the other sees.
    pub fn scatter_factors(&self) -> Vec<(usize, f64)> {
        let rows = self.layout.rows.len();
        let factor = |i: usize| {
            let of = self.scatter.iter().filter(|(_, slopes)| slopes[i] != 0.0);
            if of.clone().all(|(r, _)| *r < rows) {
                let (square, expected) = of.fold((0.0, 0.0), |(a, b), (r, _)| {
                    (a + self.z[*r] * self.z[*r], b + self.expected_square[*r])
                });
                return (square / f64::max(expected, 1e-9)).sqrt().clamp(0.3, 3.0);
            }
            // Settings: the factor of their own variance beside what the frames have.
            let parts: Vec<(f64, f64, f64)> = self
                .blocks
                .iter()
                .zip(&self.z[rows..])
                .map(|(b, z)| (z * z * b.variance, b.variance - 1.0 / b.weight, 1.0 / b.weight))
                .collect();
            let excess =
                |f: f64| parts.iter().map(|(e, own, frames)| e / (f * own + frames) - 1.0).sum::<f64>();
            if excess(1e-8) <= 0.0 {
                return 1e-4;
            }
            let (mut low, mut high) = (1e-8f64, 1e8f64);
            for _ in 0..60 {
                let middle = (low * high).sqrt();
                if excess(middle) > 0.0 { low = middle } else { high = middle }
            }
            low.sqrt().clamp(0.05, 20.0)
        };
        (0..self.n).filter(|i| self.is_scatter(*i)).map(|i| (i, factor(i))).collect()
    }

    /// Twice the negative logarithm of the likelihood at another place, with the errors of this one, but for scatter that is fitted.
    pub fn objective(&self, here: &State, there: &State, lights: &[f64]) -> f64 {
        let mut z: Vec<f64> = here
            .expected
            .iter()
            .zip(&there.expected)
            .map(|(a, b)| (b.normal.0 - b.normal.1) / a.normal.2)
            .collect();
        let mut sum = 0.0;
        for (r, _) in self.scatter.iter().filter(|(r, _)| *r < here.expected.len()) {
            let e = &there.expected[*r];
            z[*r] = e.z();
            sum += 2.0 * e.normal.2.ln();
        }
        sum += self.of_blocks(&mut z, there, false);
        sum + z.iter().map(|z| z * z).sum::<f64>() + self.of_priors(lights)
    }

    /// By how much a step would lessen the sum of squares if expectations followed their slopes.
    pub fn promised(&self, step: &[f64], lights: &[f64]) -> f64 {
        let of = |(r, z): (usize, &f64)| {
            let row = &self.slopes[r * self.n..][..self.n];
            let common: f64 = row.iter().zip(step).map(|(s, x)| s * x).sum();
            let left = z - common - self.light[r].map_or(0.0, |k| self.by_light[r] * lights[k]);
            z * z - left * left
        };
        self.z.iter().enumerate().map(of).sum()
    }

    fn of_priors(&self, lights: &[f64]) -> f64 {
        self.priors.iter().map(|(k, _, weight)| weight * lights[*k] * lights[*k]).sum()
    }

    /// Takes the common deviation off what sees the light of one set, and gives what it costs.
    fn of_blocks(&self, z: &mut [f64], there: &State, whole: bool) -> f64 {
        let mut sum = 0.0;
        let mut known = self.blocks.iter();
        let mut next = known.next();
        for (b, (_, rows)) in self.layout.blocks.iter().enumerate() {
            let Some(block) = next.filter(|block| block.rows == *rows) else { continue };
            next = known.next();
            let variance = (there.setting[b] / block.unit + 1.0 / block.weight).max(1e-30);
            let common = block.loads.iter().zip(rows).map(|(a, r)| a * z[*r]).sum::<f64>() / block.weight;
            rows.iter().zip(&block.loads).for_each(|(r, a)| z[*r] -= a * common);
            sum += common * common / variance + variance.ln() + if whole { block.weight.ln() } else { 0.0 };
        }
        sum
    }

    /// Twice the negative logarithm of the likelihood at this place.
    pub fn likelihood(&self, here: &State, lights: &[f64]) -> f64 {
        let mut z: Vec<f64> = here.expected.iter().map(Expected::z).collect();
        let errors: f64 = here.expected.iter().map(|e| 2.0 * e.normal.2.ln()).sum();
        let blocks = self.of_blocks(&mut z, here, true);
        let sum = z.iter().map(|z| z * z).sum::<f64>() + errors + blocks + self.of_priors(lights);
        if sum.is_nan() { f64::INFINITY } else { sum }
    }

    /// Deviations of the settings of sets, each over what it is expected to scatter by; by set.
    pub fn setting_scores(&self) -> Vec<(usize, f64)> {
        let sets = self.blocks.iter().filter_map(|b| self.layout.rows[b.rows[0]].set);
        sets.zip(self.z[self.layout.rows.len()..].iter().copied()).collect()
    }

    /// What the frames tell of the light of sets whose setting scatters: its deviation, and the error that this leaves, in units of the
    /// light; by set.
    pub fn settings(&self) -> Vec<(usize, f64, f64)> {
        let first = self.layout.rows.len();
        let of = |(k, block): (usize, &Block)| {
            let set = self.layout.rows[block.rows[0]].set?;
            let own = block.variance - 1.0 / block.weight;
            let common = self.z[first + k] * block.variance.sqrt();
            // Between what the frames say and a setting that is as nominal.
            Some((set, common * own / block.variance, own / block.variance / block.weight))
        };
        self.blocks.iter().enumerate().filter_map(of).collect()
    }
}

/// What a light factor has to say.
#[derive(Debug, Clone)]
struct LightTerm {
    square: f64,
    gradient: f64,
    with: Vec<f64>,
}

/// Normal equations.
#[derive(Debug, Clone)]
pub struct Normal {
    n: usize,
    matrix: Vec<f64>,
    gradient: Vec<f64>,
    /// Values that are a scatter and move no expectation: see [`System::scatter_factors`].
    scatter: Vec<bool>,
    lights: Vec<LightTerm>,
}

/// Normal equations with the lights eliminated, factored.
pub struct Solver {
    factor: Vec<f64>,
    squares: Vec<f64>,
}

impl Solver {
    /// The step that gradients ask for: of the common values and of the lights.
    fn solve(&self, normal: &Normal, gradient: Vec<f64>, lights: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut b = gradient;
        for ((l, square), gradient) in normal.lights.iter().zip(&self.squares).zip(lights) {
            b.iter_mut().zip(&l.with).for_each(|(b, w)| *b -= w * gradient / square);
        }
        b.iter_mut().zip(&normal.scatter).filter(|(_, s)| **s).for_each(|(b, _)| *b = 0.0);
        cholesky::solve(&self.factor, &mut b);
        let back = |((l, square), gradient): ((&LightTerm, &f64), &f64)| {
            (gradient - l.with.iter().zip(&b).map(|(w, x)| w * x).sum::<f64>()) / square
        };
        let lights = normal.lights.iter().zip(&self.squares).zip(lights).map(back).collect();
        (b, lights)
    }
}

impl Normal {
    /// Damped; `None` where there is no solution.
    fn solver(&self, damping: f64) -> Option<Solver> {
        let n = self.n;
        let mut a = self.matrix.clone();
        for i in 0..n {
            a[i * n + i] += damping * self.matrix[i * n + i] + 1e-12;
        }
        let squares: Vec<f64> = self.lights.iter().map(|l| l.square * (1.0 + damping) + 1e-12).collect();
        for (l, square) in self.lights.iter().zip(&squares) {
            for i in (0..n).filter(|i| l.with[*i] != 0.0) {
                for j in 0..n {
                    a[i * n + j] -= l.with[i] * l.with[j] / square;
                }
            }
        }
        for i in (0..n).filter(|i| self.scatter[*i]) {
            for j in 0..n {
                (a[i * n + j], a[j * n + i]) = (0.0, 0.0);
            }
            a[i * n + i] = 1.0;
        }
        cholesky::factor(&mut a, n).then_some(Solver { factor: a, squares })
    }

    /// The step that they ask for, damped; `None` where there is none.
    pub fn step(&self, damping: f64) -> Option<(Vec<f64>, Vec<f64>)> {
        let lights: Vec<f64> = self.lights.iter().map(|l| l.gradient).collect();
        Some(self.solver(damping)?.solve(self, self.gradient.clone(), &lights))
    }

    /// Covariance of the common values with the lights eliminated, row by row; values without any hold keep a large error.
    pub fn covariance(&self) -> Covariance {
        let n = self.n;
        let mut a = self.matrix.clone();
        let lights: Vec<(f64, Vec<f64>)> = self
            .lights
            .iter()
            .map(|l| {
                let square = l.square + 1e-12;
                (1.0 / square, l.with.iter().map(|w| w / square).collect())
            })
            .collect();
        for (l, (inverse, _)) in self.lights.iter().zip(&lights) {
            for i in 0..n {
                for j in 0..n {
                    a[i * n + j] -= l.with[i] * l.with[j] * inverse;
                }
            }
        }
        for k in 0..n {
            a[k * n + k] += 1e-12 + 1e-10 * self.matrix[k * n + k];
        }
        let common = if cholesky::factor(&mut a, n) {
            let column = |i: usize| {
                let mut b = vec![0.0; n];
                b[i] = 1.0;
                cholesky::solve(&a, &mut b);
                b
            };
            (0..n).flat_map(column).collect()
        } else {
            vec![f64::NAN; n * n]
        };
        Covariance { n, common, lights }
    }
}

/// Covariance of what was fitted.
#[derive(Debug, Clone)]
pub struct Covariance {
    n: usize,
    /// Of the common values, row by row.
    pub common: Vec<f64>,
    /// Variance of every light factor for given common values, and how it follows them.
    lights: Vec<(f64, Vec<f64>)>,
}

impl Covariance {
    /// Variance of something with these slopes with the common values, and this one with a light factor.
    pub fn of(&self, slopes: &[f64], light: Option<(usize, f64)>) -> f64 {
        let n = self.n;
        let mut slopes = slopes.to_vec();
        let mut own = 0.0;
        if let Some((k, a)) = light {
            let (variance, follow) = &self.lights[k];
            slopes.iter_mut().zip(follow).for_each(|(s, f)| *s -= a * f);
            own = a * a * variance;
        }
        let row = |i: usize| (0..n).map(|j| self.common[i * n + j] * slopes[j]).sum::<f64>();
        own + (0..n).filter(|i| slopes[*i] != 0.0).map(|i| slopes[i] * row(i)).sum::<f64>()
    }
}

/// By how much minus twice the logarithm of the likelihood falls.
#[derive(Debug, Clone, Copy)]
pub struct Gain {
    /// For the whole of a move.
    pub whole: f64,
    /// The multiple of the move that is best, if it is in proportion.
    pub multiple: f64,
    /// What that would bring.
    pub best: f64,
}

/// What moving the expectations in a direction would bring, everything else fitted: a score test (Rao 1973, section 6e).
pub struct Direction<'s, 'a> {
    system: &'s System<'a>,
    normal: Normal,
    solver: Solver,
}

impl<'s, 'a> Direction<'s, 'a> {
    /// At the place of a fit; `None` where its values cannot be told apart.
    pub fn new(system: &'s System<'a>) -> Option<Self> {
        let normal = system.normal();
        Some(Self { solver: normal.solver(1e-9)?, normal, system })
    }

    /// What a scatter of settings that follows brings beyond that: of m of them with the sum of squares S that falls to T the likelihood
    /// gains m ln(S / T), and not S - T.
    fn narrower(&self, settings: &[(f64, f64)]) -> f64 {
        let m = settings.len() as f64;
        let (before, after) = settings.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x * x, b + y * y));
        if m < 4.0 || after >= before {
            return 0.0;
        }
        // The scatter cannot fall below what the frames themselves have.
        let floor: f64 = self.system.blocks.iter().map(|b| 1.0 / b.weight / b.variance).sum();
        (m * (before / after.max(floor)).ln() - (before - after)).max(0.0)
    }

    /// What a move from `now` to `there` leaves once the fitted values have taken over what they can of it; `None` where that cannot be
    /// told.
    pub fn left_of(&self, now: &State, there: &State) -> Option<Vec<f64>> {
        let s = self.system;
        let n = s.n;
        let mut moves: Vec<f64> = now
            .expected
            .iter()
            .zip(&there.expected)
            .map(|(a, b)| (b.normal.1 - a.normal.1) / a.normal.2)
            .collect();
        for block in &s.blocks {
            let common =
                block.loads.iter().zip(&block.rows).map(|(a, r)| a * moves[*r]).sum::<f64>() / block.weight;
            block.rows.iter().zip(&block.loads).for_each(|(r, a)| moves[*r] -= a * common);
            moves.push(common / block.variance.sqrt());
        }
        let mut gradient = vec![0.0; n];
        let mut lights = vec![0.0; self.normal.lights.len()];
        for (r, m) in moves.iter().enumerate().filter(|(_, m)| **m != 0.0) {
            let row = &s.slopes[r * n..][..n];
            gradient.iter_mut().zip(row).for_each(|(g, s)| *g += s * m);
            if let Some(light) = s.light[r] {
                lights[light] += s.by_light[r] * m;
            }
        }
        let (taken, lights) = self.solver.solve(&self.normal, gradient, &lights);
        for (r, m) in moves.iter_mut().enumerate() {
            let row = &s.slopes[r * n..][..n];
            *m -= row.iter().zip(&taken).map(|(s, t)| s * t).sum::<f64>();
            if let Some(light) = s.light[r] {
                *m -= s.by_light[r] * lights[light];
            }
        }
        moves.iter().all(|m| m.is_finite()).then_some(moves)
    }

    /// What a move that leaves this would bring.
    pub fn gain(&self, left: &[f64]) -> Option<Gain> {
        let s = self.system;
        let (mut with, mut square) = (0.0, 0.0);
        for (left, z) in left.iter().zip(&s.z) {
            with += left * z;
            square += left * left;
        }
        if square <= 1e-12 || !square.is_finite() {
            return None;
        }
        let first = left.len() - s.blocks.len();
        let left_over: Vec<(f64, f64)> =
            left[first..].iter().zip(&s.z[first..]).map(|(left, z)| (*z, z - left)).collect();
        let whole = 2.0 * with - square + self.narrower(&left_over);
        Some(Gain { whole, multiple: with / square, best: with * with / square })
    }

    /// From a move that leaves `from`, the multiples of further moves that together bring most.
    pub fn together(&self, from: &[f64], moves: &[Vec<f64>]) -> Option<Vec<f64>> {
        let k = moves.len();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let rest: Vec<f64> = self.system.z.iter().zip(from).map(|(z, m)| z - m).collect();
        let mut a: Vec<f64> = (0..k * k).map(|i| dot(&moves[i / k], &moves[i % k])).collect();
        let mut b: Vec<f64> = moves.iter().map(|m| dot(m, &rest)).collect();
        for i in 0..k {
            a[i * k + i] = a[i * k + i] * (1.0 + 1e-9) + 1e-12;
        }
        cholesky::factor(&mut a, k).then(|| {
            cholesky::solve(&a, &mut b);
            b
        })
    }
}
