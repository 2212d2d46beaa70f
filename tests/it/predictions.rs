//! Statistics of drawn campaigns compared with predicted ones: drawing and predicting are two pieces of code.

use crate::effects::{asked_for, campaign, observe, scaled, unit, with};
use radcam::inference::{Comparison, compare, fit, start};
use radcam_sim::Model;
use radcam_sim::effects::{EFFECTS, Effect, example, find};

/// Draws a campaign with these effects and fits the model that has them; returns the statistics that deviate.
fn deviation(seed: u64, effects: &[(&str, f64)]) -> Option<String> {
    let model = unit(seed);
    let values = |(id, strength): &(&str, f64)| {
        Some((find(id).unwrap(), scaled(id, &example(id, &model)?, *strength)))
    };
    let held: Option<Vec<_>> = effects.iter().map(values).collect();
    deviations_from(model.clone(), &held?)
}

/// Does the same for given parameter values.
fn deviations_from(model: Model, held: &[(&'static dyn Effect, Vec<f64>)]) -> Option<String> {
    let effects: Vec<_> = held.iter().map(|(e, values)| (e.id(), values)).collect();
    let one = |more: u64| {
        let mut model = model.clone();
        model.base.seed += more;
        for (effect, values) in held {
            model = with(model, effect.id(), values);
        }
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path().join("c");
        campaign(model, &root);
        let all = observe(&root);
        let c = compare(&all, &fit(&all, &start(&all), &held.to_vec()));
        println!("{effects:?} error {:.3}, p {:.1e}", c.error, c.p_value);
        c
    };
    // Some 1400 residuals: the error of an error of 1 is 0.02; six of them, and what the predictions leave
    // out. Under a light that ripples twenty statistics of some frames share one random number: of 50 such
    // groups the error of the error is 0.1, of four campaigns 0.05.
    let ripples = held.iter().any(|(e, _)| e.id() == "light-banding");
    let all: Vec<_> = (0..if ripples { 4 } else { 1 }).map(|k| one(1_000_000 * k)).collect();
    let error = (all.iter().map(|c| c.error * c.error).sum::<f64>() / all.len() as f64).sqrt();
    (!(0.85..1.2).contains(&error) || all.iter().any(|c| c.p_value < 1e-3)).then(|| {
        let worst =
            |c: &Comparison| radcam::diagnosis::signatures(&c.residuals).into_iter().map(|s| s.text).take(3);
        let worst: Vec<_> = all.iter().map(|c| (c.p_value, worst(c).collect::<Vec<_>>())).collect();
        format!("{effects:?} {error:.3}: {worst:#?}")
    })
}

/// A seed of its own for every effect, whatever stands before it in the list.
fn seed_of(id: &str) -> u64 {
    id.bytes().fold(7u64, |h, b| h.wrapping_mul(31).wrapping_add(u64::from(b))) % 1000
}

/// For every effect: a campaign drawn by it is described by the model that holds it, fitted, on frames that
/// the fit did not see.
#[test]
fn what_is_drawn_is_what_is_predicted() {
    let bad: Vec<String> = EFFECTS
        .iter()
        .filter(|e| asked_for(e.id()))
        .filter_map(|e| deviation(seed_of(e.id()), &[(e.id(), 1.0)]))
        .collect();
    assert!(bad.is_empty(), "{bad:#?}");
}

/// Campaigns drawn with the last choice of each effect (another curve, kernel, part) are described likewise.
#[test]
fn what_is_drawn_is_what_is_predicted_for_another_choice() {
    choices_are_predicted(|all| all.len() - 1..all.len());
}

/// Campaigns drawn with every choice of each effect but the first are described likewise.
#[test]
#[ignore = "two minutes; `cargo test --release --test it for_every_choice -- --ignored`"]
fn what_is_drawn_is_what_is_predicted_for_every_choice() {
    choices_are_predicted(|all| 1..all.len());
}

/// Draws campaigns with those choices of each effect that `which` takes of its list.
fn choices_are_predicted(which: impl Fn(&[f64]) -> std::ops::Range<usize>) {
    let mut bad = Vec::new();
    for effect in EFFECTS.iter().filter(|e| asked_for(e.id())) {
        let choices = effect.parameters().iter().enumerate().filter(|(_, p)| p.is_choice());
        if example(effect.id(), &unit(40)).is_none() {
            continue;
        }
        for (k, choice) in choices.flat_map(|(k, p)| p.starts[which(p.starts)].iter().map(move |c| (k, *c))) {
            let model = unit(40 + choice as u64);
            let mut values = example(effect.id(), &model).unwrap();
            values[k] = choice;
            bad.extend(deviations_from(model, &[(*effect, values)]));
        }
    }
    assert!(bad.is_empty(), "{bad:#?}");
}

/// One of 40 random pairs at random strengths, with its seed; `None` where both are the same.
fn random_pair(k: u64) -> Option<(u64, [(&'static str, f64); 2])> {
    let pick = |n: u64| EFFECTS[((k * 7 + n * (1 + k % 23)) % EFFECTS.len() as u64) as usize].id();
    let strength = |n: u64| [0.3, 1.0, 2.0][((k / 3 + n) % 3) as usize];
    (pick(0) != pick(1)).then(|| (600 + k, [(pick(0), strength(0)), (pick(1), strength(1))]))
}

/// Campaigns drawn at three strengths, and with 40 random pairs at random strengths, are described likewise.
#[test]
#[ignore = "two minutes; `cargo test --release --test it predictions::strengths -- --ignored --nocapture`"]
fn strengths_and_pairs_are_what_is_predicted() {
    let mut bad = Vec::new();
    for (k, effect) in EFFECTS.iter().enumerate() {
        bad.extend([0.3, 1.0, 2.0].iter().filter_map(|s| deviation(300 + k as u64, &[(effect.id(), *s)])));
    }
    bad.extend((0..40).filter_map(random_pair).filter_map(|(seed, pair)| deviation(seed, &pair)));
    assert!(bad.is_empty(), "{bad:#?}");
}

/// Some of these pairs, and those that did not agree once: wells after what neighbours share, bands that a
/// well cuts, what is left of a change of level from pixel to pixel, codes that a filter moves away from
/// those that are too wide.
#[test]
fn some_strengths_and_pairs_are_what_is_predicted() {
    let pair = |a: (&'static str, f64), b: (&'static str, f64)| vec![a, b];
    let mut all = vec![
        (630, pair(("full-well-saturation", 1.0), ("brighter-fatter", 2.0))),
        (635, pair(("blooming", 2.0), ("light-banding", 0.3))),
        (305, vec![("temporal-filter", 2.0)]),
        (614, pair(("temporal-filter", 1.0), ("adc-nonlinearity", 2.0))),
    ];
    all.extend((0..40).step_by(9).filter_map(random_pair).map(|(seed, pair)| (seed, pair.to_vec())));
    let bad: Vec<String> = all.iter().filter_map(|(seed, effects)| deviation(*seed, effects)).collect();
    assert!(bad.is_empty(), "{bad:#?}");
}
