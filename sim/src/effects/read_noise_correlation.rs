//! Read-noise correlation: a pixel's read noise recurs in the next pixels of its row.

use super::{Campaign, Drawing, Effect, Page, Parameter, Plain, Prediction, Seen, Stage, takes};
use crate::predict::angle;

/// Normal noise of single pixels, each value added to its own pixel and, with the same or the opposite sign,
/// to the next of the row; or noise that decays along the row.
pub struct ReadNoiseCorrelation;

/// Index of the parameter `next_pixel`.
const NEXT: usize = 2;

fn sign(p: &[f64]) -> f64 {
    if p[0] >= 0.5 { 1.0 } else { -1.0 }
}

/// Returns true for noise that decays from pixel to pixel.
fn decays(p: &[f64]) -> bool {
    p[0] >= 1.5
}

impl Effect for ReadNoiseCorrelation {
    fn id(&self) -> &'static str {
        "read-noise-correlation"
    }

    fn stage(&self) -> Stage {
        Stage::Read
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter {
                name: "shape",
                meaning: "0: neighbours with opposite sign, 1: with equal sign, 2: dies away along the row",
                unit: "choice",
                min: 0.0,
                max: 2.0,
                starts: &[0.0, 1.0, 2.0],
            },
            Parameter {
                name: "e",
                meaning: "standard deviation of the noise that neighbours share",
                unit: "e",
                min: 0.0,
                max: 1e4,
                starts: &[1.0, 1.0],
            },
            Parameter {
                name: "next_pixel",
                meaning: "shape 2: correlation from pixel to pixel of that noise",
                unit: "1",
                min: -0.95,
                max: 0.95,
                starts: &[0.3, -0.3],
            },
        ]
    }

    fn uses(&self, p: &[f64], parameter: usize) -> bool {
        parameter != NEXT || decays(p)
    }

    fn form(&self, p: &[f64]) -> Option<&'static str> {
        Some(match (decays(p), sign(p) > 0.0) {
            (true, _) => "it dies away along the row",
            (_, true) => "with the same sign",
            _ => "with the opposite sign",
        })
    }

    /// Returns starts of a size as that of the dark noise: all of it may be shared.
    fn starts(&self, seen: &Seen) -> Vec<Vec<f64>> {
        let noise_e = (seen.dark_noise_dn * seen.peak_e / seen.peak_dn.max(1e-9)).max(1.0);
        let of = |(shape, share, next): (f64, f64, f64)| vec![shape, share * noise_e, next];
        [(0.0, 0.3, 0.3), (1.0, 0.3, 0.3), (2.0, 0.7, 0.3), (2.0, 0.7, 0.7), (2.0, 0.3, -0.3)]
            .map(of)
            .to_vec()
    }

    /// Returns the covariance of row neighbours: for read noise it is the same at every light level.
    fn told_by(&self) -> &'static [&'static str] {
        &["covariance (0,1)"]
    }

    fn example(&self, plain: &Plain) -> Option<Vec<f64>> {
        Some(vec![0.0, 0.4 * plain.noise_e, 0.0])
    }

    fn page(&self) -> Page {
        Page {
            what: "Correlated double sampling or an AC-coupled amplifier carries noise from one pixel of a row to the next.",
            equation: "v(n) + e (N(n) -+ N(n - 1)), n the pixel's place in its row; variance + 2 e^2, covariance with the next -+ e^2; or v(n) + e W(n), \
                       W(n) = r W(n - 1) + (1 - r^2)^(1/2) N(n), r next_pixel: covariance e^2 r^k over k pixels",
            signature: "neighbours along a row are correlated by the same amount at every level, darks too; nothing along the columns",
            look_alikes: "a low-pass of the video signal correlates shot noise as well, in proportion to the variance",
            remedy: "a longer time constant of the coupling, a faster clamp; a slower pixel clock",
            measure: "a run of darks: the covariance of neighbours along the rows",
            sets: takes::DARKS,
            source: "Janesick 2001, ch. 6 (correlated double sampling and its noise); Box and Jenkins 1976, 3.2.3 (autoregression)",
        }
    }

    fn predict(&self, p: &[f64], _: &Campaign, out: &mut Prediction) {
        let (sign, square) = (sign(p), p[1] * p[1]);
        if decays(p) {
            let r = p[NEXT];
            let of = |i: usize| square * (1.0 - r * r) / (1.0 + r * r - 2.0 * r * libm::cos(angle(i)));
            let power = std::array::from_fn(of);
            out.sets.iter_mut().for_each(|s| s.read.add_along_rows(&power));
            return;
        }
        let power = std::array::from_fn(|i| 2.0 * square * (1.0 + sign * libm::cos(angle(i))));
        out.sets.iter_mut().for_each(|s| s.read.add_along_rows(&power));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let (id, frame, columns) = (self.id(), d.frame, d.image.ncols());
        for y in 0..d.image.nrows() {
            let at = |x: usize| (y * (columns + 1) + x) as u32;
            let mut last = d.random(id, frame, at(0)).normal();
            let (kept, fresh) = (p[NEXT], libm::sqrt(1.0 - p[NEXT] * p[NEXT]));
            for x in 0..columns {
                let own = d.random(id, frame, at(x + 1)).normal();
                if decays(p) {
                    last = kept * last + fresh * own;
                    d.image[(y, x)] += p[1] * last;
                    continue;
                }
                d.image[(y, x)] += p[1] * (own + sign(p) * last);
                last = own;
            }
        }
    }
}
