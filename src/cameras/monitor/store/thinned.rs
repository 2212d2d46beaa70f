//! History for a page: counts, thinned curves, one page of alarms. The database thins the curves, so memory
//! does not grow with the history.

use super::{Store, StoreError, nanoseconds};
use crate::monitor::Followed;
use sqlx::Row;
use sqlx::any::AnyRow;
use std::collections::BTreeMap;

/// Maximum number of points of a curve.
const MAX_POINTS: i64 = 2000;

/// Time range of checks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Period {
    /// First check, s since 1970.
    pub from_s: f64,
    /// Last check, s since 1970.
    pub to_s: f64,
    /// Checks from the first to the last.
    pub checks: u64,
}

impl Period {
    fn bounds(&self) -> (i64, i64) {
        (nanoseconds(self.from_s), nanoseconds(self.to_s))
    }
}

/// A reading, or the minimum or maximum of several.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Time, s since 1970.
    pub time_s: f64,
    /// Value.
    pub value: f64,
    /// Standard error; for several readings, their mean standard error.
    pub std_err: f64,
}

type Curves = BTreeMap<Followed, Vec<Point>>;

impl Store {
    /// Returns the time range of a camera's checks, limited to the last `days` if given; `None` without
    /// checks.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn period(&self, camera: &str, days: Option<f64>) -> Result<Option<Period>, StoreError> {
        let Some((_, last)) = self.span(camera, i64::MIN)? else { return Ok(None) };
        let from = days.map_or(i64::MIN, |d| last.saturating_sub(nanoseconds(d * 86_400.0)));
        let Some((first, last)) = self.span(camera, from)? else { return Ok(None) };
        let query =
            sqlx::query("SELECT COUNT(*) FROM checks WHERE camera = $1 AND time_ns BETWEEN $2 AND $3");
        let query = query.bind(camera).bind(first).bind(last);
        let row = self.runtime.block_on(query.fetch_one(&self.pool)).map_err(|e| self.fault(e))?;
        let checks = row.try_get::<i64, _>(0).map_err(|e| self.fault(e))?.unsigned_abs();
        Ok(Some(Period { from_s: seconds(first), to_s: seconds(last), checks }))
    }

    fn span(&self, camera: &str, from: i64) -> Result<Option<(i64, i64)>, StoreError> {
        let query =
            sqlx::query("SELECT MIN(time_ns), MAX(time_ns) FROM checks WHERE camera = $1 AND time_ns >= $2");
        let query = query.bind(camera).bind(from);
        let row = self.runtime.block_on(query.fetch_one(&self.pool)).map_err(|e| self.fault(e))?;
        let of = |k: usize| row.try_get::<Option<i64>, _>(k).map_err(|e| self.fault(e));
        Ok(of(0)?.zip(of(1)?))
    }

    /// Returns the curves of the readings in a period, each of at most 2000 points: all readings of up to
    /// 2000 checks, otherwise minimum and maximum in 1000 equal parts of the period.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn curves(&self, camera: &str, period: &Period) -> Result<Curves, StoreError> {
        let (from, to) = period.bounds();
        // Both ends were rounded to the microsecond as floating-point numbers.
        let (from, to) = (from.saturating_sub(ROUNDING_NS), to.saturating_add(ROUNDING_NS));
        let parts = if period.checks <= MAX_POINTS.unsigned_abs() { i64::MAX } else { MAX_POINTS / 2 };
        let width = if parts == i64::MAX { 1 } else { to.saturating_sub(from) / parts + 1 };
        let query = sqlx::query(
            "SELECT quantity, (time_ns - $4) / $5 AS part, MIN(time_ns), MAX(time_ns), MIN(value), MAX(value), AVG(std_err), COUNT(*) \
             FROM readings WHERE camera = $1 AND time_ns BETWEEN $2 AND $3 GROUP BY quantity, part ORDER BY quantity, part",
        );
        let query = query.bind(camera).bind(from).bind(to).bind(from).bind(width);
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        let mut out = Curves::new();
        for row in &rows {
            let (what, points) = points(row).map_err(|e| self.fault(e))?;
            if let Some(what) = what {
                out.entry(what).or_default().extend(points);
            }
        }
        Ok(out)
    }

    /// Returns the readings of the last 2000 checks of a period that raised an alarm.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn marked(&self, camera: &str, period: &Period) -> Result<Curves, StoreError> {
        let (from, to) = period.bounds();
        let query = sqlx::query(
            "SELECT quantity, time_ns, value, std_err FROM readings WHERE camera = $1 AND time_ns IN (SELECT DISTINCT time_ns FROM alarms \
             WHERE camera = $2 AND time_ns BETWEEN $3 AND $4 ORDER BY time_ns DESC LIMIT $5) ORDER BY time_ns",
        );
        let query = query
            .bind(camera)
            .bind(camera)
            .bind(from.saturating_sub(ROUNDING_NS))
            .bind(to.saturating_add(ROUNDING_NS))
            .bind(MAX_POINTS);
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        let mut out = Curves::new();
        for row in &rows {
            let read = || -> Result<_, sqlx::Error> {
                let point = Point {
                    time_s: seconds(row.try_get(1)?),
                    value: row.try_get(2)?,
                    std_err: row.try_get(3)?,
                };
                Ok((followed(row.try_get(0)?), point))
            };
            if let (Some(what), point) = read().map_err(|e| self.fault(e))? {
                out.entry(what).or_default().push(point);
            }
        }
        Ok(out)
    }

    /// Returns the number of alarms of a camera, and `count` of them, newest first, after the first `skip`:
    /// time and sentence.
    ///
    /// # Errors
    ///
    /// The database reports an error.
    pub fn alarms_page(
        &self,
        camera: &str,
        skip: u64,
        count: u64,
    ) -> Result<(u64, Vec<(f64, String)>), StoreError> {
        let all = sqlx::query("SELECT COUNT(*) FROM alarms WHERE camera = $1").bind(camera);
        let row = self.runtime.block_on(all.fetch_one(&self.pool)).map_err(|e| self.fault(e))?;
        let all = row.try_get::<i64, _>(0).map_err(|e| self.fault(e))?.unsigned_abs();
        let query = sqlx::query(
            "SELECT time_ns, sentence FROM alarms WHERE camera = $1 ORDER BY time_ns DESC, what LIMIT $2 OFFSET $3",
        );
        let bounded = |n: u64| i64::try_from(n).unwrap_or(i64::MAX);
        let query = query.bind(camera).bind(bounded(count)).bind(bounded(skip));
        let rows = self.runtime.block_on(query.fetch_all(&self.pool)).map_err(|e| self.fault(e))?;
        let read = |row: &AnyRow| Ok((seconds(row.try_get(0)?), row.try_get(1)?));
        let page = rows.iter().map(|row| read(row).map_err(|e: sqlx::Error| self.fault(e)));
        Ok((all, page.collect::<Result<_, _>>()?))
    }
}

/// Rounding margin, ns: a time in seconds as a 64-bit float is exact to some 0.3 microseconds.
const ROUNDING_NS: i64 = 1000;

fn seconds(time_ns: i64) -> f64 {
    time_ns as f64 * 1e-9
}

fn followed(name: &str) -> Option<Followed> {
    serde_json::from_value(serde_json::Value::String(name.into())).ok()
}

/// Returns one reading, or minimum and maximum of several.
fn points(row: &AnyRow) -> Result<(Option<Followed>, Vec<Point>), sqlx::Error> {
    let std_err: f64 = row.try_get(6)?;
    let point = |time: usize, value: usize| {
        Ok::<_, sqlx::Error>(Point {
            time_s: seconds(row.try_get(time)?),
            value: row.try_get(value)?,
            std_err,
        })
    };
    let mut out = vec![point(2, 4)?];
    if row.try_get::<i64, _>(7)? > 1 {
        out.push(point(3, 5)?);
    }
    Ok((followed(row.try_get(0)?), out))
}
