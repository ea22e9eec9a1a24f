//! Progress on a terminal: phase, share done, time left, rays a second. Silent in a pipe and with `--quiet`.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Steps of the bar: fractions are shown to a thousandth.
const STEPS: u64 = 1000;

/// The line on stderr that says how far a command is.
pub struct Progress {
    bar: ProgressBar,
    visible: bool,
    phase_began: Instant,
}

impl Progress {
    /// Shown only if stderr is a terminal and `quiet` is not set.
    pub fn new(quiet: bool) -> Self {
        let visible = !quiet && std::io::stderr().is_terminal();
        let bar = if visible {
            ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr_with_hz(8))
        } else {
            ProgressBar::hidden()
        };
        Self {
            bar,
            visible,
            phase_began: Instant::now(),
        }
    }

    /// Begins a phase whose length is not known.
    pub fn phase(&mut self, name: &'static str) {
        self.phase_began = Instant::now();
        if self.visible {
            self.bar
                .set_style(style("{spinner} {prefix:<8} {elapsed_precise}  {msg}"));
            self.bar.set_prefix(name);
            self.bar.set_message("");
            self.bar.reset_elapsed();
            self.bar.enable_steady_tick(Duration::from_millis(125));
        }
    }

    /// Tells the share done of the present phase, in [0, 1], and how many rays have been traced in it.
    pub fn update(&self, fraction: f64, rays: u64) {
        if !self.visible {
            return;
        }
        let fraction = fraction.clamp(0.0, 1.0);
        let seconds = self.phase_began.elapsed().as_secs_f64();
        self.bar
            .set_style(style("{spinner} {prefix:<8} {bar:30} {msg}"));
        self.bar.set_position((fraction * STEPS as f64) as u64);
        self.bar.set_message(describe(fraction, rays, seconds));
    }

    /// Prints a line above the bar, on a terminal only.
    pub fn note(&self, text: &str) {
        if self.visible {
            self.bar.suspend(|| eprintln!("{text}"));
        }
    }

    /// Removes the bar.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }
}

fn style(template: &str) -> ProgressStyle {
    ProgressStyle::with_template(template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ")
}

/// `42.0 %  left 12 seconds  8.31 Mrays/s`
fn describe(fraction: f64, rays: u64, seconds: f64) -> String {
    let mut text = format!("{:5.1} %", 100.0 * fraction);
    if fraction > 0.01 && seconds > 0.5 && fraction < 1.0 {
        let left = seconds * (1.0 - fraction) / fraction;
        text += &format!(
            "  {} left",
            HumanDuration(Duration::from_secs_f64(left.min(1e9)))
        );
    }
    if rays > 0 && seconds > 0.05 {
        text += &format!("  {:.2} Mrays/s", rays as f64 / seconds / 1e6);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::describe;

    #[test]
    fn tells_share_time_left_and_rate() {
        assert_eq!(
            describe(0.25, 20_000_000, 10.0),
            " 25.0 %  30 seconds left  2.00 Mrays/s"
        );
        assert_eq!(describe(0.0, 0, 0.0), "  0.0 %");
        assert_eq!(describe(1.0, 0, 3.0), "100.0 %");
    }
}
