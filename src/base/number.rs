//! Numbers as text, rounded to their errors, and units.

use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;

/// A value with its standard error and unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Quantity {
    /// The value.
    #[serde(with = "finite")]
    pub value: f64,
    /// Standard error of the value.
    #[serde(with = "finite")]
    pub std_err: f64,
    /// Unit of both.
    pub unit: Cow<'static, str>,
}

impl Quantity {
    /// Creates a quantity from a value, its standard error and their unit.
    pub fn new(value: f64, std_err: f64, unit: &'static str) -> Self {
        Self { value, std_err, unit: unit.into() }
    }
}

/// Value, error and unit, as [`with_unit`] writes them.
impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&with_unit(self.value, self.std_err, &self.unit))
    }
}

/// JSON has no NaN: NaN is written as null, and read back as NaN.
pub(crate) mod finite {
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(x: &f64, s: S) -> Result<S::Ok, S::Error> {
        if x.is_finite() { s.serialize_f64(*x) } else { s.serialize_none() }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<f64, D::Error> {
        Ok(Option::deserialize(d)?.unwrap_or(f64::NAN))
    }
}

/// Formats a value and its error with the significant digits of the error: `0.38004 ± 0.00021`.
///
/// ```
/// use radcam::number::with_error;
/// assert_eq!(with_error(0.380041, 0.000213), "0.38004 ± 0.00021");
/// assert_eq!(with_error(1234.5, 56.0), "1234 ± 56"); // ties go to the even digit
/// assert_eq!(with_error(2.5, f64::NAN), "2.5");
/// assert_eq!(with_error(2.5, f64::INFINITY), "2.5"); // an error that nothing tells
/// assert_eq!(with_error(2.134e-6, 1.1e-7), "(2.13 ± 0.11)e-6");
/// assert_eq!(with_error(3_937_768.0, 283_911.0), "(3.94 ± 0.28)e6");
/// ```
pub fn with_error(value: f64, std_err: f64) -> String {
    let size = value.abs().max(std_err);
    if size > 0.0 && size.is_finite() && !(1e-4..1e6).contains(&size) && std_err > 0.0 {
        let power = size.log10().floor() as i32;
        let unit = 10f64.powi(power);
        return format!("({})e{power}", with_error(value / unit, std_err / unit));
    }
    match digits(std_err) {
        Some(digits) => format!("{value:.digits$} ± {std_err:.digits$}"),
        None => format!("{value}"),
    }
}

/// Formats a value of unknown error with six digits: `0.216947`.
///
/// ```
/// use radcam::number::six_digits;
/// assert_eq!(six_digits(0.21694656829898232), "0.216947");
/// assert_eq!(six_digits(110.76973488632103), "110.77");
/// assert_eq!(six_digits(0.0), "0");
/// ```
pub fn six_digits(value: f64) -> String {
    let power = if value == 0.0 { 0.0 } else { value.abs().log10().floor() };
    let digits = (5.0 - power).clamp(0.0, 12.0) as usize;
    let text = format!("{value:.digits$}");
    let text = if digits > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    text.into()
}

/// Formats a value with its error and its unit in usual notation; shares and choices have no unit.
///
/// ```
/// use radcam::number::with_unit;
/// assert_eq!(with_unit(7.25, 0.31, "DN^2"), "7.25 ± 0.31 DN²");
/// assert_eq!(with_unit(0.0124, 0.0011, "1"), "0.0124 ± 0.0011");
/// ```
pub fn with_unit(value: f64, std_err: f64, unit: &str) -> String {
    if value.is_nan() {
        return "not determined".into();
    }
    format!("{} {}", with_error(value, std_err), pretty(unit)).trim_end().into()
}

/// Returns a unit in usual notation.
pub fn pretty(unit: &str) -> &str {
    match unit {
        "DN^2" => "DN²",
        "DN/e" => "DN/e⁻",
        "e" => "e⁻",
        "e/s" => "e⁻/s",
        "e/DN" => "e⁻/DN",
        "DN^2/s" => "DN²/s",
        "p/um^2" => "p/µm²",
        "e/um^2" => "e⁻/µm²",
        "1" | "choice" => "",
        other => other,
    }
}

/// Formats a probability.
///
/// ```
/// use radcam::number::chance;
/// assert_eq!(chance(0.784), "0.78");
/// assert_eq!(chance(2.34e-210), "2.3e-210");
/// assert_eq!(chance(0.0), "< 1e-300"); // smaller than a number holds
/// ```
pub fn chance(p: f64) -> String {
    match p {
        p if p >= 0.01 => format!("{p:.2}"),
        p if p < 1e-300 => "< 1e-300".into(),
        p => format!("{p:.1e}"),
    }
}

/// Returns the number of decimals that show two digits of an error.
fn digits(std_err: f64) -> Option<usize> {
    (std_err.is_finite() && std_err > 0.0).then(|| (1.0 - std_err.log10().floor()).clamp(0.0, 12.0) as usize)
}

/// Formats a share in per cent, in words if rounding would give all or nothing.
pub fn percent(share: f64) -> String {
    match share {
        s if s > 0.999 => "more than 99.9 %".into(),
        s if s < 0.001 => "less than 0.1 %".into(),
        s if !(0.01..=0.99).contains(&s) => format!("{:.1} %", 100.0 * s),
        s => format!("{:.0} %", 100.0 * s),
    }
}

/// Formats numbers in ascending order as `0 to 3, 7`.
pub(crate) fn ranges(numbers: &[usize]) -> String {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for &n in numbers {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == n => *last = n,
            _ => runs.push((n, n)),
        }
    }
    let text = |(a, b): &(usize, usize)| match b - a {
        0 => a.to_string(),
        1 => format!("{a}, {b}"),
        _ => format!("{a} to {b}"),
    };
    runs.iter().map(text).collect::<Vec<_>>().join(", ")
}

/// Returns the seconds of a unit of time; `None` for another unit.
pub fn seconds(unit: &str) -> Option<f64> {
    Some(match unit.to_lowercase().as_str() {
        "s" | "sec" | "secs" | "second" | "seconds" => 1.0,
        "ms" | "msec" | "msecs" | "millisec" | "millisecond" | "milliseconds" => 1e-3,
        "us" | "usec" | "usecs" | "µs" | "μs" | "µsec" | "μsec" | "microsec" | "microsecond"
        | "microseconds" => 1e-6,
        "ns" | "nsec" | "nanosecond" | "nanoseconds" => 1e-9,
        "min" | "minute" | "minutes" => 60.0,
        _ => return None,
    })
}
