//! Photon-transfer page: points, line, residuals, estimators, levels.

use super::svg::{Mark, Panel, picture, range};
use super::{page, scrolled};
use crate::noise::{LevelReport, NoiseReport};
use crate::number::Quantity;
use crate::number::with_error;
use maud::{Markup, html};

/// True parameters of a simulated camera, for comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// A, DN per electron.
    pub gain_dn_per_e: f64,
    /// sigma_C^2, DN^2.
    pub constant_noise_var_dn2: f64,
    /// sigma_R, electrons.
    pub read_noise_e: f64,
}

impl Truth {
    /// Returns (name, measured, truth) for each quantity.
    pub fn rows<'a>(&self, r: &'a NoiseReport) -> [(&'static str, &'a Quantity, f64); 3] {
        [
            ("system gain A", &r.gain_dn_per_e, self.gain_dn_per_e),
            ("constant noise", &r.constant_noise_var_dn2, self.constant_noise_var_dn2),
            ("read noise", &r.read_noise_e, self.read_noise_e),
        ]
    }
}

/// Returns the distance from the truth in standard errors.
pub fn sigmas(measured: &Quantity, truth: f64) -> f64 {
    (measured.value - truth) / measured.std_err
}

/// Renders the page of a noise estimate.
pub fn html(title: &str, subtitle: &str, report: &NoiseReport, truth: Option<&Truth>) -> String {
    let used = report.levels.iter().filter(|l| l.used).count();
    let class = if report.consistent() { "good" } else { "bad" };
    let verdict = html! { b class=(class) { (report.line().of_a_line()) } };
    let body = html! {
        div.cards {
            div { span { "system gain A, photon transfer" } b { (report.gain_dn_per_e.to_string()) } }
            div { span { "constant noise σ" sub { "C" } "²" } b { (report.constant_noise_var_dn2.to_string()) } }
            div { span { "read noise σ" sub { "R" } } b { (report.read_noise_e.to_string()) } }
            div { span { "χ² = " (format!("{:.1}", report.chi2)) " for " (report.dof) " degrees of freedom, Q = "
                (format!("{:.3}", report.q)) } (verdict) }
        }
        @if let Some(truth) = truth {
            h2 { "Against the truth" }
            table {
                tr { th {} th { "measured" } th { "truth" } th { "difference" } }
                @for (name, measured, truth) in truth.rows(report) {
                    @let z = sigmas(measured, truth);
                    tr {
                        td { (name) }
                        td { (measured.to_string()) }
                        td { (format!("{truth:.5}")) }
                        td class=(if z.abs() <= 3.0 { "good" } else { "bad" }) { (format!("{z:+.1} σ")) }
                    }
                }
            }
        }
        h2 { "Photon transfer" }
        (plot(report))
        h2 { "Estimators" }
        (scrolled("estimators", html! { table {
            tr { th.text { "method" } th { "A (DN/e⁻)" } th { "σ" sub { "C" } "² (DN²)" } th { "χ²" } th { "dof" } th { "Q" } }
            @for e in &report.estimators {
                tr {
                    td { (format!("{:?}", e.method).to_lowercase()) }
                    td { (with_error(e.gain_dn_per_e.value, e.gain_dn_per_e.std_err)) }
                    td { (with_error(e.constant_noise_var_dn2.value, e.constant_noise_var_dn2.std_err)) }
                    td { (format!("{:.2}", e.chi2)) } td { (e.dof) } td { (format!("{:.4}", e.q)) }
                }
            }
        } }))
        h2 { "Levels" }
        p.sub {
            (used) " of " (report.levels.len()) " levels used. Means are counted from the black level, "
            (with_error(report.offset_dn.value, report.offset_dn.std_err)) " DN (" (report.offset_source) ")."
        }
        @for fault in &report.data_faults { p.bad { (fault.to_string()) } }
        @for note in &report.notes { p { (note) } }
        (scrolled("levels", html! { table {
            tr { th { "set" } th { "mean (DN)" } th { "variance (DN²)" } th { "residual (σ)" } th.text { "note" } }
            @for l in &report.levels {
                tr class=(if l.used { "" } else { "out" }) {
                    td { (l.set) " " (l.kind) }
                    td { (format!("{:.2}", l.mean_dn)) }
                    td { (with_error(l.var_dn2, l.var_std_err_dn2)) }
                    td { (format!("{:+.2}", l.z)) }
                    td.text { (l.excluded_because.as_deref().unwrap_or("")) }
                }
            }
        } }))
    };
    page(title, subtitle, body)
}

/// Plots the variance against the mean with the fitted line, and the residuals below.
pub fn plot(report: &NoiseReport) -> Markup {
    let (a, c) = (report.gain_dn_per_e.value, report.constant_noise_var_dn2.value);
    let levels = &report.levels;
    let x = range(levels.iter().map(|l| l.mean_dn).chain([0.0]));
    let top = Panel {
        frame: [72.0, 14.0, 770.0, 330.0],
        x,
        y: range(levels.iter().map(|l| l.var_dn2).chain([0.0])),
    };
    let limit = levels.iter().filter(|l| l.used).map(|l| l.z.abs()).fold(3.5, f64::max).min(50.0) * 1.1;
    let low = Panel { frame: [72.0, 372.0, 770.0, 120.0], x, y: (-limit, limit) };
    let title = |l: &LevelReport| {
        format!(
            "set {} ({}): mean {:.2} DN, variance {:.3} DN², {:+.2} σ",
            l.set, l.kind, l.mean_dn, l.var_dn2, l.z
        )
    };
    let mark = |l: &LevelReport, y, error| Mark { x: l.mean_dn, y, error, out: !l.used, title: title(l) };
    let points: Vec<Mark> = levels.iter().map(|l| mark(l, l.var_dn2, l.var_std_err_dn2)).collect();
    let residuals: Vec<Mark> = levels.iter().map(|l| mark(l, l.z, 1.0)).collect();
    let from = x.0.max(-c / a);
    let body = html! {
        (top.axes("", "variance (DN²)", false))
        (top.line((from, a * from + c), (x.1, a * x.1 + c), "var(--fit)"))
        (top.marks(&points))
        text x="100" y="38" { "σ² = A μ + σ" tspan dy="4" font-size="9" { "C" } tspan dy="-4" { "²" } }
        (low.axes("mean above the black level (DN)", "residual (σ)", true))
        (low.band(-1.0, 1.0)) (low.band(-2.0, 2.0))
        (low.line((x.0, 0.0), (x.1, 0.0), "var(--fit)"))
        (low.marks(&residuals))
    };
    picture(860.0, 545.0, "photon transfer: variance against mean, with residuals", body)
}
