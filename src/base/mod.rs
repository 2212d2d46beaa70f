//! Numbers, files, frames and formats: the base of all other modules.
//!
//! Nothing here depends on a campaign. [`number`] rounds values to their errors, [`agreement`] grades fits,
//! [`fit`] solves; [`input`] and `output` are the only places that open and write files; [`frame`],
//! [`pixel_format`], [`features`] and [`light`] are the terms of GenICam and EMVA 1288. Begin with
//! [`number`].

pub mod agreement;
pub mod features;
pub mod fit;
pub mod frame;
#[cfg(feature = "cli")]
pub(crate) mod http;
pub mod input;
pub mod light;
pub mod number;
pub(crate) mod output;
pub mod pixel_format;
pub mod plot;
#[cfg(feature = "cli")]
pub(crate) mod secret;
