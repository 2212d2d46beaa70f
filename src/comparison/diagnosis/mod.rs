//! Missing physical effects: effects are added as long as the evidence pays for them, and listed by their
//! share of the misfit, with what they cost the user. The remainder has a share of its own.

mod cost;
mod cut;
mod entry;
mod memo;
mod memory;
mod part;
mod proposal;
mod search;
mod sensor;
mod share;
mod starts;
mod turns;
mod unknown;
mod verdict;
mod words;

pub use cost::Cost;
pub use proposal::{LAW, Proposal};
pub use search::searched;
pub use sensor::SensorValues;
pub use share::Remainder;
pub use verdict::Verdict;
pub(crate) use verdict::capital;
#[cfg(feature = "cli")]
pub(crate) use verdict::{Size, WEAK};
pub use words::{Signature, signatures};

use crate::agreement::{DOUBT, P_LIMIT};
use crate::data_faults::DataFault;
use crate::dataset::Kind;
use crate::features::LeftOn;
use crate::inference::{
    Comparison, Effects, Fitted, Residual, by, compare, fit, fit_near, residuals_of, seen, start,
    words_of_settings,
};
use crate::number::Quantity;
use crate::number::{chance, percent};
use crate::observables::profile::LineProfile;
use crate::observables::{NO_PATCH, NO_TIMES, Observations, STATISTICS, Setting, Statistic, mean};
use crate::plan::Plan;
use cut::{CUT, CutOff, with_cut};
use entry::{describe, reasons};
use memo::Memo;
use part::{OtherForm, Part, equally_good, left_out, other_forms, without_one};
use radcam_sim::effects::{Seen, Take, takes};
use radcam_sim::predict::{BaseParameters, Before};
use rayon::prelude::*;
use search::{Candidate, NEEDED, is_something, is_told, rivals, score, search, surely_there, without};
use sensor::sensor;
use serde::{Deserialize, Serialize};
use share::{MATTERS, Place, place_of_unknown, remainder, shares};
use std::collections::{BTreeMap, BTreeSet};
use turns::in_turns;

/// Maximum difference in evidence of candidates that cannot be told apart.
const TIE: f64 = 6.0;
/// Error above which a fit says little of the parameters.
const FAR: f64 = 3.0;
/// Chance below which a remainder with all names in the model is significant, and reported.
const HOLDS: f64 = 0.01;
/// Minimum joint evidence of names if the given model holds: four standard errors, of whose 16 some 7 are the
/// price of a parameter. A named choice: three of 400 clean cameras raise an alarm. Of those in which
/// outsiders hid something, no more are named wrongly than with 20, at which a third of the effects at five
/// standard errors has no name (docs/CONFUSION.md).
const TRACE: f64 = 9.0;
/// Minimum decrease of the error by a single addition.
const HELPS: f64 = 1e-3;
/// Maximum number of names that are listed as the nearest of a nameless effect.
const NEAREST: usize = 3;

/// A missing effect.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Missing {
    /// Identifier; `unknown` where none of the effects explains it.
    pub effect: String,
    /// Share of the evidence among all candidates and the nameless model. For `unknown`, if no name holds:
    /// one less the chance of such residuals.
    pub confidence: f64,
    /// Share of the misfit (square of the error above the noise) that goes with it.
    pub share: f64,
    /// Errors of the results of the same frames if the effect is ignored.
    pub cost: Cost,
    /// Drop of the error on the rung of the ladder that adds it.
    pub error_drop: f64,
    /// Its parameters.
    pub parameters: BTreeMap<String, Quantity>,
    /// Form in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub form: Option<String>,
    /// Another form that this campaign does not tell from it; `cost` is that of the costlier one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub or_form: Option<String>,
    /// True if the camera behaves mostly like this effect, but not quite.
    pub partial: bool,
    /// Nearest names, for `unknown`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub nearest: Vec<String>,
    /// Effect that this campaign cannot tell from it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tied_with: Option<String>,
    /// Reasons in words.
    pub evidence: Vec<String>,
    /// Reason against the nearest name, for `unknown`, if the campaign contradicts it.
    #[serde(skip)]
    pub doubt: Option<String>,
    /// True for a bend below the dimmest flat: darks of another black level or gain than the flats look the
    /// same.
    #[serde(skip)]
    pub by_the_darks_alone: bool,
}

/// A rung of the ladder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Rung {
    /// Added effect; null for the model as given.
    pub added: Option<String>,
    /// Error on held-out frames.
    pub error: f64,
    /// Chance of such residuals.
    pub p_value: f64,
}

/// Result of a diagnosis.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[non_exhaustive]
pub struct Diagnosis {
    /// Verdict in one or two plain sentences.
    pub verdict: Verdict,
    /// True if the model as given describes the campaign.
    pub consistent: bool,
    /// Error of the model as given.
    pub error_before: f64,
    /// Error with all that was added.
    pub error_after: f64,
    /// The missing effects, the largest share of the misfit first.
    pub missing: Vec<Missing>,
    /// Remaining misfit with all names; null if it is within the noise.
    pub remainder: Option<Remainder>,
    /// Law for a nameless effect; null if all have names, or no law is found.
    pub proposal: Option<Proposal>,
    /// Gain, read noise and dark current with all effects in the model.
    #[serde(flatten)]
    pub sensor: SensorValues,
    /// Features of the camera that changed pixel values: the first suspects.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_on: Vec<LeftOn>,
    /// Ladder of models.
    pub ladder: Vec<Rung>,
    /// Measurement that would tell the closest candidates apart.
    pub next_measurement: Option<String>,
    /// Plan of that measurement.
    #[serde(skip)]
    pub next_plan: Option<Plan>,
    /// Faults of the data.
    #[serde(default)]
    pub data_faults: Vec<DataFault>,
    /// Items that could not be tested, and what is left over.
    pub notes: Vec<String>,
    /// Last model.
    #[serde(skip)]
    pub fitted: Option<Fitted>,
    /// Comparisons of the first and the last model.
    #[serde(skip)]
    pub comparisons: Vec<Comparison>,
}

/// Searches for effects missing from the given model (`base`, `effects`); without a base the campaign's own
/// is taken.
pub fn diagnose(
    all: &Observations,
    base: Option<BaseParameters>,
    effects: Effects,
    progress: &mut dyn FnMut(&str),
) -> Diagnosis {
    let base = base.unwrap_or_else(|| start(all));
    let cut = fit(all, &base, &effects);
    // Codes end at 0: noise that reaches below is certainly cut off, and the search goes on from there.
    let cut_off = CutOff::of(all, &cut);
    let (mut model, start) = match &cut_off {
        Some(open) => (open.model.clone(), with_cut(all, &open.model)),
        None => (cut.clone(), cut),
    };
    let mut first = compare(all, &model);
    progress(&format!("error {:.2}", first.error));
    let mut found = search(all, &start, first.error > FAR, progress);
    // A fit that ended in a shallow minimum is no evidence for the effects that led out of it.
    if let Some(deeper) = deeper(all, &model, &found.fitted).filter(|_| cut_off.is_none()) {
        tracing::debug!("objective {:.1} without effects, was {:.1}", deeper.objective, model.objective);
        (first, model) = (compare(all, &deeper), deeper);
        found = search(all, &model, first.error > FAR, progress);
    }
    // Evidence supports the models that were given up as it does those that hold.
    let mut given_up: Vec<Fitted> = found.given_up.into_iter().collect();
    let (mut parts, mut whole, mut last) =
        parts(all, &model, found.fitted, found.first, &first, &mut given_up);
    let mut notes: Vec<String> = all.missing.clone();
    let weak = || parts.iter().all(|p| !surely_there(all, &model, &whole, p.effect));
    if first.p_value >= DOUBT && (score(all, &model) - score(all, &whole) < TRACE || weak()) {
        notes.extend(parts.iter().map(trace));
        (parts, whole, last) = (Vec::new(), model.clone(), first.clone());
    }
    // Samples that the range of the codes cuts off are evidence, though a lower read noise fits the darks
    // equally well.
    if let Some(cut_off) = &cut_off {
        if parts.iter().all(|p| p.effect.id() != CUT) {
            whole = with_cut(all, &whole);
            (parts, last) = (left_out(all, &model, &whole), compare(all, &whole));
        }
        cut_off.weigh(&mut parts);
    }
    progress(&format!("error {:.2} with {} effects added", last.error, parts.len()));
    let mut ladder = vec![Rung { added: None, error: first.error, p_value: first.p_value }];
    ladder.extend(rungs(all, &model, &parts, &whole, &last));
    let remainder = remainder(all, &whole, [&first, &last], parts.is_empty());
    let forms = other_forms(all, &parts, &whole);
    // Samples cut off at code 0 are evidence by themselves, and no law has them.
    let is_cut = parts.iter().any(|p| p.effect.id() == CUT);
    let mut laws = None;
    if (1..=proposal::MAX_LAWS).contains(&parts.len()) && !is_cut {
        progress("comparing the names with laws");
        laws = proposal::in_place_of_names(all, &model);
    }
    let law = laws.as_ref().and_then(|laws| laws.better(all, &model, &whole));
    let mut missing =
        missing(all, &parts, &whole, &forms, [&first, &last], &ladder, (remainder.as_ref(), law));
    let dimmest_dn = dimmest_signal_dn(all, &whole);
    for m in &mut missing {
        m.by_the_darks_alone = m.parameters.get("knee_dn").is_some_and(|knee| knee.value < dimmest_dn);
        m.evidence.extend(suspects(&m.effect, &all.left_on));
        if let Some(cut_off) = cut_off.as_ref().filter(|_| m.effect == CUT) {
            m.evidence.insert(0, cut_off.to_string());
        }
    }
    // The note on smear is kept if smear, or an effect that looks like it, is named.
    if missing.iter().all(|m| !["smear", "exposure-offset", "unknown"].contains(&m.effect.as_str())) {
        notes.retain(|note| note != NO_PATCH);
    }
    if !whole.effects.iter().any(|(effect, values)| effect.is_in_time(values)) {
        notes.retain(|note| note != NO_TIMES);
    }
    let mut next = next_measurement(all, &parts, &missing);
    let mut alternatives = equally_good(&parts, &forms, &whole);
    // `unknown` in the first place puts all names in doubt, and so do darks that may be off: the values
    // without the names are equally good.
    if missing.first().is_some_and(|m| m.effect == "unknown" || m.by_the_darks_alone) {
        alternatives.push(&model);
    }
    alternatives.extend(given_up.iter().filter(|_| !parts.is_empty()));
    let nameless = missing.iter().position(|m| m.effect == "unknown");
    let proposal = nameless.and_then(|at| {
        progress("looking for a law for what has no name");
        if laws.is_none() && at == 0 {
            laws = proposal::in_place_of_names(all, &model);
        }
        let in_place = laws.take().filter(|_| at == 0);
        proposal::propose(all, &model, &whole, in_place)
    });
    let of_law = proposal.as_ref().filter(|p| nameless == Some(0) && p.holds());
    let of_law = of_law.and_then(|p| p.next_measurement.clone());
    if let (Some(measure), Some((about, _))) = (of_law, next.as_mut()) {
        *about = measure;
    }
    // The values are those of the model with a law, if the law holds.
    let with_law = proposal.as_ref().filter(|p| p.holds()).and_then(|p| Some((p, p.fitted.as_ref()?)));
    let sensor = match with_law {
        Some((law, fitted)) => {
            law.say_in(&mut missing);
            // Names that hold as well have values of their own, names that stay have their ties, and several
            // laws may describe what another one would describe with another gain.
            let mut others = if law.beside.is_empty() { Vec::new() } else { alternatives };
            others.extend((last.p_value >= DOUBT).then_some(&whole));
            others.extend(law.has_several().then_some(&model));
            sensor(all, fitted, &others, law.error_after).with_open_gain(law.gain_open_rel)
        }
        None => {
            notes.extend(sensor::range_of_gains(&whole, &alternatives, !forms.is_empty()));
            sensor(all, &whole, &alternatives, last.error)
        }
    };
    notes.extend(sensor::below_zero(&sensor));
    Diagnosis {
        verdict: Verdict::of(&missing, remainder.as_ref(), &first, &whole, &all.left_on, proposal.as_ref()),
        consistent: missing.is_empty()
            && !all.flats_left_out
            && !all.data_faults.iter().any(DataFault::is_of_means),
        error_before: first.error,
        error_after: last.error,
        ladder,
        next_plan: next.as_ref().map(|(about, sets)| Plan::of_takes(about, sets)),
        next_measurement: next.map(|n| n.0),
        missing,
        remainder,
        proposal,
        sensor,
        left_on: all.left_on.clone(),
        data_faults: all.data_faults.clone(),
        notes,
        fitted: Some(whole),
        comparisons: vec![first, last],
    }
}

/// Returns the signal of the dimmest flat, DN; infinite without flats.
fn dimmest_signal_dn(all: &Observations, whole: &Fitted) -> f64 {
    let is_lit = |set: usize| all.campaign.sets[set].light.is_some();
    let lit = all.of(&mean::Mean).filter(|o| o.set.is_some_and(is_lit));
    lit.map(|o| o.measured.value - whole.base.offset_dn).fold(f64::INFINITY, f64::min)
}

/// Fits the given model from the end of a search; returns it if that is the larger part of the gain.
fn deeper(all: &Observations, model: &Fitted, found: &Fitted) -> Option<Fitted> {
    let has_more = found.effects.len() > model.effects.len();
    let again = has_more.then(|| fit(all, &found.base, &model.effects))?;
    let gained = model.objective - found.objective;
    (model.objective - again.objective > NEEDED.max(0.5 * gained)).then_some(again)
}

/// Names the camera features left on that act like an effect; for `unknown` all of them.
fn suspects(effect: &str, left_on: &[LeftOn]) -> Option<String> {
    let acts = |l: &&LeftOn| effect == "unknown" || l.acts_like.iter().any(|id| id == effect);
    let names: Vec<String> = left_on.iter().filter(acts).map(ToString::to_string).collect();
    (!names.is_empty())
        .then(|| format!("{} was left on in the camera and may be all there is to it", names.join(", ")))
}

/// Builds the entries of the answer, the largest share first, each followed by its ties. `unknown` is first
/// if names are the smaller part or wrong, and last if the remainder matters. `law`: sentence on laws that
/// explain the campaign better than all names.
fn missing(
    all: &Observations,
    parts: &[Part],
    whole: &Fitted,
    forms: &[OtherForm],
    [first, last]: [&Comparison; 2],
    ladder: &[Rung],
    (remainder, law): (Option<&Remainder>, Option<String>),
) -> Vec<Missing> {
    let seen = seen(all, &whole.base);
    let fitted = residuals_of(all, whole);
    let named = named(parts, whole, [first, last], &fitted, ladder, &seen);
    let left = remainder.map_or(0.0, |r| r.share);
    let mut named = named;
    for (entry, share) in named.iter_mut().zip(shares(parts, &fitted)) {
        entry.share = share * (1.0 - left);
        entry.cost = cost::of_effect(all, whole, &entry.effect);
        for form in forms.iter().filter(|form| form.id() == entry.effect) {
            let other = cost::of_effect(all, &form.fitted, &entry.effect);
            if other.largest() > entry.cost.largest() {
                entry.cost = other;
            }
            entry.or_form = Some(form.name().into());
            entry.evidence.push(form.words());
        }
        let values = whole.effects.iter().find(|(e, _)| e.id() == entry.effect);
        entry.evidence.extend(values.and_then(|(e, values)| e.fits_as_well(values, &seen)));
    }
    let mut out = with_ties(parts, whole, named, &seen);
    let first_in_doubt = parts.first().and_then(|p| doubt(all, p, whole, &seen, last)).or(law);
    for part in parts.iter().skip(1) {
        let doubt = doubt(all, part, whole, &seen, last).or_else(|| part.better());
        let entry = out.iter_mut().find(|m| m.effect == part.effect.id());
        if let (Some(entry), Some(doubt)) = (entry, doubt) {
            entry.partial = true;
            entry.evidence.push(doubt);
        }
    }
    let goes_on = |id: &str| {
        let found = whole.effects.iter().find(|(e, _)| e.id() == id);
        found.is_some_and(|(e, values)| e.has_memory() && e.forgets_after(values).is_none())
    };
    for m in out.iter_mut().filter(|m| goes_on(&m.effect)) {
        if all.before_sets == Before::Level {
            m.partial = true;
            m.evidence.push(
                "first frames carry nothing of the set before: either frames were exposed between the sets that are not in the dataset, or it \
                 is noise that successive frames share; sets without discarded frames tell"
                    .into(),
            );
        }
    }
    costliest_first(&mut out);
    let largest = out.iter().map(|m| m.share).fold(0.0, f64::max);
    let place =
        place_of_unknown(parts, first_in_doubt.as_deref(), (left, largest), [first.error, last.error]);
    if place == Place::Nowhere {
        return out;
    }
    let mut unknown = unknown(parts, first_in_doubt, first, last);
    unknown.share = left;
    unknown.cost = remainder.map(|r| r.cost).unwrap_or_default();
    for m in out.iter_mut().take(if place == Place::First { usize::MAX } else { 1 }) {
        m.partial = true;
        let rest = remainder.and_then(|r| r.largest.first());
        let rest = rest.map_or(String::new(), |text| format!("; most of the rest is in {text}"));
        m.evidence.push(format!("all names together explain {} of the misfit{rest}", percent(1.0 - left)));
    }
    match place {
        Place::First => out.insert(0, unknown),
        _ => out.push(unknown),
    }
    out
}

/// Minimum share of the misfit, minimum cost, and minimum ratio of the cost to that of the largest share, for
/// an effect to be moved to the front (named choices: a smaller cost is below the per cent that EMVA 1288
/// asks for).
const COSTLY: (f64, f64, f64) = (0.1, 0.01, 5.0);

/// Moves the effect that costs far more than the largest share to the front, with its ties.
fn costliest_first(out: &mut [Missing]) {
    let Some(first) = out.first().map(|m| m.cost.largest()) else { return };
    let is_costly = |m: &Missing| {
        let cost = m.cost.largest();
        m.tied_with.is_none() && !m.partial && m.share >= COSTLY.0 && cost > COSTLY.1.max(COSTLY.2 * first)
    };
    let costly = out.iter().enumerate().filter(|(_, m)| is_costly(m));
    let Some((k, id)) = costly
        .max_by(|a, b| a.1.cost.largest().total_cmp(&b.1.cost.largest()))
        .map(|(k, m)| (k, m.effect.clone()))
    else {
        return;
    };
    let ties = out[k + 1..].iter().take_while(|m| m.tied_with.as_ref() == Some(&id)).count();
    out[..=k + ties].rotate_right(1 + ties);
}

/// Returns the evidence of levels and light against a bend of the means, or that they do not tell it from
/// noise.
fn straight(all: &Observations, part: &Part, whole: &Fitted) -> Option<String> {
    if !part.effect.bends_means() || all.means_given {
        return None;
    }
    // Squares and log errors of the noise; the rest of the objective is that of levels, profiles and light.
    let is_level = |r: &&Residual| {
        r.statistic == LineProfile.id() || STATISTICS.iter().any(|s| s.is_level() && s.id() == r.statistic)
    };
    let of = |residuals: &[Residual]| -> f64 {
        let noise = residuals.iter().filter(|r| !is_level(r));
        noise.map(|r| r.z * r.z + 2.0 * r.std_err.ln()).sum()
    };
    let by_noise = of(&part.without) - of(&residuals_of(all, whole));
    let by_light = part.rest.objective - whole.objective - by_noise;
    tracing::debug!("{}: levels and light {by_light:.1}, noise {by_noise:.1}", part.effect.id());
    if by_light >= NEEDED || by_light > by_noise {
        return None;
    }
    let flats = all.kinds.iter().filter(|kind| **kind == Kind::Flat).count();
    if flats >= whole.open_lights() + LEAST_FLATS {
        return Some(format!(
            "it is not {}: the mean follows the light without a bend, and only the noise grows otherwise than photons make it",
            part.effect.id()
        ));
    }
    // Noise of any kind adds to the variance; only a curve lowers it.
    (cost::of_effect(all, whole, part.effect.id()).gain_rel > 0.0).then(|| {
        format!(
            "the noise grows with the signal faster than photons make it, as {} makes it and other noise too: flats at one light and several \
             exposures, or a stated illumination_rel_std, tell",
            part.effect.id()
        )
    })
}

/// Minimum number of flats, beyond those whose light is open, for a bend to show in the means: a line takes
/// two.
const LEAST_FLATS: usize = 3;

/// Returns the reason why a part is not the named effect, though it explains nearly all that is fitted.
fn doubt(all: &Observations, part: &Part, whole: &Fitted, seen: &Seen, last: &Comparison) -> Option<String> {
    let at = whole.effects.iter().rposition(|(e, _)| e.id() == part.effect.id())?;
    let (effect, values) = &whole.effects[at];
    let told =
        || !effect.told_by().is_empty() && is_told(all, &without(all, whole, at), whole, *effect, seen);
    if !is_something(whole, at, seen) && !told() {
        return Some(format!("every size of {} is nothing within its errors beside the rest", effect.id()));
    }
    let contradicted = effect.contradicted(values, &whole.std_err[at], seen).map(str::to_string);
    let sets = all.kinds.iter().zip(&all.set_numbers);
    let lit = sets.filter(|(kind, _)| **kind == Kind::Flat).map(|(_, set)| *set).collect();
    let why = contradicted.or_else(|| not_told(part, last, &lit)).or_else(|| in_turns(all, part, whole));
    why.map(|why| format!("it is not {}: {why}", effect.id())).or_else(|| straight(all, part, whole))
}

/// Finds the worst remaining deviation of the statistics that tell an effect from its look-alikes. These are
/// planned tests, whose chance is not that of the worst of all. The deviation must matter beside what the
/// effect explains.
fn not_told(part: &Part, last: &Comparison, lit: &BTreeSet<u32>) -> Option<String> {
    let told_by = part.effect.told_by();
    let tells = |r: &&Residual| told_by.contains(&&*r.statistic) || told_by.contains(&r.observable.as_str());
    let told: Vec<Residual> = last.residuals.iter().filter(tells).cloned().collect();
    // Each statistic as a whole, and flats and darks alone: a deviation without light is the same with it.
    let mut groups = by(&told, |r| {
        // Tests of settings are requested by name.
        if told_by.contains(&r.observable.as_str()) { &*r.observable } else { &*r.statistic }
    });
    let (flats, darks): (Vec<Residual>, Vec<Residual>) =
        told.into_iter().partition(|r| r.set.is_some_and(|set| lit.contains(&set)));
    if !flats.is_empty() && !darks.is_empty() {
        groups.extend(by(&flats, |r| &r.observable));
        groups.extend(by(&darks, |r| &r.observable));
    }
    let worst = groups.iter().min_by(|a, b| a.chance.total_cmp(&b.chance))?;
    // A scatter excuses what it does not explain. Only a statistic that is independent of its size tells
    // whether frames, or settings, scatter independently.
    let is_scatter = part.effect.shown_by().is_some() || part.effect.sets_each();
    let matters = worst.excess >= MATTERS * part.evidence || is_scatter;
    if worst.chance * groups.len() as f64 >= HOLDS || !matters {
        return None;
    }
    let said = match words_of_settings(&worst.name) {
        Some(words) => words.to_string(),
        None => format!("with it {} still deviates by more than chance gives", worst.name),
    };
    Some(format!("{said} (p {})", chance(worst.chance)))
}

/// Returns the most informative next measurement in words, and its sets.
fn next_measurement(
    all: &Observations,
    parts: &[Part],
    missing: &[Missing],
) -> Option<(String, &'static [Take])> {
    if all.means_given && !missing.is_empty() {
        let words = "flats with their neighbour covariances (brighter-fatter) and an exposure sweep at fixed light (nonlinearity)";
        return Some((words.into(), takes::SWEEP));
    }
    let tie = parts.iter().find_map(|part| {
        let page = part.effect.page();
        let other = part.tied().first()?.effect.id();
        Some((format!("{} or {other}: {}", part.effect.id(), page.measure), page.sets))
    });
    tie.or_else(|| {
        let words = "the statistic that deviates most, at more levels and frames; a custom formula in the model file can describe it";
        missing.iter().any(|m| m.effect == "unknown").then(|| (words.into(), takes::PAIRS))
    })
}

/// Returns the effects found, each by what it explains when it alone is left out, strongest first; the model
/// with all of them, and its comparison.
fn parts(
    all: &Observations,
    model: &Fitted,
    mut whole: Fitted,
    first: Vec<Candidate>,
    before: &Comparison,
    given_up: &mut Vec<Fitted>,
) -> (Vec<Part>, Fitted, Comparison) {
    let nothing = || (Vec::new(), model.clone(), before.clone());
    let (parts, last) = loop {
        if whole.effects.len() == model.effects.len() {
            return nothing();
        }
        let (parts, last) = (left_out(all, model, &whole), compare(all, &whole));
        match without_one(all, &parts, &last) {
            Some(less) => {
                let less = fit(all, &less.base, &less.effects);
                given_up.push(std::mem::replace(&mut whole, less));
            }
            None => break (parts, last),
        }
    };
    // A single addition that does not help on held-out frames is dropped. The stated light is in no frame,
    // however: a lamp that scatters by more deviates from that alone.
    if let [only] = parts.as_slice() {
        tracing::debug!("{} alone: error {:.4}, was {:.4}", only.effect.id(), last.error, before.error);
        let of_stated = only.effect.sets_each() && matches!(all.setting, Some(Setting::Stated(_)));
        // A few residuals that make a campaign unlikely hardly move the error over all.
        let mends = before.p_value < P_LIMIT && last.p_value >= DOUBT && last.error <= before.error;
        if !of_stated && !mends && last.error > before.error - HELPS {
            return nothing();
        }
    }
    let fitted = residuals_of(all, &whole);
    let explains = shares(&parts, &fitted);
    let mut order: Vec<usize> = (0..parts.len()).collect();
    order.sort_by(|&a, &b| explains[b].total_cmp(&explains[a]));
    let mut slots: Vec<Option<Part>> = parts.into_iter().map(Some).collect();
    let mut parts: Vec<Part> = order.into_iter().filter_map(|i| slots[i].take()).collect();
    let alone = parts.len() == 1;
    for (k, part) in parts.iter_mut().enumerate() {
        part.others = if alone {
            first.iter().filter(|c| c.effect.id() != part.effect.id()).cloned().collect()
        } else if k > 0 && (part.better().is_some() || last.p_value < HOLDS) {
            // The name is in doubt anyway.
            Vec::new()
        } else {
            rivals(all, &part.rest, part.effect, part.evidence)
        };
        // Evidence also grows as errors become narrower: a candidate with more of it that does not hold is no
        // rival.
        let evidence = part.evidence;
        part.others.retain(|c| c.evidence <= evidence || compare(all, &c.fitted).p_value >= HOLDS);
        tracing::debug!(
            effect = part.effect.id(),
            evidence = part.evidence,
            nameless = part.nameless,
            next = part.others.first().map_or(0.0, |c| c.evidence),
            "part"
        );
    }
    (parts, whole, last)
}

/// Describes an effect that is too weak for a name.
fn trace(part: &Part) -> String {
    format!(
        "a trace of {} (evidence {:.0}): the model holds without it, and a name needs some four standard errors",
        part.effect.id(),
        part.evidence
    )
}

/// Builds the ladder: the parts added one by one, the strongest first.
fn rungs(all: &Observations, model: &Fitted, parts: &[Part], whole: &Fitted, last: &Comparison) -> Vec<Rung> {
    let rung = |k: usize| {
        let added = Some(parts[k].effect.id().to_string());
        if k + 1 == parts.len() {
            return Rung { added, error: last.error, p_value: last.p_value };
        }
        let mut effects = model.effects.clone();
        for part in &parts[..=k] {
            effects.extend(whole.effects.iter().find(|(e, _)| e.id() == part.effect.id()).cloned());
        }
        // The last rung but one lacks only the last part: its `rest` is that model.
        let c = if k + 2 == parts.len() {
            compare(all, &parts[k + 1].rest)
        } else {
            compare(all, &fit_near(all, whole, &effects))
        };
        Rung { added, error: c.error, p_value: c.p_value }
    };
    (0..parts.len()).into_par_iter().map(rung).collect()
}

/// Builds the entries of the parts. `fitted`: residuals with all of them.
fn named(
    parts: &[Part],
    whole: &Fitted,
    [first, last]: [&Comparison; 2],
    fitted: &Vec<Residual>,
    ladder: &[Rung],
    seen: &Seen,
) -> Vec<Missing> {
    let entry = |(k, part): (usize, &Part)| {
        let mut entry = describe(whole, part.effect, part.confidence(part.evidence), seen);
        entry.error_drop = ladder[k].error - ladder[k + 1].error;
        // A part that stands alone is compared on held-out frames.
        let [without, with] =
            if parts.len() == 1 { [&first.residuals, &last.residuals] } else { [&part.without, fitted] };
        entry.evidence = reasons(without, with, part.effect);
        let ties = part.tied();
        for other in &ties {
            entry.evidence.push(format!("a tie: {} explains it as well", other.effect.id()));
        }
        if let (true, Some(other)) = (ties.is_empty(), part.others.first().filter(|c| c.evidence > NEEDED)) {
            entry.evidence.push(format!(
                "next best: {}, which fits worse (BIC higher by {:.0})",
                other.effect.id(),
                part.evidence - other.evidence
            ));
        }
        entry
    };
    parts.iter().enumerate().map(entry).collect()
}

/// Lists each part, followed by its ties.
fn with_ties(parts: &[Part], whole: &Fitted, named: Vec<Missing>, seen: &Seen) -> Vec<Missing> {
    let mut out = Vec::new();
    for (part, entry) in parts.iter().zip(named) {
        let (drop, share, cost) = (entry.error_drop, entry.share, entry.cost);
        out.push(entry);
        for other in part.tied() {
            if whole.effects.iter().any(|(e, _)| e.id() == other.effect.id()) {
                continue;
            }
            let mut entry = describe(&other.fitted, other.effect, part.confidence(other.evidence), seen);
            (entry.error_drop, entry.share, entry.cost) = (drop, share, cost);
            entry.tied_with = Some(part.effect.id().into());
            entry
                .evidence
                .push(format!("a tie with {}: this campaign cannot tell them apart", part.effect.id()));
            out.push(entry);
        }
    }
    out
}

/// Builds the entry for what no name explains. `doubt`: reason against the first name.
fn unknown(parts: &[Part], doubt: Option<String>, first: &Comparison, last: &Comparison) -> Missing {
    let strongest = parts.first();
    let better = strongest.and_then(Part::better);
    let mut nearest: Vec<String> = parts.iter().map(|p| p.effect.id().to_string()).collect();
    if let Some(part) = strongest {
        nearest.extend(part.others.iter().filter(|c| c.evidence > NEEDED).map(|c| c.effect.id().to_string()));
    }
    nearest.dedup();
    nearest.truncate(NEAREST);
    let mut evidence = what_deviates(first, last, strongest.is_some());
    evidence.extend(better);
    if let Some(doubt) = &doubt {
        evidence.insert(0, doubt.clone());
    }
    if evidence.is_empty() {
        evidence.push(format!("error {:.3} over all statistics, p {}", last.error, chance(last.p_value)));
    }
    let confidence = match strongest {
        Some(part) if doubt.is_some() => part.confidence(part.nameless).max(0.5),
        Some(part) if last.p_value >= DOUBT => part.confidence(part.nameless),
        _ => 1.0 - last.p_value.min(1.0),
    };
    Missing {
        effect: "unknown".into(),
        confidence,
        share: 0.0,
        cost: Cost::default(),
        error_drop: 0.0,
        parameters: BTreeMap::new(),
        form: None,
        or_form: None,
        partial: false,
        nearest,
        tied_with: None,
        evidence,
        doubt,
        by_the_darks_alone: false,
    }
}

/// Describes the deviations: those left with all names tell what to look for, those before tell where to
/// look.
fn what_deviates(first: &Comparison, last: &Comparison, named: bool) -> Vec<String> {
    let of = |c: &Comparison, most: usize| -> Vec<String> {
        signatures(&c.residuals).into_iter().take(most).map(|s| s.text).collect()
    };
    if !named {
        return of(last, 6);
    }
    let left = of(last, 4).into_iter().map(|text| format!("remaining with all named effects: {text}"));
    left.chain(of(first, 3).into_iter().map(|text| format!("starting model: {text}"))).collect()
}

#[cfg(test)]
mod tests {
    use super::{Cost, Missing, STATISTICS, Statistic, costliest_first};
    use crate::inference::{ALIKE_IN_SIGNAL, AT_LONG_EXPOSURES, STEP_IN_SIGNAL, THAT_COME_BACK};
    use radcam_sim::effects;

    /// A filter that makes the gain wrong, with its ties, stands before an effect that has a larger share and
    /// costs nothing; a trace or a partial effect does not.
    #[test]
    fn what_costs_most_stands_first() {
        let entry = |effect: &str, share: f64, gain_rel: f64| Missing {
            effect: effect.into(),
            confidence: 1.0,
            share,
            cost: Cost { gain_rel, ..Cost::default() },
            error_drop: 0.0,
            parameters: Default::default(),
            form: None,
            or_form: None,
            partial: false,
            nearest: Vec::new(),
            tied_with: None,
            evidence: Vec::new(),
            doubt: None,
            by_the_darks_alone: false,
        };
        let order = |mut list: Vec<Missing>| -> Vec<String> {
            costliest_first(&mut list);
            list.into_iter().map(|m| m.effect).collect()
        };
        let tied = Missing { tied_with: Some("b".into()), ..entry("c", 0.3, 0.2) };
        let list = vec![entry("a", 0.6, 0.0), entry("b", 0.3, 0.2), tied, entry("d", 0.1, 0.0)];
        assert_eq!(order(list), ["b", "c", "a", "d"]);
        assert_eq!(order(vec![entry("a", 0.95, 0.0), entry("b", 0.05, 0.2)]), ["a", "b"]);
        let partial = Missing { partial: true, ..entry("b", 0.3, 0.2) };
        assert_eq!(order(vec![entry("a", 0.7, 0.0), partial]), ["a", "b"]);
        assert_eq!(order(vec![entry("a", 0.7, 0.05), entry("b", 0.3, 0.2)]), ["a", "b"]);
    }

    /// A misspelt name would never contradict anything.
    #[test]
    fn effects_name_statistics_that_exist() {
        for effect in effects::all() {
            for name in effect.told_by() {
                let is_name = |s: &&&dyn Statistic| s.id() == *name || (0..20).any(|k| s.name(k) == *name);
                let of_settings =
                    [ALIKE_IN_SIGNAL, AT_LONG_EXPOSURES, STEP_IN_SIGNAL, THAT_COME_BACK].contains(name);
                let known = of_settings || STATISTICS.iter().any(|s| is_name(&s));
                assert!(known, "{}: no statistic \"{name}\"", effect.id());
            }
        }
    }
}
