//! Leak beside the bright patch of a scene, relative to the background away from it: the short exposure
//! scaled up minus the long one, DN.

use super::{Direction, Expected, HalfView, Observable, Put, ScenePair, Statistic, View, in_quadrature};
use radcam_sim::predict::Prediction;

/// Leak in each of [`Direction::ALL`].
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
        // A step between taps beside the patch cancels in the difference if it is in proportion to the light.
        // A constant step cancels if every pixel has a zero of its own, which darks clipped at code 0 do not
        // show.
        let base = &view.prediction.base;
        let clipped = base.offset_dn < 4.0 * base.read_noise_e * base.gain_dn_per_e + 1.0;
        let step: f64 = view.prediction.taps.iter().map(|(_, offset)| offset.abs()).sum();
        let step = scene.map_or(0.0, |s| s.zero_scaled(clipped)) * step;
        // Under a light that ripples, the rows of the patch and of the background differ in light too.
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
