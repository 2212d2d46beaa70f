//! Observables of a table of means and variances: many labs keep only that.

use super::Identity;
use super::campaign::dark_spreads;
use super::{
    Field, Half, Observable, Observations, ObserveError, Ripples, Statistic, covariance, mean, monitor,
    variance,
};
use crate::dataset::Kind;
use crate::dataset::table::{Level, Table};
use crate::noise::{Counts, black_level_in_words, black_level_of, pixels_from_scatter, table_points};
use crate::number::ranges;
use crate::statistics::covariance::LAGS;
use crate::statistics::jackknife::Value;
use crate::statistics::peak::{strays, turn_off};
use radcam_sim::predict::{Before, Campaign, FrameInfo, NORMAL, SetInfo};

/// Converts the rows up to the peak of the variance to sets of one pair each.
///
/// # Errors
///
/// The table has too few levels.
pub fn observations(table: &Table) -> Result<Observations, ObserveError> {
    // Levels are relative to the black level.
    let black_dn = black_level_of(table);
    let mut table = table.clone();
    if let Some(black_dn) = &black_dn {
        table.levels.iter_mut().for_each(|l| l.mean_dn -= black_dn.value);
    }
    let table = &table;
    let mut points = table_points(table);
    let counts = pixels_from_scatter(&mut points);
    let mut missing = vec![
        "a table of means and variances does not tell brighter-fatter from nonlinearity: flats with their covariances and an \
         exposure sweep would"
            .to_string(),
    ];
    missing.extend(black_dn.as_ref().map(black_level_in_words));
    if let Counts::FromScatter(pixels) = counts {
        missing.push(format!(
            "no pixel count: errors are the rows' own scatter, as of {pixels:.0} pixels a row"
        ));
    }
    let copies: Vec<usize> = table.copies().into_iter().map(|(i, _)| i).collect();
    if !copies.is_empty() {
        let (rows, are) = if copies.len() == 1 {
            ("row", "is a copy of another")
        } else {
            ("rows", "are copies of others")
        };
        let numbers: Vec<usize> = copies.iter().map(|i| i + 1).collect();
        missing.push(format!("{rows} {} {are}, and left out", ranges(&numbers)));
    }
    let strays = strays(&table.levels.iter().map(|l| (l.mean_dn, l.var_dn2)).collect::<Vec<_>>());
    for &i in &strays {
        let l = &table.levels[i];
        missing.push(format!(
            "row {} (mean {:.0} DN) has a variance of {:.0} DN^2, far above the rows around, and is left out",
            i + 1,
            l.mean_dn,
            l.var_dn2
        ));
    }
    // Above the peak of the variance the well is full, and the variance of the rows is not noise.
    let mut used = vec![true; table.levels.len()];
    strays.iter().chain(&copies).for_each(|&i| used[i] = false);
    let mut order: Vec<usize> = (0..used.len()).filter(|i| used[*i]).collect();
    order.sort_by(|&a, &b| table.levels[a].mean_dn.total_cmp(&table.levels[b].mean_dn));
    let levels: Vec<(f64, f64)> =
        order.iter().map(|&i| (table.levels[i].mean_dn, table.levels[i].var_dn2)).collect();
    let top = order.last().map_or(0.0, |&i| table.levels[i].mean_dn);
    let turned = turn_off(&levels);
    let limit = turned.map_or(f64::INFINITY, |t| t.0);
    let kept: Vec<usize> = order.iter().copied().filter(|&i| table.levels[i].mean_dn <= limit).collect();
    if let Some((limit, peak)) = turned {
        missing.push(format!(
            "{} rows above {limit:.0} DN, at the turn-off of the variance ({peak:.0} DN), are full well and not looked at",
            order.len() - kept.len()
        ));
    }
    if kept.len() < 4 {
        return Err(ObserveError::Nothing(format!(
            "{} rows below the turn-off: a comparison needs four or more",
            kept.len()
        )));
    }
    let stated = kept.iter().all(|&i| table.levels[i].exposure_s.is_some());
    // Levels that differ at one exposure differ in light, which is not stated.
    let first = &table.levels[kept[0]];
    let nothing_else = |l: &Level| {
        l.exposure_s == first.exposure_s
            && l.illumination.is_none()
            && l.lamp.is_none()
            && l.monitor.is_none()
    };
    let exposures = stated && !kept.iter().all(|&i| nothing_else(&table.levels[i]));
    if stated && !exposures {
        missing.push(
            "one exposure in all rows and no illumination: the means stand for the light, and tell nothing of linearity".into(),
        );
    }
    let mut list = Vec::new();
    // Rows of one lamp share its strength; rows of one illumination share its setting.
    let mut lights: Vec<(Option<u32>, u64)> = Vec::new();
    let mut light_of = |place: usize, lamp: Option<u32>, illumination: f64| {
        if !exposures {
            return Some(place);
        }
        let key = (lamp, illumination.to_bits());
        let at = lights.iter().position(|l| *l == key).unwrap_or(lights.len());
        if at == lights.len() {
            lights.push(key);
        }
        (illumination != 0.0).then_some(at)
    };
    let (mut frames, mut sets) = (Vec::new(), Vec::new());
    for (place, &i) in kept.iter().enumerate() {
        let (level, point) = (&table.levels[i], &points[i]);
        let illumination = level.illumination.unwrap_or(1.0);
        sets.push(SetInfo {
            exposure_s: if exposures { level.exposure_s.unwrap_or(1.0) } else { 1.0 },
            light: light_of(place, level.lamp, illumination),
            illumination,
            light_ratio: 1.0,
            spread: 0.0,
            // Unknown; pixels rarely lie at one place between two codes.
            spread_dn: 1.0,
            places: NORMAL,
        });
        frames.push(FrameInfo { set: place, time_s: 0.0, before: Before::Frame });
        let turn = Half::TURNS[place % 2];
        let mut add =
            |statistic: &'static dyn Statistic, index: usize, half: Half, value: f64, std_err: f64| {
                list.push(Observable {
                    statistic,
                    index,
                    set: Some(place),
                    half,
                    frames: (place, place + 1),
                    measured: Value { value, std_err },
                    pixels: point.pixels,
                    frame_means: (0.0, 0.0),
                });
            };
        // Without exposures the mean defines the light, so both halves know it.
        add(&mean::Mean, 0, if exposures { turn } else { Half::Both }, level.mean_dn, 0.0);
        if let Some(reading) = level.monitor.filter(|m| *m > 0.0 && exposures) {
            add(&monitor::Monitor, 0, turn, reading.ln(), 0.0);
        }
        // One pair: as many degrees of freedom as pixels.
        add(&variance::Variance, 0, turn, level.var_dn2, level.var_dn2 * (2.0 / point.pixels).sqrt());
        for (lag, value) in [((0, 1), level.cov_01), ((1, 0), level.cov_10), ((1, 1), level.cov_11)] {
            let index = LAGS.iter().position(|l| *l == lag);
            if let (Some(value), Some(index)) = (value, index) {
                add(&covariance::Covariance, index, turn, value, level.var_dn2 / point.pixels.sqrt());
            }
        }
    }
    let full = top.max(1.0);
    let kinds: Vec<Kind> =
        sets.iter().map(|s: &SetInfo| if s.light.is_some() { Kind::Flat } else { Kind::Dark }).collect();
    Ok(Observations {
        identity: Identity::default(),
        largest_spread: 0.0,
        dark_spread_dn2: dark_spreads(&sets, &kinds),
        steady_dn4: None,
        together_dn4: None,
        pixel_noise: None,
        darkest_dn: None,
        no_black_level: false,
        campaign: Campaign {
            frames,
            sets,
            shape: (1000, 1000),
            full_scale_dn: full,
            from_code_0: false,
            frame_s: 0.0,
            line_cycles_per_px: None,
            ordinary: None,
        },
        set_numbers: kept.iter().map(|&i| i as u32).collect(),
        frame_means_dn: Vec::new(),
        kinds,
        list,
        scenes: [None, None],
        codes: Default::default(),
        after_scene: vec![false; kept.len()],
        is_table: true,
        means_given: !exposures,
        missing,
        data_faults: Vec::new(),
        flats_left_out: false,
        exposure_steps: Default::default(),
        left_on: Vec::new(),
        light_rel_std: None,
        setting: None,
        light_settings: (0..kept.len()).collect(),
        alike: vec![1.0; kept.len()],
        field: Field::default(),
        before_sets: Before::Frame,
        successive: None,
        peaks: [None, None],
        lines: (0, 0),
        row_cycles: Vec::new(),
        ripples: Ripples::default(),
        flickers: Ripples::default(),
        column_cycles: Vec::new(),
        stretch: None,
    })
}
