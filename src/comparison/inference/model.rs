//! Effects of a model, with their given values.

use radcam_sim::effects::Effect;

/// Effects with the values of their parameters.
pub type Effects = Vec<(&'static dyn Effect, Vec<f64>)>;

/// Returns the effects as a prediction takes them.
pub(super) fn listed(effects: &Effects) -> Vec<(&dyn Effect, &[f64])> {
    effects.iter().map(|(e, p)| (*e as &dyn Effect, p.as_slice())).collect()
}

/// An effect with the given values of its parameters, in their order.
pub type Given = (&'static dyn Effect, Vec<Option<f64>>);

/// Replaces values by those that are given.
pub fn as_given(values: &[f64], given: &[Option<f64>]) -> Vec<f64> {
    values.iter().enumerate().map(|(i, v)| given.get(i).copied().flatten().unwrap_or(*v)).collect()
}
