//! The `twopass` program.

fn main() -> std::process::ExitCode {
    twopass::cli::run()
}
