//! The sources keep to `docs/architecture.md`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Source files below a folder but for those of tests, in order.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut entries: Vec<PathBuf> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    let is_source =
        |p: &PathBuf| p.extension().is_some_and(|e| e == "rs") && p.file_name().unwrap() != "tests.rs";
    let (folders, files): (Vec<_>, Vec<_>) = entries.into_iter().partition(|p| p.is_dir());
    files.into_iter().filter(is_source).chain(folders.iter().flat_map(|f| sources(f))).collect()
}

/// The code of a file, without comments and unit tests.
fn code(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap();
    let code = text.split("#[cfg(test)]\nmod ").next().unwrap();
    let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
    lines.map(|line| format!("{line}\n")).collect()
}

fn is_name(c: char) -> bool {
    c.is_ascii_lowercase() || c == '_'
}

/// The names that follow `crate::` in a file, alone or in braces.
fn imports(code: &str) -> Vec<&str> {
    code.split("crate::")
        .skip(1)
        .flat_map(|rest| match rest.strip_prefix('{') {
            Some(list) => list.split('}').next().unwrap().split(',').map(str::trim).collect(),
            None => vec![rest],
        })
        .map(|name| name.split(|c| !is_name(c)).next().unwrap())
        .collect()
}

#[test]
fn modules_import_only_from_those_above_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = fs::read_to_string(root.join("docs/architecture.md")).unwrap();
    let table =
        text.split("| module |").nth(1).unwrap().lines().skip(1).take_while(|line| line.starts_with('|'));
    let names = table.flat_map(|line| line.split('|').nth(1).unwrap().split('`').skip(1).step_by(2));
    let place: BTreeMap<String, usize> = names.enumerate().map(|(k, name)| (name.to_string(), k)).collect();
    let mut seen = 0;
    for path in sources(&root.join("src")) {
        let within = path.strip_prefix(root.join("src")).unwrap();
        let module = within.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs");
        if module == "lib" || module == "main" {
            continue;
        }
        let own = place.get(module).unwrap_or_else(|| panic!("{module} is not in the table"));
        for name in imports(&code(&path)) {
            // What is no module is an item of the crate itself: its error type.
            let Some(other) = place.get(name) else { continue };
            assert!(other <= own, "{} imports from `{name}`, which is below `{module}`", within.display());
            seen += usize::from(other < own);
        }
    }
    assert!(seen > 300, "{seen} imports");
}

#[test]
fn only_the_command_line_prints() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    for path in sources(&root) {
        let within = path.strip_prefix(&root).unwrap();
        let prints = code(&path).contains("print!(") || code(&path).contains("println!(");
        assert!(
            !prints || within.starts_with("cli") || within == Path::new("main.rs"),
            "{}",
            within.display()
        );
    }
}
