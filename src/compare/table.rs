//! Observables of a table of means and variances: many labs keep only that.

use super::observe::{Observable, Observations, ObserveError, Statistic};
use crate::dataset::Kind;
use crate::dataset::table::Table;
use crate::noise::{Counts, pixels_from_scatter, table_points};
use crate::statistics::jackknife::Value;
use radcam_sim::predict::{Campaign, FrameInfo, NORMAL, SetInfo};

/// Rows up to the peak of the variance as sets of one pair each.
pub(super) fn observations(table: &Table) -> Result<Observations, ObserveError> {
    let mut points = table_points(table);
    let counts = pixels_from_scatter(&mut points);
    let mut missing = vec![
        "a table of means and variances does not tell brighter-fatter from nonlinearity: flats with their covariances and an \
         exposure sweep would"
            .to_string(),
    ];
    if let Counts::FromScatter(pixels) = counts {
        missing.push(format!(
            "no pixel count: errors are the rows' own scatter, as of {pixels:.0} pixels a row"
        ));
    }
    // Past the variance's peak the well is full: what the rows say there is not noise.
    let mut order: Vec<usize> = (0..table.levels.len()).collect();
    order.sort_by(|&a, &b| table.levels[a].mean_dn.total_cmp(&table.levels[b].mean_dn));
    let peak =
        order.iter().copied().max_by(|&a, &b| table.levels[a].var_dn2.total_cmp(&table.levels[b].var_dn2));
    let peak = peak.map_or(f64::INFINITY, |i| table.levels[i].mean_dn);
    let top = order.last().map_or(0.0, |&i| table.levels[i].mean_dn);
    let turned = top > 1.02 * peak;
    let limit = if turned { 0.97 * peak } else { f64::INFINITY };
    let kept: Vec<usize> = order.iter().copied().filter(|&i| table.levels[i].mean_dn <= limit).collect();
    if turned {
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
    let exposures = kept.iter().all(|&i| table.levels[i].exposure_s.is_some());
    let mut all = Vec::new();
    // Rows of one illumination share their light.
    let mut lights: Vec<u64> = Vec::new();
    let mut light_of = |place: usize, illumination: f64| {
        if !exposures {
            return Some(place);
        }
        let bits = illumination.to_bits();
        let at = lights.iter().position(|l| *l == bits).unwrap_or(lights.len());
        if at == lights.len() {
            lights.push(bits);
        }
        (illumination != 0.0).then_some(at)
    };
    let (mut frames, mut sets) = (Vec::new(), Vec::new());
    for (place, &i) in kept.iter().enumerate() {
        let (level, point) = (&table.levels[i], &points[i]);
        let illumination = level.illumination.unwrap_or(1.0);
        sets.push(SetInfo {
            exposure_s: if exposures { level.exposure_s.unwrap_or(1.0) } else { 1.0 },
            light: light_of(place, illumination),
            illumination,
            spread: 0.0,
            // Not known; pixels rarely lie at one place between two codes.
            spread_dn: 1.0,
            places: NORMAL,
        });
        frames.push(FrameInfo { set: place, time_s: 0.0 });
        let mut add = |kind, value: f64, std_err: f64| {
            all.push(Observable {
                kind,
                set: Some(place),
                half: (place % 2) as u8,
                frames: (place, place + 1),
                measured: Value { value, std_err },
                pixels: point.pixels,
            });
        };
        add(Statistic::Mean, level.mean_dn, 0.0);
        // One pair: as many degrees of freedom as pixels.
        add(Statistic::Variance, level.var_dn2, level.var_dn2 * (2.0 / point.pixels).sqrt());
        for (lag, value) in [((0, 1), level.cov_01), ((1, 0), level.cov_10), ((1, 1), level.cov_11)] {
            if let Some(value) = value {
                let std_err = level.var_dn2 / point.pixels.sqrt();
                add(Statistic::Covariance(lag.0, lag.1), value, std_err);
            }
        }
    }
    let full = top.max(1.0);
    let kinds = sets.iter().map(|s| if s.light.is_some() { Kind::Flat } else { Kind::Dark }).collect();
    Ok(Observations {
        campaign: Campaign {
            frames,
            sets,
            shape: (1000, 1000),
            full_scale_dn: full,
            line_cycles_per_px: None,
        },
        set_numbers: kept.iter().map(|&i| i as u32).collect(),
        kinds,
        all,
        scenes: [None, None],
        codes: [0..0, 0..0],
        means_given: !exposures,
        missing,
        light_rel_std: None,
    })
}
