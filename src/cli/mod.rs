//! The command line: reads arguments, runs stages, prints. Nothing else in the crate prints.

mod args;
mod bench;
mod compare;
mod form_factors;
mod frames;
mod info;
mod options;
mod progress;
mod render;
mod solve;

use crate::{Error, Result, output};
use args::{Command, Common};
use clap::Parser;
use std::collections::HashSet;
use std::fmt::Display;
use std::io::{self, ErrorKind, Write};
use std::path::PathBuf;
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
        Command::Compare(a) => compare::run(a),
        Command::Bench(a) => with_threads(&a.common, || bench::run(a)),
        Command::Info(a) => with_threads(&a.common, || info::run(a)),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            say(format_args!("twopass: {e}"));
            ExitCode::from(e.exit_code())
        }
    }
}

/// Runs a command on the number of threads asked for.
///
/// The threads have ended when this returns, their destructors included, which neither rayon nor a scope of threads waits for:
/// one that ended while the process exits could run those of OpenImageIO's dependencies after their library's own, and
/// crash (log4cplus 2.0 does).
fn with_threads(common: &Common, work: impl FnOnce() -> Result<()> + Send) -> Result<()> {
    let mut threads = Vec::new();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(common.threads.unwrap_or(0))
        .spawn_handler(|thread| {
            threads.push(std::thread::Builder::new().spawn(|| thread.run())?);
            Ok(())
        })
        .build()
        .map_err(|e| Error::Usage(format!("--threads: {e}")))?;
    let result = pool.install(work);
    drop(pool);
    for thread in threads {
        // A panic in it has reached `install`.
        let _ = thread.join();
    }
    result
}

/// A line on standard error; nobody may be there to read it.
fn say(text: impl Display) {
    let _ = writeln!(io::stderr(), "{text}");
}

/// Text on standard output. Who closes the pipe has read enough.
fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => Err(Error::io("standard output", e)),
        _ => Ok(()),
    }
}

/// Refuses outputs that cannot be written, or that would replace each other or what is read, before any work is done.
fn check_outputs<'a>(
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    outputs: impl IntoIterator<Item = &'a PathBuf> + Clone,
) -> Result<()> {
    output::check_all(outputs.clone().into_iter().map(PathBuf::as_path))?;
    let mut taken = HashSet::new();
    for path in outputs.clone() {
        if !taken.insert(output::place(path)) {
            let message = "is an output given twice; choose another name";
            return Err(Error::Usage(format!("{}: {message}", path.display())));
        }
    }
    spare_inputs(inputs, outputs)
}

/// Refuses outputs that would replace what is read.
fn spare_inputs<'a>(
    inputs: impl IntoIterator<Item = &'a PathBuf>,
    outputs: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<()> {
    let inputs: HashSet<PathBuf> = inputs.into_iter().map(|path| output::place(path)).collect();
    match outputs.into_iter().find(|path| inputs.contains(&output::place(path))) {
        Some(path) => {
            let message = "is read in this run and would be replaced; choose another name";
            Err(Error::Usage(format!("{}: {message}", path.display())))
        }
        None => Ok(()),
    }
}

/// A length as text, to four digits that count.
fn length(metres: f64) -> String {
    let rounded: f64 = format!("{metres:.3e}").parse().unwrap_or(metres);
    if rounded == 0.0 || (1e-4..1e9).contains(&rounded.abs()) {
        rounded.to_string()
    } else {
        format!("{rounded:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_have_digits_that_count() {
        let lengths = [0.0, 0.000_25, 0.000_123_456, 1.5e-7, 0.1 + 0.2, 2.0, 1234.56, 123_456.7, 3e12];
        let texts = lengths.map(length);
        assert_eq!(texts, ["0", "0.00025", "0.0001235", "1.5e-7", "0.3", "2", "1235", "123500", "3e12"]);
    }
}
