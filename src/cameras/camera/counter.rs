//! Running numbers of frames.

use std::collections::VecDeque;

/// Maximum lateness of a frame, in frames, and number of frame numbers kept: no stream has so many buffers.
const LATE: u64 = 4096;

/// Extends the 16-bit frame numbers of GigE Vision, which run 1 .. 65535 and restart at 1, to unlimited ones.
#[derive(Debug, Clone, Default)]
pub struct FrameCounter {
    last: Option<u64>,
    /// Numbers of the last frames.
    seen: VecDeque<u64>,
}

impl FrameCounter {
    /// Returns the running number of a frame, and how many were skipped before it; `None` if a frame of this
    /// number came before. `bits16`: the camera wraps at 16 bits.
    pub fn take(&mut self, id: u64, bits16: bool) -> Option<(u64, u64)> {
        const PERIOD: u64 = 65_535; // 0 is never used
        let last = self.last.unwrap_or(id);
        let mut long = id;
        if bits16 && id <= PERIOD && self.last.is_some() {
            long = last - last % PERIOD + id % PERIOD;
            // A large step back is a wrap; a step forward by almost the period is a late frame.
            if long < last && last - long > LATE {
                long += PERIOD;
            } else if long > last && long - last > PERIOD - LATE {
                long = long.saturating_sub(PERIOD);
            }
        }
        if long <= last && self.seen.contains(&long) {
            return None;
        }
        if self.seen.len() >= LATE as usize {
            self.seen.pop_front();
        }
        self.seen.push_back(long);
        self.last = Some(last.max(long));
        Some((long, if long > last { long - last - 1 } else { 0 }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrap_of_the_frame_number_is_no_loss() {
        let mut counter = FrameCounter::default();
        let mut take = |id| counter.take(id, true);
        assert_eq!(take(65_534), Some((65_534, 0)));
        assert_eq!(take(65_535), Some((65_535, 0)));
        assert_eq!(take(1), Some((65_536, 0)));
        assert_eq!(take(4), Some((65_539, 2)));
        // Out of order: neither a loss nor a wrap.
        assert_eq!(take(3), Some((65_538, 0)));
        for lap in 0..200_000u64 {
            let id = (4 + lap) % 65_535 + 1;
            assert_eq!(take(id), Some((65_540 + lap, 0)));
        }
        // A long gap right at the start, and a late frame there.
        let mut gap = FrameCounter::default();
        assert_eq!(gap.take(3, true), Some((3, 0)));
        assert_eq!(gap.take(65_534, true), Some((0, 0)));
        assert_eq!(gap.take(50_003, true), Some((50_003, 49_999)));
        let mut long = FrameCounter::default();
        long.take(65_535, false);
        assert_eq!(long.take(65_540, false), Some((65_540, 4)));
    }

    #[test]
    fn a_number_comes_once() {
        let mut counter = FrameCounter::default();
        assert_eq!(counter.take(7, true), Some((7, 0)));
        assert_eq!(counter.take(7, true), None);
        assert_eq!(counter.take(9, true), Some((9, 1)));
        assert_eq!((counter.take(7, true), counter.take(9, true)), (None, None));
        assert_eq!(counter.take(8, true), Some((8, 0)));
        assert_eq!(counter.take(8, true), None);
        // One wrap later the same 16-bit numbers belong to other frames.
        for id in 10..=65_535 {
            assert_eq!(counter.take(id, true), Some((id, 0)));
        }
        for id in 1..=9 {
            assert_eq!(counter.take(id, true), Some((65_535 + id, 0)));
        }
        assert_eq!(counter.take(9, true), None);
        let mut long = FrameCounter::default();
        assert_eq!((long.take(5, false), long.take(5, false)), (Some((5, 0)), None));
    }
}
