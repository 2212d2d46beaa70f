//! Progress on standard error: a bar on a terminal, plain lines elsewhere.

use crate::capture::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Interval between plain lines.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// Progress display of long work.
pub struct Show {
    what: &'static str,
    bar: Option<ProgressBar>,
    begun: Instant,
    first: Option<u64>,
    last_line: Instant,
}

impl Show {
    pub fn new(what: &'static str) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            let style = "{prefix:>10} [{bar:32}] {pos}/{len} {msg}, {eta} left";
            bar.set_style(ProgressStyle::with_template(style).unwrap_or(ProgressStyle::default_bar()));
            bar.set_prefix(what);
            bar
        });
        let now = Instant::now();
        Self { what, bar, begun: now, first: None, last_line: now }
    }

    /// Shows steps without a data rate.
    pub fn step(&mut self, done: usize, of: usize) {
        self.update(done as u64, of as u64, "");
    }

    /// Shows frames with their data rate.
    pub fn frames(&mut self, p: Progress) {
        let first = *self.first.get_or_insert(p.frames.saturating_sub(1));
        let seconds = self.begun.elapsed().as_secs_f64().max(1e-3);
        let rate = (p.frames - first) as f64 * p.frame_bytes as f64 / seconds / 1e6;
        self.update(p.frames, p.of, &format!("frames, set {}/{}, {rate:.0} MB/s", p.set + 1, p.sets));
    }

    fn update(&mut self, done: u64, of: u64, what: &str) {
        if let Some(bar) = &self.bar {
            bar.set_length(of);
            bar.set_message(what.to_string());
            bar.set_position(done);
        } else if self.last_line.elapsed() >= LINE_EVERY {
            self.last_line = Instant::now();
            let left = self.begun.elapsed().as_secs_f64() / done.max(1) as f64 * (of - done.min(of)) as f64;
            eprintln!("{}: {done}/{of} {what}, {left:.0} s left", self.what);
        }
    }
}

impl Drop for Show {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
