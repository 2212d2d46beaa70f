//! Frames with parts of an earlier frame: a packet was lost and its place in the buffer not cleared.

use super::facts::digest;
use super::{Campaign, Check, DataFault, FaultKind};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Number of pixels per segment: shorter than the payload of a GigE Vision packet of 1500 bytes. Noise
/// that leaves 70 % of the pixels unchanged repeats all of them with probability 10^-40.
const SEGMENT: usize = 256;
/// Number of earlier frames of the set that are compared: drivers rotate that many buffers (a named
/// choice).
const BUFFERS: usize = 16;
/// Minimum fraction of pixels that differ from frame to frame around a segment with usable noise.
const MIN_CHANGED: f64 = 0.3;
/// Number of surrounding segments on either side.
const AROUND: usize = 8;
/// Maximum fraction of the samples of a segment at code 0 or full scale with usable noise.
const MAX_AT_ENDS: f64 = 0.1;
/// Maximum fraction of frames in which the same segment is old data: more show something burnt into the
/// image.
const MAX_SHARE_OF_FRAMES: f64 = 0.05;

/// Old data in a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct OldData {
    /// Index of the frame in its set.
    pub frame: usize,
    /// Index of the frame that the data come from.
    pub of: usize,
    /// First pixel, row by row, and number of pixels.
    pub pixels: (usize, usize),
}

/// Incremental search for old data in the frames of a set.
#[derive(Debug, Default)]
pub(super) struct Search {
    frames: usize,
    /// Segment digests of earlier frames, the newest first; `None` for a segment without usable noise.
    before: VecDeque<Vec<Option<u64>>>,
    /// Maximum number of pixels of each segment that changed between frames.
    most_changed: Vec<u16>,
    /// Segments that repeat those of an earlier frame: (segment, frame, earlier frame).
    repeated: Vec<(usize, usize, usize)>,
}

impl Search {
    /// Adds the next frame, with the previous one.
    pub fn add(&mut self, codes: &[u16], before: Option<&[u16]>, full: u16) {
        let tells = |segment: &[u16]| {
            let ends = segment.iter().filter(|c| **c == 0 || **c >= full).count();
            segment.len() == SEGMENT && (ends as f64) < MAX_AT_ENDS * SEGMENT as f64
        };
        let of = |segment: &[u16]| tells(segment).then(|| digest(segment));
        let own: Vec<Option<u64>> = codes.chunks(SEGMENT).map(of).collect();
        self.most_changed.resize(own.len(), 0);
        if let Some(before) = before {
            let pairs = codes.chunks(SEGMENT).zip(before.chunks(SEGMENT));
            for (most, (a, b)) in self.most_changed.iter_mut().zip(pairs) {
                *most = (*most).max(a.iter().zip(b).map(|(a, b)| u16::from(a != b)).sum());
            }
        }
        for (back, other) in self.before.iter().enumerate() {
            let same =
                |(s, (a, b)): (usize, (&Option<u64>, &Option<u64>))| (a.is_some() && a == b).then_some(s);
            let same: Vec<usize> = own.iter().zip(other).enumerate().filter_map(same).collect();
            // A copy of the whole frame is left to another check.
            if same.len() < own.iter().flatten().count() {
                self.repeated.extend(same.into_iter().map(|s| (s, self.frames, self.frames - 1 - back)));
            }
        }
        self.before.push_front(own);
        self.before.truncate(BUFFERS);
        self.frames += 1;
    }

    /// Returns the old data, frame by frame.
    pub fn finish(mut self) -> Vec<OldData> {
        let around = |s: usize| {
            let near = s.saturating_sub(AROUND)..(s + AROUND + 1).min(self.most_changed.len());
            self.most_changed[near].iter().copied().max().unwrap_or(0)
        };
        let most = (MAX_SHARE_OF_FRAMES * self.frames as f64).max(1.0) as usize;
        let mut times = vec![0; self.most_changed.len()];
        self.repeated.iter().for_each(|r| times[r.0] += 1);
        self.repeated
            .retain(|r| times[r.0] <= most && f64::from(around(r.0)) >= MIN_CHANGED * SEGMENT as f64);
        self.repeated.sort_unstable_by_key(|r| (r.1, r.2, r.0));
        let mut out: Vec<OldData> = Vec::new();
        for (segment, frame, of) in self.repeated {
            let first = segment * SEGMENT;
            match out.last_mut() {
                Some(last) if (last.frame, last.of) == (frame, of) => {
                    last.pixels.1 = first + SEGMENT - last.pixels.0;
                }
                _ => out.push(OldData { frame, of, pixels: (first, SEGMENT) }),
            }
        }
        out
    }
}

/// Check for old data in frames.
pub struct OldDataInFrames;

impl Check for OldDataInFrames {
    fn find(&self, campaign: &mut Campaign<'_>) -> Vec<DataFault> {
        let mut found: Vec<(usize, OldData)> = Vec::new();
        for set in campaign.places(|_| true) {
            let view = &campaign.sets[set];
            found.extend(view.facts.old_data.iter().filter(|o| view.kept[o.frame]).map(|o| (set, *o)));
        }
        // Data that repeat at one position in many sets are not lost packets, but for example lines of
        // sensor registers.
        let frames = campaign.places(|_| true).iter().map(|&s| campaign.sets[s].frames()).sum::<usize>();
        let most = (MAX_SHARE_OF_FRAMES * frames as f64).max(1.0) as usize;
        let places: Vec<usize> = found.iter().map(|(_, o)| o.pixels.0).collect();
        found.retain(|(_, o)| places.iter().filter(|first| **first == o.pixels.0).count() <= most);
        let Some((set, first)) = found.first().copied() else { return Vec::new() };
        let mut frames: Vec<(usize, usize)> = found.iter().map(|(set, o)| (*set, o.frame)).collect();
        frames.dedup();
        let mut sets: Vec<usize> = frames.iter().map(|f| f.0).collect();
        sets.dedup();
        let columns = campaign.columns();
        let (from, to) = (first.pixels.0 / columns, (first.pixels.0 + first.pixels.1 - 1) / columns);
        let text = format!(
            "{}: {} from row {from} to row {to} holds the data of {}, code for code{}: a packet was lost and its place \
             in the buffer not cleared; count lost packets when you capture",
            campaign.named(&sets),
            campaign.file(set, first.frame),
            campaign.file(set, first.of),
            match frames.len() {
                1 => String::new(),
                n => format!(", and {} more frames are so", n - 1),
            },
        );
        vec![campaign.fault_of_frames(FaultKind::CopiedFrames, &frames, text)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use radcam_sim::rng::{PixelRng, Stream};

    /// Returns noise of this standard deviation on 40 rows of 100 pixels.
    fn frame(k: u64, sigma: f64) -> Vec<u16> {
        let code = |i: u32| 500.4 + sigma * PixelRng::new(7, Stream::Effect, k, i, 0).normal();
        (0..4000).map(|i| code(i).round() as u16).collect()
    }

    fn search(frames: &[Vec<u16>]) -> Vec<OldData> {
        let mut search = Search::default();
        for (i, f) in frames.iter().enumerate() {
            search.add(f, i.checked_sub(1).map(|b| &*frames[b]), 4095);
        }
        search.finish()
    }

    /// A part of the previous frame, or of the fifth before, is found with its position. Noise is not,
    /// nor is an image that is burnt in, at full scale, or without changes.
    #[test]
    fn old_data_are_found_and_noise_is_not() {
        for sigma in [0.5, 3.0] {
            let mut frames: Vec<Vec<u16>> = (0..12).map(|k| frame(k, sigma)).collect();
            assert_eq!(search(&frames), [], "{sigma}");
            let old = frames[2][1000..2000].to_vec();
            frames[7][1000..2000].copy_from_slice(&old);
            let found = search(&frames);
            assert_eq!(found, [OldData { frame: 7, of: 2, pixels: (1024, 768) }], "{sigma}");
        }
        let mut frames: Vec<Vec<u16>> = (0..12).map(|k| frame(k, 3.0)).collect();
        let logo = frames[0][..600].to_vec();
        for f in &mut frames {
            f[..600].copy_from_slice(&logo);
            f[3000..].fill(4095);
        }
        assert_eq!(search(&frames), []);
        assert_eq!(search(&(0..12).map(|k| frame(k, 0.05)).collect::<Vec<_>>()), []);
    }
}
