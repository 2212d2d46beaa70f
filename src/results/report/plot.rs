//! Plots of series as SVG: linear and logarithmic axes, points with error bars, curves with bands, steps, and
//! a legend below.

use crate::plot::{Axis, Plot, Series, Shape};
use maud::{Markup, html};
use serde_json::json;

/// Width and height of a plot, user units, and its margins: left, top, right, bottom.
const SIZE: (f64, f64) = (440.0, 262.0);
const MARGIN: [f64; 4] = [62.0, 10.0, 14.0, 46.0];

/// Colours that colour-blind readers can tell apart (Okabe and Ito, 2008). The page's style defines them.
const COLOURS: [&str; 5] = ["var(--c0)", "var(--c1)", "var(--c2)", "var(--c3)", "var(--c4)"];

/// Linear or logarithmic scale from values to user units.
struct Scale {
    log: bool,
    from: f64,
    to: f64,
    at: (f64, f64),
}

impl Scale {
    fn of(axis: &Axis, values: impl Iterator<Item = f64>, at: (f64, f64)) -> Self {
        let sound = values.filter(|v| v.is_finite() && (!axis.log || *v > 0.0));
        let (mut from, mut to) =
            sound.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
        if from > to {
            (from, to) = if axis.log { (0.1, 1.0) } else { (0.0, 1.0) };
        }
        if axis.log {
            // At most six decades; smaller values are clipped.
            from = from.max(to * 1e-6);
            let room = (to / from).powf(0.04).max(1.05);
            (from, to) = (from / room, to * room);
        } else {
            let room = if to > from { 0.04 * (to - from) } else { 0.5 * to.abs().max(1.0) };
            // A scale that begins at 0 has no margin below.
            (from, to) = (if from == 0.0 { 0.0 } else { from - room }, to + room);
        }
        Self { log: axis.log, from, to, at }
    }

    fn unit(&self, v: f64) -> f64 {
        if self.log {
            (v.max(f64::MIN_POSITIVE) / self.from).ln() / (self.to / self.from).ln()
        } else {
            (v - self.from) / (self.to - self.from)
        }
    }

    /// Converts to user units. Values outside the scale are clamped to its ends.
    fn px(&self, v: f64) -> f64 {
        self.at.0 + (self.at.1 - self.at.0) * self.unit(v).clamp(0.0, 1.0)
    }

    fn holds(&self, v: f64) -> bool {
        v.is_finite() && (-0.001..=1.001).contains(&self.unit(v))
    }

    fn ticks(&self, count: f64) -> Vec<(f64, String)> {
        if !self.log {
            let all = super::svg::ticks((self.from, self.to), count);
            return all.into_iter().map(|v| (v, linear(v))).collect();
        }
        let (low, high) = (self.from.log10().ceil() as i32, self.to.log10().floor() as i32);
        let decades: Vec<(f64, String)> = (low..=high).map(|e| (10f64.powi(e), power(e))).collect();
        if decades.len() > 2 {
            let every = decades.len().div_ceil(6);
            return decades.into_iter().step_by(every).collect();
        }
        // Within a decade or two: some multiples of each decade.
        let narrow = self.to / self.from < 12.0;
        let multiples: &[f64] = if narrow { &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0] } else { &[1.0, 2.0, 5.0] };
        let of = |e: i32| multiples.iter().map(move |m| m * 10f64.powi(e));
        (low - 1..=high).flat_map(of).filter(|v| self.holds(*v)).map(|v| (v, linear(v))).collect()
    }
}

/// Formats a number of an axis, with thousands separators and without rounding noise.
fn linear(v: f64) -> String {
    let a = v.abs();
    if a > 0.0 && !(1e-3..1e6).contains(&a) {
        let e = a.log10().floor() as i32;
        let m = (v / 10f64.powi(e) * 1e6).round() / 1e6;
        return if m == 1.0 { power(e) } else { format!("{m}·{}", power(e)) };
    }
    let rounded = (v * 1e9).round() / 1e9 + 0.0;
    if a < 1e4 {
        return format!("{rounded}");
    }
    format!("{}\u{202f}{:03}", (rounded / 1000.0).trunc(), (rounded.abs() % 1000.0).round())
}

fn power(exponent: i32) -> String {
    let digit = |c: char| match c {
        '-' => '⁻',
        '0' => '⁰',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        c => char::from_u32('⁰' as u32 + c.to_digit(10).unwrap_or(0)).unwrap_or(c),
    };
    match exponent {
        0 => "1".into(),
        1 => "10".into(),
        e => format!("10{}", e.to_string().chars().map(digit).collect::<String>()),
    }
}

/// Maximum points of a curve: the resolution of a plot of this width.
const CURVE: usize = 900;

fn path(points: impl Iterator<Item = (f64, f64)>) -> String {
    points.map(|(x, y)| format!("{x:.1},{y:.1}")).collect::<Vec<_>>().join(" ")
}

fn drawn(s: &Series, colour: &str, x: &Scale, y: &Scale) -> Markup {
    let seen = |p: &&[f64; 3]| {
        x.holds(p[0]) && p[1].is_finite() && (!y.log || p[1] > 0.0 || s.shape == Shape::Steps)
    };
    let points: Vec<&[f64; 3]> = s.points.iter().filter(seen).collect();
    let place = |p: &[f64; 3]| (x.px(p[0]), y.px(p[1]));
    match s.shape {
        Shape::Points => html! {
            @for p in &points {
                @let (px, py) = place(p);
                g {
                    title { (s.label) ": " (linear(significant(p[0]))) ", " (linear(significant(p[1])))
                        @if p[2].is_finite() { " ± " (linear(significant(p[2]))) } }
                    @if p[2].is_finite() && (y.px(p[1] - p[2]) - y.px(p[1] + p[2])).abs() > 5.0 {
                        line x1=(fine(px)) x2=(fine(px)) y1=(fine(y.px(p[1] - p[2]))) y2=(fine(y.px(p[1] + p[2]))) stroke=(colour) {}
                    }
                    circle cx=(fine(px)) cy=(fine(py)) r="2.4" fill=(colour) {}
                }
            }
        },
        Shape::Line | Shape::Dashed => {
            let step = points.len().div_ceil(CURVE).max(1);
            let shown = || points.iter().step_by(step);
            let banded = s.points.iter().any(|p| p[2].is_finite());
            let edge =
                |sign: f64| shown().map(move |p| (x.px(p[0]), y.px(p[1] + sign * p[2]))).collect::<Vec<_>>();
            let band = banded.then(|| path(edge(1.0).into_iter().chain(edge(-1.0).into_iter().rev())));
            html! {
                @if let Some(band) = band { polygon points=(band) fill=(colour) opacity="0.22" {} }
                polyline points=(path(shown().map(|p| place(p)))) fill="none" stroke=(colour)
                    stroke-width="1.3" stroke-dasharray=[(s.shape == Shape::Dashed).then_some("5 3")] {}
            }
        }
        Shape::Steps => {
            let ends = points.windows(2).flat_map(|w| [place(w[0]), (x.px(w[1][0]), y.px(w[0][1]))]);
            let all = ends.chain(points.last().map(|p| place(p)));
            html! { polyline points=(path(all)) fill="none" stroke=(colour) stroke-width="1.2" {} }
        }
    }
}

/// Splits a text into pieces, each flagged if it is a subscript: `σ²_y.dark (DN²)` has one, `y.dark`.
fn pieces(text: &str) -> Vec<(String, bool)> {
    let mut out = vec![(String::new(), false)];
    for c in text.chars() {
        let below = out.last().is_some_and(|p| p.1);
        match c {
            '_' => out.push((String::new(), true)),
            c if below && !(c.is_alphanumeric() || c == '.') => out.push((c.to_string(), false)),
            c => {
                if let Some(last) = out.last_mut() {
                    last.0.push(c);
                }
            }
        }
    }
    out
}

/// Renders a symbol with its subscripts.
pub fn in_html(text: &str) -> Markup {
    html! { @for (piece, below) in pieces(text) { @if below { sub { (piece) } } @else { (piece) } } }
}

fn in_svg(text: &str) -> Markup {
    let mut low = false;
    let shifted = pieces(text).into_iter().map(|(piece, below)| {
        let shift = [["0", "3"], ["-3", "0"]][usize::from(low)][usize::from(below)];
        low = below;
        (piece, below, shift)
    });
    html! {
        @for (piece, below, shift) in shifted {
            tspan dy=(shift) font-size=[below.then_some("9")] { (piece) }
        }
    }
}

/// Formats a coordinate to a tenth of a unit.
fn fine(v: f64) -> String {
    format!("{v:.1}")
}

/// Rounds to five significant digits.
fn significant(v: f64) -> f64 {
    format!("{v:.4e}").parse().unwrap_or(v)
}

/// Returns the values of a series that its scale must include.
fn ends(s: &Series) -> impl Iterator<Item = f64> {
    let bars = s.shape == Shape::Points;
    s.points.iter().flat_map(move |p| {
        let e = if bars && p[2].is_finite() { p[2] } else { 0.0 };
        [p[1] - e, p[1] + e]
    })
}

/// Describes a plot for the script, which reads the numbers from the CSV.
fn description(plot: &Plot) -> String {
    let axis = |a: &Axis| json!({ "title": a.title, "log": a.log });
    let shape = |s: Shape| match s {
        Shape::Points => "points",
        Shape::Line => "line",
        Shape::Dashed => "dashed",
        Shape::Steps => "steps",
    };
    let series: Vec<_> =
        plot.series.iter().map(|s| json!({ "label": s.label, "shape": shape(s.shape) })).collect();
    let range = plot.y_range.map(|(a, b)| [a, b]);
    json!({ "x": axis(&plot.x), "y": axis(&plot.y), "range": range, "series": series }).to_string()
}

/// Encodes text for a `data:` URL.
fn in_address(text: &str) -> String {
    let mut out = String::with_capacity(text.len() + text.len() / 8);
    for byte in text.bytes() {
        match byte {
            b'0'..=b'9' | b'a'..=b'z' | b'A'..=b'Z' | b'.' | b',' | b'-' | b'_' => out.push(char::from(byte)),
            byte => out += &format!("%{byte:02X}"),
        }
    }
    out
}

/// Renders a figure: title, plot, legend, and its numbers as CSV.
pub fn figure(plot: &Plot) -> Markup {
    figure_of(plot, "")
}

/// Renders a figure at full page width.
#[cfg(feature = "cli")]
pub fn wide(plot: &Plot) -> Markup {
    figure_of(plot, "wide")
}

fn figure_of(plot: &Plot, class: &str) -> Markup {
    let (width, height) = SIZE;
    let [left, top, right, bottom] = MARGIN;
    let all = || plot.series.iter().flat_map(|s| &s.points);
    let x = Scale::of(&plot.x, all().map(|p| p[0]), (left, width - right));
    let at = (height - bottom, top);
    let y = match plot.y_range {
        Some((from, to)) => Scale { log: false, from, to, at },
        // Include the error bars.
        None => Scale::of(&plot.y, plot.series.iter().flat_map(ends), at),
    };
    let (low, high) = (height - bottom, top);
    html! {
        figure class=(class) data-plot=(description(plot)) {
            h3 { (in_html(&plot.title)) }
            svg viewBox={ "0 0 " (width) " " (height) } role="img" aria-label=(plot.title) {
                @for (v, label) in y.ticks(5.0) {
                    line x1=(left) x2=(width - right) y1=(fine(y.px(v))) y2=(fine(y.px(v))) stroke="var(--line)" {}
                    text x=(left - 6.0) y=(fine(y.px(v) + 3.5)) text-anchor="end" .soft { (label) }
                }
                @for (v, label) in x.ticks(5.0) {
                    line x1=(fine(x.px(v))) x2=(fine(x.px(v))) y1=(low) y2=(low + 4.0) stroke="var(--soft)" {}
                    text x=(fine(x.px(v))) y=(low + 16.0) text-anchor="middle" .soft { (label) }
                }
                @for (i, s) in plot.series.iter().enumerate() { (drawn(s, COLOURS[i % COLOURS.len()], &x, &y)) }
                polyline points=(path([(left, high), (left, low), (width - right, low)].into_iter())) fill="none" stroke="var(--soft)" {}
                text x=(f64::midpoint(left, width - right)) y=(height - 10.0) text-anchor="middle" { (in_svg(&plot.x.title)) }
                text transform={ "translate(13," (f64::midpoint(low, high)) ") rotate(-90)" } text-anchor="middle" { (in_svg(&plot.y.title)) }
            }
            p.legend {
                @for (i, s) in plot.series.iter().enumerate() {
                    span {
                        @let colour = COLOURS[i % COLOURS.len()];
                        svg.key viewBox="0 0 18 8" aria-hidden="true" {
                            @if s.shape == Shape::Points { circle cx="9" cy="4" r="3" fill=(colour) {} }
                            @else {
                                line x1="0" x2="18" y1="4" y2="4" stroke=(colour) stroke-width="2"
                                    stroke-dasharray=[(s.shape == Shape::Dashed).then_some("5 3")] {}
                            }
                        }
                        (in_html(&s.label))
                    }
                }
            }
            @let name = format!("{}.csv", plot.id);
            figcaption { a.csv download=(name) href={ "data:text/csv," (in_address(&plot.csv())) } { "CSV" span.hidden { " of " (plot.title) } } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn subscripts_end_with_their_word() {
        let of = |text| in_html(text).into_string();
        assert_eq!(of("signal μ_y − μ_y.dark (DN)"), "signal μ<sub>y</sub> − μ<sub>y.dark</sub> (DN)");
        assert_eq!(of("|K_i − K|/K"), "|K<sub>i</sub> − K|/K");
    }

    #[test]
    fn numbers_of_axes_are_short() {
        for (v, said) in [
            (0.0, "0"),
            (0.5, "0.5"),
            (-2000.0, "-2000"),
            (12_000.0, "12\u{202f}000"),
            (2e-5, "2·10⁻⁵"),
            (1e6, "10⁶"),
        ] {
            assert_eq!(linear(v), said);
        }
        let axis = |log| Axis { title: String::new(), log };
        let log = Scale::of(&axis(true), [1.0, 1e4].into_iter(), (0.0, 100.0));
        let labels: Vec<String> = log.ticks(5.0).into_iter().map(|t| t.1).collect();
        assert_eq!(labels, ["1", "10", "10²", "10³", "10⁴"]);
        assert!(log.px(100.0) > 45.0 && log.px(100.0) < 55.0);
        // An empty plot must still have a finite scale.
        let none = Scale::of(&axis(false), [f64::NAN].into_iter(), (0.0, 1.0));
        assert!(none.px(0.5).is_finite());
    }
}
