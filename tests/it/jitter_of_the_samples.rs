//! jitter-of-the-samples: more noise of single pixels, growing as the square of the signal.
//!
//! It begins as formulas, which draw and predict it. Once its mechanism is known, `predict` and `draw` follow
//! that, `stage` says where it acts, and the page what to do about it.

use radcam_sim::effects::{Drawing, Effect, OwnEffect, Page, Parameter, Plain, Stage};
use radcam_sim::predict::{Campaign, Prediction};
use std::sync::LazyLock;

/// Formulas, values where a search begins, and page.
const WRITTEN: &str = r#"
name = "jitter-of-the-samples"

[formulas]
variance = "k * (mu / 1000)^2"

[parameters]
k = 8.0

[units]
k = "DN^2"

[page]
what = 'The instant at which a sample is taken "jitters".'
signature = "more noise of single pixels, growing as the square of the signal"
look_alikes = ""
remedy = ""
measure = ""
source = ""
"#;

/// The effect; its page says what it is.
pub struct JitterOfTheSamplesEffect;

static FORMULAS: LazyLock<Result<&'static dyn Effect, String>> =
    LazyLock::new(|| OwnEffect::from_toml(WRITTEN)?.effect());

/// Effect that the formulas make; a test holds that they are understood.
fn formulas() -> &'static dyn Effect {
    match &*FORMULAS {
        Ok(effect) => *effect,
        Err(e) => unreachable!("{e}"),
    }
}

impl Effect for JitterOfTheSamplesEffect {
    fn id(&self) -> &'static str {
        "jitter-of-the-samples"
    }

    fn stage(&self) -> Stage {
        formulas().stage()
    }

    fn parameters(&self) -> &'static [Parameter] {
        formulas().parameters()
    }

    fn example(&self, _: &Plain) -> Option<Vec<f64>> {
        Some(self.parameters().iter().map(|p| p.starts[0]).collect())
    }

    fn page(&self) -> Page {
        formulas().page()
    }

    fn is_in_time(&self, p: &[f64]) -> bool {
        formulas().is_in_time(p)
    }

    fn predict(&self, p: &[f64], campaign: &Campaign, out: &mut Prediction) {
        formulas().predict(p, campaign, out);
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        formulas().draw(p, d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The formulas are understood, and the values of the campaign that showed it lie within their bounds.
    #[test]
    fn it_is_what_was_measured() {
        let own = OwnEffect::from_toml(WRITTEN).expect("formulas");
        assert_eq!(own.name, JitterOfTheSamplesEffect.id());
        for p in JitterOfTheSamplesEffect.parameters() {
            assert!((p.min..=p.max).contains(&p.starts[0]), "{}", p.name);
        }
    }
}
