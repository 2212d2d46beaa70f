//! Brighter-fatter: charge already in a pixel repels what arrives later.

use super::{
    Campaign, Drawing, Effect, Needs, Page, Parameter, Plain, Prediction, Seen, Stage, Together, shifted,
    takes,
};
use crate::predict::{HALF, angle};

/// Flow of arriving charge along the gradient of the charge so far.
pub struct BrighterFatter;

/// Number of steps in which the charge of a frame is drawn.
const STEPS: usize = 8;

/// Axis ratio above which the effect is contradicted; CCDs reach 3 (a named choice).
const ONE_SIDED: f64 = 4.0;
/// Margin of this ratio, in standard errors of each coefficient.
const SURE: f64 = 2.0;

impl Effect for BrighterFatter {
    fn id(&self) -> &'static str {
        "brighter-fatter"
    }

    fn stage(&self) -> Stage {
        Stage::Charge
    }

    fn parameters(&self) -> &'static [Parameter] {
        const STARTS: &[f64] = &[1e-6];
        &[
            Parameter {
                name: "a_vertical_per_e",
                meaning: "change of a pixel's area for one electron more in the neighbour above or below",
                unit: "1/e",
                min: 0.0,
                max: 1e-3,
                starts: STARTS,
            },
            Parameter {
                name: "a_horizontal_per_e",
                meaning: "the same for the neighbour to the left or right",
                unit: "1/e",
                min: 0.0,
                max: 1e-3,
                starts: STARTS,
            },
        ]
    }

    fn needs(&self) -> Needs {
        Needs::Variances
    }

    /// Returns starts with equal coefficients of both axes, and with one dominant axis. Growth with the
    /// square of the level is visible only from two levels of light on.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        if seen.lit_levels < 2 {
            return Vec::new();
        }
        vec![vec![1e-6, 1e-6], vec![1e-6, 1e-7], vec![1e-7, 1e-6]]
    }

    fn together(&self, p: &[f64]) -> Option<Together> {
        let name = "a_vertical_per_e + a_horizontal_per_e";
        let sum = p[0] + p[1];
        // The variance is mu (1 - 2 s mu + (2/3) r (2 s mu)^2) to second order, s the sum and r between 1
        // (far neighbours too) and 1.5 (one axis alone); two equal axes have 1.25. A uniform r between them
        // has the deviation 0.5 / root 12: s is off by 0.2 s^2 mu.
        Some(Together {
            name,
            unit: "1/e",
            value: sum,
            slopes: vec![1.0, 1.0],
            unsure_per_e: 0.2 * sum * sum,
        })
    }

    /// Charge pushes away field lines on all sides (Antilogus et al. 2014: along the rows and the columns of
    /// CCDs by factors of up to three).
    fn contradicted(&self, p: &[f64], std_err: &[f64], seen: &Seen) -> Option<&'static str> {
        if !seen.neighbours {
            return None;
        }
        let (less, more) = if p[0] < p[1] { (0, 1) } else { (1, 0) };
        (p[less] + SURE * std_err[less] < (p[more] - SURE * std_err[more]) / ONE_SIDED).then_some(
            "neighbours along one axis share it and those along the other do not, and charge pushes field lines on all sides",
        )
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.03 / plain.range_e, 0.022 / plain.range_e])
    }

    fn page(&self) -> Page {
        Page {
            what: "Charge collected in a pixel pushes the field lines of its neighbours: a bright pixel collects less of what \
                   follows, its neighbours more.",
            equation: "dq/dt = I (1 + a_v (q_up + q_down - 2 q) + a_h (q_left + q_right - 2 q)); in the Fourier domain \
                       P = (exp(2 g mu) - 1) / (2 g), g = -2 a_v (1 - cos k_y) - 2 a_h (1 - cos k_x)",
            signature: "variance falls below the line as -mu^2, covariance with the nearest neighbours grows as +mu^2, the mean \
                        stays linear",
            look_alikes: "nonlinearity bends the mean; crosstalk correlates neighbours in proportion to mu, not mu^2",
            remedy: "take the gain from the low end of the photon-transfer curve, or from eq. 16 of Astier et al.; correct images \
                     by the measured a",
            measure: "flats at many levels with their neighbour covariances: a table of means and variances alone cannot tell",
            sets: takes::PAIRS,
            source: "Antilogus et al. 2014, JINST 9 C03048; Astier et al. 2019, A&A 629, A36, eq. 16 and 20",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let (a_v, a_h) = (p[0], p[1]);
        let one = |i: usize| 1.0 - libm::cos(angle(i));
        let g: Vec<f64> =
            (0..HALF * HALF).map(|i| -2.0 * (a_v * one(i / HALF) + a_h * one(i % HALF))).collect();
        for s in &mut out.sets {
            let signal = s.signal.max(0.0);
            s.shot.shape_by(g.iter().map(|g| {
                let x = 2.0 * g * signal;
                if x.abs() < 1e-9 { 1.0 } else { libm::expm1(x) / x }
            }));
        }
    }

    /// Draws the charge of the frame in steps; in each, the charge present deflects the arriving charge.
    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let n = STEPS as f64;
        let columns = d.image.ncols();
        // Parts of a Poisson number are Poisson numbers that add up to it.
        let whole = d.image.clone();
        let mut parts: Vec<_> = (0..STEPS).map(|_| whole.mapv(|q| q / n)).collect();
        for ((y, x), &q) in whole.indexed_iter() {
            let mut rng = d.random(self.id(), d.frame, (y * columns + x) as u32);
            let noise: [f64; STEPS] = std::array::from_fn(|_| rng.normal());
            let mean = noise.iter().sum::<f64>() / n;
            let size = libm::sqrt(q.max(0.0) / n);
            parts.iter_mut().zip(noise).for_each(|(part, e)| part[(y, x)] += size * (e - mean));
        }
        let mut filled = ndarray::Array2::zeros(whole.raw_dim());
        for part in parts {
            let side = |dy, dx| shifted(&filled, dy, dx);
            let push = (side(1, 0) + side(-1, 0) - &filled * 2.0) * p[0]
                + (side(0, 1) + side(0, -1) - &filled * 2.0) * p[1];
            // `push` ignores the charge of the current step, half of which is present on average; n/(n-1)
            // corrects for it.
            filled = filled + &part + &whole * (1.0 / n) * push * (n / (n - 1.0));
        }
        d.image = filled;
    }
}
