//! `twopass bench`.

use super::args::BenchArgs;
use super::{print, say};
use crate::bench::{self, Context, Group, Settings};
use crate::embree::Device;
use crate::output::write_whole;
use crate::report::{markdown, suite};
use crate::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::Instant;

pub fn run(args: &BenchArgs) -> Result<()> {
    if let (Some(readme), true) = (&args.tables, args.names.is_empty()) {
        if args.quick {
            return Err(Error::Usage(
                "--tables measures nothing, quickly or not, unless groups are named".into(),
            ));
        }
        return tables(readme, &args.output);
    }
    let groups = Group::named(&args.names)?;
    if let Some(readme) = &args.tables {
        // Before anything is measured.
        std::fs::metadata(readme).map_err(|e| Error::io(readme, e))?;
        crate::output::check(readme)?;
    }
    suite::prepare(&args.output)?;
    let settings = Settings {
        quick: args.quick,
        seed: args.common.seed,
        cache: args.cache.clone().unwrap_or_else(|| cache(&args.output)),
        program: std::env::current_exe().ok(),
        foreign: foreign(args.foreign.as_deref())?,
    };
    let device = Device::new(rayon::current_num_threads())?;
    let start = Instant::now();
    let observer = |what: &str| {
        if !args.common.quiet {
            say(format_args!("{:7.1} s  {what}", start.elapsed().as_secs_f64()));
        }
    };
    let context = Context { settings: &settings, device: &device, observer: &observer };
    bench::run(&groups, &context, |measured| suite::write(measured, &args.output))?;
    observer(&format!("done: {}", args.output.join("report.html").display()));
    args.tables.as_ref().map_or(Ok(()), |readme| tables(readme, &args.output))
}

/// Replaces the tables of a Markdown file with those of earlier records.
fn tables(readme: &Path, records: &Path) -> Result<()> {
    let suite = suite::read(records)?;
    let old = std::fs::read_to_string(readme).map_err(|e| Error::io(readme, e))?;
    let (new, names) = markdown::replace_tables(&old, readme, &suite)?;
    write_whole(readme, new.as_bytes())?;
    print(&format!("{}: {}", readme.display(), names.join(", ")))
}

/// The user's cache folder; the records' own folder where there is none.
fn cache(output: &Path) -> PathBuf {
    let set = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let user = set("XDG_CACHE_HOME").or_else(|| set("HOME").map(|home| home.join(".cache")));
    user.map_or_else(|| output.join("references"), |folder| folder.join("twopass/references"))
}

/// The folder of another renderer's images, where there is one.
fn foreign(asked: Option<&Path>) -> Result<Option<PathBuf>> {
    if let Some(folder) = asked {
        if !folder.is_dir() {
            return Err(Error::Usage(format!("--foreign {}: is no folder", folder.display())));
        }
        return Ok(Some(folder.into()));
    }
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes");
    Ok(beside.is_dir().then_some(beside))
}
