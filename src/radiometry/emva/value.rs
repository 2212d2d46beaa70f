//! Values with standard errors, propagated to first order through functions.

use std::collections::BTreeMap;

/// Value with its derivatives with respect to the independent inputs, each times the input's standard error.
/// Shared inputs therefore stay correlated.
#[derive(Debug, Clone)]
pub(super) struct Value {
    pub value: f64,
    parts: Vec<(usize, f64)>,
}

impl Value {
    /// Creates a value without an error, or an undefined one (NaN).
    pub fn exact(value: f64) -> Self {
        Self { value, parts: Vec::new() }
    }

    pub fn undefined() -> Self {
        Self::exact(f64::NAN)
    }

    pub fn std_err(&self) -> f64 {
        self.parts.iter().map(|p| p.1 * p.1).sum::<f64>().sqrt()
    }

    /// Computes a function of values, with derivatives by central differences.
    pub fn of(values: &[&Self], f: impl Fn(&[f64]) -> f64) -> Self {
        let at: Vec<f64> = values.iter().map(|v| v.value).collect();
        let mut parts: BTreeMap<usize, f64> = BTreeMap::new();
        for (k, v) in values.iter().enumerate() {
            let step = 1e-6 * v.value.abs().max(1e-12);
            let moved = |by: f64| {
                let mut to = at.clone();
                to[k] += by;
                f(&to)
            };
            let slope = (moved(step) - moved(-step)) / (2.0 * step);
            for (input, part) in &v.parts {
                *parts.entry(*input).or_default() += slope * part;
            }
        }
        Self { value: f(&at), parts: parts.into_iter().collect() }
    }

    /// Adds an error proportional to the value and shared with others. `share`: signed relative standard
    /// error; the sign is that of the correlation.
    pub fn scaled_by(mut self, input: usize, share: f64) -> Self {
        if share != 0.0 {
            self.parts.push((input, share * self.value));
        }
        self
    }
}

/// Counter of the independent inputs.
#[derive(Debug, Default)]
pub(super) struct Inputs(usize);

impl Inputs {
    /// Returns the number of a new input.
    pub fn next(&mut self) -> usize {
        self.0 += 1;
        self.0
    }

    /// Creates a new independent input.
    pub fn value(&mut self, value: f64, std_err: f64) -> Value {
        Value { value, parts: vec![(self.next(), std_err)] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_shared_cancels() {
        let mut inputs = Inputs::default();
        let (a, b) = (inputs.value(4.0, 0.3), inputs.value(2.0, 0.4));
        let sum = Value::of(&[&a, &b], |v| v[0] + v[1]);
        assert!((sum.std_err() - 0.5).abs() < 1e-6);
        let back = Value::of(&[&sum, &b], |v| v[0] - v[1]);
        assert!((back.value, (back.std_err() - 0.3).abs() < 1e-6) == (4.0, true));
        let scale = inputs.next();
        let (r, p) = (a.scaled_by(scale, -0.1), inputs.value(5.0, 0.0).scaled_by(scale, 0.1));
        assert!((Value::of(&[&r, &p], |v| v[0] * v[1]).std_err() - 1.5).abs() < 1e-6);
    }
}
