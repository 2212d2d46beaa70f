//! K common to all configurations, the light of each a smooth surface: what the window of eq. (47) only approximates.
//!
//! e_i(a,b) = K(a,b) L_i(a,b) (1 + card grain), with L_i a polynomial surface whose order the data choose and K without a
//! smooth part of its own (a surface common to K and every L_i cannot be told apart by any number of configurations).
//! Surface and K are fitted in turn, both with Tukey's biweight (Beaton and Tukey 1974), so that spots of the card do
//! not matter. Against the window's mean, neighbours' spots and K's own mean over the window drop out of the error.

use super::pattern::{FixedPattern, PatternError, check};
use ndarray::{Array2, Zip};
use radcam_sim::rng::{PixelRng, Stream};
use rayon::prelude::*;

/// Largest order of a light surface.
const MAX_ORDER: usize = 6;
/// Side of the blocks whose medians the surfaces are fitted to, pixels.
const BLOCK: usize = 8;
/// Tukey's constant: 95 % efficiency for normal data.
const BIWEIGHT: f64 = 4.685;

/// K by the joint model. `configurations` are the e_i of eq. (46), DN, each (rows, columns).
///
/// The standard error is the scatter over the configurations; the surfaces' own errors are smaller by the root of the
/// pixels over the surface's terms.
pub fn joint(configurations: &[Array2<f32>]) -> Result<FixedPattern, PatternError> {
    check(configurations)?;
    let shape = configurations[0].dim();
    let blocks = Blocks::new(shape);
    let mut k = Array2::<f32>::ones(shape);
    let order = blocks.order(configurations, &k);
    let (mut pooled_sd, mut mean_before) = (0.0, 1.0);
    let mut kept = Array2::zeros(shape);
    // The first round's K takes the grain out of the second's surfaces; a third changes nothing that matters.
    for _ in 0..2 {
        let light: Vec<Array2<f32>> =
            configurations.par_iter().map(|e| blocks.surface(&blocks.medians(e, &k), order)).collect();
        (pooled_sd, kept, mean_before) = common(configurations, &light, &mut k);
    }
    let variance = efficiency(configurations.len());
    let n1 = configurations.len() as f64;
    let std_err = kept.mapv(|kept: u16| (pooled_sd * (variance * n1 / f64::from(kept.max(1))).sqrt()) as f32);
    Ok(FixedPattern { k, std_err, kept, pooled_sd, mean_before })
}

/// K where nothing was moved: the mean image over a smooth surface. What the card and the lamp have at a finer scale than
/// the surface is taken for the camera's: no frame can tell.
///
/// `noise` is (A, sigma_C^2) and `frames` their number in each image: the standard error holds the temporal noise alone.
pub fn smooth(
    images: &[Array2<f32>],
    noise: Option<(f64, f64)>,
    frames: u64,
) -> Result<FixedPattern, PatternError> {
    let Some(first) = images.first() else { return Err(PatternError::TooFew(0)) };
    super::pattern::check_images(images)?;
    let shape = first.dim();
    let blocks = Blocks::new(shape);
    let even = Array2::<f32>::ones(shape);
    let order = blocks.order(images, &even);
    let mut k = Array2::<f32>::zeros(shape);
    let mut level = 0.0;
    for e in images {
        let light = blocks.surface(&blocks.medians(e, &even), order);
        Zip::from(&mut k).and(e).and(&light).for_each(|k, &e, &l| *k += e / l.max(1e-6));
        level += light.mean().map_or(0.0, f64::from) / images.len() as f64;
    }
    let mean = k.iter().map(|&k| f64::from(k)).sum::<f64>() / k.len() as f64;
    k.mapv_inplace(|k| (f64::from(k) / mean) as f32);
    let (gain, constant) = noise.unwrap_or((0.0, 1.0 / 12.0));
    let samples = (frames.max(1) * images.len() as u64) as f64;
    let error = ((gain * level + constant) / samples).sqrt() / level;
    Ok(FixedPattern {
        std_err: Array2::from_elem(shape, error as f32),
        kept: Array2::from_elem(shape, images.len() as u16),
        pooled_sd: error * (images.len() as f64).sqrt(),
        mean_before: mean,
        k,
    })
}

/// K as the robust mean of e_i / L_i at every pixel, mean 1; returns the pooled deviation, the points with weight and the
/// mean before it was brought to 1.
fn common(
    configurations: &[Array2<f32>],
    light: &[Array2<f32>],
    k: &mut Array2<f32>,
) -> (f64, Array2<u16>, f64) {
    let (rows, columns) = k.dim();
    let n1 = configurations.len();
    let slopes = |at: (usize, usize), m: &mut Vec<f64>| {
        m.clear();
        m.extend(
            configurations.iter().zip(light).map(|(e, l)| f64::from(e[at]) / f64::from(l[at]).max(1e-6)),
        );
    };
    let s = super::pattern::pooled_deviation((rows, columns), n1, slopes);
    let mut kept = Array2::zeros((rows, columns));
    let bands = k.as_slice_mut().unwrap_or_default().par_chunks_mut(columns);
    let counts = kept.as_slice_mut().unwrap_or_default().par_chunks_mut(columns);
    bands.zip(counts).enumerate().for_each(|(y, (k, kept))| {
        let (mut m, mut sorted) = (Vec::with_capacity(n1), Vec::with_capacity(n1));
        for (x, (k, kept)) in k.iter_mut().zip(kept).enumerate() {
            slopes((y, x), &mut m);
            let (location, points) = biweight(&m, &mut sorted, s);
            *k = location as f32;
            *kept = points;
        }
    });
    let mean = k.iter().map(|&k| f64::from(k)).sum::<f64>() / k.len() as f64;
    k.mapv_inplace(|k| (f64::from(k) / mean) as f32);
    (s, kept, mean)
}

/// Tukey's biweight location with a known scale, from the median; and the number of points with weight.
fn biweight(m: &[f64], sorted: &mut Vec<f64>, s: f64) -> (f64, u16) {
    let mut middle = super::pattern::median(m, sorted);
    let reach = BIWEIGHT * s;
    let mut points = 0;
    for _ in 0..4 {
        let (mut sum, mut weights) = (0.0, 0.0);
        points = 0;
        for &x in m {
            let u = (x - middle) / reach;
            if u.abs() < 1.0 {
                let w = (1.0 - u * u).powi(2);
                sum += w * x;
                weights += w;
                points += 1;
            }
        }
        if weights <= 0.0 {
            break;
        }
        middle = sum / weights;
    }
    (middle, points)
}

/// Variance of [`biweight`] for standard normal points, by running it.
fn efficiency(n1: usize) -> f64 {
    const RUNS: u32 = 4000;
    let mut sorted = Vec::with_capacity(n1);
    let square: f64 = (0..RUNS)
        .map(|run| {
            let m: Vec<f64> =
                (0..n1).map(|i| PixelRng::new(0x51, Stream::Frame, i as u64, run, 0).normal()).collect();
            biweight(&m, &mut sorted, 1.0).0.powi(2)
        })
        .sum();
    square / f64::from(RUNS)
}

/// The frame in blocks, and polynomial surfaces over it.
struct Blocks {
    shape: (usize, usize),
    /// Middle of each block, -1 to 1 in x and y.
    at: Vec<(f64, f64)>,
    across: usize,
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

/// Products of total order up to `order`.
fn terms(order: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..=order).flat_map(move |i| (0..=order - i).map(move |j| (i, j)))
}

impl Blocks {
    fn new(shape: (usize, usize)) -> Self {
        let (rows, columns) = shape;
        let across = columns.div_ceil(BLOCK);
        let middle = |i: usize, n: usize| {
            let (from, to) = (i * BLOCK, ((i + 1) * BLOCK).min(n));
            (from + to) as f64 / n as f64 - 1.0
        };
        let at = (0..rows.div_ceil(BLOCK))
            .flat_map(|y| (0..across).map(move |x| (middle(x, columns), middle(y, rows))))
            .collect();
        Self { shape, at, across }
    }

    /// Median of e / K in every block.
    fn medians(&self, e: &Array2<f32>, k: &Array2<f32>) -> Vec<f64> {
        let (rows, columns) = self.shape;
        let (mut values, mut sorted) = (Vec::new(), Vec::new());
        (0..self.at.len())
            .map(|block| {
                let (y, x) = (block / self.across * BLOCK, block % self.across * BLOCK);
                values.clear();
                for y in y..(y + BLOCK).min(rows) {
                    for x in x..(x + BLOCK).min(columns) {
                        values.push(f64::from(e[(y, x)]) / f64::from(k[(y, x)]).max(1e-3));
                    }
                }
                super::pattern::median(&values, &mut sorted)
            })
            .collect()
    }

    /// Coefficients of the least-squares surface, by Cholesky's factorisation of the normal equations.
    fn fit(&self, values: &[f64], order: usize) -> Vec<f64> {
        let n = terms(order).count();
        let (mut a, mut b) = (vec![0.0; n * n], vec![0.0; n]);
        let mut row = Vec::with_capacity(n);
        for (&(x, y), value) in self.at.iter().zip(values) {
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
        for i in 0..n {
            for j in 0..=i {
                let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
                let rest = a[i * n + j] - dot;
                // More terms than a small frame has blocks: the term is left out.
                a[i * n + j] = if i == j { rest.max(0.0).sqrt() } else { rest / a[j * n + j].max(1e-9) };
            }
        }
        for i in 0..n {
            let dot: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
            b[i] = if a[i * n + i] > 1e-6 { (b[i] - dot) / a[i * n + i] } else { 0.0 };
        }
        for i in (0..n).rev() {
            let dot: f64 = (i + 1..n).map(|k| a[k * n + i] * b[k]).sum();
            b[i] = if a[i * n + i] > 1e-6 { (b[i] - dot) / a[i * n + i] } else { 0.0 };
        }
        b
    }

    /// The order that the configurations ask for together: the smallest Bayesian information criterion (Schwarz 1978).
    fn order(&self, configurations: &[Array2<f32>], k: &Array2<f32>) -> usize {
        let medians: Vec<Vec<f64>> = configurations.par_iter().map(|e| self.medians(e, k)).collect();
        let n = self.at.len() as f64;
        let most = (0..=MAX_ORDER).take_while(|&o| 2 * terms(o).count() <= self.at.len()).last().unwrap_or(0);
        let criterion = |order: usize| -> f64 {
            let parameters = terms(order).count() as f64;
            medians
                .iter()
                .map(|values| {
                    let c = self.fit(values, order);
                    let rss: f64 =
                        self.at.iter().zip(values).map(|(&at, v)| (v - value(&c, order, at)).powi(2)).sum();
                    n * (rss / n).max(f64::MIN_POSITIVE).ln() + parameters * n.ln()
                })
                .sum()
        };
        (0..=most).min_by(|&a, &b| criterion(a).total_cmp(&criterion(b))).unwrap_or(0)
    }

    /// The surface through block values, at every pixel.
    fn surface(&self, values: &[f64], order: usize) -> Array2<f32> {
        let (rows, columns) = self.shape;
        let c = self.fit(values, order);
        let place = |i: usize, n: usize| (2 * i + 1) as f64 / n as f64 - 1.0;
        let mut out = Array2::zeros(self.shape);
        // Of each row a polynomial in x is left, by Legendre's coefficients.
        let along: Vec<_> = (0..columns).map(|x| legendre(place(x, columns))).collect();
        for (y, mut row) in out.outer_iter_mut().enumerate() {
            let py = legendre(place(y, rows));
            let mut of_x = [0.0; MAX_ORDER + 1];
            terms(order).zip(&c).for_each(|((i, j), c)| of_x[i] += c * py[j]);
            Zip::from(&mut row).and(&ndarray::ArrayView1::from(&along)).for_each(|out: &mut f32, px| {
                *out = px.iter().zip(&of_x).map(|(p, c)| p * c).sum::<f64>() as f32;
            });
        }
        out
    }
}

/// A surface at one place.
fn value(c: &[f64], order: usize, (x, y): (f64, f64)) -> f64 {
    let (px, py) = (legendre(x), legendre(y));
    terms(order).zip(c).map(|((i, j), c)| c * px[i] * py[j]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::pattern::tests::{GRAIN, bench, chi2};
    use crate::calibrate::pattern::{Options, paper};

    /// 2 % spots, grain and a 10 % gradient: the residual deviation is at most 1.1 times the limit (grain over the root of
    /// n1), the stated errors are true within 5 %, edges included, and the windows do worse.
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

    /// One configuration: lamp and slope are taken off, the card's grain stays in K.
    #[test]
    fn one_configuration_keeps_the_card() {
        let (images, truth) = bench(1, 0.0, 0.10, (128, 144));
        let found = smooth(&images, None, 20).unwrap();
        let off = Zip::from(&found.k).and(&truth).map_collect(|&k, &t| f64::from(k) - t);
        let rms = off.mapv(|x| x * x).mean().unwrap().sqrt();
        // 18,432 pixels: 3 % is more than five standard errors.
        assert!((rms / GRAIN - 1.0).abs() < 0.03, "{rms}");
        assert_eq!(smooth(&[], None, 1).unwrap_err(), PatternError::TooFew(0));
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
