//! Darks that all have another camera, gain or black level than the flats: no dark stands out among the
//! others, and only the flats reveal it.
//!
//! The flats contain the fixed pattern of the darks: over the level, each of their pixels lies on a line
//! (offset and response: Healey and Kondepudy 1994, eq. 22), whose value at zero signal is the offset
//! pattern. The regression of that on the dark pattern is 1; another gain makes it the ratio of the
//! gains; another camera, a turned frame, or dark subtraction in the camera make it 0. If the black
//! level differs, both level and noise of the flats meet the darks elsewhere; an exposure longer than
//! stated shifts only the level.

use super::campaign::Zero;
use super::law::{Law, Point};
use super::patterns::{Line, Noise, combined, moved_by, noise_of_mean, share};
use super::set_view::SetView;
use super::transfer::{MIN_VARIANCE_DN2, MODEL_ERROR, Transfer};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::{six_digits, with_error};
use crate::statistics::median::median;
use crate::statistics::quantisation::QUANTISATION_DN2;
use std::collections::BTreeMap;

/// Minimum deviation from 1 of the pattern in the flats, standard deviations.
const MIN_SIGMAS: f64 = 8.0;
/// Maximum fraction of the pattern at which it counts as absent.
const MAX_ABSENT: f64 = 0.2;
/// Minimum ratio of two gains that is reported (cameras step in 1 dB or more: 1.12), and a margin.
const MIN_GAIN_RATIO: f64 = 1.25;
/// Minimum fraction of the noise shared by neighbours in filtered flats (a named choice).
const MAX_SHARED: f64 = 0.1;
/// Minimum ratio of the flats' levels for an extrapolation to zero signal.
const MIN_RANGE: f64 = 2.5;
/// Maximum bend of a straight response, relative to the range.
const MAX_BEND: f64 = 0.03;
/// Maximum relative difference of exposures with interchangeable dark charge.
const SAME_EXPOSURE: f64 = 0.2;
/// Maximum ratio of a dark's exposure to that of the longest flat (a named choice; the standard plan has
/// 16): the charge of far longer darks dominates their pattern, and their hot pixels are saturated.
const MAX_LONGER: f64 = 20.0;
/// Minimum level change within a dark set that shows light carried over from earlier frames, relative to
/// the brightest flat's signal (a named choice: no black level moves by as much).
const MIN_CARRIED_REL: f64 = 0.02;
/// Maximum number of darks for a search over all pairs.
const MAX_DARKS_FOR_PAIRS: usize = 8;
/// Minimum ratio of the darks' exposures that determines the growth of the pattern.
const MIN_EXPOSURE_RATIO: f64 = 1.5;
/// Usual bend of a response at the highest level, relative to the range, scatter of a lamp, and minimum
/// error of a level, DN (named choices).
const USUAL_BEND: f64 = 0.2;
const LAMP_SCATTER: f64 = 0.002;
const MIN_STD_DN: f64 = 0.02;
/// Minimum significance by noise that the darks' black level differs from the flats', maximum distance
/// from the one given by the level, standard deviations, and minimum difference of their squares (named
/// choices: the level must agree).
const BLACK: (f64, f64) = (4.0, 3.0);
const MIN_DIFFERENCE_OF_SQUARES: f64 = 9.0;
/// Maximum error of the flats' level at zero light, relative to that of the darks, that distinguishes
/// dark-subtracted flats and lost bits from a coincidence (a named choice).
const MAX_REL_ERROR_AT_ZERO: f64 = 0.12;
/// Minimum tolerance around code 0, or a multiple of the darks' level, relative to that level: a black
/// level drifts by less (a named choice).
const MIN_REL_TOLERANCE: f64 = 0.01;
/// Minimum deficit of the noise of darks with lost bits below that of the flats at zero light, standard
/// deviations.
const MIN_SIGMAS_OF_LOST_BITS: f64 = 4.0;
/// Maximum number of lost bits that is searched for.
const MAX_LOST_BITS: u32 = 8;
/// Minimum ratio of the noise of the darks to that of the flats at zero light that shows another gain (a
/// named choice).
const MIN_VARIANCE_RATIO: f64 = 1.6;
/// Maximum relative difference between what darks have more than the flats leave and their growth with the
/// exposure (a named choice).
const SAME_LIGHT: f64 = 0.1;
/// Minimum difference of the black levels that is reported, DN.
const MIN_BLACK_DN: f64 = 2.0;

/// Check for darks that do not match the flats.
pub struct DarksOfFlats;

impl Check for DarksOfFlats {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero().filter(|_| campaign.is_of_one_part()) else { return Vec::new() };
        // Rounding creates its own pattern unless noise dithers it.
        let steps = campaign.sets.iter().map(|s| s.facts.step_dn.max(s.facts.code_step_dn));
        let blurred_dn2 = MIN_VARIANCE_DN2 * steps.fold(1.0, f64::max).powi(2);
        let told = |s: &SetView| s.variance_dn2().is_some_and(|v| v.0 > blurred_dn2);
        let usable = |s: &SetView| s.has_pattern() && !s.is_cut_off() && told(s);
        let lit = campaign.places(|s| s.is_lit());
        let longest_s = lit.iter().map(|&i| campaign.sets[i].exposure_s).fold(0.0, f64::max);
        let is_long = |s: &SetView| s.exposure_s > MAX_LONGER * longest_s;
        let brightest = lit.iter().map(|&i| campaign.sets[i].level_dn()).fold(0.0, f64::max);
        let carries = |s: &SetView| {
            let means = s.facts.means_dn.iter();
            let (least, most) = means.fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
            most - least > MIN_CARRIED_REL * (brightest - least)
        };
        let darks = campaign.places(|s| s.kind == Kind::Dark && usable(s) && !is_long(s));
        // Darks whose noise is hidden by rounding still have a valid level.
        let has_level = |s: &SetView| s.has_pattern() && !s.is_cut_off() && !is_long(s);
        let with_level = campaign.places(|s| s.kind == Kind::Dark && has_level(s));
        let mut flats = campaign.flats_by_field();
        flats.values_mut().for_each(|sets| sets.retain(|&i| usable(&campaign.sets[i])));
        // A single level gives no line.
        flats.retain(|_, sets| sets.len() > 1);
        let of_one_size = campaign.are_of_one_size(darks.iter().chain(flats.values().flatten()));
        // Carried-over light has the pattern of the flats, and darks after dim flats carry some as well.
        let carried = with_level.iter().any(|&i| carries(&campaign.sets[i]));
        if with_level.is_empty() || flats.is_empty() || !of_one_size || carried {
            return Vec::new();
        }
        let Some(response) = Response::of(campaign, &flats, &zero) else { return Vec::new() };
        let pattern =
            if darks.is_empty() { None } else { of_pattern(campaign, &darks, &flats, &zero, &response) };
        let verdict =
            pattern.map(Verdict::new).or_else(|| of_black_level(campaign, &with_level, &zero, &response));
        let Some(Verdict { text, flats_are_dark_subtracted }) = verdict else { return Vec::new() };
        campaign.flats_are_dark_subtracted = flats_are_dark_subtracted;
        let all = campaign.places(|s| s.kind == Kind::Dark);
        let text = format!("all darks: {text}");
        vec![campaign.fault_of_sets(FaultKind::OtherSettings, &all, text, true)]
    }
}

/// Fault of all darks.
struct Verdict {
    text: String,
    /// True if the black level was subtracted from the flats, and not from the darks.
    flats_are_dark_subtracted: bool,
}

impl Verdict {
    fn new(text: String) -> Self {
        Self { text, flats_are_dark_subtracted: false }
    }
}

/// Level of the flats over exposure times light.
struct Response {
    /// Level at zero light, above the darks, DN, and its standard deviation.
    black_dn: (f64, f64),
    /// True if the response is known to be straight.
    straight: bool,
}

impl Response {
    /// Fits one line for each position of card and light, with a common level at zero light and a common
    /// bend.
    fn of(campaign: &Campaign<'_>, flats: &BTreeMap<u32, Vec<usize>>, zero: &Zero) -> Option<Self> {
        let light = |i: usize| campaign.sets[i].light();
        let above = |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s);
        let scatter = campaign.scatter(zero);
        let lines = flats.len();
        let range = flats.values().flatten().map(|&i| above(i)).fold(1.0, f64::max);
        let mut points = Vec::new();
        for (k, sets) in flats.values().enumerate() {
            let brightest = *sets.iter().max_by(|a, b| light(**a).total_cmp(&light(**b)))?;
            for &i in sets {
                let x = light(i) / light(brightest);
                let own = scatter.of_frame_dn(&campaign.sets[i]) / (campaign.sets[i].frames() as f64).sqrt();
                let mut factors = vec![0.0; lines + 2];
                (factors[0], factors[1], factors[2 + k]) = (1.0, x * x * above(brightest) / range, x);
                let std = own.hypot(LAMP_SCATTER * above(i)).max(MIN_STD_DN);
                points.push(Point { factors, value: above(i), std });
            }
        }
        let priors: Vec<f64> =
            [1e5, USUAL_BEND * range].into_iter().chain(std::iter::repeat_n(1e6, lines)).collect();
        let most = if points.len() > lines + 2 { (points.len() / 5).clamp(1, 3) } else { 0 };
        let law = Law::fit(&points, &priors, most)?;
        let coefficient = |k: usize, std: f64| {
            let factors: Vec<f64> = (0..lines + 2).map(|i| f64::from(u8::from(i == k))).collect();
            (law.at(&factors), law.std(&Point { factors, value: 0.0, std }))
        };
        // A bend at the end of the range shifts the middle by a quarter of it.
        let bend = coefficient(1, 0.0);
        let straight = 0.25 * (bend.0.abs() + bend.1) < MAX_BEND * range;
        Some(Self { black_dn: coefficient(0, zero.scatter_dn.max(MIN_STD_DN)), straight })
    }
}

/// Returns the verdict of the fixed pattern.
fn of_pattern(
    campaign: &Campaign<'_>,
    darks: &[usize],
    flats: &BTreeMap<u32, Vec<usize>>,
    zero: &Zero,
    response: &Response,
) -> Option<String> {
    // Smoothed or sharpened flats have a modified dark pattern too.
    let shared = flats.values().flatten().map(|&i| campaign.sets[i].facts.neighbours.share.abs());
    if median(shared) > MAX_SHARED {
        return None;
    }
    let columns = campaign.sets[darks[0]].facts.middle_columns;
    let above =
        |i: usize| campaign.sets[i].level_dn() - zero.at(campaign.sets[i].exposure_s) - response.black_dn.0;
    // Value at zero signal for each position of card and light, and their mean.
    let (mut sets, mut of_flats, mut total) = (Vec::new(), Vec::new(), 0.0);
    for own in flats.values() {
        let level: Vec<f64> = own.iter().map(|&i| above(i)).collect();
        let (least, most) = level.iter().fold((f64::INFINITY, 0.0f64), |(a, b), v| (a.min(*v), b.max(*v)));
        let Some(line) = Line::of(campaign, own, &level).filter(|_| least > 0.0 && most > MIN_RANGE * least)
        else {
            continue;
        };
        let noise = |(w, i): (&f64, &usize)| w * w * noise_of_mean(&campaign.sets[*i]);
        let variance: f64 = line.at_zero.iter().zip(own).map(noise).sum::<f64>().max(1e-12);
        sets.extend_from_slice(own);
        of_flats.extend(line.at_zero.iter().map(|w| w / variance));
        total += 1.0 / variance;
    }
    if sets.is_empty() {
        return None;
    }
    of_flats.iter_mut().for_each(|w| *w /= total);
    // Exposure that corresponds to the dark charge of the value at zero signal.
    let exposure_s: f64 = sets.iter().zip(&of_flats).map(|(&i, w)| w * campaign.sets[i].exposure_s).sum();
    let (offsets, _) = combined(campaign, &sets, &of_flats);
    let part_of = |darks: &[usize]| {
        let of_darks = at_exposure(campaign, darks, exposure_s)?;
        let (pattern, noise_dn2) = combined(campaign, darks, &of_darks);
        let noise = Noise::of_darks(noise_dn2);
        let (part, std) = share(&offsets, &pattern, noise, columns)?;
        tracing::debug!("darks' pattern in the flats: {part:.3} +- {std:.3}");
        Some((part, std, pattern, noise))
    };
    let (part, std, pattern, noise) = part_of(darks)?;
    if (part - 1.0).abs() < MIN_SIGMAS * std {
        return None;
    }
    // One or two darks of another charge (a warm sensor, a wrong label) would tilt the line of all: a
    // property of all darks must show without any of them too.
    let is_told_without = |odd: &[usize]| {
        let others: Vec<usize> = darks.iter().copied().filter(|d| !odd.contains(d)).collect();
        let is_off = |part: f64, std: f64| (part - 1.0).abs() >= MIN_SIGMAS * std;
        others.len() < 2 || part_of(&others).is_none_or(|(part, std, ..)| is_off(part, std))
    };
    let mut pairs = darks.iter().enumerate().flat_map(|(k, a)| darks[..k].iter().map(move |b| [*a, *b]));
    let by_singles = darks.iter().all(|d| is_told_without(&[*d]));
    if !by_singles || darks.len() <= MAX_DARKS_FOR_PAIRS && !pairs.all(|odd| is_told_without(&odd)) {
        return None;
    }
    let frames = "the fixed pattern of these darks";
    if part.abs() < MAX_ABSENT.max(4.0 * std) {
        if let Some(how) = moved_by(&offsets, &pattern, noise, columns, MIN_SIGMAS) {
            return Some(format!("{how} against the flats: {frames} is in the flats so"));
        }
        return Some(format!(
            "not of the flats: {frames} is not in the flats ({:.2} ± {:.2} of it). They are of another camera or another part of the \
             sensor, or the camera took dark frames off the flats and not off the darks",
            part, std
        ));
    }
    let ratio = 1.0 / part;
    let is_gain = part > 0.0 && !(1.0 / MIN_GAIN_RATIO..MIN_GAIN_RATIO).contains(&ratio) && response.straight;
    is_gain.then(|| {
        let ratio = with_error(ratio, std * ratio * ratio);
        format!("another gain than the flats: {frames} is {ratio} times that in the flats")
    })
}

/// Returns the verdict that the darks have light: at the exposure of the flats they are brighter than the
/// flats leave at zero light by all that they grow with the exposure, and their noise is that of as much
/// light. Charge that the sensor collects in darkness is in the flats too.
fn of_lit_darks(
    campaign: &Campaign<'_>,
    darks: &[usize],
    zero: &Zero,
    response: &Response,
    transfer: &Transfer,
) -> Option<String> {
    let (black_dn, std) = response.black_dn;
    let exposures =
        |sets: &[usize]| -> Vec<f64> { sets.iter().map(|&i| campaign.sets[i].exposure_s).collect() };
    let of_flats = median(exposures(&campaign.places(|s| s.is_lit())).into_iter());
    let like_flats = |i: &&usize| (campaign.sets[**i].exposure_s / of_flats - 1.0).abs() < SAME_EXPOSURE;
    let beside: Vec<usize> = darks.iter().filter(like_flats).copied().collect();
    let of_darks = exposures(darks);
    let longest = of_darks.iter().copied().fold(0.0, f64::max);
    let shortest = of_darks.iter().copied().fold(f64::INFINITY, f64::min);
    let grown_dn = zero.dn_per_s * of_flats;
    let is_all = (black_dn + grown_dn).abs() < SAME_LIGHT * grown_dn + BLACK.1 * std;
    if beside.is_empty() || longest < MIN_EXPOSURE_RATIO * shortest || black_dn > 0.0 || !is_all {
        return None;
    }
    let has_its_noise = |&i: &usize| {
        let (var_dn2, pairs) = campaign.sets[i].variance_dn2()?;
        let own = var_dn2 * (3.0 / (campaign.sets[i].facts.pixels * pairs)).sqrt().hypot(MODEL_ERROR);
        let off = |above_dn: f64| {
            let (expected, std) = transfer.expected_dn2(above_dn);
            (var_dn2 - expected).abs() / std.hypot(own)
        };
        let above_dn = campaign.sets[i].level_dn() - zero.dn;
        Some(off(above_dn) < BLACK.1 && off(above_dn - grown_dn) > BLACK.0)
    };
    beside.iter().all(|i| has_its_noise(i) == Some(true)).then(|| {
        format!(
            "light falls on them: in {} s they have {} DN and its noise more than the flats leave at zero light, and they grow by as much with \
             the exposure, which is no dark current",
            six_digits(of_flats),
            six_digits((10.0 * grown_dn).round() / 10.0)
        )
    })
}

/// Returns the weights that interpolate the dark pattern to an exposure; `None` if the darks do not
/// determine it.
fn at_exposure(campaign: &Campaign<'_>, darks: &[usize], exposure_s: f64) -> Option<Vec<f64>> {
    let off: Vec<f64> = darks.iter().map(|&i| campaign.sets[i].exposure_s - exposure_s).collect();
    let of = |i: usize| campaign.sets[darks[i]].exposure_s;
    let longest = (0..darks.len()).map(of).fold(0.0, f64::max);
    let shortest = (0..darks.len()).map(of).fold(f64::INFINITY, f64::min);
    if longest > MIN_EXPOSURE_RATIO * shortest {
        return Line::of(campaign, darks, &off).map(|line| line.at_zero);
    }
    let near = off.iter().all(|d| d.abs() <= SAME_EXPOSURE * longest);
    let weight: Vec<f64> = darks.iter().map(|&i| 1.0 / noise_of_mean(&campaign.sets[i]).max(1e-6)).collect();
    let sum: f64 = weight.iter().sum();
    near.then(|| weight.iter().map(|w| w / sum).collect())
}

/// Returns the verdict of level and noise on the black level.
fn of_black_level(
    campaign: &Campaign<'_>,
    darks: &[usize],
    zero: &Zero,
    response: &Response,
) -> Option<Verdict> {
    let (black_dn, std) = response.black_dn;
    if !response.straight || black_dn.abs() < MIN_BLACK_DN.max(MIN_SIGMAS * std) {
        return None;
    }
    let all_darks = campaign.places(|s| s.kind == Kind::Dark);
    let transfer = Transfer::by_pixels(campaign, zero, &all_darks)?;
    // Noise of the shortest dark compared with that of the flats, at its level and at zero light.
    let shortest = *darks
        .iter()
        .min_by(|a, b| campaign.sets[**a].exposure_s.total_cmp(&campaign.sets[**b].exposure_s))?;
    let (var_dn2, pairs) = campaign.sets[shortest].variance_dn2()?;
    let own = var_dn2 * (3.0 / (campaign.sets[shortest].facts.pixels * pairs)).sqrt().hypot(MODEL_ERROR);
    // Deviation of the darks' noise, times a factor, from that of the flats at a level, standard
    // deviations. Rounding comes after a gain.
    let off = |above_dn: f64, factor: f64| {
        let (expected, std) = transfer.expected_dn2(above_dn);
        (factor * (var_dn2 - QUANTISATION_DN2) + QUANTISATION_DN2 - expected) / std.hypot(factor * own)
    };
    let (at_dark, at_black) = (off(0.0, 1.0), off(black_dn, 1.0));
    tracing::debug!(
        "flats meet no light at {black_dn:.3} +- {std:.3} DN; the darks' noise is off by {at_black:.1} sigma there, by {at_dark:.1} at the darks' level"
    );
    if let Some(text) = of_lit_darks(campaign, darks, zero, response, &transfer) {
        return Some(Verdict::new(text));
    }
    let zero_dn = zero.at(campaign.sets[shortest].exposure_s);
    let of_flats_dn = zero_dn + black_dn;
    let is_known = std < MAX_REL_ERROR_AT_ZERO * zero_dn.max(of_flats_dn);
    let tolerance_dn = (2.0 * std).max(MIN_REL_TOLERANCE * zero_dn);
    if is_known && at_black.abs() < BLACK.1 && of_flats_dn.abs() < tolerance_dn {
        return Some(Verdict {
            text: format!(
                "the flats have {:.0} ± {std:.0} DN at zero light, and the darks {zero_dn:.0} DN: the flats are dark-subtracted (black level or dark \
                 frames), and the darks are not",
                // Rounding below zero gives -0.
                of_flats_dn.round() + 0.0
            ),
            flats_are_dark_subtracted: true,
        });
    }
    let lost_bits = (1..=MAX_LOST_BITS).find(|bits| {
        let factor = f64::from(1u32 << bits);
        let is_multiple = (of_flats_dn - factor * zero_dn).abs() < tolerance_dn.max(factor);
        let noise_agrees = off(black_dn, factor * factor).abs() < BLACK.1;
        is_known && is_multiple && noise_agrees
    });
    let lost = lost_bits.map(|bits| 1u32 << bits);
    if let Some(factor) = lost.filter(|_| at_black.abs() > MIN_SIGMAS_OF_LOST_BITS) {
        return Some(Verdict::new(format!(
            "level and noise are those of the flats at zero light divided by {factor}: the darks lost their last bits"
        )));
    }
    let is_black = at_dark.abs() > BLACK.0
        && at_black.abs() < BLACK.1
        && at_dark.powi(2) - at_black.powi(2) > MIN_DIFFERENCE_OF_SQUARES;
    let (left_dn2, _) = transfer.expected_dn2(black_dn);
    let ratio = var_dn2 / left_dn2.max(QUANTISATION_DN2);
    let is_other = at_dark.abs() > BLACK.0
        && at_black.abs() > BLACK.1
        && !(MIN_VARIANCE_RATIO.recip()..MIN_VARIANCE_RATIO).contains(&ratio);
    if is_other {
        return Some(Verdict::new(format!(
            "of another gain, bit depth or camera than the flats: these have {:.0} ± {std:.0} DN and a variance of {} DN² at zero light, and the \
             darks {zero_dn:.0} DN and {} DN²",
            of_flats_dn.round() + 0.0,
            six_digits((100.0 * left_dn2).round() / 100.0),
            six_digits((100.0 * var_dn2).round() / 100.0)
        )));
    }
    is_black.then(|| {
        Verdict::new(format!(
            "another black level than the flats, {} DN {}: level and noise of the flats both say so{}",
            six_digits(black_dn.abs()),
            if black_dn > 0.0 { "lower" } else { "higher" },
            lost.map_or(String::new(), |factor| {
                format!(
                    "; or they lost their last bits: their level is that of the flats divided by {factor}"
                )
            })
        ))
    })
}
