//! History of checks and alarms in a database: SQLite in a file, or a PostgreSQL server, with the same tables
//! and statements.

use super::{Alarm, Changed, Check, Limits, Monitor, Reading};
use crate::secret::shown;
use sqlx::any::{AnyPoolOptions, install_default_drivers};
use sqlx::migrate::{MigrateError, Migrator};
use sqlx::{AnyPool, Connection, Row};
use std::collections::BTreeSet;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use tokio::runtime::Runtime;

mod thinned;

pub use thinned::{Period, Point};

static MIGRATIONS: Migrator = sqlx::migrate!("src/cameras/monitor/migrations");

/// Stored history.
#[derive(Debug)]
pub struct Store {
    pool: AnyPool,
    runtime: Runtime,
    url: String,
    /// SQLite: file and inode. SQLite keeps writing into a deleted file.
    file: Option<(PathBuf, u64)>,
}

/// Database error.
#[derive(Debug, thiserror::Error)]
#[error("{url}: {message}")]
pub struct StoreError {
    url: String,
    message: String,
    /// True for transient errors: the database is locked, starts, or cannot be reached.
    passing: bool,
}

impl StoreError {
    /// Returns true if another attempt may succeed: the database is locked, starts, or cannot be reached.
    pub fn is_passing(&self) -> bool {
        self.passing
    }
}

/// Returns true for transient errors, among them SQLite's BUSY and LOCKED with their extended codes, and
/// PostgreSQL's classes 08 (connection), 53 (insufficient resources) and 57 (shut down, or not started yet).
fn is_passing(e: &sqlx::Error) -> bool {
    match e {
        sqlx::Error::Io(e) => e.kind() != std::io::ErrorKind::InvalidInput,
        sqlx::Error::PoolTimedOut | sqlx::Error::WorkerCrashed => true,
        sqlx::Error::Database(e) => e.code().is_some_and(|code| {
            let sqlite = code.parse::<u32>().is_ok_and(|c| code.len() < 5 && [5, 6].contains(&(c & 0xff)));
            sqlite || code.len() == 5 && ["08", "53", "57"].iter().any(|class| code.starts_with(class))
        }),
        _ => false,
    }
}

fn inode(path: &Path) -> Option<u64> {
    std::fs::metadata(path).ok().map(|m| m.ino())
}

/// Converts a time to its key, ns. A clock that was never set may be before 1970, and 64 bits end in 2262:
/// such times are clamped to +-4.6e18 ns, so that differences of two keys fit too.
fn nanoseconds(time_s: f64) -> i64 {
    const END: f64 = 4.6e18;
    (time_s * 1e9).round().clamp(-END, END) as i64
}

/// Maximum number of checks with the same time (a clock that stands still or is out of range).
const SAME_TIME: i64 = 1_000_000;

impl Store {
    /// Opens a store and creates missing tables: `sqlite:FILE` or `postgres://USER:PASSWORD@HOST/DATABASE`; a
    /// plain path is a SQLite file.
    ///
    /// # Errors
    ///
    /// The database cannot be reached or is of a later version.
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
        let fault = |message: String| StoreError { url: shown(&url), message, passing: false };
        let refused = |e: sqlx::Error| StoreError { passing: is_passing(&e), ..fault(e.to_string()) };
        // SQLite follows links and blocks on a FIFO.
        if let Some(file) =
            url.strip_prefix("sqlite:").and_then(|f| f.trim_start_matches("//").split('?').next())
        {
            crate::output::must_be_file_or_new(file.as_ref()).map_err(|e| fault(e.to_string()))?;
        }
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|e| fault(e.to_string()))?;
        install_default_drivers();
        let pool = runtime.block_on(async {
            // A single connection reports the cause of a failure; a pool reports only its timeout.
            let one = sqlx::AnyConnection::connect(&url).await.map_err(refused)?;
            one.close().await.map_err(refused)?;
            let wait = std::time::Duration::from_secs(10);
            let pool = AnyPoolOptions::new().max_connections(1).acquire_timeout(wait).connect(&url).await;
            let pool = pool.map_err(refused)?;
            MIGRATIONS.run(&pool).await.map_err(|e| match e {
                MigrateError::Execute(e) | MigrateError::ExecuteMigration(e, _) => refused(e),
                e => fault(e.to_string()),
            })?;
            Ok(pool)
        })?;
        let path = url.strip_prefix("sqlite:").and_then(|rest| rest.split('?').next());
        let file = path.map(PathBuf::from).and_then(|path| Some((path.clone(), inode(&path)?)));
        Ok(Self { pool, runtime, url: shown(&url), file })
    }

    /// Reopens a SQLite database whose file was replaced.
    ///
    /// # Errors
    ///
    /// The file is missing (transient), or the new one cannot be opened.
    pub fn follow(&mut self) -> Result<(), StoreError> {
        let Some((path, known)) = &self.file else { return Ok(()) };
        match inode(path) {
            Some(now) if now == *known => Ok(()),
            Some(_) => {
                *self = Self::open(&path.to_string_lossy())?;
                Ok(())
            }
            None => Err(StoreError { passing: true, ..self.fault("the file is not there") }),
        }
    }

    fn fault(&self, e: impl std::fmt::Display) -> StoreError {
        StoreError { url: self.url.clone(), message: e.to_string(), passing: false }
    }

    /// Stores a check and its alarms in one transaction.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn keep(
        &self,
        camera: &str,
        calibration: &str,
        check: &Check,
        alarms: &[Alarm],
    ) -> Result<(), StoreError> {
        let body = serde_json::to_string(check).map_err(|e| self.fault(e))?;
        self.keep_as(camera, calibration, nanoseconds(check.time_s), &body, (check, alarms))
    }

    /// Stores a check unless it is stored already: the reply to an earlier attempt may have been lost. A
    /// different check of the same time (wrong clock) is stored beside it.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn keep_again(
        &self,
        camera: &str,
        calibration: &str,
        check: &Check,
        alarms: &[Alarm],
    ) -> Result<(), StoreError> {
        let body = serde_json::to_string(check).map_err(|e| self.fault(e))?;
        let first = nanoseconds(check.time_s);
        let taken = sqlx::query(
            "SELECT time_ns, body FROM checks WHERE camera = $1 AND time_ns >= $2 AND time_ns < $3",
        )
        .bind(camera)
        .bind(first)
        .bind(first + SAME_TIME);
        let rows = self.runtime.block_on(taken.fetch_all(&self.pool)).map_err(|e| self.refused(e))?;
        let mut times = BTreeSet::new();
        for row in rows {
            let (time_ns, kept): (i64, String) = row
                .try_get(0)
                .and_then(|time_ns| Ok((time_ns, row.try_get(1)?)))
                .map_err(|e| self.refused(e))?;
            if kept == body {
                return Ok(());
            }
            times.insert(time_ns);
        }
        let free = (first..first + SAME_TIME).find(|time_ns| !times.contains(time_ns)).unwrap_or(first);
        self.keep_as(camera, calibration, free, &body, (check, alarms))
    }

    fn refused(&self, e: sqlx::Error) -> StoreError {
        StoreError { passing: is_passing(&e), ..self.fault(e) }
    }

    fn keep_as(
        &self,
        camera: &str,
        calibration: &str,
        time_ns: i64,
        body: &str,
        (check, alarms): (&Check, &[Alarm]),
    ) -> Result<(), StoreError> {
        let work = async {
            let mut all = self.pool.begin().await?;
            sqlx::query("INSERT INTO checks (camera, calibration, time_ns, body) VALUES ($1, $2, $3, $4)")
                .bind(camera)
                .bind(calibration)
                .bind(time_ns)
                .bind(body)
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
        self.runtime.block_on(work).map_err(|e| self.refused(e))
    }

    /// Returns the checks of a camera under a calibration, the oldest first.
    ///
    /// # Errors
    ///
    /// The database reports an error, or a row was changed by hand.
    pub fn checks(&self, camera: &str, calibration: &str) -> Result<Vec<Check>, StoreError> {
        let query =
            sqlx::query("SELECT body FROM checks WHERE camera = $1 AND calibration = $2 ORDER BY time_ns")
                .bind(camera)
                .bind(calibration);
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        self.read(camera, &rows)
    }

    /// Returns the checks of a camera under all calibrations, the oldest first.
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

    /// Returns every camera that was checked.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn cameras(&self) -> Result<Vec<String>, StoreError> {
        let query = sqlx::query("SELECT DISTINCT camera FROM checks ORDER BY camera");
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        rows.iter().map(|row| row.try_get(0).map_err(|e| self.fault(e))).collect()
    }

    /// Returns every alarm of a camera: name, time and sentence, the oldest first.
    ///
    /// # Errors
    ///
    /// The database reports an error.
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

    /// Rebuilds the monitor from the stored checks.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn monitor(&self, camera: &str, calibration: &str, limits: Limits) -> Result<Monitor, StoreError> {
        let mut monitor = Monitor::new(limits);
        for check in self.checks(camera, calibration)? {
            monitor.add(check);
        }
        Ok(monitor)
    }
}

/// Returns the name of a change, as in JSON.
pub fn name(what: Changed) -> String {
    serde_json::to_value(what).ok().and_then(|w| w.as_str().map(Into::into)).unwrap_or_default()
}
