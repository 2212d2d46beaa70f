//! Physics of an image sensor, from light to digital number.
//!
//! The chain is that of Healey and Kondepudy, "Radiometric CCD Camera Calibration and Noise Estimation",
//! IEEE PAMI 16(3), 1994, eq. (20):
//!
//! D(a,b) = (K(a,b) I(a,b) + N_DC(a,b) + N_S(a,b) + N_R(a,b)) A + N_Q(a,b)
//!
//! K: relative response of a pixel (PRNU), mean 1; A: system gain, DN/e (K in EMVA 1288); I: light, e; N_DC,
//! N_S, N_R, N_Q: dark charge, shot, read and quantisation noise. [`Sensor`] draws frames, [`predict`]
//! computes their expected statistics, and [`effects`] change both.
//!
//! Nothing here reads a file, speaks to a camera or knows how a measurement is made.
//!
//! ```
//! use radcam_sim::{Sensor, sensors};
//!
//! let sensor = Sensor::new(sensors::load("cmos12")?)?;
//! let region = sensor.region();
//! let mut frame = vec![0u16; (region.width * region.height) as usize];
//! sensor.draw(0, &sensor.conditions(0.005), region, &mut frame); // codes in DN, row by row
//! # Ok::<(), radcam_sim::ModelError>(())
//! ```

mod chart;
mod clipping;
mod draw;
mod drift;
pub mod effects;
mod maps;
mod model;
mod normal;
mod optics;
mod poisson;
pub mod predict;
mod quantize;
mod region;
pub mod rng;
mod scene;
pub mod sensors;
mod spectrum;
mod surface;
pub mod text;

pub use chart::Square;
pub use draw::{Conditions, Expected, Sensor};
pub use maps::Maps;
pub use model::{Base, Bench, Body, EffectValues, FORMAT, Model, ModelError};
pub use optics::{Band, Optics};
pub use quantize::{Rounded, rounded};
pub use region::Region;
pub use scene::{PATCH_BACKGROUND, Scene};
pub use surface::{Spectrum, Texture};
