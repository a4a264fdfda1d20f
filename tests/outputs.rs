//! Where the program writes: what it refuses before any work, and what is left when it fails.

mod common;

use common::program::*;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use twopass::image::supported;

#[test]
fn outputs_that_cannot_be_written_are_found_before_the_work() {
    let room = Files::room();
    fs::create_dir(room.path("folder.exr")).unwrap();
    fs::create_dir(room.path("folder.npz")).unwrap();
    // The scene does not exist: whoever reads it first says so instead.
    let render = |output: &str, code: i32, parts: &[&str]| {
        room.fails(&["render", "gone.toml", "-o", output], code, parts);
    };
    render("gone/a.exr", 1, &["gone/a.exr", "folder gone does not exist"]);
    render("folder.exr", 1, &["folder.exr", "is a folder"]);
    render("a.bmp", 2, &["a.bmp", ".exr", ".png"]);
    render("a", 2, &["the image format is unknown"]);
    room.fails(&["solve", "gone.toml", "-o", "gone/a.npz"], 1, &["gone/a.npz", "does not exist"]);
    room.fails(&["solve", "gone.toml", "-o", "folder.npz"], 1, &["folder.npz", "is a folder"]);
    room.fails(&["solve", "gone.toml", "-o", "a.csv"], 2, &["a.csv", ".npz"]);
    room.fails(&["form-factors", "gone.toml", "-o", "gone/a.npz"], 1, &["gone/a.npz", "does not exist"]);
    room.fails(&["form-factors", "gone.toml", "-o", "a.txt"], 2, &["a.txt", ".npz"]);
    room.fails(&["form-factors", "gone.toml"], 2, &["name an output", "--by-object"]);
    room.fails(&["form-factors", "gone.toml", "--view", "0", "-o", "a.npz"], 2, &["a.npz", "picture"]);
    let report = ["--report", "gone/r.json"];
    for command in [
        &["render", "gone.toml", "-o", "a.exr"][..],
        &["solve", "gone.toml", "-o", "a.npz"],
        &["form-factors", "gone.toml", "--by-object"],
    ] {
        room.fails(&[command, &report].concat(), 1, &["gone/r.json", "does not exist"]);
    }
    let twice = ["render", "gone.toml", "-o", "a.exr", "-o", "./a.exr"];
    room.fails(&twice, 2, &["./a.exr", "given twice"]);
    room.fails(
        &["solve", "scene.toml", "-o", "a.npz", "--report", "scene.toml"],
        2,
        &["scene.toml", "is read in this run"],
    );
}

/// libjpeg would end the process when all is rendered.
#[test]
fn pictures_too_large_for_their_format() {
    let room = Files::room();
    let render = |size: &str| {
        let args = ["render", "scene.toml", "-o", "a.exr", "-o", "b.JPG", "--size", size, "--spp", "1"];
        room.fails(&args, 2, &["b.JPG", "at most 65500 pixels", size.replace('x', " x ").as_str(), ".png"]);
    };
    render("65501x1");
    render("1x65536");
    let image = twopass::image::Image::new(65_501, 1);
    let options = twopass::image::WriteOptions::default();
    let write = |name: &str| twopass::image::write(&image, &room.path(name), &options);
    assert!(write("c.jpeg").unwrap_err().to_string().contains("c.jpeg: JPEG holds at most 65500"));
    for name in ["c.exr", "c.png", "c.tif", "c.hdr"] {
        write(name).unwrap();
        assert_eq!(twopass::image::read(&room.path(name)).unwrap(), image, "{name}");
    }
}

#[test]
#[cfg(unix)]
fn what_is_read_is_not_replaced() {
    let room = Files::new(CAMERA, &format!("mtllib room.mtl\n{ROOM}"));
    fs::write(room.path("room.mtl"), "newmtl white\nKd 0.5 0.5 0.5\nnewmtl lamp\nKe 3 2 1\n").unwrap();
    let solve = [&["solve", "scene.toml", "-o", "s.npz"], &QUICK[..]].concat();
    room.done(&solve);
    fs::create_dir(room.path("folder")).unwrap();
    for (link, file) in [("o", "../room.obj"), ("m", "../room.mtl"), ("s", "../s.npz")] {
        std::os::unix::fs::symlink(file, room.path("folder").join(link)).unwrap();
    }
    let inputs = ["room.obj", "room.mtl", "scene.toml", "s.npz"];
    let before = inputs.map(|name| fs::read(room.path(name)).unwrap());
    let says = "is read in this run and would be replaced";
    for report in ["room.obj", "room.mtl", "./folder/../room.obj", "folder/o", "folder/m"] {
        let report = ["--report", report];
        room.fails(&[&solve[..], &report].concat(), 2, &[report[1], says]);
        let factors = ["form-factors", "scene.toml", "-o", "f.npz"];
        room.fails(&[&factors[..], &report].concat(), 2, &[report[1], says]);
        let render = ["render", "scene.toml", "-o", "a.exr", "--solution", "s.npz"];
        room.fails(&[&render[..], &report].concat(), 2, &[report[1], says]);
    }
    for report in ["s.npz", "folder/s", "scene.toml"] {
        let render = ["render", "scene.toml", "-o", "a.exr", "--solution", "s.npz", "--report", report];
        room.fails(&render, 2, &[report, says]);
    }
    assert!(inputs.map(|name| fs::read(room.path(name)).unwrap()) == before);
}

#[test]
#[cfg(unix)]
fn folders_without_write_permission() {
    use std::os::unix::fs::PermissionsExt;
    let room = Files::room();
    let closed = room.path("closed");
    fs::create_dir(&closed).unwrap();
    fs::set_permissions(&closed, fs::Permissions::from_mode(0o555)).unwrap();
    if supported(&closed.join("a.exr")).is_ok() {
        println!("skipped: permissions do not bind this user");
        return;
    }
    room.fails(&["render", "scene.toml", "-o", "closed/a.exr"], 1, &["closed/a.exr", "cannot be written to"]);
    room.fails(&["solve", "scene.toml", "-o", "closed/a.npz"], 1, &["closed/a.npz", "cannot be written to"]);
}

#[test]
#[cfg(unix)]
fn a_closed_pipe_is_no_panic() {
    let room = Files::room();
    // The standard input of a program that has ended: nobody reads what is written there.
    let closed = || -> Stdio {
        let mut ended = Command::new("true").stdin(Stdio::piped()).spawn().unwrap();
        let writer = ended.stdin.take().unwrap();
        ended.wait().unwrap();
        writer.into()
    };
    let start = |args: &[&str]| -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_twopass"));
        command.current_dir(room.0.path()).args(args);
        command
    };
    let output = start(&["info", "scene.toml"]).stdout(closed()).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!((output.status.code(), stderr.as_str()), (Some(0), ""));
    let factors = ["form-factors", "room.obj", "--by-object", "--quiet", "--rays", "16"];
    let output = start(&factors).stdout(closed()).output().unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(stderr.contains("standard output") && !stderr.contains("panicked"), "{stderr}");
    // Standard error closed: progress is lost, the work is not.
    let render = [&["render", "scene.toml", "-o", "a.exr", "--spp", "1"], &QUICK[..]].concat();
    assert_eq!(start(&render).stderr(closed()).status().unwrap().code(), Some(0));
    assert!(room.path("a.exr").is_file());
}

#[test]
#[cfg(unix)]
fn names_that_are_not_unicode() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    let room = Files::room();
    let name = OsStr::from_bytes(b"caf\xe9.exr");
    let output = Command::new(env!("CARGO_BIN_EXE_twopass"))
        .current_dir(room.0.path())
        .args(["render", "scene.toml", "--spp", "1", "--report", "r.json", "-o"])
        .arg(name)
        .args(QUICK)
        .output()
        .unwrap();
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{stderr}");
    assert!(room.path("r.json").is_file() && Path::new(&room.0.path().join(name)).is_file());
}
