//! Residuals in words: statistics that deviate, their scaling, their axis and their frames.

use crate::inference::Residual;
use crate::number::pretty;

/// Deviation of one statistic.
#[derive(Debug, Clone, PartialEq)]
pub struct Signature {
    /// Its name.
    pub name: String,
    /// Description in words.
    pub text: String,
    /// Root mean square of its residuals.
    pub rms: f64,
    /// Chi-square above its expectation, in standard deviations.
    pub excess: f64,
}

/// Returns the statistics whose residuals are larger than chance allows, worst first.
pub fn signatures(residuals: &[Residual]) -> Vec<Signature> {
    let mut names: Vec<&String> = residuals.iter().map(|r| &r.observable).collect();
    names.sort();
    names.dedup();
    let mut out: Vec<Signature> = names
        .into_iter()
        .filter_map(|name| {
            let of: Vec<&Residual> = residuals.iter().filter(|r| &r.observable == name).collect();
            let n = of.len() as f64;
            let squares: f64 = of.iter().map(|r| r.z * r.z).sum();
            let excess = (squares - n) / (2.0 * n).sqrt();
            (excess > 5.0).then(|| Signature {
                name: name.clone(),
                text: describe(name, &of),
                rms: (squares / n).sqrt(),
                excess,
            })
        })
        .collect();
    out.sort_by(|a, b| b.excess.total_cmp(&a.excess));
    out
}

/// Maximum level of a set with hardly any light, DN (a named choice).
const DARK_DN: f64 = 20.0;

/// Ratio of a deviation to the prediction above which it is given in its unit and not in per cent (a named
/// choice).
const MANY_TIMES: f64 = 10.0;

fn describe(name: &str, of: &[&Residual]) -> String {
    let worst = of.iter().max_by(|a, b| a.z.abs().total_cmp(&b.z.abs()));
    let Some(worst) = worst else { return name.to_string() };
    let off = if worst.predicted.abs() > 5.0 * worst.std_err
        && (worst.measured - worst.predicted).abs() < MANY_TIMES * worst.predicted.abs()
    {
        let rel = (worst.measured - worst.predicted) / worst.predicted.abs();
        let decimals = if rel.abs() < 0.1 { 2 } else { 0 };
        format!("{:+.decimals$} % from the prediction", 100.0 * rel)
    } else {
        let unit = if worst.unit.is_empty() { String::new() } else { format!(" {}", pretty(&worst.unit)) };
        format!("{:+.3}{unit} from the prediction", worst.measured - worst.predicted)
    };
    let place = match worst.set {
        Some(set) => format!(" in set {set} (signal {:.0} DN)", worst.level_dn.round() + 0.0),
        None => String::new(),
    };
    let grows = match power(of) {
        Some(power) => format!(", in proportion to mean^{power:.1}"),
        None if !worst.is_of_first_frames() && darks_deviate(of) => ", near black too".into(),
        None => String::new(),
    };
    let decimals = usize::from(worst.z.abs() < 100.0);
    format!("{name}{place}: {off}, {:+.decimals$} standard errors{grows} ({})", worst.z, worst.meaning)
}

/// Returns true if darks deviate by twice their errors: at least three darks among at least four residuals.
fn darks_deviate(of: &[&Residual]) -> bool {
    let dark: Vec<f64> =
        of.iter().filter(|r| r.set.is_some() && r.level_dn < DARK_DN).map(|r| r.z * r.z).collect();
    of.len() >= 4 && dark.len() >= 3 && dark.iter().sum::<f64>() / dark.len() as f64 > 4.0
}

/// Returns the power of the mean with which the deviation grows, if the residuals are large enough to tell.
fn power(of: &[&Residual]) -> Option<f64> {
    let points: Vec<(f64, f64, f64)> = of
        .iter()
        .filter(|r| r.level_dn > DARK_DN && r.z.abs() > 3.0)
        .map(|r| {
            let off = r.measured - r.predicted;
            (r.level_dn.ln(), off.abs().ln(), off.signum())
        })
        .collect();
    let n = points.len() as f64;
    let one_sign = points.iter().map(|p| p.2).sum::<f64>().abs() > 0.8 * n;
    if points.len() < 4 || !one_sign {
        return None;
    }
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let xx: f64 = points.iter().map(|p| (p.0 - mx).powi(2)).sum();
    let xy: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    (xx > 0.3).then(|| xy / xx)
}
