//! Grammar of laws: statistics that a law may change, and ways in which it may grow.

use radcam_sim::effects::{Described, Effect, UNBOUNDED, custom};
use std::sync::LazyLock;

/// Statistic that a law changes, or several in a fixed ratio.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Target {
    /// Its name.
    pub name: &'static str,
    /// Name in words; for a noise, the words after "noise".
    pub words: &'static str,
    /// Its kind.
    pub kind: Kind,
    /// Targets of a custom effect, with the part of the law for each.
    pub parts: &'static [(&'static str, f64)],
    /// True for noise that is added to that of pixels: its size is not negative.
    pub adds: bool,
}

/// Kinds of targets, which differ in unit and in the reference of their size.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Noise of single pixels, DN².
    Pixels,
    /// Noise that pixels of a frame share in pairs, DN².
    Shared,
    /// Noise of whole lines, frames or fields, DN².
    Lines,
    /// Level, DN.
    Level,
}

impl Kind {
    fn unit(self) -> &'static str {
        if self == Self::Level { "DN" } else { "DN^2" }
    }
}

/// Targets of all laws. Noise of a block of two by two is shared by every second pair of neighbours, and by
/// every fourth pair along a diagonal.
pub const TARGETS: &[Target] = &[
    Target {
        name: "variance",
        words: "of single pixels",
        kind: Kind::Pixels,
        parts: &[("variance", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_01",
        words: "that a pixel shares with the next one in its row",
        kind: Kind::Shared,
        parts: &[("cov_01", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_10",
        words: "that a pixel shares with the next one in its column",
        kind: Kind::Shared,
        parts: &[("cov_10", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_02",
        words: "that pixels two columns apart share",
        kind: Kind::Shared,
        parts: &[("cov_02", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_20",
        words: "that pixels two rows apart share",
        kind: Kind::Shared,
        parts: &[("cov_20", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_03",
        words: "that pixels three columns apart share",
        kind: Kind::Shared,
        parts: &[("cov_03", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_30",
        words: "that pixels three rows apart share",
        kind: Kind::Shared,
        parts: &[("cov_30", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_11",
        words: "that diagonal neighbours share",
        kind: Kind::Shared,
        parts: &[("cov_11", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_1-1",
        words: "shared along the diagonal up to the right alone",
        kind: Kind::Shared,
        parts: &[("cov_1-1", 1.0)],
        adds: false,
    },
    Target {
        name: "diagonal down",
        words: "shared along the diagonal down to the right alone",
        kind: Kind::Shared,
        parts: &[("cov_11", 1.0), ("cov_1-1", -1.0)],
        adds: false,
    },
    Target {
        name: "cov_12",
        words: "that pixels one row and two columns apart share",
        kind: Kind::Shared,
        parts: &[("cov_12", 1.0)],
        adds: false,
    },
    Target {
        name: "cov_21",
        words: "that pixels two rows and one column apart share",
        kind: Kind::Shared,
        parts: &[("cov_21", 1.0)],
        adds: false,
    },
    Target {
        name: "parity_01",
        words: "that an odd column shares with the next one, beyond what an even one does",
        kind: Kind::Shared,
        parts: &[("parity_01", 1.0)],
        adds: false,
    },
    Target {
        name: "parity_10",
        words: "that an odd row shares with the next one, beyond what an even one does",
        kind: Kind::Shared,
        parts: &[("parity_10", 1.0)],
        adds: false,
    },
    Target {
        name: "neighbours",
        words: "that a pixel shares with all eight neighbours alike",
        kind: Kind::Shared,
        parts: &[("cov_01", 1.0), ("cov_10", 1.0), ("cov_11", 1.0)],
        adds: false,
    },
    Target {
        name: "even pairs of columns",
        words: "that columns share in pairs, the even one first",
        kind: Kind::Shared,
        parts: &[("cov_01", 0.5), ("parity_01", -1.0)],
        adds: true,
    },
    Target {
        name: "odd pairs of columns",
        words: "that columns share in pairs, the odd one first",
        kind: Kind::Shared,
        parts: &[("cov_01", 0.5), ("parity_01", 1.0)],
        adds: true,
    },
    Target {
        name: "even pairs of rows",
        words: "that rows share in pairs, the even one first",
        kind: Kind::Shared,
        parts: &[("cov_10", 0.5), ("parity_10", -1.0)],
        adds: true,
    },
    Target {
        name: "odd pairs of rows",
        words: "that rows share in pairs, the odd one first",
        kind: Kind::Shared,
        parts: &[("cov_10", 0.5), ("parity_10", 1.0)],
        adds: true,
    },
    Target {
        name: "blocks",
        words: "that blocks of two by two pixels share",
        kind: Kind::Shared,
        parts: &[
            ("cov_01", 0.5),
            ("cov_10", 0.5),
            ("cov_11", 0.25),
            ("parity_01", -1.0),
            ("parity_10", -1.0),
        ],
        adds: true,
    },
    Target {
        name: "shifted blocks",
        words: "that blocks of two by two pixels share, one off the corner",
        kind: Kind::Shared,
        parts: &[("cov_01", 0.5), ("cov_10", 0.5), ("cov_11", 0.25), ("parity_01", 1.0), ("parity_10", 1.0)],
        adds: true,
    },
    Target {
        name: "row",
        words: "common to the pixels of a row",
        kind: Kind::Lines,
        parts: &[("row", 1.0)],
        adds: true,
    },
    Target {
        name: "column",
        words: "common to the pixels of a column",
        kind: Kind::Lines,
        parts: &[("column", 1.0)],
        adds: true,
    },
    Target {
        name: "common",
        words: "common to the pixels of a frame",
        kind: Kind::Lines,
        parts: &[("common", 1.0)],
        adds: true,
    },
    Target {
        name: "gradient down",
        words: "of a field that tilts down the rows, anew in each frame",
        kind: Kind::Lines,
        parts: &[("gradient_y", 1.0)],
        adds: true,
    },
    Target {
        name: "gradient across",
        words: "of a field that tilts across the columns, anew in each frame",
        kind: Kind::Lines,
        parts: &[("gradient_x", 1.0)],
        adds: true,
    },
    Target {
        name: "gradients",
        words: "of a field that tilts to any side, anew in each frame",
        kind: Kind::Lines,
        parts: &[("gradient_y", 1.0), ("gradient_x", 1.0)],
        adds: true,
    },
    Target {
        name: "curvature down",
        words: "of a field that bends down the rows, anew in each frame",
        kind: Kind::Lines,
        parts: &[("curvature_y", 1.0)],
        adds: true,
    },
    Target {
        name: "curvature across",
        words: "of a field that bends across the columns, anew in each frame",
        kind: Kind::Lines,
        parts: &[("curvature_x", 1.0)],
        adds: true,
    },
    Target {
        name: "bulge",
        words: "of a field that bulges, anew in each frame: its middle against its corners",
        kind: Kind::Lines,
        parts: &[("curvature_y", 1.0), ("curvature_x", 1.0)],
        adds: true,
    },
    Target { name: "mean", words: "level", kind: Kind::Level, parts: &[("mean", 1.0)], adds: false },
];

/// Way in which a law grows. Levels are divided by 1000 DN, so that formulas read the same in every campaign
/// and
/// `k` is the size at that level.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Formula; `k` is its size.
    pub formula: &'static str,
    /// Growth in words.
    pub words: &'static str,
    /// Growth.
    pub growth: Growth,
    /// Unit of the size, beyond that of the target.
    per: &'static str,
    /// Start values of the parameters, in the order of their names, from the signals of the flats in
    /// ascending order, DN.
    starts: fn(&[f64]) -> Vec<Vec<f64>>,
}

/// Growth of a law.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Growth {
    /// Nothing: the same at every level, in darks too.
    Constant,
    /// The noise of single pixels, in proportion.
    Noise,
    /// The signal, by a power below 1.
    Slower,
    /// The signal, in proportion.
    Signal,
    /// The signal, by a power between 1 and 2.
    Faster,
    /// The square of the signal, or a higher power.
    Square,
    /// The exposure.
    Exposure,
    /// A step at a level.
    Step,
    /// A wave over the level.
    Wave,
    /// The time since the first frame.
    Time,
    /// Every second frame.
    Odd,
}

fn one(_: &[f64]) -> Vec<Vec<f64>> {
    vec![vec![1.0]]
}

fn hundredth(_: &[f64]) -> Vec<Vec<f64>> {
    vec![vec![0.01]]
}

/// Returns starts at powers between those that have a shape of their own.
fn powers(_: &[f64]) -> Vec<Vec<f64>> {
    [1.3, 1.7, 2.5, 3.5].map(|p| vec![1.0, p]).into()
}

/// Maximum number of steps tried.
const MOST_STEPS: usize = 12;

/// Returns starts with a step between neighbouring levels. Its place is not fitted: nothing changes until it
/// passes a level.
fn steps(levels_dn: &[f64]) -> Vec<Vec<f64>> {
    let between: Vec<f64> = levels_dn.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    let every = between.len().div_ceil(MOST_STEPS).max(1);
    between.into_iter().step_by(every).map(|m| vec![1.0, m]).collect()
}

/// Returns starts with a few periods over the range; sine and cosine of each.
fn waves(levels_dn: &[f64]) -> Vec<Vec<f64>> {
    let peak_dn = levels_dn.last().copied().unwrap_or(1.0).max(1.0);
    let of = |periods: f64| [0.0, 1.57].map(|f| vec![f, 1.0, peak_dn / periods]);
    [1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0].into_iter().flat_map(of).collect()
}

/// Shapes of a noise, the simple ones first.
const OF_NOISE: &[Shape] = &[
    Shape {
        formula: "k",
        words: "the same at every level, in darks too",
        growth: Growth::Constant,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * (mu / 1000)",
        words: "in proportion to the signal",
        growth: Growth::Signal,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * noise",
        words: "the same share of the noise at every level",
        growth: Growth::Noise,
        per: "",
        starts: hundredth,
    },
    Shape {
        formula: "k * (mu / 1000)^2",
        words: "growing as the square of the signal",
        growth: Growth::Square,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * (mu / 1000)^1.5",
        words: "growing as the signal to the power of 1.5",
        growth: Growth::Faster,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * (mu / 1000)^3",
        words: "growing as the cube of the signal",
        growth: Growth::Square,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * (mu / 1000)^0.5",
        words: "growing as the root of the signal",
        growth: Growth::Slower,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * exposure",
        words: "in proportion to the exposure",
        growth: Growth::Exposure,
        per: "/s",
        starts: one,
    },
    Shape {
        formula: "k * (1 + signum(mu - m)) / 2",
        words: "above one level alone",
        growth: Growth::Step,
        per: "",
        starts: steps,
    },
    Shape {
        formula: "k * (mu / 1000)^p",
        words: "growing as the signal to the power p",
        growth: Growth::Faster,
        per: "",
        starts: powers,
    },
];

/// Shapes of a level.
const OF_LEVEL: &[Shape] = &[
    Shape {
        formula: "k * (mu / 1000)^2",
        words: "off by a part that grows as the square of the signal",
        growth: Growth::Square,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * (mu / 1000)^3",
        words: "off by a part that grows as the cube of the signal",
        growth: Growth::Square,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * (1 + signum(mu - m)) / 2",
        words: "off by a step at one level",
        growth: Growth::Step,
        per: "",
        starts: steps,
    },
    Shape {
        formula: "k * mu / 1000 * (1 + signum(mu - m)) / 2",
        words: "off in proportion to the signal above one level",
        growth: Growth::Step,
        per: "",
        starts: steps,
    },
    Shape {
        formula: "k * sin(6.2831853 * mu / m + f)",
        words: "off by a wave over the level",
        growth: Growth::Wave,
        per: "",
        starts: waves,
    },
    Shape {
        formula: "k * time",
        words: "moving with time by the same number of DN at every level",
        growth: Growth::Time,
        per: "/s",
        starts: one,
    },
    Shape {
        formula: "k * time * mu / 1000",
        words: "moving with time in proportion to the signal",
        growth: Growth::Time,
        per: "/s",
        starts: one,
    },
    Shape {
        formula: "k * odd",
        words: "off in every second frame by the same number of DN at every level",
        growth: Growth::Odd,
        per: "",
        starts: one,
    },
    Shape {
        formula: "k * odd * mu / 1000",
        words: "off in every second frame in proportion to the signal",
        growth: Growth::Odd,
        per: "",
        starts: one,
    },
];

/// A law of one target.
#[derive(Clone, Copy)]
pub struct Law {
    /// Statistic that it changes.
    pub target: &'static Target,
    /// Way in which it grows.
    pub shape: &'static Shape,
    /// Effect that it makes.
    pub effect: &'static dyn Effect,
}

impl Law {
    /// Returns the name in a few words.
    pub fn in_short(&self) -> String {
        match self.target.kind {
            Kind::Level => format!("a level that is {}", self.shape.words),
            _ => format!("noise {}, {},", self.target.words, self.shape.words),
        }
    }

    /// Returns the start values. `levels_dn`: signals of the flats in ascending order.
    pub fn starts(&self, levels_dn: &[f64]) -> Vec<Vec<f64>> {
        (self.shape.starts)(levels_dn)
    }
}

/// Returns the names of a shape's parameters.
fn parameters(formula: &str) -> impl Iterator<Item = &'static str> + '_ {
    // No other letter stands alone in a formula.
    let is_there =
        |name: &&str| formula.split(|c: char| !c.is_ascii_alphanumeric()).any(|word| word == *name);
    ["f", "k", "m", "p"].into_iter().filter(is_there)
}

/// Returns every law of the grammar.
pub fn all() -> &'static [Law] {
    static ALL: LazyLock<Vec<Law>> = LazyLock::new(make);
    &ALL
}

fn make() -> Vec<Law> {
    let of = |target: &'static Target| {
        let shapes = if target.kind == Kind::Level { OF_LEVEL } else { OF_NOISE };
        shapes
            .iter()
            .filter(move |shape| !is_of_model(target, shape))
            .filter_map(move |shape| law(target, shape))
    };
    TARGETS.iter().flat_map(of).collect()
}

/// Returns true for a law that the paper's model already has: noise of single pixels that is constant or in
/// proportion to the signal or to the noise is another read noise or gain. Lines have no share of the noise
/// of pixels either.
fn is_of_model(target: &Target, shape: &Shape) -> bool {
    let is_scaled = matches!(shape.growth, Growth::Constant | Growth::Signal | Growth::Noise);
    target.kind == Kind::Pixels && is_scaled || target.kind == Kind::Lines && shape.growth == Growth::Noise
}

/// Returns the formula of a part of a law.
pub fn part_of(part: f64, formula: &str) -> String {
    match part {
        1.0 => formula.into(),
        -1.0 => format!("-{formula}"),
        _ => format!("{part} * {formula}"),
    }
}

fn law(target: &'static Target, shape: &'static Shape) -> Option<Law> {
    let owned = |text: &str| text.to_string();
    let formulas =
        target.parts.iter().map(|(name, part)| (owned(name), part_of(*part, shape.formula))).collect();
    let names: Vec<&str> = parameters(shape.formula).collect();
    let values = names.iter().map(|name| (owned(name), 1.0)).collect();
    let unit = |name: &&str| match *name {
        "k" if shape.growth == Growth::Noise => "1".into(),
        "k" => format!("{}{}", target.kind.unit(), shape.per),
        "m" => "DN".into(),
        _ => "1".into(),
    };
    let units = names.iter().map(|name| (owned(name), unit(name))).collect();
    // The model has no noise of lines, frames or blocks: there cannot be less of it.
    let least = if target.adds { 0.0 } else { -UNBOUNDED };
    let bound = |name: &&str| match *name {
        "k" => Some([least, UNBOUNDED]),
        "m" => Some([1e-3, 1e6]),
        "p" => Some([0.3, 6.0]),
        _ => None,
    };
    let bounds = names.iter().filter_map(|name| Some((owned(name), bound(name)?))).collect();
    let name = format!("law {} = {}", target.name, shape.formula);
    let described = Described {
        name: &name,
        formulas: &formulas,
        values: &values,
        bounds: &bounds,
        units: &units,
        page: None,
    };
    Some(Law { target, shape, effect: custom(described).ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each law is an effect whose parameters are those of its formula, and each start has a value for each.
    #[test]
    fn every_law_is_an_effect() {
        let levels = [100.0, 1000.0, 3000.0];
        let laws = all();
        let of_level = TARGETS.iter().filter(|t| t.kind == Kind::Level).count();
        let lines = TARGETS.iter().filter(|t| t.kind == Kind::Lines).count();
        let noises = TARGETS.len() - of_level;
        assert_eq!(laws.len(), noises * OF_NOISE.len() - 3 - lines + of_level * OF_LEVEL.len());
        for law in laws {
            let names: Vec<&str> = law.effect.parameters().iter().map(|p| p.name).collect();
            assert_eq!(names, parameters(law.shape.formula).collect::<Vec<_>>());
            assert!(
                law.starts(&levels).iter().all(|start| start.len() == names.len()),
                "{}",
                law.effect.id()
            );
        }
    }
}
