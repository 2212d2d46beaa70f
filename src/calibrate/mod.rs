//! Section V: what a camera adds to an even light, and how to take it off again.

pub mod dark;
pub mod file;
pub mod joint;
pub mod pattern;
pub mod window;
