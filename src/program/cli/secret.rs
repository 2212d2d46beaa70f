//! Database addresses. Passwords do not appear on the command line, which every user of the machine can read.

use crate::secret::{has_password, shown};
use anyhow::{Context, Result, bail};

/// Resolves the address of a database: as given, `@FILE` from a file, `env:NAME` from the environment.
pub fn database(given: &str) -> Result<String> {
    if let Some(path) = given.strip_prefix('@') {
        let text = crate::input::settings(path.as_ref()).with_context(|| path.to_string())?;
        return Ok(text.lines().next().unwrap_or_default().trim().into());
    }
    if let Some(name) = given.strip_prefix("env:") {
        return std::env::var(name)
            .with_context(|| format!("the environment has no {name} with the address"));
    }
    if has_password(given) {
        bail!(
            "{}: a password on the command line is seen by every user of this machine; leave it out and set PGPASSWORD or ~/.pgpass, or give \
             the whole address as @FILE or env:NAME",
            shown(given)
        );
    }
    Ok(given.into())
}
