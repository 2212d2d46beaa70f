//! Beside a scene's bright patch, against the background away from it: the short exposure scaled up less the long one, DN.

use super::{Direction, Expected, HalfView, Observable, Put, ScenePair, Statistic, View, in_quadrature};
use radcam_sim::predict::Prediction;

/// What leaks out, for each of [`Direction::ALL`].
#[derive(Debug)]
pub struct Leak;

fn way(index: usize) -> Direction {
    Direction::ALL.get(index).copied().unwrap_or(Direction::Up)
}

impl Statistic for Leak {
    fn id(&self) -> &'static str {
        "leak"
    }

    fn name(&self, index: usize) -> String {
        format!("scene, {} the patch", way(index).name())
    }

    fn meaning(&self, index: usize) -> &'static str {
        match way(index) {
            Direction::Left | Direction::Right => "out of the bright patch along the rows",
            _ => "out of the bright patch along the columns",
        }
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        for (direction, value) in half.scene.map_or(&[][..], |s| &s.leaks) {
            let index = Direction::ALL.iter().position(|d| d == direction).unwrap_or(0);
            put.put(index, value.value, value.std_err);
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let scene = view.all.scenes[o.half.place()].as_ref();
        let of = |f: fn(&ScenePair, Direction, &Prediction) -> f64| {
            scene.map_or(0.0, |s| f(s, way(o.index), view.prediction))
        };
        let (leak, unsure) = (of(ScenePair::expected), of(ScenePair::unsure));
        // A step between taps that lies beside the patch drops out of the difference in proportion to the light; a constant one does where every
        // pixel has a zero of its own. Darks that code 0 clips have none.
        let base = &view.prediction.base;
        let clipped = base.offset_dn < 4.0 * base.read_noise_e * base.gain_dn_per_e + 1.0;
        let step: f64 = view.prediction.taps.iter().map(|(_, offset)| offset.abs()).sum();
        let step = scene.map_or(0.0, |s| s.zero_scaled(clipped)) * step;
        // Nor are the rows of the patch and of the background under the same light where that ripples.
        let ripple = view
            .prediction
            .sets
            .iter()
            .map(|s| s.ripple(0.0) + s.fields.variance())
            .fold(0.0, f64::max)
            .sqrt();
        Expected::plain(o, leak, in_quadrature(&[o.measured.std_err, 0.01 * leak, unsure, step, ripple]))
    }
}
