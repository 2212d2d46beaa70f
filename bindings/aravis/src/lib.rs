//! Bindings to [libaravis](https://github.com/AravisProject/aravis) for radcam, with the only `unsafe` code
//! of the project.
//!
//! GigE Vision and USB3 Vision cameras ([`Camera`], [`Stream`]). Socket filters check the received packets
//! where libaravis does not. This crate is a leaf: it knows nothing of frames, formats or physics.
//!
//! libaravis is LGPL and linked dynamically.

mod camera;
mod socket;
mod stream;

pub use camera::{Camera, DeviceInfo, Feature, FeatureKind, devices};
pub use socket::broadcast_address;
pub use stream::{Received, Stream, StreamCounts, StreamSetup};

unsafe extern "C" {
    fn arv_get_major_version() -> std::ffi::c_uint;
    fn arv_get_minor_version() -> std::ffi::c_uint;
    fn arv_get_micro_version() -> std::ffi::c_uint;
}

/// Returns the version of the loaded libaravis: major, minor, micro.
pub fn version() -> [u32; 3] {
    // SAFETY: plain calls without arguments that return constants of the library (arvmisc.h of libaravis 0.8).
    unsafe { [arv_get_major_version(), arv_get_minor_version(), arv_get_micro_version()] }
}

/// Error reported by libaravis.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what}: {message}")]
pub struct Error {
    /// Feature or action.
    pub what: String,
    /// Message of libaravis.
    pub message: String,
}

impl Error {
    fn new(what: &str, message: impl std::fmt::Display) -> Self {
        Self { what: what.into(), message: message.to_string() }
    }
}

/// Adds the feature's name to an error.
trait Named<T> {
    fn named(self, what: &str) -> Result<T, Error>;
}

impl<T> Named<T> for Result<T, aravis::glib::Error> {
    fn named(self, what: &str) -> Result<T, Error> {
        self.map_err(|e| Error::new(what, e.message()))
    }
}
