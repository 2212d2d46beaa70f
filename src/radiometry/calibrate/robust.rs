//! Robust location of a few values at every pixel, many pixels at a time.
//!
//! The values of 16 neighbouring pixels lie side by side, so that comparisons and sums are vector operations.
//! Medians come from a sorting network (Batcher's odd-even merge, Knuth, "The Art of Computer Programming",
//! vol. 3, algorithm 5.2.2M), which takes the same steps for every pixel.

use ndarray::Array2;
use radcam_sim::rng::{PixelRng, Stream};
use rayon::prelude::*;

/// Start of the search for outliers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Start {
    /// Median over the configurations.
    #[default]
    Median,
    /// Mean over the configurations, as in the paper (eq. 48).
    Mean,
}

/// Pixels per vector.
const LANES: usize = 16;
type Lane = [f32; LANES];

/// Tukey's constant: 95 % efficiency for normal data.
const BIWEIGHT: f32 = 4.685;
/// Iterations of the biweight, from the median.
const ROUNDS: usize = 4;

/// Light of all configurations.
pub(super) trait Light: Sync {
    /// Returns a function that walks down the frame from a row on. Each call writes the next row of every
    /// configuration, one after the other, DN.
    fn sweep(&self, first_row: usize) -> impl FnMut(&mut [f32]);
}

/// Rows per work item of a thread.
const BAND: usize = 64;

/// Location estimator that combines the slopes of a pixel into K.
#[derive(Debug, Clone, Copy)]
pub(super) enum Location {
    /// Sum of e over sum of light where the slope lies within `reach` of the start (eq. 49 and 50).
    Kept { reach: f32, start: Start },
    /// Tukey's biweight of the slopes with a known scale, from the median.
    Biweight { scale: f32 },
}

/// Comparisons that sort n values.
struct Network(Vec<(usize, usize)>);

impl Network {
    fn new(n: usize) -> Self {
        let mut pairs = Vec::new();
        let top = n.next_power_of_two() / 2;
        let mut p = top;
        while p > 0 {
            let (mut q, mut r, mut d) = (top, 0, p);
            loop {
                pairs.extend((0..n.saturating_sub(d)).filter(|i| i & p == r).map(|i| (i, i + d)));
                if q == p {
                    break;
                }
                (d, q, r) = (q - p, q / 2, p);
            }
            p /= 2;
        }
        Self(pairs)
    }

    #[inline(always)]
    fn median(&self, m: &[Lane], sorted: &mut [Lane]) -> Lane {
        sorted.copy_from_slice(m);
        for &(i, j) in &self.0 {
            let (a, b) = (sorted[i], sorted[j]);
            for l in 0..LANES {
                sorted[i][l] = if a[l] < b[l] { a[l] } else { b[l] };
                sorted[j][l] = if a[l] < b[l] { b[l] } else { a[l] };
            }
        }
        let (low, high) = (sorted[(m.len() - 1) / 2], sorted[m.len() / 2]);
        let mut out = [0.0; LANES];
        for l in 0..LANES {
            out[l] = 0.5 * (low[l] + high[l]);
        }
        out
    }
}

/// Work item: the pixels of one row.
struct Row<'a> {
    network: &'a Network,
    location: Location,
    /// e of each configuration.
    e: &'a [&'a [f32]],
    /// Light of each configuration.
    light: &'a [f32],
    k: &'a mut [f32],
    kept: &'a mut [u16],
}

impl pulp::NullaryFnOnce for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (n1, columns) = (self.e.len(), self.k.len());
        let mut values = vec![[0.0f32; LANES]; 4 * n1];
        let (e, rest) = values.split_at_mut(n1);
        let (light, rest) = rest.split_at_mut(n1);
        let (m, sorted) = rest.split_at_mut(n1);
        for from in (0..columns).step_by(LANES) {
            let width = LANES.min(columns - from);
            for i in 0..n1 {
                // Pads with harmless numbers past the end of the row.
                (e[i], light[i]) = ([1.0; LANES], [1.0; LANES]);
                e[i][..width].copy_from_slice(&self.e[i][from..from + width]);
                light[i][..width].copy_from_slice(&self.light[i * columns + from..][..width]);
                for l in 0..LANES {
                    let below = if light[i][l] > 1e-6 { light[i][l] } else { 1e-6 };
                    light[i][l] = below;
                    m[i][l] = e[i][l] / below;
                }
            }
            let (k, kept) = locate(self.network, self.location, e, light, m, sorted);
            self.k[from..from + width].copy_from_slice(&k[..width]);
            for (out, kept) in self.kept[from..from + width].iter_mut().zip(kept) {
                *out = kept as u16;
            }
        }
    }
}

/// Computes K and the number of points with weight, for 16 pixels.
#[inline(always)]
#[allow(clippy::needless_range_loop)] // lanes are indexed: the shape that vectorises
fn locate(
    network: &Network,
    location: Location,
    e: &[Lane],
    light: &[Lane],
    m: &[Lane],
    sorted: &mut [Lane],
) -> (Lane, Lane) {
    let mut middle = network.median(m, sorted);
    let mut points = [0.0; LANES];
    match location {
        Location::Kept { reach, start } => {
            if start == Start::Mean {
                middle = [0.0; LANES];
                for value in m {
                    for l in 0..LANES {
                        middle[l] += value[l] / m.len() as f32;
                    }
                }
            }
            let (mut sum_e, mut sum_light) = ([0.0; LANES], [0.0; LANES]);
            for i in 0..m.len() {
                for l in 0..LANES {
                    let near = if (m[i][l] - middle[l]).abs() <= reach { 1.0 } else { 0.0 };
                    sum_e[l] += near * e[i][l];
                    sum_light[l] += near * light[i][l];
                    points[l] += near;
                }
            }
            for l in 0..LANES {
                // Nothing kept: K is the start, and the count is 0.
                middle[l] = if points[l] > 0.0 { sum_e[l] / sum_light[l] } else { middle[l] };
            }
        }
        Location::Biweight { scale } => {
            let per_reach = 1.0 / (BIWEIGHT * scale).max(f32::MIN_POSITIVE);
            for _ in 0..ROUNDS {
                let (mut sum, mut weights) = ([0.0; LANES], [0.0; LANES]);
                points = [0.0; LANES];
                for value in m {
                    for l in 0..LANES {
                        let off = value[l] - middle[l];
                        let u = off * per_reach;
                        let inside = 1.0 - u * u;
                        let w = if inside > 0.0 { inside * inside } else { 0.0 };
                        sum[l] += w * off;
                        weights[l] += w;
                        // 1 for any weight, without the masked store of a condition.
                        let counts = w * 1e30;
                        points[l] += if counts < 1.0 { counts } else { 1.0 };
                    }
                }
                for l in 0..LANES {
                    middle[l] += if weights[l] > 0.0 { sum[l] / weights[l] } else { 0.0 };
                }
            }
        }
    }
    (middle, points)
}

/// Estimates K at every pixel; returns the number of points with weight there.
pub(super) fn estimate(
    configurations: &[Array2<f32>],
    light: &impl Light,
    location: Location,
    k: &mut Array2<f32>,
) -> Array2<u16> {
    let n1 = configurations.len();
    let columns = k.ncols();
    let mut kept = Array2::zeros(k.dim());
    if columns == 0 || n1 == 0 {
        return kept;
    }
    let network = Network::new(n1);
    let standard: Vec<_> = configurations.iter().map(|e| e.as_standard_layout()).collect();
    let all: Vec<&[f32]> = standard.iter().filter_map(|e| e.as_slice()).collect();
    let arch = pulp::Arch::new();
    let bands = k.as_slice_mut().unwrap_or_default().par_chunks_mut(BAND * columns);
    let counts = kept.as_slice_mut().unwrap_or_default().par_chunks_mut(BAND * columns);
    bands.zip(counts).enumerate().for_each(|(band, (k, kept))| {
        let mut sweep = light.sweep(band * BAND);
        let mut lights = vec![0.0f32; n1 * columns];
        let rows = k.chunks_mut(columns).zip(kept.chunks_mut(columns));
        for (y, (k, kept)) in rows.enumerate() {
            let at = (band * BAND + y) * columns;
            sweep(&mut lights);
            let e: Vec<&[f32]> = all.iter().map(|e| &e[at..at + columns]).collect();
            arch.dispatch(Row { network: &network, location, e: &e, light: &lights, k, kept });
        }
    });
    kept
}

/// Simulates an estimator of scale 1 for standard normal slopes; returns its variance and the mean number of
/// points with weight.
pub(super) fn efficiency(n1: usize, location: Location) -> (f64, f64) {
    const BLOCKS: u32 = 250;
    let network = Network::new(n1);
    let ones = vec![[1.0; LANES]; n1];
    let mut sorted = ones.clone();
    let (mut square, mut points) = (0.0, 0.0);
    for block in 0..BLOCKS {
        let m: Vec<Lane> = (0..n1)
            .map(|i| {
                std::array::from_fn(|l| {
                    let run = block * LANES as u32 + l as u32;
                    PixelRng::new(0x51, Stream::Frame, i as u64, run, 0).normal() as f32
                })
            })
            .collect();
        let (k, kept) = locate(&network, location, &m, &ones, &m, &mut sorted);
        for l in 0..LANES {
            square += if kept[l] > 0.0 { f64::from(k[l]).powi(2) } else { 0.0 };
            points += f64::from(kept[l]);
        }
    }
    let runs = f64::from(BLOCKS) * LANES as f64;
    (square / runs, points / runs)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_network_sorts_any_number_of_values() {
        for n in 1..40 {
            let network = Network::new(n);
            for seed in 0..20u32 {
                let values: Vec<f32> = (0..n as u32)
                    .map(|i| PixelRng::new(7, Stream::Frame, 0, i, seed).normal() as f32)
                    .collect();
                let lanes: Vec<Lane> = values.iter().map(|v| [*v; LANES]).collect();
                let mut sorted = lanes.clone();
                let median = network.median(&lanes, &mut sorted)[3];
                let wide: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
                let expected = crate::statistics::median::median_of(&wide, &mut Vec::new());
                assert!((f64::from(median) - expected).abs() < 1e-6, "{n}");
                assert!(sorted.windows(2).all(|w| w[0][0] <= w[1][0]));
            }
        }
    }

    /// Without outliers the biweight loses 5 % to the mean at many points; keeping points within 1.5
    /// deviations loses more.
    #[test]
    fn efficiencies_are_the_known_ones() {
        let (biweight, _) = efficiency(50, Location::Biweight { scale: 1.0 });
        // 4000 runs: four standard errors of a variance are 9 %.
        assert!((biweight * 50.0 * 0.95 - 1.0).abs() < 0.09, "{biweight}");
        let (_, kept) = efficiency(50, Location::Kept { reach: 1.5, start: Start::Median });
        assert!((kept / 50.0 - 0.866).abs() < 0.01, "{kept}");
    }
}
