//! Plots as SVG: axes, points with error bars, lines and bands. Each point has a tooltip with its numbers.

use maud::{Markup, html};

/// A panel in data coordinates.
#[derive(Debug, Clone)]
pub struct Panel {
    /// Left, top, width, height in the picture, user units.
    pub frame: [f64; 4],
    /// Range of x.
    pub x: (f64, f64),
    /// Range of y.
    pub y: (f64, f64),
}

/// A point with an error bar.
#[derive(Debug, Clone)]
pub struct Mark {
    /// Abscissa.
    pub x: f64,
    /// Ordinate.
    pub y: f64,
    /// Half length of the error bar.
    pub error: f64,
    /// Drawn hollow and grey.
    pub out: bool,
    /// Tooltip.
    pub title: String,
}

/// Returns the range of the values with a small margin. The range is never empty.
pub fn range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (min, max) = values
        .filter(|v| v.is_finite())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    if min > max {
        return (0.0, 1.0);
    }
    let room = if max > min { 0.04 * (max - min) } else { 0.5 * min.abs().max(1.0) };
    (min - room, max + room)
}

/// Returns about `count` round numbers within a range.
pub fn ticks((min, max): (f64, f64), count: f64) -> Vec<f64> {
    let raw = (max - min) / count;
    if !(raw.is_finite() && raw > 0.0) {
        return Vec::new();
    }
    let power = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= 0.75 * raw).unwrap_or(raw);
    let first = (min / step).ceil();
    (0..100).map(|i| (first + f64::from(i)) * step).take_while(|t| *t <= max + 1e-9 * step).collect()
}

/// Formats a tick without rounding noise.
fn label(tick: f64) -> String {
    let rounded = (tick * 1e9).round() / 1e9;
    if rounded != 0.0 && (rounded.abs() >= 1e5 || rounded.abs() < 1e-3) {
        format!("{rounded:.0e}")
    } else {
        format!("{rounded}")
    }
}

impl Panel {
    fn px(&self, x: f64) -> f64 {
        let [left, _, width, _] = self.frame;
        left + width * (x - self.x.0) / (self.x.1 - self.x.0)
    }

    fn py(&self, y: f64) -> f64 {
        let [_, top, _, height] = self.frame;
        let y = y.clamp(self.y.0, self.y.1);
        top + height * (1.0 - (y - self.y.0) / (self.y.1 - self.y.0))
    }

    /// Renders frame, ticks and titles; prints numbers below the axis if `numbers` is set.
    pub fn axes(&self, x_title: &str, y_title: &str, numbers: bool) -> Markup {
        let [left, top, width, height] = self.frame;
        let (right, bottom) = (left + width, top + height);
        let y_ticks = ticks(self.y, (height / 45.0).max(4.0));
        html! {
            @for y in y_ticks {
                line x1=(left) x2=(right) y1=(self.py(y)) y2=(self.py(y)) stroke="var(--line)" {}
                text x=(left - 8.0) y=(self.py(y) + 4.0) text-anchor="end" .soft { (label(y)) }
            }
            @for x in ticks(self.x, 8.0) {
                line x1=(self.px(x)) x2=(self.px(x)) y1=(bottom) y2=(bottom + 5.0) stroke="var(--soft)" {}
                @if numbers {
                    text x=(self.px(x)) y=(bottom + 19.0) text-anchor="middle" .soft { (label(x)) }
                }
            }
            line x1=(left) x2=(right) y1=(bottom) y2=(bottom) stroke="var(--soft)" {}
            text x=((left + right) / 2.0) y=(bottom + 38.0) text-anchor="middle" { (x_title) }
            text transform={ "translate(" (left - 52.0) "," (top + height / 2.0) ") rotate(-90)" }
                text-anchor="middle" { (y_title) }
        }
    }

    /// Renders a straight segment in data coordinates.
    pub fn line(&self, from: (f64, f64), to: (f64, f64), colour: &str) -> Markup {
        html! {
            line x1=(self.px(from.0)) y1=(self.py(from.1)) x2=(self.px(to.0)) y2=(self.py(to.1))
                stroke=(colour) stroke-width="1.5" {}
        }
    }

    /// Renders a curve through points in data coordinates.
    pub fn curve(&self, points: &[(f64, f64)], colour: &str) -> Markup {
        let path: Vec<String> =
            points.iter().map(|&(x, y)| format!("{:.1},{:.1}", self.px(x), self.py(y))).collect();
        html! { polyline points=(path.join(" ")) fill="none" stroke=(colour) stroke-width="1.8" {} }
    }

    /// Renders a horizontal band.
    pub fn band(&self, low: f64, high: f64) -> Markup {
        let [left, _, width, _] = self.frame;
        html! {
            rect x=(left) width=(width) y=(self.py(high)) height=(self.py(low) - self.py(high))
                fill="var(--band)" {}
        }
    }

    /// Renders points with error bars.
    pub fn marks(&self, marks: &[Mark]) -> Markup {
        self.coloured(marks, "var(--data)")
    }

    /// Renders points with error bars in a colour.
    pub fn coloured(&self, marks: &[Mark], colour: &str) -> Markup {
        html! {
            @for m in marks.iter().filter(|m| m.x.is_finite() && m.y.is_finite()) {
                @let colour = if m.out { "var(--soft)" } else { colour };
                g {
                    title { (m.title) }
                    @if m.error.is_finite() && m.error > 0.0 {
                        line x1=(self.px(m.x)) x2=(self.px(m.x)) y1=(self.py(m.y - m.error))
                            y2=(self.py(m.y + m.error)) stroke=(colour) stroke-width="1.5" {}
                    }
                    circle cx=(self.px(m.x)) cy=(self.py(m.y)) r="4" stroke=(colour) stroke-width="1.5"
                        fill=(if m.out { "var(--page)" } else { colour }) {}
                }
            }
        }
    }
}

/// Renders a whole picture.
pub fn picture(width: f64, height: f64, label: &str, body: Markup) -> Markup {
    html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox={ "0 0 " (width) " " (height) } role="img"
            aria-label=(label) { (body) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(ticks((0.0, 10.0), 5.0), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(ticks((-0.3, 0.31), 3.0), [-0.2, 0.0, 0.2]);
        assert!(ticks((1.0, 1.0), 5.0).is_empty() && ticks((f64::NAN, 1.0), 5.0).is_empty());
        let (a, b) = range([3.0, 3.0, f64::NAN].into_iter());
        assert!(a < 3.0 && b > 3.0);
    }
}
