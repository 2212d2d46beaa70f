//! Logarithm of the reading of a light monitor: the true light of a set, in a unit of its own.

use super::{Expected, Observable, Statistic, View};

/// Reading of the light monitor.
#[derive(Debug)]
pub struct Monitor;

impl Statistic for Monitor {
    fn id(&self) -> &'static str {
        "light monitor"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "the light, as the monitor sees it"
    }

    fn is_level(&self) -> bool {
        true
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let light = view.at.and_then(|i| view.prediction.light_e.get(i)).copied().unwrap_or(0.0);
        let monitor = view.prediction.base.monitor.unwrap_or_default();
        Expected::plain(o, monitor.ln_per_e + light.max(1e-300).ln(), monitor.rel)
    }
}
