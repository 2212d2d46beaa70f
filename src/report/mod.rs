//! Reports as single HTML files: no scripts, no fonts, nothing fetched.

pub mod budget;
pub mod compare;
pub mod noise;
pub mod reproduce;
pub mod svg;

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// Colours and measures of every page; the system's dark mode is followed.
const STYLE: &str = "
:root { --ink: #1b1f24; --soft: #5b6570; --line: #d5dae0; --page: #ffffff; --card: #f6f8fa;
  --data: #0b5fa5; --fit: #c2410c; --good: #1a7f37; --bad: #b3261e; --band: #0b5fa51c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ed; --soft: #9aa5b1; --line: #37404a; --page: #14181d;
  --card: #1c2229; --data: #62b0f0; --fit: #ff9257; --good: #4cc26a; --bad: #ff7b72; --band: #62b0f024; } }
body { font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--page); margin: 2rem auto;
  max-width: 60rem; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin: 0 0 .2rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
p.sub { color: var(--soft); margin: 0 0 1.5rem; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
th, td { text-align: right; padding: .25rem .7rem; border-bottom: 1px solid var(--line); }
th { color: var(--soft); font-weight: 600; } th:first-child, td:first-child { text-align: left; }
td.text, th.text { text-align: left; }
tr.out td { color: var(--soft); } .good { color: var(--good); } .bad { color: var(--bad); }
.cards { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1rem 0; }
.cards div { background: var(--card); border-radius: .5rem; padding: .7rem 1rem; flex: 1 1 12rem; }
.cards b { display: block; font-size: 1.05rem; white-space: nowrap; font-variant-numeric: tabular-nums; }
.cards span { color: var(--soft); font-size: .85rem; }
svg { width: 100%; height: auto; } svg text { fill: var(--ink); font: 12px system-ui, sans-serif; }
span.note { color: var(--soft); font-size: .85rem; }
svg .soft { fill: var(--soft); }
";

/// A whole page.
fn page(title: &str, subtitle: &str, body: Markup) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                p.sub { (subtitle) }
                (body)
            }
        }
    }
    .into_string()
}

/// A value and its error with as many digits as the error is worth: `0.38004 ± 0.00021`.
///
/// ```
/// use radcam::report::with_error;
/// assert_eq!(with_error(0.380041, 0.000213), "0.38004 ± 0.00021");
/// assert_eq!(with_error(1234.5, 56.0), "1234 ± 56"); // ties go to the even digit
/// assert_eq!(with_error(2.5, f64::NAN), "2.5");
/// assert_eq!(with_error(2.134e-6, 1.1e-7), "(2.13 ± 0.11)e-6");
/// assert_eq!(with_error(3_937_768.0, 283_911.0), "(3.94 ± 0.28)e6");
/// ```
pub fn with_error(value: f64, std_err: f64) -> String {
    let size = value.abs().max(std_err);
    if size > 0.0 && !(1e-4..1e6).contains(&size) && std_err > 0.0 {
        let power = size.log10().floor() as i32;
        let unit = 10f64.powi(power);
        return format!("({})e{power}", with_error(value / unit, std_err / unit));
    }
    match digits(std_err) {
        Some(digits) => format!("{value:.digits$} ± {std_err:.digits$}"),
        None => format!("{value}"),
    }
}

/// A value whose error is not known, to six digits: `0.216947`.
///
/// ```
/// use radcam::report::six_digits;
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

/// A value with its error and its unit as people write it; shares and choices have none.
///
/// ```
/// use radcam::report::with_unit;
/// assert_eq!(with_unit(7.25, 0.31, "DN^2"), "7.25 ± 0.31 DN²");
/// assert_eq!(with_unit(0.0124, 0.0011, "1"), "0.0124 ± 0.0011");
/// ```
pub fn with_unit(value: f64, std_err: f64, unit: &str) -> String {
    format!("{} {}", with_error(value, std_err), pretty(unit)).trim_end().into()
}

/// A unit as people write it.
pub fn pretty(unit: &str) -> &str {
    match unit {
        "DN^2" => "DN²",
        "DN/e" => "DN/e⁻",
        "e" => "e⁻",
        "1" | "choice" => "",
        other => other,
    }
}

/// A chance, as people write it.
///
/// ```
/// use radcam::report::chance;
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

/// Decimals that show two digits of an error.
fn digits(std_err: f64) -> Option<usize> {
    (std_err.is_finite() && std_err > 0.0).then(|| (1.0 - std_err.log10().floor()).clamp(0.0, 12.0) as usize)
}

/// A share in per cent, with a word where rounding would say all or nothing.
pub fn percent(share: f64) -> String {
    match share {
        s if s > 0.999 => "more than 99.9 %".into(),
        s if s < 0.001 => "less than 0.1 %".into(),
        s if !(0.01..=0.99).contains(&s) => format!("{:.1} %", 100.0 * s),
        s => format!("{:.0} %", 100.0 * s),
    }
}
