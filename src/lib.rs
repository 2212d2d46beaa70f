//! Radiometric camera calibration and noise estimation for machine vision.
//!
//! The system of Healey and Kondepudy, "Radiometric CCD Camera Calibration and Noise Estimation", IEEE PAMI
//! 16(3), 1994: the camera model (in [`radcam_sim`]), noise from pairs of flats ([`noise`], Section IV), on
//! any camera behind one trait ([`camera`]) and on any dataset folder ([`dataset`]).
//!
//! `radcam-sim` says what should be seen, this crate says what was seen, and the difference is the product.
//!
//! From a camera to its gain and to the effect that its model lacks; `aravis:192.168.1.5` in place of
//! `sim:cmos12` is a real camera:
//!
//! ```
//! use radcam::prelude::*;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = tempfile::tempdir()?;
//! # let campaign = folder.path().join("campaign");
//! let mut camera = camera::open("sim:cmos12")?;
//! let mut plan = Plan::quick(); // two darks and eight exposures, four frames each
//! plan.camera.region = Some([0, 0, 64, 64]);
//! let mut bench = bench::of(&mut *camera, &plan);
//! let summary = Capture::new(&mut *camera, &mut *bench).run(&plan, &campaign)?;
//! assert_eq!(summary.frames, 40);
//!
//! let source = Source::open(&campaign)?; // a dataset folder, an EMVA 1288 descriptor or a table
//! let noise = source.noise()?;
//! println!("gain {}", noise.gain_dn_per_e); // such as: gain 0.3815 ± 0.0019 DN/e⁻
//! let diagnosis = source.diagnose(&[])?;
//! println!("{}", diagnosis.verdict.sentence());
//! # assert!((noise.gain_dn_per_e.value - 0.38).abs() < 5.0 * noise.gain_dn_per_e.std_err);
//! # assert!(diagnosis.consistent, "{}", diagnosis.verdict.sentence());
//! # Ok(())
//! # }
//! ```
//!
//! Frames one by one, as in an inspection program:
//!
//! ```
//! use radcam::prelude::*;
//! use std::time::Duration;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let mut camera = camera::open("sim:cmos12")?;
//! camera.set_region(Region { x: 0, y: 0, width: 64, height: 48 })?;
//! let exposure_s = camera.set_exposure_s(0.005)?; // what the camera then reports, s
//! let mut frame = Frame::new(64, 48);
//! let mut stream = camera.stream(&StreamOptions::default())?;
//! stream.next(&mut frame, Duration::from_secs(1))?;
//! assert_eq!(frame.pixels.dim(), (48, 64)); // (rows, columns), DN
//! # assert_eq!(exposure_s, 0.005);
//! # Ok(())
//! # }
//! ```
//!
//! Results ([`NoiseReport`](noise::NoiseReport), [`Diagnosis`](diagnosis::Diagnosis), ...) serialise to the
//! JSON of the program and back.

// Rooms; their order is the table in CONTRIBUTING.md, which tests/it/rooms.rs holds against the imports. Each
// module has its short path below.
mod base;
mod cameras;
mod campaign;
mod comparison;
#[cfg(feature = "cli")]
mod program;
mod radiometry;
mod results;
pub mod statistics;

#[cfg(feature = "cli")]
pub(crate) use base::http;
pub(crate) use base::output;
#[cfg(feature = "cli")]
pub(crate) use base::secret;
pub use base::{agreement, features, fit, frame, input, light, number, pixel_format, plot};
#[cfg(feature = "aravis")]
pub use cameras::serve;
pub use cameras::{bench, camera, capture, monitor, stream, upload};
pub(crate) use campaign::first_look;
pub use campaign::{data_faults, dataset, import, plan};
pub use comparison::{diagnosis, inference, model, observables};
#[cfg(feature = "cli")]
pub use program::{cli, workbench};
pub use radiometry::{budget, calibrate, correct, emva, flat_field, noise, scene_variation, surfaces};
pub use results::{investigate, reduction, report, reproduce, source, study};

pub use ndarray;
pub use radcam_sim as sim;
pub use toml;

/// Names that most programs use: `use radcam::prelude::*;`
pub mod prelude {
    pub use crate::bench::{self, Illuminator};
    pub use crate::calibrate::file::Calibration;
    pub use crate::camera::{self, Camera, FrameStream, StreamOptions};
    pub use crate::capture::Capture;
    pub use crate::correct::{Codes, Corrector};
    pub use crate::dataset::Dataset;
    pub use crate::diagnosis::Diagnosis;
    pub use crate::frame::{Frame, Region};
    pub use crate::noise::NoiseReport;
    pub use crate::plan::Plan;
    pub use crate::source::Source;
}
