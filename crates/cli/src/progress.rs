//! Progress on a terminal: phase, share done, time left, rays a second. Silent in a pipe and with `--quiet`.

use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};
use occlude_render::job::{self, Job};
use std::io::IsTerminal;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Steps of the bar.
const STEPS: u64 = 1000;

/// How often the line is drawn anew.
const PERIOD: Duration = Duration::from_millis(125);

/// The line on stderr that says how far a job is. It watches the job from a thread of its own: work never waits for it.
pub struct Progress {
    bar: ProgressBar,
    visible: bool,
    finished: Arc<AtomicBool>,
    limit_ms: Arc<AtomicU64>,
}

impl Progress {
    /// Shown only if stderr is a terminal and `quiet` is not set.
    pub fn new(job: &Job, quiet: bool) -> Self {
        let visible = !quiet && std::io::stderr().is_terminal();
        let finished = Arc::new(AtomicBool::new(false));
        let limit_ms = Arc::new(AtomicU64::new(0));
        if !visible {
            return Self {
                bar: ProgressBar::hidden(),
                visible,
                finished,
                limit_ms,
            };
        }
        let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
        let (line, job, end, limit) = (
            bar.clone(),
            job.clone(),
            Arc::clone(&finished),
            Arc::clone(&limit_ms),
        );
        // Detached: it ends with the program or soon after `finish`.
        std::thread::spawn(move || watch(&line, &job, &end, &limit));
        Self {
            bar,
            visible,
            finished,
            limit_ms,
        }
    }

    /// Tells that rendering ends after this time at the latest.
    pub fn expect(&self, limit: Option<Duration>) {
        let milliseconds = limit.map_or(0, |limit| {
            u64::try_from(limit.as_millis()).unwrap_or(u64::MAX)
        });
        self.limit_ms.store(milliseconds, Ordering::SeqCst);
    }

    /// Prints without disturbing the line.
    pub fn suspend(&self, print: impl FnOnce()) {
        if self.visible {
            self.bar.suspend(print)
        } else {
            print()
        }
    }

    /// Tells people at a terminal something that is not worth a line elsewhere.
    pub fn note(&self, text: &str) {
        if self.visible {
            self.bar.suspend(|| eprintln!("{text}"));
        }
    }

    /// Removes the line for good.
    pub fn finish(&self) {
        self.finished.store(true, Ordering::SeqCst);
        self.bar.finish_and_clear();
    }
}

fn watch(bar: &ProgressBar, job: &Job, finished: &AtomicBool, limit_ms: &AtomicU64) {
    let mut start = job.progress();
    let mut began = Instant::now();
    loop {
        std::thread::sleep(PERIOD);
        let mut now = job.progress();
        if now.phase != start.phase || now.done < start.done {
            (start, began) = (now, Instant::now());
        }
        let mut shown_start = start;
        let limit = limit_ms.load(Ordering::SeqCst);
        let elapsed = u64::try_from(began.elapsed().as_millis()).unwrap_or(u64::MAX);
        // Whichever comes first: all samples, or the end of the time.
        if now.total > 0
            && limit > 0
            && u128::from(elapsed) * u128::from(now.total)
                > u128::from(now.done) * u128::from(limit)
        {
            (now.done, now.total) = (elapsed, limit);
            shown_start.done = 0;
        }
        // After `finish` nothing may be drawn.
        if finished.load(Ordering::SeqCst) {
            return;
        }
        let template = if now.total > 0 {
            "{spinner} {prefix:<8} {bar:30} {msg}"
        } else {
            "{spinner} {prefix:<8} {msg}"
        };
        let style =
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style.progress_chars("=> "));
        bar.set_prefix(now.phase);
        bar.set_position(STEPS * now.done.min(now.total) / now.total.max(1));
        bar.set_message(describe(&shown_start, &now, began.elapsed().as_secs_f64()));
        bar.tick();
    }
}

/// `42.0 %  12 seconds left  8.31 Mrays/s`, from the states at the beginning of the phase and now.
fn describe(start: &job::Progress, now: &job::Progress, seconds: f64) -> String {
    let mut parts = Vec::new();
    if now.total > 0 {
        parts.push(format!(
            "{:5.1} %",
            100.0 * now.done.min(now.total) as f64 / now.total as f64
        ));
        // What a resumed run began with took no time.
        let done = now.done.saturating_sub(start.done);
        if done > 0 && now.done < now.total && seconds > 0.5 {
            let left = seconds * (now.total - now.done) as f64 / done as f64;
            parts.push(format!(
                "{} left",
                HumanDuration(Duration::from_secs_f64(left.min(1e9)))
            ));
        }
    } else {
        parts.push(format!("{seconds:.1} s"));
    }
    let rays = now.rays.saturating_sub(start.rays);
    if rays > 0 && seconds > 0.05 {
        parts.push(format!("{:.2} Mrays/s", rays as f64 / seconds / 1e6));
    }
    parts.join("  ")
}

#[cfg(test)]
mod tests {
    use super::describe;
    use occlude_render::job::Progress;

    #[test]
    fn tells_share_time_left_and_rate() {
        let state = |done, total, rays| Progress {
            phase: "render",
            done,
            total,
            rays,
        };
        let start = state(0, 100, 1_000_000);
        assert_eq!(
            describe(&start, &state(25, 100, 21_000_000), 10.0),
            " 25.0 %  30 seconds left  2.00 Mrays/s"
        );
        assert_eq!(
            describe(&state(50, 100, 0), &state(75, 100, 0), 10.0),
            " 75.0 %  10 seconds left"
        );
        assert_eq!(describe(&start, &state(0, 100, 0), 0.0), "  0.0 %");
        assert_eq!(describe(&start, &state(0, 0, 0), 3.0), "3.0 s");
    }
}
