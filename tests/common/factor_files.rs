//! `twopass form-factors`, run on an OBJ file in a folder of its own.

use super::{Point, box_faces};
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// A folder with an OBJ file in it.
pub struct Folder(pub tempfile::TempDir);

impl Folder {
    pub fn new(objects: &[(&str, Vec<Vec<Point>>)]) -> Folder {
        let (mut obj, mut n) = (String::new(), 0);
        for (name, polygons) in objects {
            let _ = writeln!(obj, "o {name}");
            for p in polygons {
                p.iter().for_each(|v| {
                    let _ = writeln!(obj, "v {:?} {:?} {:?}", v[0], v[1], v[2]);
                });
                let ids: Vec<String> = (1..=p.len()).map(|k| (n + k).to_string()).collect();
                let _ = writeln!(obj, "f {}", ids.join(" "));
                n += p.len();
            }
        }
        let folder = tempfile::tempdir().expect("temporary directory");
        fs::write(folder.path().join("s.obj"), obj).expect("temporary file");
        Folder(folder)
    }

    /// The faces of a closed box, each an object.
    pub fn room() -> Folder {
        let faces = box_faces([0.0; 3], [1.0, 0.5, 2.0], true);
        Folder::new(&faces.into_iter().map(|(n, p)| (n, vec![p])).collect::<Vec<_>>())
    }

    /// Two squares that face each other, and space.
    pub fn plates() -> Folder {
        far_plates(1.0)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&fs::read(self.path(name)).expect(name)).expect("JSON")
    }

    /// Exit code and standard error of a run on the OBJ file.
    pub fn run(&self, args: &[&str]) -> (i32, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_twopass"))
            .current_dir(self.0.path())
            .args([&["form-factors", "s.obj", "--threads", "2"], args].concat())
            .stdin(Stdio::null())
            .output()
            .expect("twopass");
        let stderr = String::from_utf8(output.stderr).expect("UTF-8");
        assert!(!stderr.contains("panicked"), "{args:?}: {stderr}");
        (output.status.code().expect("no signal"), stderr)
    }

    #[track_caller]
    pub fn done(&self, args: &[&str]) -> String {
        let (code, stderr) = self.run(args);
        assert_eq!(code, 0, "{args:?}: {stderr}");
        stderr
    }

    #[track_caller]
    pub fn refuses(&self, args: &[&str], parts: &[&str]) {
        let (code, stderr) = self.run(args);
        assert_eq!(code, 2, "{args:?}: {stderr}");
        for part in parts {
            assert!(stderr.contains(part), "{args:?} should say {part:?}: {stderr}");
        }
        let left = fs::read_dir(self.0.path()).expect("folder").count();
        assert_eq!(left, 1, "{args:?} left a file");
    }
}

pub fn floats(v: &Value) -> Vec<f64> {
    v.as_array().expect("array").iter().map(|x| x.as_f64().expect("number")).collect()
}

/// Rows of an element file as dense rows.
pub fn dense(file: &Value) -> Vec<Vec<f64>> {
    let n = file["elements"].as_u64().expect("elements") as usize;
    let start: Vec<usize> = floats(&file["indptr"]).iter().map(|x| *x as usize).collect();
    let (columns, values) = (floats(&file["indices"]), floats(&file["form_factors"]));
    start
        .windows(2)
        .map(|w| {
            let mut row = vec![0.0; n];
            (w[0]..w[1]).for_each(|k| row[columns[k] as usize] = values[k]);
            row
        })
        .collect()
}

/// Two unit squares that face each other at a distance.
pub fn far_plates(distance: f64) -> Folder {
    let square = |z: f64| vec![[0.0, 0.0, z], [1.0, 0.0, z], [1.0, 1.0, z], [0.0, 1.0, z]];
    let down = square(distance).into_iter().rev().collect();
    Folder::new(&[("low", vec![square(0.0)]), ("high", vec![down])])
}
