//! K common to all configurations, with a smooth surface as the light of each: the window of eq. (47)
//! approximates it.
//!
//! e_i(a,b) = K(a,b) L_i(a,b) (1 + card grain), with L_i a polynomial surface whose order the data choose,
//! and K without a smooth part of its own (no number of configurations separates a surface common to K and
//! every L_i). Surface and K are fitted alternately, both with Tukey's biweight (Beaton and Tukey 1974), so
//! that spots of the card have no influence. Compared with the window's mean, neighbours' spots and K's own
//! mean over the window drop out of the error.

use super::pattern::{FixedPattern, PatternError, check, level_of, pooled_deviation};
use super::robust::{self, Light, Location};
use crate::fit::cholesky::Factor;
use crate::statistics::median::median_of;
use ndarray::Array2;
use rayon::prelude::*;

/// Maximum order of a light surface.
const MAX_ORDER: usize = 6;
/// Side of the blocks whose medians the surfaces are fitted to, pixels.
const BLOCK: usize = 8;
/// Approximate maximum number of blocks.
const MOST_BLOCKS: f64 = 6000.0;
/// Maximum residual of a block over the robust deviation of all blocks: the rim of an image circle and spots
/// of a block's size are no part of the surface (Tukey's biweight constant, as for the pixels).
const MAX_BLOCK_DEVIATIONS: f64 = 4.685;
/// Maximum iterations of excluding blocks.
const BLOCK_ROUNDS: usize = 5;

/// Estimates K by the joint model. `configurations` are the e_i of eq. (46), DN, each (rows, columns).
///
/// The standard error is the scatter over the configurations; the surfaces' own errors are smaller by the
/// root of the number of pixels over that of the surface's terms.
///
/// # Errors
///
/// If there are too few configurations, or they differ in size.
pub fn joint(configurations: &[Array2<f32>]) -> Result<FixedPattern, PatternError> {
    check(configurations)?;
    joint_of(configurations, &Array2::from_elem(configurations[0].dim(), true))
}

/// As `joint`, from the sound pixels only; K of the others is meaningless.
pub(super) fn joint_of(
    configurations: &[Array2<f32>],
    sound: &Array2<bool>,
) -> Result<FixedPattern, PatternError> {
    check(configurations)?;
    let shape = configurations[0].dim();
    let blocks = Blocks::new(sound);
    let mut k = Array2::<f32>::ones(shape);
    let order = blocks.order(configurations, &k);
    let n1 = configurations.len();
    let (mut pooled_sd, mut mean_before) = (0.0, 1.0);
    let mut kept = Array2::zeros(shape);
    // K of the first iteration removes the grain from the surfaces of the second; a third changes nothing
    // that matters.
    for _ in 0..2 {
        let light = blocks.surfaces(configurations, &k, order);
        pooled_sd = pooled_deviation(sound, n1, |at, m| {
            m.clear();
            m.extend(configurations.iter().enumerate().map(|(i, e)| f64::from(e[at]) / light.at(i, at)));
        });
        let location = Location::Biweight { scale: pooled_sd as f32 };
        kept = robust::estimate(configurations, &light, location, &mut k);
        mean_before = mean_of(&k, sound);
        k.mapv_inplace(|k| (f64::from(k) / mean_before) as f32);
    }
    let (variance, _) = robust::efficiency(n1, Location::Biweight { scale: 1.0 });
    let share = |kept: u16| variance * n1 as f64 / f64::from(kept.max(1));
    let std_err = kept.mapv(|kept: u16| (pooled_sd * share(kept).sqrt()) as f32);
    Ok(FixedPattern { k, std_err, kept, pooled_sd, mean_before, level_dn: level_of(configurations, sound) })
}

/// Computes the mean over the sound pixels.
pub(super) fn mean_of(k: &Array2<f32>, sound: &Array2<bool>) -> f64 {
    let used = k.iter().zip(sound).filter(|(_, sound)| **sound).map(|(k, _)| f64::from(*k));
    let (n, sum) = used.fold((0.0, 0.0), |(n, sum), k| (n + 1.0, sum + k));
    sum / f64::max(n, 1.0)
}

/// Replaces pixels that are not sound by the light's surface, so that a window's mean is that of the light.
pub(super) fn filled(configurations: &[Array2<f32>], sound: &Array2<bool>) -> Vec<Array2<f32>> {
    let blocks = Blocks::new(sound);
    let even = Array2::<f32>::ones(sound.dim());
    let light = blocks.surfaces(configurations, &even, blocks.order(configurations, &even));
    let mut out = configurations.to_vec();
    for (i, image) in out.iter_mut().enumerate() {
        for ((at, e), _) in image.indexed_iter_mut().zip(sound).filter(|(_, sound)| !**sound) {
            *e = light.at(i, at) as f32;
        }
    }
    out
}

/// Estimates K without moved configurations: the mean image over a smooth surface. Structure of the card and
/// the lamp finer than the surface is attributed to the camera: no frame can separate them.
///
/// `noise_dn2` is the variance of the temporal noise left in each image (that of a frame over the number of
/// frames): it gives the weights of the images, and the standard error contains it alone.
///
/// # Errors
///
/// If there are too few configurations, or they differ in size.
pub fn smooth(images: &[Array2<f32>], noise_dn2: &[f64]) -> Result<FixedPattern, PatternError> {
    let Some(first) = images.first() else { return Err(PatternError::TooFew(0)) };
    smooth_of(images, noise_dn2, &Array2::from_elem(first.dim(), true))
}

/// As `smooth`, from the sound pixels only; K of the others is meaningless.
pub(super) fn smooth_of(
    images: &[Array2<f32>],
    noise_dn2: &[f64],
    sound: &Array2<bool>,
) -> Result<FixedPattern, PatternError> {
    let Some(first) = images.first() else { return Err(PatternError::TooFew(0)) };
    super::pattern::check_images(images)?;
    let shape = first.dim();
    let blocks = Blocks::new(sound);
    let even = Array2::<f32>::ones(shape);
    let order = blocks.order(images, &even);
    let levels: Vec<f64> = images.iter().map(|e| mean_of(e, sound)).collect();
    // Slopes have the variance of the noise over the square of the level.
    let weight = |i: usize| levels[i].powi(2) / noise_dn2.get(i).map_or(1.0, |v| v.max(1e-12));
    let weights: Vec<f64> = (0..images.len()).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    let mut k = Array2::<f32>::zeros(shape);
    let mut std_err = Array2::<f32>::zeros(shape);
    let light = blocks.surfaces(images, &even, order);
    let mut sweep = light.sweep(0);
    let mut lights = vec![0.0; images.len() * shape.1];
    for (y, (mut k, mut std_err)) in k.outer_iter_mut().zip(std_err.outer_iter_mut()).enumerate() {
        sweep(&mut lights);
        for (i, (e, l)) in images.iter().zip(lights.chunks(shape.1)).enumerate() {
            let share = (weights[i] / sum) as f32;
            k.iter_mut().zip(e.row(y)).zip(l).for_each(|((k, &e), &l)| *k += share * e / l.max(1e-6));
            // Shot noise: the relative variance goes with 1 / light.
            let over = levels[i] as f32 * share;
            std_err.iter_mut().zip(l).for_each(|(s, &l)| *s += over / l.max(1e-6));
        }
    }
    let mean = mean_of(&k, sound);
    k.mapv_inplace(|k| (f64::from(k) / mean) as f32);
    let error = sum.sqrt().recip();
    std_err.mapv_inplace(|over| (error * f64::from(over).max(0.0).sqrt()) as f32);
    Ok(FixedPattern {
        std_err,
        kept: Array2::from_elem(shape, images.len() as u16),
        pooled_sd: error * (images.len() as f64).sqrt(),
        mean_before: mean,
        level_dn: levels.iter().zip(&weights).map(|(l, w)| l * w).sum::<f64>() / sum,
        k,
    })
}

/// Blocks of the frame, and polynomial surfaces over it.
struct Blocks<'a> {
    shape: (usize, usize),
    sound: &'a Array2<bool>,
    /// Centre of each block, -1 to 1 in x and y.
    at: Vec<(f64, f64)>,
    /// First row and column of each block.
    corners: Vec<(usize, usize)>,
}

/// Legendre polynomials 0 to [`MAX_ORDER`] at x in [-1, 1].
fn legendre(x: f64) -> [f64; MAX_ORDER + 1] {
    let mut p = [1.0; MAX_ORDER + 1];
    p[1] = x;
    for n in 1..MAX_ORDER {
        let m = n as f64;
        p[n + 1] = ((2.0 * m + 1.0) * x * p[n] - m * p[n - 1]) / (m + 1.0);
    }
    p
}

/// Lists the products of total order up to `order`.
fn terms(order: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=order).flat_map(move |i| (0..=order - i).map(move |j| (i, j)))
}

impl<'a> Blocks<'a> {
    /// Creates the blocks that are at least half sound, or, without any, those with the largest sound share.
    fn new(sound: &'a Array2<bool>) -> Self {
        let shape = sound.dim();
        let (rows, columns) = shape;
        let (down, across) = (rows.div_ceil(BLOCK), columns.div_ceil(BLOCK));
        // Large frames have more blocks than 28 coefficients need: every `step`-th is used.
        let step = ((down * across) as f64 / MOST_BLOCKS).sqrt().ceil().max(1.0) as usize;
        let mut corners: Vec<_> = (0..down)
            .step_by(step)
            .flat_map(|y| (0..across).step_by(step).map(move |x| (y * BLOCK, x * BLOCK)))
            .collect();
        let share = |&(y, x): &(usize, usize)| {
            let block = sound.slice(ndarray::s![y..(y + BLOCK).min(rows), x..(x + BLOCK).min(columns)]);
            block.iter().filter(|s| **s).count() as f64 / block.len() as f64
        };
        let most = corners.iter().map(share).fold(0.0, f64::max);
        corners.retain(|c| share(c) >= most.min(0.5));
        let middle = |from: usize, n: usize| (from + (from + BLOCK).min(n)) as f64 / n as f64 - 1.0;
        let at = corners.iter().map(|&(y, x)| (middle(x, columns), middle(y, rows))).collect();
        Self { shape, sound, at, corners }
    }

    /// Computes the median of e / K in every block.
    fn medians(&self, e: &Array2<f32>, k: &Array2<f32>) -> Vec<f64> {
        let (rows, columns) = self.shape;
        let (mut values, mut sorted) = (Vec::new(), Vec::new());
        self.corners
            .iter()
            .map(|&(y, x)| {
                values.clear();
                for y in y..(y + BLOCK).min(rows) {
                    for x in (x..(x + BLOCK).min(columns)).filter(|x| self.sound[(y, *x)]) {
                        values.push(f64::from(e[(y, x)]) / f64::from(k[(y, x)]).max(1e-3));
                    }
                }
                median_of(&values, &mut sorted)
            })
            .collect()
    }

    /// Fits the surface without outlying blocks; returns its coefficients, and the robust deviation of all
    /// blocks.
    fn fit(&self, values: &[f64], order: usize) -> (Vec<f64>, f64) {
        let mut used = vec![true; values.len()];
        let mut sorted = Vec::new();
        let mut c = self.fit_to(values, &used, order);
        let mut scale = 0.0;
        for _ in 0..BLOCK_ROUNDS {
            let off: Vec<f64> =
                self.at.iter().zip(values).map(|(&at, v)| (v - value(&c, order, at)).abs()).collect();
            scale = median_of(&off, &mut sorted) / 0.6745;
            let near: Vec<bool> = off.iter().map(|o| *o <= MAX_BLOCK_DEVIATIONS * scale).collect();
            // A surface needs enough blocks for its terms.
            if near == used || near.iter().filter(|n| **n).count() < 2 * terms(order).count() {
                break;
            }
            used = near;
            c = self.fit_to(values, &used, order);
        }
        (c, scale)
    }

    /// Fits the least-squares surface, by Cholesky factorisation of the normal equations.
    fn fit_to(&self, values: &[f64], used: &[bool], order: usize) -> Vec<f64> {
        let n = terms(order).count();
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
        let mut row = Vec::with_capacity(n);
        for ((&(x, y), value), _) in self.at.iter().zip(values).zip(used).filter(|(_, used)| **used) {
            let (px, py) = (legendre(x), legendre(y));
            row.clear();
            row.extend(terms(order).map(|(i, j)| px[i] * py[j]));
            for i in 0..n {
                b[i] += row[i] * value;
                for j in 0..=i {
                    a[i * n + j] += row[i] * row[j];
                }
            }
        }
        // A small frame may have fewer blocks than terms: undetermined terms stay near 0.
        (0..n).for_each(|i| a[i * n + i] += 1e-9 * a[i * n + i] + 1e-12);
        match Factor::of(&a, n) {
            Some(factor) => factor.solve(&mut b),
            None => b.fill(0.0),
        }
        b
    }

    /// Selects the order common to all configurations: the smallest Bayesian information criterion (Schwarz
    /// 1978).
    fn order(&self, configurations: &[Array2<f32>], k: &Array2<f32>) -> usize {
        let medians: Vec<Vec<f64>> = configurations.par_iter().map(|e| self.medians(e, k)).collect();
        let n = self.at.len() as f64;
        let most = (0..=MAX_ORDER).take_while(|&o| 2 * terms(o).count() <= self.at.len()).last().unwrap_or(0);
        // Blocks that no surface follows have the same penalty for all orders.
        let scales: Vec<f64> = medians.iter().map(|values| self.fit(values, most).1).collect();
        let criterion = |order: usize| -> f64 {
            let parameters = terms(order).count() as f64;
            let of = |(values, scale): (&Vec<f64>, &f64)| {
                let (c, _) = self.fit(values, order);
                let limit = if *scale > 0.0 { MAX_BLOCK_DEVIATIONS * scale } else { f64::INFINITY };
                let off = |(&at, v): (&(f64, f64), &f64)| (v - value(&c, order, at)).abs().min(limit);
                let rss: f64 = self.at.iter().zip(values).map(|b| off(b).powi(2)).sum();
                n * (rss / n).max(f64::MIN_POSITIVE).ln() + parameters * n.ln()
            };
            medians.iter().zip(&scales).map(of).sum()
        };
        (0..=most).min_by(|&a, &b| criterion(a).total_cmp(&criterion(b))).unwrap_or(0)
    }

    /// Fits the surfaces of all configurations to the medians of e / K.
    fn surfaces(&self, configurations: &[Array2<f32>], k: &Array2<f32>, order: usize) -> Surfaces {
        let coefficients =
            configurations.par_iter().map(|e| self.fit(&self.medians(e, k), order).0).collect();
        let (rows, columns) = self.shape;
        let place = |i: usize, n: usize| (2 * i + 1) as f64 / n as f64 - 1.0;
        let table = |n: usize| {
            let mut table = vec![vec![0.0; n]; MAX_ORDER + 1];
            for i in 0..n {
                let p = legendre(place(i, n));
                table.iter_mut().zip(p).for_each(|(row, p)| row[i] = p);
            }
            table
        };
        let narrow = |table: Vec<Vec<f64>>| -> Vec<Vec<f32>> {
            table.into_iter().map(|row| row.into_iter().map(|p| p as f32).collect()).collect()
        };
        Surfaces { coefficients, order, of_x: narrow(table(columns)), of_y: table(rows) }
    }
}

/// Light of every configuration as polynomials.
struct Surfaces {
    coefficients: Vec<Vec<f64>>,
    order: usize,
    /// Legendre polynomials along the row and down the column.
    of_x: Vec<Vec<f32>>,
    of_y: Vec<Vec<f64>>,
}

impl Surfaces {
    /// Returns the coefficients of the polynomial in x that is left at row `y`.
    fn along(&self, i: usize, y: usize) -> [f64; MAX_ORDER + 1] {
        let mut of_x = [0.0; MAX_ORDER + 1];
        terms(self.order).zip(&self.coefficients[i]).for_each(|((a, b), c)| of_x[a] += c * self.of_y[b][y]);
        of_x
    }

    fn at(&self, i: usize, (y, x): (usize, usize)) -> f64 {
        self.along(i, y).iter().zip(&self.of_x).map(|(c, p)| c * f64::from(p[x])).sum::<f64>().max(1e-6)
    }
}

impl Light for Surfaces {
    fn sweep(&self, first_row: usize) -> impl FnMut(&mut [f32]) {
        let columns = self.of_x[0].len();
        let mut y = first_row;
        move |lights| {
            for (i, out) in lights.chunks_mut(columns).enumerate() {
                let c = self.along(i, y);
                out.fill(c[0] as f32);
                for (c, p) in c.iter().zip(&self.of_x).skip(1).take(self.order) {
                    let c = *c as f32;
                    out.iter_mut().zip(p).for_each(|(o, p)| *o += c * p);
                }
            }
            y += 1;
        }
    }
}

/// Evaluates a surface at one place.
fn value(c: &[f64], order: usize, (x, y): (f64, f64)) -> f64 {
    let (px, py) = (legendre(x), legendre(y));
    terms(order).zip(c).map(|((i, j), c)| c * px[i] * py[j]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::pattern::tests::{GRAIN, bench, chi2};
    use crate::calibrate::pattern::{Options, paper};
    use ndarray::Zip;

    /// 2 % spots, grain and a 10 % gradient: the residual deviation is at most 1.1 times the limit (grain
    /// over the root of n1), the stated errors hold within 5 %, edges included, and the windows do worse.
    #[test]
    fn k_is_found_to_the_limit_of_the_card() {
        let n1 = 20;
        let (images, truth) = bench(n1, 0.02, 0.10, (128, 144));
        let found = joint(&images).unwrap();
        let rms = |k: &Array2<f32>, part: &dyn Fn(usize, usize) -> bool| {
            let (mut sum, mut n) = (0.0, 0.0);
            Zip::indexed(k).and(&truth).for_each(|(y, x), &k, &t| {
                if part(y, x) {
                    sum += (f64::from(k) - t).powi(2);
                    n += 1.0;
                }
            });
            (sum / n).sqrt()
        };
        let limit = GRAIN / (n1 as f64).sqrt();
        let edge = |y: usize, x: usize| y < 4 || x < 4 || y >= 124 || x >= 140;
        assert!(rms(&found.k, &|_, _| true) < 1.1 * limit, "{} of {limit}", rms(&found.k, &|_, _| true));
        assert!(rms(&found.k, &edge) < 1.15 * limit, "edges: {} of {limit}", rms(&found.k, &edge));
        let c = chi2(&found, &truth);
        assert!((c - 1.0).abs() < 0.05, "chi-square per pixel {c}");
        let windows = paper(&images, Options::default()).unwrap();
        assert!(rms(&windows.k, &|_, _| true) > 1.2 * rms(&found.k, &|_, _| true));
    }

    /// One configuration: lamp and slope are removed, the card's grain stays in K.
    #[test]
    fn one_configuration_keeps_the_card() {
        let (images, truth) = bench(1, 0.0, 0.10, (128, 144));
        let found = smooth(&images, &[1.0]).unwrap();
        let off = Zip::from(&found.k).and(&truth).map_collect(|&k, &t| f64::from(k) - t);
        let rms = off.mapv(|x| x * x).mean().unwrap().sqrt();
        // 18,432 pixels: 3 % is more than five standard errors.
        assert!((rms / GRAIN - 1.0).abs() < 0.03, "{rms}");
        assert_eq!(smooth(&[], &[]).unwrap_err(), PatternError::TooFew(0));
    }

    #[test]
    fn small_and_even_frames_do_not_trouble_it() {
        for shape in [(1, 1), (3, 5), (9, 17)] {
            let images = vec![Array2::from_elem(shape, 100.0f32); 4];
            let found = joint(&images).unwrap();
            assert!(found.k.iter().all(|&k| (k - 1.0).abs() < 1e-4), "{shape:?}");
        }
    }
}
