//! Observables that take part in a fit, and their expectations under a model.

use super::free::{Free, Point};
use super::model::listed;
use crate::observables::{Expected, Half, Observable, Observations, expectations_beside, mean};
use radcam_sim::effects::{self, Chain};
use radcam_sim::predict::Prediction;
use std::collections::BTreeMap;

/// Expectations at a point.
pub struct State {
    /// One for each observable that takes part.
    pub expected: Vec<Expected>,
    /// Variance of the mean by the setting of its light, DN^2, for each of [`Layout::blocks`].
    pub(super) setting: Vec<f64>,
}

impl State {
    /// Returns true if the scatter of settings is far larger than at `from`: score tests hold for small moves
    /// only.
    pub fn setting_widens(&self, from: &Self) -> bool {
        self.setting.iter().zip(&from.setting).any(|(a, b)| *a > 4.0 * b)
    }
}

/// Observables that take part, grouped by the set whose light they see.
pub struct Layout<'a> {
    /// The campaign.
    pub all: &'a Observations,
    /// Observables that take part.
    pub rows: Vec<&'a Observable>,
    /// Indexes of the rows in [`Observations::list`].
    pub(super) places: Vec<usize>,
    halves: Vec<Half>,
    /// True if statistics that only judge take part.
    judges: bool,
    /// Index of each light setting, and the rows that see its light.
    pub(super) blocks: Vec<(usize, Vec<usize>)>,
    /// Index of the setting of every set's light.
    settings: Vec<usize>,
    /// Rows of the same frames.
    pub(super) chunks: Vec<Vec<usize>>,
}

fn takes_part(o: &Observable, halves: &[Half], judges: bool) -> bool {
    halves.contains(&o.half) && (judges || !o.statistic.only_judges())
}

impl<'a> Layout<'a> {
    /// Lays out a fit to these halves, under a model with these effects.
    pub fn new<'e>(
        all: &'a Observations,
        halves: &[Half],
        effects: impl Iterator<Item = &'e &'static dyn effects::Effect>,
    ) -> Self {
        Self::of(all, halves, effects, false)
    }

    /// Lays out a judgement by this half, with the statistics that no fit follows.
    pub fn to_judge<'e>(
        all: &'a Observations,
        half: Half,
        effects: impl Iterator<Item = &'e &'static dyn effects::Effect>,
    ) -> Self {
        Self::of(all, &[half], effects, true)
    }

    fn of<'e>(
        all: &'a Observations,
        halves: &[Half],
        mut effects: impl Iterator<Item = &'e &'static dyn effects::Effect>,
        judges: bool,
    ) -> Self {
        let settings = if effects.any(|e| e.sets_each()) {
            (0..all.campaign.sets.len()).collect()
        } else {
            all.light_settings.clone()
        };
        let (places, rows): (Vec<usize>, Vec<&Observable>) =
            all.list.iter().enumerate().filter(|(_, o)| takes_part(o, halves, judges)).unzip();
        let mut blocks: Vec<(usize, Vec<usize>)> = Vec::new();
        let mut place: Vec<Option<usize>> = vec![None; all.campaign.sets.len()];
        for (i, o) in rows.iter().enumerate() {
            let Some(set) =
                o.set.filter(|s| o.statistic.sees_light() && all.campaign.sets[*s].light.is_some())
            else {
                continue;
            };
            let setting = settings[set];
            let at = *place[setting].get_or_insert_with(|| {
                blocks.push((setting, Vec::new()));
                blocks.len() - 1
            });
            // The mean first: it is what the light of a set moves.
            if o.is(&mean::Mean) { blocks[at].1.insert(0, i) } else { blocks[at].1.push(i) }
        }
        let mut chunks: BTreeMap<_, Vec<usize>> = BTreeMap::new();
        for (i, o) in rows.iter().enumerate() {
            chunks.entry((o.set, o.frames)).or_default().push(i);
        }
        let chunks = chunks.into_values().collect();
        Self { all, rows, places, halves: halves.to_vec(), judges, blocks, chunks, settings }
    }

    /// Returns the index of the setting of a set's light; sets that follow one another under the same light
    /// share it.
    pub fn setting_of(&self, set: usize) -> usize {
        self.settings[set]
    }

    /// Computes the expectations of the rows from a prediction.
    pub fn state(&self, prediction: &Prediction) -> State {
        self.state_beside(prediction, None)
    }

    /// Computes the expectations of the rows, given another prediction and its state.
    pub fn state_beside(&self, prediction: &Prediction, known: Option<(&Prediction, &State)>) -> State {
        let known = known.map(|(p, state)| (p, state.expected.as_slice()));
        let wanted = |o: &Observable| takes_part(o, &self.halves, self.judges);
        let expected = expectations_beside(self.all, prediction, wanted, known);
        let of_first =
            |rows: &[usize]| self.rows[rows[0]].set.map_or(0.0, |set| prediction.sets[set].setting);
        let setting = self.blocks.iter().map(|(_, rows)| of_first(rows)).collect();
        State { expected, setting }
    }

    /// Computes the expectations at `point`, given those at `from` (`known`) and its chain. The scatter of
    /// settings moves no expectation: if it alone differs, no prediction is needed.
    pub fn at_from(
        &self,
        free: &Free,
        point: &Point,
        known: &State,
        from: &Point,
        chain: Option<&Chain<'_>>,
    ) -> State {
        if let Some(factor) = free.scales_settings(from, point) {
            let setting = known.setting.iter().map(|s| s * factor * factor).collect();
            return State { expected: known.expected.clone(), setting };
        }
        let Some(chain) = chain else { return self.at(free, point) };
        let (base, effects) = free.unpack(point);
        let prediction = chain.predict(&base, &listed(&effects));
        self.state_beside(&prediction, Some((chain.prediction(), known)))
    }

    /// Computes the expectations of the model at a point.
    pub fn at(&self, free: &Free, point: &Point) -> State {
        let (base, effects) = free.unpack(point);
        let list = listed(&effects);
        self.state(&effects::predict(&self.all.campaign, &base, &list))
    }
}
