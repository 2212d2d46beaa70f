//! Spectrum of the row means: frequencies at which light ripples down the rows. Its peaks are the starts of a
//! search; the strongest of the campaign is an observable ([`line_peak`]).

use super::line_peak::{self, Axis};
use super::{Expected, HalfView, Observable, Put, Statistic, View};
use crate::statistics::layout::Layout;
use crate::statistics::lines::Lines;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::cell::RefCell;
use std::sync::Arc;

/// Power of the row means of the deviations at frequencies in steps of a quarter of a cycle over all rows.
#[derive(Debug)]
pub struct RowSpectrum;

/// Factor of zero padding of the rows: a peak lies within an eighth of a cycle of a bin.
pub(super) const PADDED: usize = 4;
/// Minimum number of rows to tell bands from a slope.
const FEWEST: usize = 16;
/// Maximum number of peaks used as starts.
const PEAKS: usize = 3;
/// Minimum power of a peak over the median of all (a named choice: of the sum over some thirty frames one
/// chance peak in a hundred spectra). The strongest peak starts a search from half as much: a chance peak
/// costs time, and no fit keeps it.
const STANDS_OUT: f64 = 3.0;

/// Fourier transform of one length, with its buffer.
pub(super) type Plan = (usize, Arc<dyn Fft<f32>>, Vec<Complex<f32>>);

thread_local! {
    static ROWS: RefCell<Option<Plan>> = const { RefCell::new(None) };
}

/// Returns the number of spectrum sums of a frame of this many lines.
pub(super) fn count(lines: usize) -> usize {
    if lines < FEWEST { 0 } else { PADDED * lines / 2 + 1 }
}

/// Adds the power of the means of lines to the sums. `plan`: kept from frame to frame.
pub(super) fn add_power(
    plan: &mut Option<Plan>,
    lines: usize,
    means: impl Iterator<Item = f32>,
    sums: &mut [f64],
) {
    let length = PADDED * lines;
    if plan.as_ref().is_none_or(|p| p.0 != length) {
        *plan = Some((length, FftPlanner::new().plan_fft_forward(length), vec![Complex::default(); length]));
    }
    let Some((_, fft, buffer)) = plan else { return };
    buffer.fill(Complex::default());
    buffer.iter_mut().zip(means).for_each(|(b, m)| b.re = m);
    fft.process(buffer);
    sums.iter_mut().zip(buffer).for_each(|(sum, v)| *sum += f64::from(v.norm_sqr()));
}

impl Statistic for RowSpectrum {
    fn id(&self) -> &'static str {
        "spectrum of row means"
    }

    fn name(&self, index: usize) -> String {
        line_peak::name("row", index)
    }

    fn meaning(&self, _: usize) -> &'static str {
        "a ripple down the rows"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        half.put_peak(Axis::Rows, put);
    }

    fn sums(&self, layout: &Layout) -> usize {
        count(layout.shape.0)
    }

    fn add(&self, _: &[f32], lines: &Lines, _: &Layout, sums: &mut [f64]) {
        let rows = lines.row_means();
        ROWS.with_borrow_mut(|plan| add_power(plan, rows.len(), rows.iter().copied(), sums));
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        view.peak(Axis::Rows, o)
    }
}

/// Returns the frequencies of the strongest peaks of a spectrum, cycles per line, the strongest first.
/// `rows`: number of lines.
pub fn peaks(power: &[f64], rows: usize) -> Vec<f64> {
    let usual = crate::statistics::median::median(power.iter().copied());
    // Below half a cycle over all rows there is no peak.
    let first = (PADDED / 2).max(1);
    let mut found: Vec<usize> = (first..power.len().saturating_sub(1))
        .filter(|&k| {
            power[k] >= power[k - 1] && power[k] > power[k + 1] && power[k] > 0.5 * STANDS_OUT * usual
        })
        .collect();
    found.sort_by(|&a, &b| power[b].total_cmp(&power[a]));
    let strong = found.iter().filter(|&&k| power[k] > STANDS_OUT * usual).count();
    found
        .into_iter()
        .take(strong.clamp(1, PEAKS))
        .map(|k| refined(power, k) / (PADDED * rows) as f64)
        .collect()
}

/// Returns the place of a peak between bins, by a parabola through the logarithms.
pub(super) fn refined(power: &[f64], k: usize) -> f64 {
    let [a, b, c] = [k - 1, k, k + 1].map(|k| power[k].max(1e-300).ln());
    let bend = a - 2.0 * b + c;
    k as f64 + if bend < 0.0 { (0.5 * (a - c) / bend).clamp(-0.5, 0.5) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    /// A sine of another phase in each frame is found within a tenth of a cycle over all rows.
    #[test]
    fn the_frequency_of_a_ripple_is_found() {
        let rows = 96usize;
        let layout = Layout::new(&Array2::from_elem((rows, 16), true), 4095);
        for cycles in [0.0121, 0.02895, 0.05, 0.12, 0.37] {
            let mut sums = vec![0.0; RowSpectrum.sums(&layout)];
            for f in 0..12 {
                let mut lines = Lines::new((rows, 16));
                let phase = 2.4 * f64::from(f);
                let image: Vec<f32> = (0..rows * 16)
                    .map(|i| (std::f64::consts::TAU * cycles * (i / 16) as f64 + phase).sin() as f32)
                    .collect();
                for y in 0..rows {
                    crate::statistics::quadratic::Quadratic::row(&mut lines, y, &image, &layout);
                }
                RowSpectrum.add(&image, &lines, &layout, &mut sums);
            }
            let found = peaks(&sums, rows);
            assert!((found[0] - cycles).abs() * 96.0 < 0.1, "{cycles}: {found:?}");
        }
    }
}
