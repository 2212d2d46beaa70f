//! Power spectrum of the noise in read-out order.

use super::layout::Layout;
use super::lines::Lines;
use rustfft::num_complex::Complex;
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Maximum number of pixels analysed, from the first row on.
const LONGEST: usize = 1 << 16;

/// Power of the deviations after subtraction of row and column means: noise of whole lines is no spectral
/// line.
pub struct Power {
    length: usize,
    power: Vec<f64>,
    fft: Arc<dyn Fft<f32>>,
    /// Two frames per transform: one in the real part, one in the imaginary part.
    pair: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
    half: bool,
    window: Vec<f32>,
}

impl std::fmt::Debug for Power {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Power({} pixels)", self.length)
    }
}

impl Power {
    /// Number of pixels in read-out order used of a frame of (rows, columns).
    pub fn length(shape: (usize, usize)) -> usize {
        (shape.0 * shape.1).min(LONGEST)
    }

    /// Creates an accumulator for frames of (rows, columns).
    pub fn new(shape: (usize, usize)) -> Self {
        let length = Self::length(shape);
        let fft = FftPlanner::new().plan_fft_forward(length);
        // Hann's window keeps a line within a few bins; its mean square is 3/8.
        let turn = std::f32::consts::TAU / length as f32;
        Self {
            length,
            power: vec![0.0; length / 2 + 1],
            pair: vec![Complex::default(); length],
            scratch: vec![Complex::default(); fft.get_inplace_scratch_len()],
            half: false,
            window: (0..length).map(|n| 0.5 - 0.5 * (turn * n as f32).cos()).collect(),
            fft,
        }
    }

    fn flush(&mut self) {
        if !std::mem::take(&mut self.half) {
            return;
        }
        self.fft.process_with_scratch(&mut self.pair, &mut self.scratch);
        let n = self.length;
        let scale = 1.0 / (0.375 * n as f64);
        for (k, p) in self.power.iter_mut().enumerate() {
            // Sum of the powers of real and imaginary part: (|F_k|^2 + |F_-k|^2) / 2.
            let both = self.pair[k].norm_sqr() + self.pair[(n - k) % n].norm_sqr();
            *p += 0.5 * scale * f64::from(both);
        }
        self.pair.fill(Complex::default());
    }

    /// Discards all frames.
    pub fn clear(&mut self) {
        self.power.fill(0.0);
        self.pair.fill(Complex::default());
        self.half = false;
    }

    /// Summed power at each frequency k / length cycles per pixel, DN^2: for white noise, variance times
    /// degrees of freedom.
    pub fn finish(&mut self) -> Vec<f64> {
        self.flush();
        self.power.clone()
    }

    /// Adds an image of deviations with known line means: a sum of products, like
    /// [`super::quadratic::Quadratic`].
    pub fn add(&mut self, image: &[f32], lines: &Lines, layout: &Layout) {
        let columns = layout.columns();
        let rows = self.length.div_ceil(columns);
        let row_means = lines.row_means();
        // The row means already contain the frame's mean.
        let whole = row_means.iter().sum::<f32>() / row_means.len() as f32;
        let off: Vec<f32> = lines.column_means(layout).map(|m| m - whole).collect();
        for (y, row_mean) in row_means.iter().enumerate().take(rows) {
            let from = y * columns;
            let to = (from + columns).min(self.length);
            let row = image[from..to].iter().zip(&off).zip(&layout.mask[from..to]);
            let places = self.pair[from..to].iter_mut().zip(&self.window[from..to]);
            for ((out, window), ((v, off), used)) in places.zip(row) {
                let value = (v - (row_mean + off) * used) * window;
                if self.half { out.im = value } else { out.re = value }
            }
        }
        if self.half {
            self.flush();
        } else {
            self.half = true;
        }
    }

    /// Merges the sums of another.
    pub fn absorb(&mut self, other: &Self) {
        self.power.iter_mut().zip(&other.power).for_each(|(a, b)| *a += b);
        if other.half {
            // A pending frame is transformed alone.
            let mut waiting = other.pair.clone();
            self.fft.process(&mut waiting);
            let scale = 1.0 / (0.375 * self.length as f64);
            self.power.iter_mut().zip(&waiting).for_each(|(p, v)| *p += scale * f64::from(v.norm_sqr()));
        }
    }
}
