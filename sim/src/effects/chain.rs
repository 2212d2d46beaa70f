//! Chain of a model, kept step by step: models that differ late in it are predicted from the first difference
//! on.

use super::{Effect, Stage};
use crate::predict::{BaseParameters, Campaign, Prediction, Spectrum};

/// A step of the chain.
#[derive(Clone, Copy)]
enum Step<'e> {
    /// An effect with its values.
    Effect(&'e dyn Effect, &'e [f64]),
    /// Shot noise of the charge of light and dark current.
    Shot,
    /// Read noise is added.
    Read,
    /// The amplifier.
    Amplify,
    /// The converter.
    Convert,
    /// Firmware outputs whole codes.
    Codes,
}

impl Step<'_> {
    fn is(&self, other: &Step<'_>) -> bool {
        match (self, other) {
            (Step::Effect(a, p), Step::Effect(b, q)) => {
                // Effects without fields may share an address, and users' effects an identifier.
                std::ptr::addr_eq(*a, *b)
                    && a.id() == b.id()
                    && p.len() == q.len()
                    && p.iter().zip(*q).all(|(a, b)| a.to_bits() == b.to_bits())
            }
            (a, b) => std::mem::discriminant(a) == std::mem::discriminant(b),
        }
    }

    fn run(&self, campaign: &Campaign, out: &mut Prediction) {
        match *self {
            Step::Effect(effect, p) => effect.predict(p, campaign, out),
            Step::Shot => {
                // A fitted dark charge may be negative within its error. Its noise continues linearly, so
                // that the error propagates, down to minus half of the read-noise variance.
                let least = -0.5 * out.base.read_noise_e * out.base.read_noise_e;
                for s in &mut out.sets {
                    s.shot = Spectrum::white(s.signal.max(least.min(0.0)));
                }
            }
            Step::Read => {
                let square = out.base.read_noise_e * out.base.read_noise_e;
                let spread = out.base.read_noise_spread.max(0.0);
                for s in &mut out.sets {
                    s.read.add_white(square);
                    s.unequal += spread * square * square;
                }
            }
            Step::Amplify => out.amplify(out.base.gain_dn_per_e),
            Step::Convert => out.quantize(campaign, out.code_step_dn),
            Step::Codes => out.quantize(campaign, 1.0),
        }
    }
}

/// Returns the steps of a model, in the order in which light travels.
fn steps<'e>(effects: &[(&'e dyn Effect, &'e [f64])]) -> Vec<Step<'e>> {
    let mut order: Vec<_> = effects.to_vec();
    order.sort_by_key(|(e, p)| e.stage_with(p));
    let of = |from: Stage, to: Stage| {
        let within = order.iter().filter(move |(e, p)| (from..=to).contains(&e.stage_with(p)));
        within.map(|(e, p)| Step::Effect(*e, p))
    };
    let mut out: Vec<Step<'e>> = of(Stage::Light, Stage::Light).collect();
    out.push(Step::Shot);
    out.extend(of(Stage::Charge, Stage::Transfer));
    out.push(Step::Read);
    out.extend(of(Stage::Read, Stage::Read));
    out.push(Step::Amplify);
    out.extend(of(Stage::Amplifier, Stage::Converter));
    out.push(Step::Convert);
    out.extend(of(Stage::Firmware, Stage::Firmware).flat_map(|effect| [effect, Step::Codes]));
    out
}

/// Adds the offset, so that frame means count from code 0.
fn with_offset(mut out: Prediction) -> Prediction {
    let offset_dn = out.base.offset_dn;
    out.frame_signal.iter_mut().for_each(|m| *m += offset_dn);
    out
}

/// Predicts the statistics of a campaign under the paper's model and some effects, each with its parameters,
/// in the order of the chain.
pub fn predict(campaign: &Campaign, base: &BaseParameters, effects: &[(&dyn Effect, &[f64])]) -> Prediction {
    let mut out = Prediction::begin(campaign, base);
    steps(effects).iter().for_each(|step| step.run(campaign, &mut out));
    with_offset(out)
}

/// Prediction of a model, with the prediction before each step of its chain.
pub struct Chain<'e> {
    campaign: &'e Campaign,
    steps: Vec<Step<'e>>,
    before: Vec<Prediction>,
    last: Prediction,
}

impl<'e> Chain<'e> {
    /// Runs the chain of a model.
    pub fn new(
        campaign: &'e Campaign,
        base: &BaseParameters,
        effects: &[(&'e dyn Effect, &'e [f64])],
    ) -> Self {
        let steps = steps(effects);
        let mut last = Prediction::begin(campaign, base);
        let mut before = Vec::with_capacity(steps.len() + 1);
        for step in &steps {
            before.push(last.clone());
            step.run(campaign, &mut last);
        }
        before.push(last.clone());
        Self { campaign, steps, before, last: with_offset(last) }
    }

    /// Returns the model's own prediction.
    pub fn prediction(&self) -> &Prediction {
        &self.last
    }

    /// Predicts another model, starting at the first step that differs; equals [`predict`].
    pub fn predict(&self, base: &BaseParameters, effects: &[(&dyn Effect, &[f64])]) -> Prediction {
        if *base != self.last.base {
            return predict(self.campaign, base, effects);
        }
        let steps = steps(effects);
        let same = steps.iter().zip(&self.steps).take_while(|(a, b)| a.is(b)).count();
        let mut out = self.before[same].clone();
        steps[same..].iter().for_each(|step| step.run(self.campaign, &mut out));
        with_offset(out)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EFFECTS, Plain, find};
    use super::*;
    use crate::predict::{Before, FrameInfo, NORMAL, SetInfo};

    /// A stage in no range would be neither drawn nor predicted.
    #[test]
    fn every_effect_is_a_step_of_the_chain() {
        for effect in EFFECTS {
            let values: Vec<f64> =
                effect.parameters().iter().map(|p| p.starts.first().copied().unwrap_or(p.min)).collect();
            let steps = steps(&[(*effect, &values)]);
            let found =
                steps.iter().filter(|s| matches!(s, Step::Effect(e, _) if e.id() == effect.id())).count();
            assert_eq!(found, 1, "{}", effect.id());
        }
    }

    const PLAIN: Plain = Plain {
        gain_dn_per_e: 0.4,
        range_e: 9000.0,
        bright_s: 0.02,
        noise_e: 4.0,
        frame_s: 0.03,
        rows: 96.0,
        full_scale_dn: 4095.0,
        long_dark_e: 20.0,
        black_dn: 64.0,
    };

    /// Darks and flats in turn, four frames each.
    fn campaign() -> Campaign {
        let frame = |i: usize| FrameInfo { set: i / 4, time_s: 0.03 * i as f64, before: Before::Frame };
        let set = |i: usize| SetInfo {
            exposure_s: 0.005 * (1 + i) as f64,
            light: (i % 2 == 1).then_some(i / 2),
            illumination: 1.0,
            light_ratio: 1.0,
            spread: 0.05,
            spread_dn: 0.3,
            places: NORMAL,
        };
        Campaign {
            frames: (0..24).map(frame).collect(),
            sets: (0..6).map(set).collect(),
            shape: (96, 112),
            full_scale_dn: PLAIN.full_scale_dn,
            from_code_0: true,
            frame_s: PLAIN.frame_s,
            line_cycles_per_px: None,
            ordinary: None,
        }
    }

    fn base() -> BaseParameters {
        BaseParameters {
            gain_dn_per_e: PLAIN.gain_dn_per_e,
            read_noise_e: PLAIN.noise_e,
            read_noise_spread: 0.1,
            offset_dn: PLAIN.black_dn,
            dark_e_per_s: 30.0,
            flux_e_per_s: vec![2e5, 3e5, 3.2e5],
            past_e: None,
            setting_rel: Some(0.01),
            monitor: None,
            cut_at_0: true,
        }
    }

    /// Predictions from the first differing step equal full predictions to the last bit: for one more effect,
    /// one less, other values and another base.
    #[test]
    fn a_chain_goes_on_from_where_it_differs() {
        let (campaign, base) = (campaign(), base());
        let given: Vec<(&dyn Effect, Vec<f64>)> = ["row-noise", "image-lag", "adc-nonlinearity"]
            .into_iter()
            .map(|id| {
                let effect = find(id).expect("an effect of the catalogue");
                (effect as &dyn Effect, effect.example(&PLAIN).expect("an example"))
            })
            .collect();
        let listed: Vec<(&dyn Effect, &[f64])> = given.iter().map(|(e, p)| (*e, p.as_slice())).collect();
        let chain = Chain::new(&campaign, &base, &listed);
        assert!(*chain.prediction() == predict(&campaign, &base, &listed));
        let agree = |base: &BaseParameters, list: &[(&dyn Effect, &[f64])]| {
            assert!(chain.predict(base, list) == predict(&campaign, base, list));
        };
        for effect in EFFECTS {
            let Some(values) = effect.example(&PLAIN) else { continue };
            let mut more = listed.clone();
            more.push((*effect, &values));
            agree(&base, &more);
        }
        for (i, (effect, values)) in given.iter().enumerate() {
            let mut less = listed.clone();
            less.remove(i);
            agree(&base, &less);
            let other: Vec<f64> = values.iter().map(|v| 1.001 * v).collect();
            less.push((*effect, &other));
            agree(&base, &less);
        }
        agree(&BaseParameters { offset_dn: 63.0, ..base.clone() }, &listed);
    }
}
