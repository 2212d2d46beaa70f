//! Share of the samples of darks at the lowest codes that occur: whether something is cut off there.

use super::{ChunkView, Expected, Observable, Put, Statistic, View};
use radcam_sim::predict::{NORMAL, PLACES};
use radcam_sim::quantize::share_below;

/// The share; the index is the code up to which samples are counted.
#[derive(Debug)]
pub struct This;

/// The lowest code is the first up to which so many samples lie: a dead pixel is none.
const LEAST: f64 = 1e-3;

impl Statistic for This {
    fn id(&self) -> &'static str {
        "share of the lowest code"
    }

    fn meaning(&self, _: usize) -> &'static str {
        "cut off at the lowest code"
    }

    fn of_chunk(&self, chunk: &ChunkView<'_>, put: &mut Put<'_>) {
        if !chunk.is_dark() {
            return;
        }
        let counts = &chunk.said().occupancy.0;
        let all = counts.iter().sum::<u64>() as f64;
        let sums = counts.iter().scan(0u64, |sum, n| {
            *sum += n;
            Some(*sum as f64 / all)
        });
        if let Some((code, share)) = sums.enumerate().find(|(_, share)| *share >= LEAST) {
            put.put(code, share, (share / all).sqrt());
        }
    }

    fn expect(&self, o: &Observable, view: &View<'_>) -> Expected {
        let (Some(s), Some(set)) = (view.set(), view.at) else { return Expected::plain(o, 0.0, 1.0) };
        let info = &view.all.campaign.sets[set];
        let places = if info.places.iter().all(|x| *x == 0.0) { &NORMAL } else { &info.places };
        let level = view.mean + view.prediction.base.offset_dn;
        let edge = o.index as f64 + 0.5;
        // The tail of the noise; where something is cut off, that instead.
        let tail = share_below(edge, level, info.spread_dn, places, view.noise);
        let value = if s.cut_off > 0.01 { s.cut_off } else { tail };
        // Tails of few codes, of places known as so many shares, and a limit anywhere within a code.
        let density = (-0.5 * (edge - level).powi(2) / view.noise.max(0.1)).exp() / view.noise.max(0.1).sqrt();
        let unsure = 0.3 * density + 0.1 * value + 0.005;
        debug_assert_eq!(PLACES.len(), places.len());
        Expected::plain(o, value, o.measured.std_err.hypot(unsure))
    }
}
