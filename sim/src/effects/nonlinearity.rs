//! Nonlinearity: the signal bends away from a straight line in the light.

use super::{Campaign, Drawing, Effect, Page, Parameter, Prediction, Stage, takes};

/// v (1 - rel v / full scale), after the amplifier.
pub struct This;

impl Effect for This {
    fn id(&self) -> &'static str {
        "nonlinearity"
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[Parameter { name: "rel", unit: "1", min: -0.45, max: 0.45, starts: &[0.01, -0.01] }]
    }

    fn tables_tell(&self) -> bool {
        true
    }

    fn page(&self) -> Page {
        Page {
            what: "The amplifier's output does not grow in proportion to the charge: a source follower whose capacitance changes \
                   with the voltage, or an amplifier near its rail.",
            equation: "D = v (1 - rel v / v_full), v = A q; noise is multiplied by the slope 1 - 2 rel v / v_full",
            signature: "mean against exposure bends as -mu^2; variance over mean falls as (1 - 2 b x)^2 / (1 - b x); neighbours stay \
                        uncorrelated",
            look_alikes: "brighter-fatter lowers the variance too, but leaves the mean alone and correlates neighbours",
            remedy: "correct by the inverse curve, or stay in the lower half of the range",
            measure: "an exposure sweep at fixed light: the mean tells nonlinearity from brighter-fatter",
            sets: takes::SWEEP,
            source: "Janesick 2007, Photon Transfer, ch. 7; EMVA 1288 release 4, linearity",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        let b = p[0] / c.full_scale_dn;
        out.bend(|v| v * (1.0 - b * v));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        let b = p[0] / d.full_scale_dn;
        d.image.mapv_inplace(|v| v * (1.0 - b * v));
    }
}
