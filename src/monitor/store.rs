//! The history of checks and alarms in a database: SQLite in a file, or a PostgreSQL server. The same tables and the same statements.

use super::{Alarm, Changed, Check, Limits, Monitor, Reading};
use sqlx::any::{AnyPoolOptions, install_default_drivers};
use sqlx::migrate::Migrator;
use sqlx::{AnyPool, Connection, Row};
use tokio::runtime::Runtime;

static MIGRATIONS: Migrator = sqlx::migrate!("src/monitor/migrations");

/// A history that is kept.
#[derive(Debug)]
pub struct Store {
    pool: AnyPool,
    runtime: Runtime,
    url: String,
}

/// The database refused.
#[derive(Debug, thiserror::Error)]
#[error("{url}: {message}")]
pub struct StoreError {
    url: String,
    message: String,
}

/// An address without its password.
fn shown(url: &str) -> String {
    match (url.split_once("://"), url.rsplit_once('@')) {
        (Some((kind, rest)), Some((_, host))) if rest.contains('@') => {
            let user = rest.split([':', '@']).next().unwrap_or_default();
            format!("{kind}://{user}@{host}")
        }
        _ => url.into(),
    }
}

fn nanoseconds(time_s: f64) -> i64 {
    (time_s * 1e9).round() as i64
}

impl Store {
    /// Opens a store, and makes its tables where there are none: `sqlite:FILE` or `postgres://USER:PASSWORD@HOST/DATABASE`; a plain path is a
    /// SQLite file.
    ///
    /// # Errors
    ///
    /// Where the database cannot be reached or is of a later version.
    pub fn open(url: &str) -> Result<Self, StoreError> {
        let url = if url.contains("://") || url.starts_with("sqlite:") {
            url.into()
        } else {
            format!("sqlite:{url}")
        };
        let url = match url.strip_prefix("sqlite:") {
            Some(file) if !file.contains('?') => format!("sqlite:{file}?mode=rwc"),
            _ => url,
        };
        let fault = |message: String| StoreError { url: shown(&url), message };
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| fault(e.to_string()))?;
        install_default_drivers();
        let pool = runtime.block_on(async {
            // A pool would only say that time ran out.
            let one = sqlx::AnyConnection::connect(&url).await.map_err(|e| fault(e.to_string()))?;
            one.close().await.map_err(|e| fault(e.to_string()))?;
            let wait = std::time::Duration::from_secs(10);
            let pool = AnyPoolOptions::new().max_connections(1).acquire_timeout(wait).connect(&url).await;
            let pool = pool.map_err(|e| fault(e.to_string()))?;
            MIGRATIONS.run(&pool).await.map_err(|e| fault(e.to_string()))?;
            Ok(pool)
        })?;
        Ok(Self { pool, runtime, url: shown(&url) })
    }

    fn fault(&self, e: impl std::fmt::Display) -> StoreError {
        StoreError { url: self.url.clone(), message: e.to_string() }
    }

    /// Keeps a check and what it found, both or neither.
    ///
    /// # Errors
    ///
    /// What the database says.
    pub fn keep(
        &self,
        camera: &str,
        calibration: &str,
        check: &Check,
        alarms: &[Alarm],
    ) -> Result<(), StoreError> {
        let body = serde_json::to_string(check).map_err(|e| self.fault(e))?;
        let time_ns = nanoseconds(check.time_s);
        let work = async {
            let mut all = self.pool.begin().await?;
            sqlx::query("INSERT INTO checks (camera, calibration, time_ns, body) VALUES ($1, $2, $3, $4)")
                .bind(camera)
                .bind(calibration)
                .bind(time_ns)
                .bind(&body)
                .execute(&mut *all)
                .await?;
            for (what, Reading { value, std_err }) in &check.readings {
                let what = serde_json::to_value(what).ok();
                sqlx::query(
                    "INSERT INTO readings (camera, time_ns, quantity, value, std_err) VALUES ($1, $2, $3, $4, $5)",
                )
                .bind(camera)
                .bind(time_ns)
                .bind(what.as_ref().and_then(|w| w.as_str()).unwrap_or_default())
                .bind(*value)
                .bind(*std_err)
                .execute(&mut *all)
                .await?;
            }
            for alarm in alarms {
                sqlx::query(
                    "INSERT INTO alarms (camera, time_ns, since_ns, what, sentence) VALUES ($1, $2, $3, $4, $5)",
                )
                .bind(camera)
                .bind(time_ns)
                .bind(nanoseconds(alarm.since_s))
                .bind(name(alarm.what))
                .bind(&alarm.sentence)
                .execute(&mut *all)
                .await?;
            }
            all.commit().await
        };
        self.runtime.block_on(work).map_err(|e| self.fault(e))
    }

    /// The checks of a camera under a calibration, the oldest first.
    ///
    /// # Errors
    ///
    /// What the database says, and rows that were changed by hand.
    pub fn checks(&self, camera: &str, calibration: &str) -> Result<Vec<Check>, StoreError> {
        let query =
            sqlx::query("SELECT body FROM checks WHERE camera = $1 AND calibration = $2 ORDER BY time_ns")
                .bind(camera)
                .bind(calibration);
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        self.read(camera, &rows)
    }

    /// The checks of a camera under all calibrations, the oldest first.
    ///
    /// # Errors
    ///
    /// As [`checks`](Self::checks).
    pub fn history(&self, camera: &str) -> Result<Vec<Check>, StoreError> {
        let query = sqlx::query("SELECT body FROM checks WHERE camera = $1 ORDER BY time_ns").bind(camera);
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        self.read(camera, &rows)
    }

    fn read(&self, camera: &str, rows: &[sqlx::any::AnyRow]) -> Result<Vec<Check>, StoreError> {
        rows.iter()
            .map(|row| {
                let body: String = row.try_get(0).map_err(|e| self.fault(e))?;
                serde_json::from_str(&body)
                    .map_err(|e| self.fault(format!("a check of {camera} was changed: {e}")))
            })
            .collect()
    }

    /// Every camera that was checked.
    ///
    /// # Errors
    ///
    /// What the database says.
    pub fn cameras(&self) -> Result<Vec<String>, StoreError> {
        let query = sqlx::query("SELECT DISTINCT camera FROM checks ORDER BY camera");
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        rows.iter().map(|row| row.try_get(0).map_err(|e| self.fault(e))).collect()
    }

    /// Every alarm of a camera: name, time and sentence, the oldest first.
    ///
    /// # Errors
    ///
    /// What the database says.
    pub fn alarms(&self, camera: &str) -> Result<Vec<(String, f64, String)>, StoreError> {
        let query = sqlx::query(
            "SELECT what, time_ns, sentence FROM alarms WHERE camera = $1 ORDER BY time_ns, what",
        )
        .bind(camera);
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        let read = |row: &sqlx::any::AnyRow| {
            Ok((row.try_get(0)?, row.try_get::<i64, _>(1)? as f64 * 1e-9, row.try_get(2)?))
        };
        rows.iter().map(|row| read(row).map_err(|e: sqlx::Error| self.fault(e))).collect()
    }

    /// A monitor as it stood after the last check that was kept.
    ///
    /// # Errors
    ///
    /// What the database says.
    pub fn monitor(&self, camera: &str, calibration: &str, limits: Limits) -> Result<Monitor, StoreError> {
        let mut monitor = Monitor::new(limits);
        for check in self.checks(camera, calibration)? {
            monitor.add(check);
        }
        Ok(monitor)
    }
}

/// The name of a change, as in JSON.
pub fn name(what: Changed) -> String {
    serde_json::to_value(what).ok().and_then(|w| w.as_str().map(Into::into)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::shown;

    #[test]
    fn a_password_is_not_shown() {
        assert_eq!(shown("postgres://me:secret@host/db"), "postgres://me@host/db");
        assert_eq!(shown("sqlite:/a/b.db?mode=rwc"), "sqlite:/a/b.db?mode=rwc");
    }
}
