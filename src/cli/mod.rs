//! The command line: reads arguments, runs stages, prints. Nothing else in the crate prints.

mod args;
mod form_factors;
mod info;
mod progress;
mod render;
mod solve;

use args::{Command, Common};
use clap::Parser;
use std::process::ExitCode;

/// Runs the program with the process's arguments.
///
/// Exit codes: 0 done, 1 failed (message on standard error), 2 bad usage.
pub fn run() -> ExitCode {
    let args = args::Args::parse();
    let result = match &args.command {
        Command::Render(a) => with_threads(&a.common, || render::run(a)),
        Command::Solve(a) => with_threads(&a.common, || solve::run(a)),
        Command::FormFactors(a) => with_threads(&a.common, || form_factors::run(a)),
        Command::Info(a) => with_threads(&a.common, || info::run(a)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            eprintln!("twopass: {e}");
            ExitCode::from(e.exit_code())
        }
    }
}

/// Runs a command on the number of threads asked for.
fn with_threads(common: &Common, work: impl FnOnce() -> crate::Result<()> + Send) -> crate::Result<()> {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(common.threads.unwrap_or(0))
        .build()
        .map_err(|e| crate::Error::Usage(format!("--threads: {e}")))?;
    pool.install(work)
}
