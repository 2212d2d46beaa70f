//! The pages, one file each, and what they share.

pub mod camera;
pub mod data;
pub mod history;
pub mod model;
pub mod runs;
pub mod save;
pub mod shell;

use super::Shared;
use axum::extract::State;
use maud::Markup;
use std::sync::Arc;

/// The line that says what goes on.
pub async fn status(State(shared): State<Arc<Shared>>) -> Markup {
    shell::status(&shared)
}
