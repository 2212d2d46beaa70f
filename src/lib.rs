//! Radiometric camera calibration and noise estimation for machine vision.
//!
//! The system of Healey and Kondepudy, "Radiometric CCD Camera Calibration and Noise Estimation", IEEE PAMI 16(3),
//! 1994: the camera model (in [`radcam_sim`]), noise from pairs of flats ([`noise`], Section IV), on any camera behind
//! one trait ([`camera`]) and on any dataset folder ([`dataset`]).
//!
//! `radcam-sim` says what should be seen, this crate says what was seen, and the difference is the product.
//!
//! ```
//! use radcam::bench::{BenchState, Illuminator, SharedBench};
//! use radcam::camera::{Camera, StreamOptions, sim::SimCamera};
//! use radcam::frame::{Frame, Region};
//! use std::time::Duration;
//!
//! let sensor = radcam_sim::Sensor::new(radcam_sim::sensors::load("cmos12")?)?;
//! let mut bench = SharedBench::default();
//! let mut camera = SimCamera::new("cmos12", sensor.into(), bench.clone());
//! camera.set_region(Region { x: 0, y: 0, width: 64, height: 48 })?;
//! let exposure_s = camera.set_exposure_s(0.005)?; // what the camera then reports, s
//! bench.apply(&BenchState { illumination: 0.5, ..Default::default() }, &mut camera)?;
//!
//! let mut frame = Frame::new(64, 48);
//! camera.stream(&StreamOptions::default())?.next(&mut frame, Duration::from_secs(1))?;
//! assert_eq!(frame.pixels.dim(), (48, 64)); // (rows, columns), DN
//! # assert_eq!(exposure_s, 0.005);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod agreement;
pub mod bench;
pub mod budget;
pub mod calibrate;
pub mod camera;
pub mod capture;
#[cfg(feature = "cli")]
pub mod cli;

pub mod correct;
pub mod dataset;
pub mod diagnosis;
pub mod features;
pub mod fit;
pub mod frame;
pub mod import;
pub mod inference;
pub mod investigate;
pub mod noise;
pub mod number;
pub mod observables;
pub mod pixel_format;
pub mod plan;
pub mod report;
pub mod reproduce;
pub mod scene_variation;
#[cfg(feature = "aravis")]
pub mod serve;
pub mod statistics;
pub mod surfaces;
