//! Cameras, and what runs on them: capture, live correction, monitoring.
//!
//! In: a name such as `aravis:192.168.1.5` or `sim:cmos12`. Out: frames ([`camera`]), campaigns ([`capture`]
//! with a [`bench`], which drives the light), corrected frames to disk or another program ([`stream`]), a
//! simulated or corrected camera offered over GigE Vision ([`serve`](crate::serve)), a calibration written
//! into a camera ([`upload`]), alarms ([`monitor`]). Features that a capture switches off are in
//! [`features`](crate::features). Begin with [`camera::Camera`], the trait that every backend implements.

pub mod bench;
pub mod camera;
pub mod capture;
pub mod monitor;
#[cfg(feature = "aravis")]
pub mod serve;
pub mod stream;
pub mod upload;
