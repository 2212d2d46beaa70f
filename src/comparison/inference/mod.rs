//! Fits models to observables, and judges them on held-out frames.
//!
//! The light is a nuisance parameter: every light level has a factor that touches its own sets only. The
//! normal equations are therefore an arrowhead, and the cost grows with the number of sets (Bjorck 1996,
//! Numerical Methods for Least Squares Problems, 6.3).

mod direction;
mod exposure_steps;
mod fit;
mod free;
mod iteration;
mod judge;
mod layout;
mod model;
mod normal;
mod photon_transfer;
mod screen;
mod settings;
mod slopes;
mod start;
mod system;
mod white;

pub use fit::{Fitted, fit, seen};
pub(crate) use fit::{fit_briefly, fit_near};
pub use judge::{Comparison, OfStatistic, Residual, by_statistic, compare};
pub(crate) use judge::{by, residuals_of};
pub use model::{Effects, Given, as_given};
pub use screen::{Scored, Screen};
pub(crate) use settings::words as words_of_settings;
#[cfg(test)]
pub(crate) use settings::{ALIKE_IN_SIGNAL, AT_LONG_EXPOSURES, STEP_IN_SIGNAL, THAT_COME_BACK};
pub(crate) use start::has_flats;
pub use start::{reference_level, start};
