//! Numbers, files, frames and formats: the ground of every other room.
//!
//! Nothing here knows a campaign. [`number`] rounds values to their errors, [`agreement`] grades fits,
//! [`fit`] solves; [`input`] and `output` are the only places that open and write files; [`features`] lists
//! the GenICam features that are known, their effect on pixel values, and the value that switches each off;
//! [`frame`], [`pixel_format`] and [`light`] are terms of GenICam and EMVA 1288; [`plot`] holds figures as
//! data; `http` and `secret` serve the pages of the program. Begin with [`number`].

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
