//! Where and when a suite runs.

use super::Context;
use crate::report::record::Machine;
use crate::report::{Versions, command_line};
use std::time::SystemTime;

/// This machine, now.
pub fn machine(context: &Context) -> Machine {
    let versions = Versions::new(context.device);
    let versions = [
        ("twopass", versions.twopass.to_string()),
        ("Embree", versions.embree),
        ("OpenImageIO", versions.openimageio),
        ("compiler", env!("TWOPASS_RUSTC").to_string()),
    ];
    Machine {
        command: command_line(),
        versions: versions.map(|(name, version)| (name.to_string(), version)).to_vec(),
        cpu: cpu(),
        cores: std::thread::available_parallelism().map_or(1, |n| n.get()),
        threads: context.threads(),
        seed: context.settings.seed,
        quick: context.settings.quick,
        date: humantime::format_rfc3339_seconds(SystemTime::now()).to_string(),
    }
}

/// The processor's name where the system says it.
fn cpu() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text.lines().find_map(|l| l.strip_prefix("model name")).and_then(|l| l.split_once(':'));
    name.map_or_else(|| std::env::consts::ARCH.to_string(), |(_, name)| name.trim().to_string())
}
