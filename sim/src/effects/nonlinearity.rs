//! Nonlinearity: the signal bends away from a straight line in the light.

use super::{Campaign, Drawing, Effect, Needs, Page, Parameter, Prediction, Stage, takes};

/// v (1 - rel (v / full scale)^order), after the amplifier.
pub struct This;

/// The curve.
fn bent(p: &[f64], full_scale_dn: f64) -> impl Fn(f64) -> f64 {
    let (rel, order) = (p[0], p[1].round() as i32);
    // Below zero it goes on as a straight line would: noise there is small.
    move |v| v * (1.0 - rel * (v.max(0.0) / full_scale_dn).powi(order))
}

impl Effect for This {
    fn id(&self) -> &'static str {
        "nonlinearity"
    }

    fn stage(&self) -> Stage {
        Stage::Amplifier
    }

    fn parameters(&self) -> &'static [Parameter] {
        &[
            Parameter { name: "rel", unit: "1", min: -0.45, max: 0.45, starts: &[0.01] },
            Parameter { name: "order", unit: "choice", min: 1.0, max: 3.0, starts: &[1.0, 2.0, 3.0] },
        ]
    }

    fn needs(&self) -> Needs {
        Needs::Variances
    }

    fn page(&self) -> Page {
        Page {
            what: "The amplifier's output does not grow in proportion to the charge: a source follower whose capacitance changes \
                   with the voltage, or an amplifier near its rail.",
            equation: "D = v (1 - rel (v / v_full)^order), v = A q, order 1, 2 or 3; noise is multiplied by the slope, 1 - 2 rel v / v_full for \
                       order 1",
            signature: "mean against exposure bends as -mu^2 (or a higher power); variance over mean falls as (1 - 2 b x)^2 / (1 - b x); neighbours stay \
                        uncorrelated",
            look_alikes: "brighter-fatter lowers the variance too, but leaves the mean alone and correlates neighbours",
            remedy: "correct by the inverse curve, or stay in the lower half of the range",
            measure: "an exposure sweep at fixed light: the mean tells nonlinearity from brighter-fatter",
            sets: takes::SWEEP,
            source: "Janesick 2007, Photon Transfer, ch. 7; EMVA 1288 release 4, linearity",
        }
    }

    fn predict(&self, p: &[f64], c: &Campaign, out: &mut Prediction) {
        out.bend(bent(p, c.full_scale_dn));
    }

    fn draw(&self, p: &[f64], d: &mut Drawing<'_>) {
        d.image.mapv_inplace(bent(p, d.full_scale_dn));
    }
}
