//! Variance in the strongest line of the noise's spectrum in read-out order, DN^2, and at one row's frequency
//! on either side of it: interference that continues while rows are blanked is a comb there.

use crate::statistics::spectrum::Power;

use super::{Expected, HalfView, Observable, Put, Statistic, View};

/// Line of the spectrum.
#[derive(Debug)]
pub struct Line;

impl Statistic for Line {
    fn id(&self) -> &'static str {
        "line in the spectrum"
    }

    fn name(&self, index: usize) -> String {
        let beside = ["", ", one cycle a row below it", ", one cycle a row above it"];
        format!("line in the spectrum{}", beside[index.min(2)])
    }

    fn meaning(&self, _: usize) -> &'static str {
        "at one frequency"
    }

    fn of_half(&self, half: &HalfView<'_>, put: &mut Put<'_>) {
        for (index, v) in half.line.into_iter().flatten().enumerate() {
            if let Some(v) = v {
                put.put(index, v.value, v.std_err);
            }
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let shape = view.all.campaign.shape;
        let Some(seen) = view.all.campaign.line_cycles_per_px else {
            return Expected::plain(o, 0.0, o.measured.std_err);
        };
        let columns = shape.1 as f64;
        let rows = Power::length(shape) as f64 / columns;
        let here = seen + TEETH[o.index.min(2)] / columns;
        let tooth = |&(variance, across, down): &(f64, f64, f64)| {
            let turns = |phase: f64| phase / std::f64::consts::TAU;
            // Teeth of a comb, for rows put one after another. They lie at frequencies at which the phases of
            // rows agree. Each is as strong as the spectrum of a sine cut to one row is there, sin(x)^2 / x^2
            // (Bracewell, The Fourier Transform and Its Applications, ch. 10: a train of pulses).
            let between = turns(down) - here * columns;
            let away = (between - between.round()) * rows;
            let within = std::f64::consts::PI * (turns(across) - here) * columns;
            let cut = if within.abs() < 1e-9 { 1.0 } else { (within.sin() / within).powi(2) };
            variance * cut * (-0.5 * away * away).exp()
        };
        // The line is the same in all sets, unless clipping reduces it. A frequency and one minus it are
        // equivalent: near half a cycle the teeth of both coincide.
        let both = |l: &(f64, f64, f64)| tooth(l) + tooth(&(l.0, std::f64::consts::TAU - l.1, -l.2));
        let of_sets = view.prediction.sets.iter().map(|s| s.lines.iter().map(both).sum::<f64>());
        let line = of_sets.fold(0.0, f64::max);
        Expected::plain(o, line, o.measured.std_err)
    }
}

/// Places of the line and of its neighbours, in cycles per row.
pub const TEETH: [f64; 3] = [0.0, -1.0, 1.0];
