//! Frames of a few sets that were averaged or filtered over time before saving: less noise than usual at
//! their level, or correlated successive frames.

use super::orientation::{correlation, pattern};
use super::patterns;
use super::set_view::SetView;
use super::transfer::{self, Transfer, above};
use super::{Campaign, Check, DataFault, FaultKind};
use crate::dataset::Kind;
use crate::number::six_digits;
use crate::statistics::median::median;
use crate::statistics::quantisation::QUANTISATION_DN2;

/// Maximum ratio of the variance of averaged frames to the usual one: two frames make it a half.
const MAX_AVERAGED_RATIO: f64 = 0.8;
/// Minimum ratio of the variance of a dark with another gain to the usual one.
const MIN_GAIN_RATIO: f64 = 1.25;
/// Minimum ratio of the level of another set with as much light.
const MIN_EQUAL_LEVEL: f64 = 0.98;
/// Maximum ratio of the level at which all wells are full to that at which noise begins to be missing (a
/// named choice).
const MAX_SPREAD_OF_WELLS: f64 = 1.06;
/// Minimum deficit of the variance of successive frames relative to that of frames two apart.
const MIN_DEPENDENCE: f64 = 0.12;
/// Minimum significance of that, standard deviations.
const MIN_SIGMAS: f64 = 10.0;
/// Maximum difference of two equal variance losses, standard deviations.
const SAME_LOSS_SIGMAS: f64 = 3.0;
/// Minimum significance of the noise deficit of the shorter of two darks relative to the flats' line,
/// standard errors (a named choice).
const SIGMAS_OF_FLATS: f64 = 3.0;
/// Minimum ratio of the variances of two fixed patterns if only one includes that of a charge (a named
/// choice).
const MIN_RATIO_OF_PATTERNS: f64 = 1.3;
/// Maximum fraction of the sets that are isolated faults: more are a property of the camera.
const MAX_SHARE_OF_SETS: f64 = 0.34;

/// Minimum number of darks among which one can have another gain by its pattern.
const MIN_DARKS_FOR_A_GAIN: usize = 3;

/// Returns the amplitude of the fixed pattern of a dark relative to that of other darks of similar
/// exposure; `None` without a visible pattern.
fn pattern_gain(campaign: &Campaign<'_>, set: usize) -> Option<f64> {
    let exposure_s = campaign.sets[set].exposure_s;
    let alike = |s: &SetView| s.kind == Kind::Dark && (0.5..2.0).contains(&(s.exposure_s / exposure_s));
    let mut darks = campaign.places(alike);
    if darks.len() < MIN_DARKS_FOR_A_GAIN {
        darks = campaign.places(|s| s.kind == Kind::Dark);
    }
    if darks.len() < MIN_DARKS_FOR_A_GAIN {
        return None;
    }
    let columns = campaign.sets[set].facts.middle_columns;
    let patterns: Vec<Vec<f64>> =
        darks.iter().map(|&i| pattern(&campaign.sets[i].facts.middle_dn, columns)).collect();
    let mut sum = vec![0.0; patterns[0].len()];
    patterns.iter().for_each(|p| sum.iter_mut().zip(p).for_each(|(s, v)| *s += v));
    let slope = |k: usize| {
        let others: Vec<f64> = sum.iter().zip(&patterns[k]).map(|(s, v)| s - v).collect();
        let square: f64 = others.iter().map(|v| v * v).sum();
        let product: f64 = others.iter().zip(&patterns[k]).map(|(a, b)| a * b).sum();
        (product / square, correlation(&patterns[k], &others))
    };
    let own = darks.iter().position(|d| *d == set)?;
    let (slope_of_it, correlated) = slope(own);
    let usual = median((0..darks.len()).filter(|k| *k != own).map(|k| slope(k).0));
    (correlated > MIN_PATTERN_CORRELATION).then_some(slope_of_it / usual)
}

/// Minimum correlation of a visible pattern: ten times that of chance in 4096 pixels.
pub const MIN_PATTERN_CORRELATION: f64 = 0.16;

/// Usual relative scatter of the variances of darks about a smooth law.
const DARK_VARIANCE_SCATTER: f64 = 0.03;

/// Maximum distance of the levels of darks that rounding treats alike, DN.
const SAME_FRACTION_DN: f64 = 0.1;
/// Maximum ratio of the variance of a dark to that of all others for it to be the only quiet one, and maximum
/// ratio among the others (named choices).
const QUIETER: (f64, f64) = (0.5, 1.25);

/// Returns the only dark of three or more with far less noise than the others, which are alike, if one of
/// these has its exposure and its level: also where rounding hides its noise.
fn quieter_dark(campaign: &Campaign<'_>) -> Option<usize> {
    let darks = campaign.places(|s| s.kind == Kind::Dark && !s.clipped && !s.is_cut_off());
    let var = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
    let one = darks.iter().copied().min_by(|a, b| var(*a).total_cmp(&var(*b)))?;
    let others: Vec<usize> = darks.into_iter().filter(|i| *i != one).collect();
    let least = others.iter().map(|i| var(*i)).fold(f64::INFINITY, f64::min);
    let most = others.iter().map(|i| var(*i)).fold(0.0, f64::max);
    let own = &campaign.sets[one];
    let is_twin = |i: &usize| {
        let other = &campaign.sets[*i];
        other.exposure_s == own.exposure_s && (other.level_dn() - own.level_dn()).abs() < SAME_FRACTION_DN
    };
    let is_quieter = var(one) < QUIETER.0 * least && most < QUIETER.1 * least;
    (others.len() + 1 >= MIN_DARKS_FOR_A_GAIN && is_quieter && others.iter().any(is_twin)).then_some(one)
}

/// Returns true if the flats show that a dark of more noise is right and all others are averages, and false
/// if they do not tell, with the number of averaged frames; `None` if the dark is off: by its pattern, or by
/// the variance that the flats leave, DN^2, with its error.
fn noisier(
    campaign: &Campaign<'_>,
    dark: usize,
    others: &[usize],
    left: Option<(f64, f64)>,
) -> Option<(bool, f64)> {
    let var = |i: usize| campaign.sets[i].variance_dn2().map_or(f64::NAN, |v| v.0);
    let (own, usual) = (var(dark), median(others.iter().map(|i| var(*i))));
    let off = (own / usual).ln();
    // Averages keep the pattern of single frames; another gain scales it.
    let has_a_gain =
        pattern_gain(campaign, dark).is_some_and(|g| g > 0.0 && (2.0 * g.ln() - off).abs() < 0.35 * off);
    let rounding_dn2 = QUANTISATION_DN2 * campaign.code_step_dn.powi(2);
    let frames = ((own - rounding_dn2) / (usual - rounding_dn2).max(0.01)).round().max(2.0);
    if has_a_gain || !off.is_finite() {
        return None;
    }
    let Some((left_dn2, std_dn2)) = left else { return Some((false, frames)) };
    let is_as = |v: f64| (v - left_dn2).abs() < SIGMAS_OF_FLATS * std_dn2;
    match (is_as(own), is_as(usual)) {
        (true, false) => Some((true, frames)),
        (false, true) => None,
        _ => Some((false, frames)),
    }
}

/// Check for averaged or filtered frames.
pub struct DependentFrames;

impl Check for DependentFrames {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let Some(zero) = campaign.zero() else { return Vec::new() };
        let usable = |s: &SetView| !s.clipped && !s.is_cut_off() && !campaign.is_rounded(s);
        let all = campaign.places(|s| matches!(s.kind, Kind::Dark | Kind::Flat) && usable(s));
        let level = |i: usize| above(campaign, &zero, i);
        // Correlated frames.
        let usual = median(all.iter().filter_map(|&i| campaign.sets[i].dependence()));
        let alike = |i: usize| {
            let set = &campaign.sets[i];
            let triples = set.frames().saturating_sub(2).max(1) as f64;
            let std = (4.0 / (set.facts.pixels * triples)).sqrt();
            set.is_of_one_level(&zero)
                && !set.wanders()
                && set.dependence().is_some_and(|d| d < usual - MIN_DEPENDENCE.max(MIN_SIGMAS * std))
        };
        let mut filtered: Vec<usize> = all.iter().copied().filter(|&i| alike(i)).collect();
        let transfer = Transfer::of(campaign, &zero, &filtered);
        // A filter reduces noise: correlated frames with the usual noise are drifting, or have jumping
        // pixels.
        if let Some(transfer) = &transfer {
            let is_less = |i: usize| {
                transfer.off(campaign, i, level(i)).is_none_or(|(off, _)| off < MAX_AVERAGED_RATIO.ln())
            };
            filtered.retain(|i| is_less(*i));
        }
        let (mut averaged, mut gained) = (filtered.clone(), Vec::new());
        let mut brightest: Vec<(usize, f64, f64)> = Vec::new();
        if let Some(transfer) = &transfer {
            for &i in &all {
                if let Some((off, std)) = transfer.off(campaign, i, level(i)) {
                    tracing::debug!(
                        "set {}: level {:.1} DN, ln of the variance's ratio {off:+.4}, standard deviation {std:.4}",
                        campaign.sets[i].number,
                        level(i)
                    );
                }
            }
            let strays: Vec<usize> = transfer.strays.iter().chain(&transfer.quiet).copied().collect();
            // Another black level shifts a dark along the curve: then another dark of the same exposure
            // has the same noise.
            let has_twin = |i: usize| {
                let (own, var) = (&campaign.sets[i], |d: usize| campaign.sets[d].variance_dn2().map(|v| v.0));
                own.kind == Kind::Dark
                    && all.iter().filter(|d| **d != i).any(|&d| {
                        let other = &campaign.sets[d];
                        let ratio = var(i).zip(var(d)).map_or(0.0, |(a, b)| a / b);
                        (other.kind, other.exposure_s) == (own.kind, own.exposure_s)
                            && (MAX_AVERAGED_RATIO..MAX_AVERAGED_RATIO.recip()).contains(&ratio)
                    })
            };
            for &i in strays.iter().filter(|i| !has_twin(**i)) {
                let Some((off, std)) = transfer.off(campaign, i, level(i)) else { continue };
                let lit = campaign.sets[i].is_lit();
                // A full well reduces noise, unless another set of as much light has the full noise.
                let full = |d: &usize| {
                    level(*d) < MIN_EQUAL_LEVEL * level(i)
                        || strays.contains(d)
                        || !campaign.sets[*d].is_lit()
                };
                // The wells are not full where brighter sets end at the codes' full scale.
                let is_beyond = |s: &SetView| {
                    s.is_lit() && s.clipped && s.level_dn() - zero.dn > MAX_SPREAD_OF_WELLS * level(i)
                };
                let saturates = lit && all.iter().all(full) && campaign.places(is_beyond).is_empty();
                // The fixed pattern of a dark scales with gain; averaging preserves it.
                let gain = if lit { None } else { pattern_gain(campaign, i) };
                let of_gain = gain.is_some_and(|g| g > 0.0 && (2.0 * g.ln() - off).abs() < (0.5 * off).abs());
                if of_gain && off.abs() > MIN_GAIN_RATIO.ln() && off.abs() > MIN_SIGMAS * std {
                    gained.push((i, off));
                } else if off < MAX_AVERAGED_RATIO.ln() && off < -MIN_SIGMAS * std {
                    if saturates { brightest.push((i, off, std)) } else { averaged.push(i) }
                } else if !lit && off > MIN_GAIN_RATIO.ln() && off > MIN_SIGMAS * std {
                    gained.push((i, off));
                }
            }
            // A full well may remove any fraction; a fraction equal to that of another set points to
            // averaging.
            let is_as_others = |&(_, off, std): &(usize, f64, f64)| {
                averaged.iter().any(|&i| {
                    let other = transfer.off(campaign, i, level(i)).filter(|_| campaign.sets[i].is_lit());
                    other.is_some_and(|(own, own_std)| {
                        (own - off).abs() < SAME_LOSS_SIGMAS * std.hypot(own_std)
                    })
                })
            };
            let same: Vec<usize> = brightest.iter().filter(|b| is_as_others(b)).map(|b| b.0).collect();
            averaged.extend(same);
            // Rounding determines the noise of quiet darks, equally for those at the same fraction of a
            // code.
            let darks = || all.iter().copied().filter(|&i| campaign.sets[i].kind == Kind::Dark);
            let known: Vec<usize> = averaged.iter().copied().chain(gained.iter().map(|g| g.0)).collect();
            for i in darks().filter(|i| !known.contains(i)) {
                let Some((own, _)) = campaign.sets[i].variance_dn2().filter(|v| v.0 > 0.0) else { continue };
                let alike: Vec<f64> = darks()
                    .filter(|&d| d != i && (level(d) - level(i)).abs() < 0.1)
                    .filter_map(|d| campaign.sets[d].variance_dn2().map(|v| v.0))
                    .collect();
                let usual = median(alike.iter().copied());
                let off = (own / usual).ln();
                if alike.len() < 4
                    || usual > 4.0 * transfer::MIN_VARIANCE_DN2
                    || off.abs() < -MAX_AVERAGED_RATIO.ln()
                {
                    continue;
                }
                let of_gain = pattern_gain(campaign, i)
                    .is_some_and(|g| g > 0.0 && (2.0 * g.ln() - off).abs() < 0.6 * off.abs());
                if off > 0.0 || of_gain { gained.push((i, off)) } else { averaged.push(i) }
            }
            // A smooth change of the dark noise with exposure is a property of the sensor.
            let smooth = |i: usize| {
                let var = |d: usize| campaign.sets[d].variance_dn2().map_or(f64::NAN, |v| v.0.ln());
                let is_dark = campaign.sets[i].kind == Kind::Dark;
                is_dark
                    && !filtered.contains(&i)
                    && !campaign.is_off_the_darks(i, var, |_| DARK_VARIANCE_SCATTER)
            };
            averaged.retain(|i| !smooth(*i));
            gained.retain(|g| !smooth(g.0));
            // The noise of long darks is that of their charge: another gain needs another dark that
            // would share it.
            let gains: Vec<usize> = gained.iter().map(|g| g.0).collect();
            let told = |i: usize| {
                let alike = |&d: &usize| {
                    let (own, other) = (&campaign.sets[i], &campaign.sets[d]);
                    other.kind == Kind::Dark && !gains.contains(&d) && other.exposure_s > 0.5 * own.exposure_s
                };
                all.iter().any(alike)
            };
            gained.retain(|g| told(g.0));
        }
        // A deviation shared by all repeats of a setting is a property of the camera.
        let alone = averaged.clone();
        let repeats = |i: usize, d: usize| {
            let (a, b) = (&campaign.sets[i], &campaign.sets[d]);
            d != i && (a.kind, a.exposure_s, a.illumination) == (b.kind, b.exposure_s, b.illumination)
        };
        averaged.retain(|&i| {
            let mut others = all.iter().filter(|d| repeats(i, **d)).peekable();
            filtered.contains(&i) || others.peek().is_none() || others.any(|d| !alone.contains(d))
        });
        averaged.extend(quieter_dark(campaign).filter(|i| !averaged.contains(i)));
        averaged.sort_unstable();
        // Two darks do not show which of them has the flats' gain.
        let darks = campaign.places(|s| s.kind == Kind::Dark);
        let few_darks = darks.len() < MIN_DARKS_FOR_A_GAIN;
        // The shorter dark has less noise anyway; only the flats can show that it has too little.
        let is_shorter =
            |i: usize| darks.iter().any(|&d| campaign.sets[d].exposure_s > campaign.sets[i].exposure_s);
        let of_flats = Transfer::of(campaign, &zero, &darks);
        let flats_have_more = |i: usize| {
            let left = of_flats.as_ref().map(|t| t.expected_dn2(level(i)));
            left.zip(campaign.sets[i].variance_dn2()).is_some_and(|((left_dn2, std_dn2), own)| {
                own.0 < MAX_AVERAGED_RATIO * (left_dn2 - SIGMAS_OF_FLATS * std_dn2)
            })
        };
        // Flats of longer exposures have the noise of a dark charge whose level the camera subtracts,
        // like a dark of their exposure.
        let lit = campaign.places(|s| s.is_lit());
        let exposure_s = |i: usize| campaign.sets[i].exposure_s;
        let shortest_s = lit.iter().map(|&f| exposure_s(f)).fold(f64::INFINITY, f64::min);
        let has_the_flats_noise = |d: usize| {
            let left = of_flats.as_ref().map(|t| t.expected_dn2(level(d)));
            left.zip(campaign.sets[d].variance_dn2()).is_some_and(|((left_dn2, std_dn2), own)| {
                (own.0 - left_dn2).abs()
                    < (SIGMAS_OF_FLATS * std_dn2).max((1.0 - MAX_AVERAGED_RATIO) * left_dn2)
            })
        };
        // Charge has its own pattern; averages keep that of single frames.
        let has_more_pattern = |d: usize, i: usize| {
            let square = |i: usize| {
                let pattern = patterns::pattern_of(&campaign.sets[i]);
                let mean = pattern.iter().map(|v| v * v).sum::<f64>() / pattern.len().max(1) as f64;
                mean - patterns::noise_of_mean(&campaign.sets[i])
            };
            square(d) > MIN_RATIO_OF_PATTERNS * square(i)
        };
        let is_of_less_charge = |i: usize| {
            let has_its_charge = |d: usize| {
                2.0 * exposure_s(d) > shortest_s && has_the_flats_noise(d) && has_more_pattern(d, i)
            };
            2.0 * exposure_s(i) < shortest_s && darks.iter().any(|&d| d != i && has_its_charge(d))
        };
        averaged.retain(|&i| {
            if campaign.sets[i].is_lit() || filtered.contains(&i) {
                return true;
            }
            !is_of_less_charge(i) && (!few_darks || !is_shorter(i) || flats_have_more(i))
        });
        let mut out = Vec::new();
        if !averaged.is_empty() && averaged.len() as f64 <= (MAX_SHARE_OF_SETS * all.len() as f64).max(1.0) {
            let i = averaged[0];
            let ratio = transfer.as_ref().and_then(|t| t.off(campaign, i, level(i))).map(|o| o.0.exp());
            let few = few_darks && averaged.iter().all(|&i| !campaign.sets[i].is_lit());
            let kind = if few { FaultKind::OtherSettings } else { FaultKind::DependentFrames };
            let text = match ratio {
                Some(ratio) if few && ratio < MAX_AVERAGED_RATIO => format!(
                    "{}: darks of another gain or camera, or averaged before they were saved: variance of set {} is {} of what the flats leave for its level",
                    campaign.named(&averaged),
                    campaign.sets[i].number,
                    six_digits((ratio * 1000.0).round() / 1000.0)
                ),
                Some(ratio) if ratio < MAX_AVERAGED_RATIO => format!(
                    "{}: frames were averaged or filtered over time before they were saved: variance of set {} is {} of what its level has elsewhere",
                    campaign.named(&averaged),
                    campaign.sets[i].number,
                    six_digits((ratio * 1000.0).round() / 1000.0)
                ),
                _ => format!(
                    "{}: frames were filtered over time before they were saved: successive frames are alike",
                    campaign.named(&averaged)
                ),
            };
            out.push(campaign.fault_of_sets(kind, &averaged, text, true));
        }
        let by_flats = Transfer::by_pixels(campaign, &zero, &darks);
        let gains: Vec<usize> = gained.iter().map(|g| g.0).collect();
        for (i, off) in gained {
            let others: Vec<usize> =
                darks.iter().copied().filter(|d| !gains.contains(d) && !campaign.sets[*d].out).collect();
            let left = by_flats.as_ref().map(|t| t.expected_dn2(above(campaign, &zero, i)));
            let doubt = noisier(campaign, i, &others, left).filter(|_| off > 0.0 && !few_darks);
            if let Some((is_clear, frames)) = doubt {
                let set = campaign.sets[i].number;
                let ratio = six_digits(((0.5 * off).exp() * 1000.0).round() / 1000.0);
                let fault = if is_clear {
                    let text = format!(
                        "{}: all darks but set {set} were averaged before they were saved, about {frames} frames each: set {set} has {ratio} times their noise, as the flats leave it for its level",
                        campaign.named(&others)
                    );
                    campaign.fault_of_sets(FaultKind::DependentFrames, &others, text, true)
                } else {
                    let text = format!(
                        "set {set} ({}): this dark has {ratio} times the noise of the other darks: it has another gain, or the others were averaged before they were saved, about {frames} frames each; the flats do not tell which, and read noise may be wrong by that factor. Take darks again",
                        campaign.file(i, 0)
                    );
                    campaign.fault_of_sets(FaultKind::DependentFrames, &[i], text, false)
                };
                out.push(fault);
                continue;
            }
            let what = if few_darks { "the darks differ in gain or camera" } else { "another gain" };
            let text = format!(
                "set {} ({}): {what}: the noise of this dark is {} times that of others at its level",
                campaign.sets[i].number,
                campaign.file(i, 0),
                six_digits((0.5 * off).exp())
            );
            out.push(campaign.fault_of_sets(FaultKind::OtherSettings, &[i], text, true));
        }
        out
    }
}
