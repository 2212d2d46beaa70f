//! Cameras, and what runs on them: capture, correction at the camera's rate, monitoring.
//!
//! In: a name such as `aravis:192.168.1.5` or `sim:cmos12`. Out: frames ([`camera`]), campaigns ([`capture`]
//! with a [`bench`]), corrected frames to disk or network ([`stream`], [`serve`](crate::serve), [`upload`]),
//! alarms ([`monitor`]). Begin with [`camera::Camera`], the trait that every backend implements.

pub mod bench;
pub mod camera;
pub mod capture;
pub mod monitor;
#[cfg(feature = "aravis")]
pub mod serve;
pub mod stream;
pub mod upload;
