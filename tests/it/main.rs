//! One integration binary, laid out as `src/` is: the library's public face, the real program, the real libaravis.

mod conformance;
mod dataset;
mod noise;
mod program;
mod support;

#[cfg(feature = "aravis")]
mod serve;
