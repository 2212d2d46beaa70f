//! Covariance of a pixel's noise in successive frames, DN^2.

use super::{ChunkView, Expected, Observable, Put, Statistic, View, in_quadrature};
use crate::statistics::pass::Summary;
use crate::statistics::successive::error_of;

/// Noise carried to the next frame.
#[derive(Debug)]
pub struct Successive;

/// Returns the standard error for independent normal pixels. Each pixel scatters in proportion to its own
/// variance, so a few noisy pixels dominate.
pub fn theory(r: &Summary) -> f64 {
    let mean_square = 1.0 + r.unequal.value.max(0.0);
    r.var.value * (mean_square / r.pixels).sqrt() * error_of(r.frames)
}

/// Change of this statistic over the change of the variance if rounding follows the noise: for the noise of
/// one frame x of three, with slope r, the variance changes by 2 r x / 3 and the covariance of one pair of
/// two by r x / 2.
const MOVING: f64 = 0.75;

impl Statistic for Successive {
    fn id(&self) -> &'static str {
        "covariance of successive frames"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "carried to the next frame"
    }

    fn unit(&self) -> &'static str {
        "DN^2"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        let r = chunk.summary();
        if r.frames > 2 {
            put.put(0, r.successive.value, chunk.inflation.successive * theory(r));
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let Some(s) = view.set() else { return Expected::plain(o, 0.0, 1.0) };
        // Sum of the mean product and of the variance left over the frames; 0 for independent frames.
        let carried = |variance: f64, memory: &[f64], left: f64| {
            if memory.is_empty() {
                return 0.0;
            }
            variance * (view.product(memory) + left / view.n.max(2.0))
        };
        let (shot, read) = view.pixels();
        let jumps = s.two_levels;
        let stays: Vec<f64> =
            if jumps.stays != 0.0 { (1..=8).map(|k| jumps.stays.powi(k)).collect() } else { Vec::new() };
        let value = carried(shot, &s.shot_memory, view.left.0)
            + carried(read, &s.read_memory, view.left.1)
            + carried(jumps.share * jumps.variance, &stays, view.left_of(&stays));
        Expected::plain(
            o,
            value,
            in_quadrature(&[
                o.measured.std_err,
                view.alike_in_time(o.pixels),
                0.5 * view.rough.1,
                s.unsure_var,
                MOVING * view.unsure_moving(),
                view.lines(0, 0),
                0.3 * view.moving,
                view.shared(1, 1),
                // Light of whole frames that is alike in successive ones by chance.
                view.with_light * view.all.field.pixels / view.dof.sqrt(),
            ]),
        )
    }
}
