//! Running numbers of frames.

/// Takes the 16-bit frame numbers of GigE Vision, which run 1 .. 65535 and begin again, for ever longer ones.
#[derive(Debug, Clone, Copy, Default)]
pub struct FrameCounter {
    last: Option<u64>,
}

impl FrameCounter {
    /// The running number of a frame, and how many were skipped before it. `bits16` tells a camera that wraps.
    pub fn take(&mut self, id: u64, bits16: bool) -> (u64, u64) {
        let Some(last) = self.last else {
            self.last = Some(id);
            return (id, 0);
        };
        const PERIOD: u64 = 65_535; // 0 is never used
        const LATE: u64 = 4096; // no stream has so many buffers
        let id = if bits16 && id <= PERIOD {
            let mut long = last - last % PERIOD + id % PERIOD;
            if long <= last {
                long += PERIOD;
            }
            // A step of almost the period is a frame that came late.
            if long - last > PERIOD - LATE { long.saturating_sub(PERIOD) } else { long }
        } else {
            id
        };
        if id <= last {
            return (id, 0);
        }
        self.last = Some(id);
        (id, id - last - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrap_of_the_frame_number_is_no_loss() {
        let mut counter = FrameCounter::default();
        assert_eq!(counter.take(65_534, true), (65_534, 0));
        assert_eq!(counter.take(65_535, true), (65_535, 0));
        assert_eq!(counter.take(1, true), (65_536, 0));
        assert_eq!(counter.take(4, true), (65_539, 2));
        // Out of order: neither loss nor a lap.
        assert_eq!(counter.take(3, true), (65_538, 0));
        for lap in 0..200_000u64 {
            let id = (4 + lap) % 65_535 + 1;
            assert_eq!(counter.take(id, true), (65_540 + lap, 0));
        }
        // A long gap right at the start, and a late frame there.
        let mut gap = FrameCounter::default();
        assert_eq!(gap.take(3, true), (3, 0));
        assert_eq!(gap.take(65_534, true), (0, 0));
        assert_eq!(gap.take(50_003, true), (50_003, 49_999));
        let mut long = FrameCounter::default();
        long.take(65_535, false);
        assert_eq!(long.take(65_540, false), (65_540, 4));
    }
}
