//! The program, run on a scene in a folder of its own.

use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A closed cube of one metre, seen from within; a quarter of it is lit by a panel under the ceiling.
pub const ROOM: &str = "o cube\nusemtl white\n\
    v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n\
    f 1 5 6 2\nf 4 3 7 8\nf 1 2 3 4\nf 5 8 7 6\nf 1 4 8 5\nf 2 6 7 3\n\
    o panel\nusemtl lamp\n\
    v 0.3 0.9 0.3\nv 0.7 0.9 0.3\nv 0.7 0.9 0.7\nv 0.3 0.9 0.7\nf 9 10 11 12\n";
pub const CAMERA: &str =
    "[camera]\norigin = [0.5, 0.4, 0.95]\ntarget = [0.5, 0.4, 0]\nfov = 60\nsize = [12, 8]\n";
pub const MATERIALS: &str = "[materials.white]\ndiffuse = 0.5\n[materials.lamp]\nemission = [3, 2, 1]\n";
/// So little work that a run takes a moment.
pub const QUICK: [&str; 4] = ["--rays", "16", "--element-size", "0.5"];

/// A folder with a scene in it.
pub struct Files(pub tempfile::TempDir);

/// What a run of the program left.
pub struct Run {
    pub code: i32,
    pub stdout: Vec<u8>,
    pub stderr: String,
}

impl Files {
    /// `scene.toml` with this text behind its geometry, and `room.obj`.
    pub fn new(toml: &str, obj: &str) -> Files {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("scene.toml"), format!("geometry = [\"room.obj\"]\n{toml}")).unwrap();
        fs::write(folder.path().join("room.obj"), obj).unwrap();
        Files(folder)
    }

    pub fn room() -> Files {
        Files::new(&format!("{CAMERA}{MATERIALS}"), ROOM)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Runs the program in the folder; it must never panic.
    #[track_caller]
    pub fn run(&self, args: &[&str]) -> Run {
        let output = Command::new(env!("CARGO_BIN_EXE_twopass"))
            .current_dir(self.0.path())
            .args(args)
            .stdin(Stdio::null())
            .output()
            .unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
        Run { code: output.status.code().expect("no signal"), stdout: output.stdout, stderr }
    }

    /// Runs the program, which must succeed.
    #[track_caller]
    pub fn done(&self, args: &[&str]) -> Run {
        let run = self.run(args);
        assert_eq!(run.code, 0, "{args:?}: {}", run.stderr);
        run
    }

    /// Runs the program, which must fail so, say all of `parts`, and leave no file.
    #[track_caller]
    pub fn fails(&self, args: &[&str], code: i32, parts: &[&str]) {
        let before = self.names();
        let run = self.run(args);
        assert_eq!(run.code, code, "{args:?}: {}", run.stderr);
        for part in parts {
            assert!(run.stderr.contains(part), "{args:?} should say {part:?}: {}", run.stderr);
        }
        assert!(run.stdout.is_empty(), "{args:?}");
        assert_eq!(self.names(), before, "{args:?}");
    }

    /// A rendering of the scene fails with exit code 1 and says all of `parts`.
    #[track_caller]
    pub fn render_fails(&self, parts: &[&str]) {
        let args = [&["render", "scene.toml", "-o", "a.exr", "--spp", "1"], &QUICK[..]].concat();
        self.fails(&args, 1, parts);
    }

    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(self.0.path())
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }
}
