//! Drift with time: a straight line, or exponential settling as in a warm-up (the first time constant of a
//! body's approach to its surroundings: Newton's law of cooling). Light may also change exponentially, as at
//! twilight. The four values are the shape, the change per second, the excess at the start and the time
//! constant.

use crate::effects::{Parameter, Seen};

/// Choice between line and settling.
pub(crate) const SHAPE: Parameter = Parameter {
    name: "shape",
    meaning: "0: a straight line in time, 1: it settles",
    unit: "choice",
    min: 0.0,
    max: 1.0,
    starts: &[0.0, 1.0],
};

/// Choice of the shape for light: additionally exponential, like daylight.
pub(crate) const SHAPE_OF_LIGHT: Parameter = Parameter {
    meaning: "0: a straight line in time, 1: it settles, 2: it fades or grows by the same share each second",
    max: 2.0,
    starts: &[0.0, 1.0, 2.0],
    ..SHAPE
};

/// Time constant of the settling.
pub(crate) const TAU: Parameter = Parameter {
    name: "tau_s",
    meaning: "shape 1: time constant of the settling",
    unit: "s",
    min: 1e-3,
    max: 1e5,
    starts: &[],
};

/// Builds the parameter of the relative change per second of light or gain.
pub(crate) const fn relative_rate(meaning: &'static str) -> Parameter {
    Parameter { name: "rel_per_s", meaning, unit: "1/s", min: -0.05, max: 0.05, starts: &[1e-4, -1e-4] }
}

/// Builds the parameter of the relative excess of light or gain at the start, of up to `max`.
pub(crate) const fn relative_excess(meaning: &'static str, max: f64) -> Parameter {
    Parameter { name: "rel", meaning, unit: "1", min: -max, max, starts: &[0.01] }
}

/// Start values of the time constant, in durations of the campaign.
const PARTS: [f64; 2] = [0.1, 0.4];

fn settles(p: &[f64]) -> bool {
    p[0].round() as i32 == 1
}

fn fades(p: &[f64]) -> bool {
    p[0].round() as i32 == 2
}

/// Returns the change at a time.
pub(crate) fn change(p: &[f64], time_s: f64) -> f64 {
    if settles(p) {
        p[2] * libm::exp(-time_s / p[3].max(1e-9))
    } else if fades(p) {
        libm::expm1(p[1] * time_s)
    } else {
        p[1] * time_s
    }
}

/// Returns true if a shape uses a parameter.
pub(crate) fn uses(p: &[f64], parameter: usize) -> bool {
    parameter == 0 || (parameter >= 2) == settles(p)
}

/// Describes the shape.
pub(crate) fn form(p: &[f64]) -> &'static str {
    if settles(p) {
        "it settles"
    } else if fades(p) {
        "by the same share each second"
    } else {
        "straight in time"
    }
}

/// Returns starts with these changes per second, and with this excess for settling.
pub(crate) fn starts(rates: &[f64], excess: f64, seen: &Seen) -> Vec<Vec<f64>> {
    let straight = rates.iter().map(|rate| vec![0.0, *rate, 0.0, 1.0]);
    straight.chain(PARTS.map(|part| vec![1.0, 0.0, excess, part * seen.duration_s.max(1e-3)])).collect()
}

/// Returns the defaults for a model that gives the change per second alone.
pub(crate) fn usual(parameter: usize) -> Option<f64> {
    [Some(0.0), None, Some(0.0), Some(1.0)][parameter.min(3)]
}

/// Methods of an effect whose values are those four.
macro_rules! in_time {
    () => {
        fn uses(&self, p: &[f64], parameter: usize) -> bool {
            $crate::drift::uses(p, parameter)
        }

        fn usual(&self, parameter: usize) -> Option<f64> {
            $crate::drift::usual(parameter)
        }

        fn form(&self, p: &[f64]) -> Option<&'static str> {
            Some($crate::drift::form(p))
        }

        fn is_in_time(&self, _: &[f64]) -> bool {
            true
        }
    };
}
pub(crate) use in_time;
