//! A blind test through the real program: random sensors with effects hidden at a stated strength.
//!
//! Strength: the campaign's observables are set to what the model with the effect expects, the paper's model
//! is fitted to them, and of what it leaves the statistic with the largest chi, over all levels, is the
//! strength in standard errors.

use crate::effects::{campaign, observe, scaled, unit, with};
use crate::support::radcam;
use radcam::inference::{Fitted, compare, fit, seen, start};
use radcam::observables::{Observations, expectations};
use radcam_sim::Model;
use radcam_sim::effects::{EFFECTS, Effect, Parameter, example, find};
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// A random sensor: 10, 12 or 14 bits, its own size, gain, noise, black level, pattern and dark current.
fn sensor(seed: u64) -> Model {
    let mut model = unit(seed);
    let bits = [10, 12, 12, 14][(seed % 4) as usize];
    let scale = 2f64.powi(bits - 12);
    model.camera.bit_depth = bits as u8;
    model.camera.width = 96 + 16 * (seed % 5) as u32;
    model.camera.height = 112 + 16 * (seed / 5 % 3) as u32;
    model.base.gain_dn_per_e *= scale;
    model.base.black_level_dn *= scale.max(0.5);
    model.base.offset_spread_dn *= scale;
    model
}

/// Standard errors by which an effect moves its best statistic on this campaign.
fn strength(
    clean: &Observations,
    truth: &Fitted,
    effect: &'static dyn Effect,
    values: &[f64],
) -> (String, f64) {
    let mut hidden = truth.clone();
    hidden.effects.push((effect, values.to_vec()));
    let mut seen = clean.clone();
    let expected: Vec<f64> =
        expectations(clean, &hidden.predict(clean), |_| true).iter().map(|e| e.value).collect();
    seen.list.iter_mut().zip(expected).for_each(|(o, v)| o.measured.value = v);
    let fitted = fit(&seen, &truth.base, &Vec::new());
    let mut of: BTreeMap<String, f64> = BTreeMap::new();
    for (o, e) in seen.list.iter().zip(expectations(&seen, &fitted.predict(&seen), |_| true)) {
        *of.entry(o.name()).or_default() += e.z().powi(2);
    }
    let best = of.iter().max_by(|a, b| a.1.total_cmp(b.1));
    best.map_or((String::new(), 0.0), |(name, squares)| (name.clone(), squares.sqrt()))
}

/// Values of an effect at a strength on this sensor, and that strength; `None` where no values within its
/// bounds come near it.
fn values_at(model: &Model, id: &str, wanted: f64) -> Option<(Vec<f64>, f64)> {
    let plain = example(id, model)?;
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("clean");
    campaign(model.clone(), &root);
    let clean = observe(&root);
    let truth = fit(&clean, &start(&clean), &Vec::new());
    let effect = find(id).unwrap();
    let values = |knob: f64| -> Vec<f64> {
        let within = |(v, p): (f64, &Parameter)| v.clamp(p.min, p.max);
        scaled(id, &plain, knob).into_iter().zip(effect.parameters()).map(within).collect()
    };
    let of = |knob: f64| strength(&clean, &truth, effect, &values(knob)).1;
    let (mut low, mut high) = (1e-3f64, 1e2f64);
    for _ in 0..16 {
        let middle = (low * high).sqrt();
        if of(middle) > wanted { high = middle } else { low = middle }
    }
    let values = values(high);
    let (statistic, reached) = strength(&clean, &truth, effect, &values);
    println!("    {id}: {values:?}, {reached:.1} in {statistic}");
    // Some move statistics only beyond their bounds, in steps, or at values at which they are no such effect.
    if effect.is_another(&values, &seen(&clean, &truth.base)) {
        return None;
    }
    (0.75..1.33).contains(&(reached / wanted)).then_some((values, reached))
}

/// Verdict of the program on a hidden camera.
struct Answer {
    /// The first name, and those that are tied with it.
    first: Vec<String>,
    named: Vec<String>,
    before: f64,
    after: f64,
    consistent: bool,
    /// Parameters of what was named first, with their errors.
    parameters: BTreeMap<String, (f64, f64)>,
}

fn ask(model: &Model) -> Answer {
    let dir = tempfile::tempdir().unwrap();
    // Kept for a closer look where a folder is named.
    let kept =
        std::env::var("BLIND_KEEP").map(|d| std::path::PathBuf::from(d).join(model.base.seed.to_string()));
    let root = kept.unwrap_or_else(|_| dir.path().join("c"));
    campaign(model.clone(), &root);
    let out = radcam(&["diagnose", root.to_str().unwrap(), "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&out.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&out.stderr)));
    let missing = json["missing"].as_array().unwrap();
    let name = |m: &serde_json::Value| m["effect"].as_str().unwrap().to_string();
    let tied = |m: &&serde_json::Value| m["tied_with"].is_string();
    let number = |q: &serde_json::Value, key: &str| q[key].as_f64().unwrap_or(f64::NAN);
    let parameters = missing.first().and_then(|m| m["parameters"].as_object()).into_iter().flatten();
    let first = missing.first().map(name).into_iter();
    Answer {
        first: first.chain(missing.iter().skip(1).take_while(tied).map(name)).collect(),
        named: missing.iter().map(name).collect(),
        before: json["error_before"].as_f64().unwrap(),
        after: json["error_after"].as_f64().unwrap(),
        consistent: json["consistent"].as_bool().unwrap(),
        parameters: parameters
            .map(|(n, q)| (n.clone(), (number(q, "value"), number(q, "std_err"))))
            .collect(),
    }
}

impl Answer {
    fn right(&self, id: &str) -> bool {
        self.first.first().is_some_and(|f| f == id)
            || self.first.len() <= 2 && self.first.iter().any(|f| f == id)
    }
}

fn number(name: &str, otherwise: u64) -> u64 {
    std::env::var(name).ok().and_then(|v| v.parse().ok()).unwrap_or(otherwise)
}

/// A quick part of the table: two effects, and a clean camera.
#[test]
fn hidden_effects_are_named_first() {
    for (k, id) in ["illumination-flicker", "interpixel-crosstalk"].iter().enumerate() {
        let model = sensor(71 + k as u64);
        let (values, strength) = values_at(&model, id, 20.0).unwrap();
        assert!((strength - 20.0).abs() < 2.0, "{id}: {strength}");
        let a = ask(&with(model, id, &values));
        assert!(
            a.right(id) && a.after < 1.15 && !a.consistent,
            "{id}: {:?} {} {}",
            a.named,
            a.before,
            a.after
        );
    }
    let a = ask(&sensor(77));
    assert!(
        a.consistent && a.named.is_empty() && (0.9..1.1).contains(&a.before),
        "{:?} {}",
        a.named,
        a.before
    );
}

/// Ones that once had no name or a wrong one: a temporal filter of little more than 1/256, a well that only
/// the brightest pixels reach, a step between taps beside a scene; two halves whose noise is below a code,
/// pixels that pile up at a code where high bits toggle, tables of nearly as many codes as steps.
#[test]
fn weak_effects_are_named() {
    let cases: [(&str, u64, &[f64]); 8] = [
        ("temporal-filter", 1490, &[0.005, 0.0]),
        ("temporal-filter", 1500, &[0.005, 1.0]),
        ("full-well-saturation", 3343, &[9_880.66, 0.0, 0.0]),
        ("tap-mismatch", 3655, &[0.004, 0.4, 0.0]),
        ("tap-mismatch", 3696, &[0.007_219_468_9, 0.721_946_89, 0.0]),
        ("blooming", 3793, &[14_455.074]),
        ("companding", 3925, &[0.0, 6_554.0, 1_024.0, 2.0]),
        ("companding", 3946, &[0.0, 7_219.0, 1_024.0, 2.0]),
    ];
    for (id, seed, values) in cases {
        let a = ask(&with(sensor(seed), id, values));
        assert!(a.right(id) && a.after < 1.15, "{id}, sensor {seed}: {:?} {} {}", a.named, a.before, a.after);
        // Within four standard errors: of some eight numbers one in two thousand lies farther.
        for (p, hidden) in find(id).unwrap().parameters().iter().zip(values) {
            let Some((found, std_err)) = a.parameters.get(p.name).filter(|q| q.1 > 0.0) else { continue };
            assert!(
                (found - hidden).abs() < 4.0 * std_err,
                "{id} {}: {found} +- {std_err}, hidden {hidden}",
                p.name
            );
        }
    }
}

/// The whole table, as it stands in docs/METHODS.md and docs/CONFUSION.md.
#[test]
#[ignore = "ten minutes; `cargo test --release --test it blind::the_whole -- --ignored --nocapture`"]
fn the_whole_table() {
    let each = number("BLIND_EACH", 3);
    let mut text = String::new();
    let mut rows = String::new();
    // (found - hidden) / error of the parameters of what was named first and alone.
    let mut pulls: Vec<f64> = Vec::new();
    for wanted in [15.0, 5.0] {
        let (mut right, mut settled, mut all) = (0, 0, 0);
        for (e, effect) in EFFECTS.iter().enumerate() {
            let id = effect.id();
            if std::env::var("BLIND_ONLY").is_ok_and(|only| !only.split(',').any(|o| o == id)) {
                continue;
            }
            let mut said: BTreeMap<String, usize> = BTreeMap::new();
            let mut afters = Vec::new();
            for k in 0..each {
                let model = sensor(1000 + 97 * e as u64 + 31 * k + wanted as u64);
                let Some((values, reached)) = values_at(&model, id, wanted) else { continue };
                let a = ask(&with(model, id, &values));
                if a.named == [id] {
                    for (p, hidden) in effect.parameters().iter().zip(&values) {
                        // Choices have no error, and what a choice does not use is not said.
                        let Some((found, std_err)) = a.parameters.get(p.name).filter(|q| q.1 > 0.0) else {
                            continue;
                        };
                        let pull = (found - hidden) / std_err;
                        println!(
                            "    {} = {found:.3e} +- {std_err:.1e}, hidden {hidden:.3e}: {pull:+.1}",
                            p.name
                        );
                        pulls.push(pull);
                    }
                }
                all += 1;
                right += usize::from(a.right(id));
                settled += usize::from(a.after <= 1.15);
                let answer = if a.first.is_empty() { "nothing".into() } else { a.first.join(" = ") };
                println!(
                    "{wanted:>3} {id:<28} {reached:>6.1} {:>7.3} -> {:>6.3} {} {:?}",
                    a.before,
                    a.after,
                    if a.right(id) { "  " } else { "X " },
                    a.named
                );
                *said.entry(answer).or_default() += 1;
                afters.push(a.after);
            }
            if afters.is_empty() {
                continue;
            }
            let said: Vec<String> = said.iter().map(|(n, k)| format!("{n} {k}")).collect();
            let worst = afters.iter().copied().fold(0.0, f64::max);
            writeln!(rows, "| {id} | {wanted} | {} | {worst:.2} |", said.join(", ")).unwrap();
        }
        let line = format!(
            "At {wanted} standard errors: {right} of {all} named first, error_after at most 1.15 in {settled}."
        );
        println!("{line}");
        writeln!(text, "{line}").unwrap();
    }
    pulls.retain(|p| p.is_finite());
    let within = |limit: f64| 100 * pulls.iter().filter(|p| p.abs() < limit).count() / pulls.len().max(1);
    writeln!(
        text,
        "Of {} fitted parameters {} % lie within one standard error of the hidden value, {} % within two, {} % within three.",
        pulls.len(),
        within(1.0),
        within(2.0),
        within(3.0)
    )
    .unwrap();
    let (mut pairs, mut both, mut settled) = (0, 0, 0);
    for k in 0..number("BLIND_PAIRS", 30) {
        let model = sensor(5000 + k);
        let pick = |n: u64| EFFECTS[((k * 7 + n * (3 + k % 11) + n) % EFFECTS.len() as u64) as usize].id();
        let (a, b) = (pick(0), pick(1));
        let found = (values_at(&model, a, 15.0), values_at(&model, b, 15.0));
        let (Some((va, _)), Some((vb, _)), true) = (found.0, found.1, a != b) else {
            continue;
        };
        pairs += 1;
        let answer = ask(&with(with(model, a, &va), b, &vb));
        let ok = answer.right(a) || answer.right(b);
        println!(
            "{a} + {b}: {:.3} -> {:.3} {} {:?}",
            answer.before,
            answer.after,
            if ok { "" } else { "X" },
            answer.named
        );
        both += usize::from(ok);
        settled += usize::from(answer.after <= 1.15);
    }
    writeln!(
        text,
        "Of {pairs} pairs: one of the two first in {both}, error_after at most 1.15 in {settled}."
    )
    .unwrap();
    let clean = number("BLIND_CLEAN", 200);
    let mut alarms = 0;
    let from = number("BLIND_FROM", 0);
    for k in from..from + clean {
        let a = ask(&sensor(9000 + k));
        if !a.consistent {
            alarms += 1;
            println!("clean {k}: {:?} {:.3} -> {:.3}", a.named, a.before, a.after);
        }
    }
    writeln!(text, "Of {clean} clean cameras {alarms} raised an alarm.").unwrap();
    println!(
        "{text}\n| hidden | strength | named first | largest error after |\n| --- | --- | --- | --- |\n{rows}"
    );
}

/// Standardised residuals of cameras that are what the model says, statistic by statistic: their squares have
/// the mean 1.
#[test]
#[ignore = "a second for each camera; `cargo test --release --test it blind::residuals -- --ignored --nocapture`"]
fn residuals_of_clean_cameras_are_of_unit_size() {
    let cameras = number("BLIND_CLEAN", 24);
    let mut of: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    let mut errors = Vec::new();
    for k in 0..cameras {
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("c");
        campaign(sensor(20_000 + k), &root);
        let all = observe(&root);
        let c = compare(&all, &fit(&all, &start(&all), &Vec::new()));
        errors.push(c.error);
        println!("{k} {:?} {:.3} {:.1e}", all.campaign.shape, c.error, c.p_value);
        for r in &c.residuals {
            of.entry(r.observable.clone()).or_default().push(r.z);
        }
    }
    for (name, z) in &of {
        let n = z.len() as f64;
        let rms = (z.iter().map(|z| z * z).sum::<f64>() / n).sqrt();
        let most = z.iter().map(|z| z.abs()).fold(0.0, f64::max);
        println!("{name:<48} {n:>5} mean {:+.2} rms {rms:.3} largest {most:.1}", z.iter().sum::<f64>() / n);
    }
    let error = errors.iter().sum::<f64>() / errors.len() as f64;
    println!("error {error:.4}");
    // Below 1: errors of the kurtosis are stated too large, and shares of codes cannot deviate where all
    // occur (docs/METHODS.md).
    assert!((0.96..1.01).contains(&error), "{error}");
}
