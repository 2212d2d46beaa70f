//! Pages of the workbench, one file each, and their shared parts.

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

/// Renders the status line.
pub async fn status(State(shared): State<Arc<Shared>>) -> Markup {
    shell::status(&shared)
}
