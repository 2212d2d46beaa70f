//! What frames tell: streaming accumulators that can be merged, one observable to a file.

pub mod level;
pub mod moments;
pub mod residual;
