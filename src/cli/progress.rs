//! Progress of each stage: a bar on a terminal, plain lines elsewhere.

use super::say;
use crate::pipeline::Event;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Shows what [`crate::pipeline`] tells.
pub struct Progress {
    quiet: bool,
    terminal: bool,
    current: Mutex<Option<(&'static str, Instant, ProgressBar)>>,
}

impl Progress {
    pub fn new(quiet: bool) -> Progress {
        Progress { quiet, terminal: std::io::stderr().is_terminal(), current: Mutex::new(None) }
    }

    /// Passes on one event.
    pub fn tell(&self, event: Event) {
        if self.quiet {
            return;
        }
        let mut current = self.current.lock().unwrap_or_else(|e| e.into_inner());
        match event {
            Event::Begin(name, total) => {
                let bar = match (self.terminal, total) {
                    (false, _) => ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::hidden()),
                    (true, 0) => ProgressBar::new_spinner(),
                    (true, _) => ProgressBar::new(total),
                };
                let template = if total == 0 {
                    "{msg:13} {elapsed_precise}"
                } else {
                    "{msg:13} {elapsed_precise} [{wide_bar}] {percent:>3} % {eta_precise} left"
                };
                if let Ok(style) = ProgressStyle::with_template(template) {
                    bar.set_style(style.progress_chars("=> "));
                }
                bar.set_message(name);
                if self.terminal {
                    bar.enable_steady_tick(Duration::from_millis(200));
                }
                *current = Some((name, Instant::now(), bar));
            }
            Event::Advance(n) => {
                if let Some((_, _, bar)) = &*current {
                    bar.inc(n);
                }
            }
            Event::Item(k, n) => {
                if let Some((name, _, bar)) = &*current {
                    bar.set_message(format!("{name} {k}/{n}"));
                }
            }
            Event::End => {
                if let Some((name, start, bar)) = current.take() {
                    bar.finish_and_clear();
                    say(format_args!("{name:13} {:8.3} s", start.elapsed().as_secs_f64()));
                }
            }
        }
    }

    /// A warning, once.
    pub fn warn(&self, text: &str) {
        say(format_args!("warning: {text}"));
    }

    /// A line of the summary, unless quiet.
    pub fn line(&self, text: &str) {
        if !self.quiet {
            say(text);
        }
    }
}
