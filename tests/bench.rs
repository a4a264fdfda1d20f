//! `twopass bench`: its records can be read back, its report opens in a browser, its tables find their places.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use twopass::bench::{self, Context, Files, Group, Settings};
use twopass::embree::Device;
use twopass::image::png;
use twopass::report::record::{
    Chart, Figure, GroupRecord, Machine, PARAMETER, Picture, Series, Strip, Subject, Suite, Unit,
};
use twopass::report::{markdown, suite};

/// Two methods whose errors fall with the root of their time, one of them below what the reference tells.
fn subject() -> Subject {
    let mut subject = Subject::new("room", "A <room> & its \"light\"", "Two methods.");
    for (name, speed) in [("slow", 1.0), ("fast", 4.0)] {
        for spp in [1.0f64, 4.0, 16.0] {
            let point = subject.series(name, "samples a pixel").at(spp);
            for round in [0.95, 1.0, 1.1] {
                point.push("following frame", Unit::Seconds, round * spp / speed);
                point.push("relative RMSE", Unit::Share, 0.1 * round / spp.sqrt());
            }
            point.unresolved = name == "fast" && spp == 16.0;
        }
    }
    let mut chart =
        Chart::new("Error over time", "following frame", "relative RMSE", "Left and down is better.")
            .fitted(&subject.series)
            .guide("theory: -1/2", -0.5);
    chart.floor = Some(("noise".into(), 0.03));
    subject.charts.push(chart);
    let colours: Vec<u8> = (0..8 * 4 * 3).map(|k| (k * 7 % 256) as u8).collect();
    subject.strips.push(Strip {
        title: "Errors".into(),
        about: "Blue is too dark.".into(),
        scale: Some(0.1),
        pictures: vec![Picture {
            caption: "slow".into(),
            file: "pictures/slow.png".into(),
            png: png(8, 4, &colours).unwrap(),
        }],
        whole: Some(Picture {
            caption: "all".into(),
            file: "pictures/all.png".into(),
            png: png(4, 8, &colours).unwrap(),
        }),
    });
    subject.notes.push("skipped: nothing".into());
    subject
}

fn made() -> Suite {
    let text = |s: &str| s.to_string();
    Suite {
        machine: Machine {
            command: vec![text("/usr/bin/twopass"), text("bench"), text("-o"), text("my dir")],
            versions: vec![(text("twopass"), text("0.1.0"))],
            cpu: text("A processor"),
            cores: 2,
            threads: 2,
            seed: 0,
            quick: true,
            date: text("2000-01-01T00:00:00Z"),
        },
        groups: vec![GroupRecord {
            name: text("images"),
            title: text("Error over time"),
            about: text("Made for a test."),
            seconds: 1.0,
            figures: vec![Figure {
                label: text("times faster"),
                unit: Unit::Plain,
                samples: vec![4.0, 3.9, 4.1],
            }],
            subjects: vec![subject(), words()],
        }],
    }
}

/// A table of words and numbers: nothing varies, nothing is drawn.
fn words() -> Subject {
    let mut subject = Subject::new("cases", "Cases", "What breaks.");
    for (name, answer, error) in [("edge", "closed | form", Some(0.01)), ("hole", "a warning", None)] {
        let series = subject.series(name, "");
        series.words.push(("answer from".into(), answer.into()));
        series.at(1.0).push("time", Unit::Seconds, 2.0);
        if let Some(error) = error {
            series.at(1.0).push("error", Unit::Share, error);
        }
    }
    subject
}

fn written() -> (tempfile::TempDir, Suite) {
    let folder = tempfile::tempdir().unwrap();
    let suite = made();
    suite::write(&suite, folder.path()).unwrap();
    (folder, suite)
}

#[test]
fn json_reads_back_whole() {
    let (folder, suite) = written();
    assert_eq!(suite::read(folder.path()).unwrap(), suite);
    fs::write(folder.path().join("bench.json"), "{\n  \"machine\": 7 }").unwrap();
    let error = suite::read(folder.path()).unwrap_err().to_string();
    assert!(error.contains("bench.json:2"), "{error}");
}

/// Every sample of every quantity, and nothing else.
#[test]
fn csv_reads_back_whole() {
    let (folder, suite) = written();
    let mut reader = csv::Reader::from_path(folder.path().join("bench.csv")).unwrap();
    let columns: Vec<String> = reader.headers().unwrap().iter().map(String::from).collect();
    let expected = [
        "group",
        "subject",
        "series",
        "parameter",
        "at",
        "quantity",
        "unit",
        "unresolved",
        "run",
        "sample",
        "words",
    ];
    assert_eq!(columns, expected);
    let rows: Vec<Vec<String>> =
        reader.records().map(|r| r.unwrap().iter().map(String::from).collect()).collect();
    assert_eq!(rows.len(), 2 * 3 * 2 * 3 + 3);
    assert!(rows.iter().take(36).all(|r| r[10].is_empty()));
    assert_eq!(rows[36][10], "answer from: closed | form");
    let mut at = rows.iter();
    for series in &suite.groups[0].subjects[0].series {
        for point in &series.points {
            for m in &point.measured {
                for (run, sample) in m.samples.iter().enumerate() {
                    let row = at.next().unwrap();
                    assert_eq!((&row[2], &row[5]), (&series.name, &m.quantity));
                    assert_eq!(row[4].parse::<f64>().unwrap(), point.parameter);
                    assert_eq!(row[7], point.unresolved.to_string());
                    assert_eq!(row[8], run.to_string());
                    assert_eq!(row[9].parse::<f64>().unwrap(), *sample);
                }
            }
        }
    }
}

#[test]
fn samples_that_are_no_numbers_are_refused() {
    let mut suite = made();
    suite.groups[0].subjects[0].series[1].points[0].measured[0].samples[1] = f64::NAN;
    let error = suite.check().unwrap_err().to_string();
    assert!(error.contains("images/room/fast") && error.contains("following frame"), "{error}");
}

/// The fitted exponent of a series that falls with the root of time, without the point that is not resolved.
#[test]
fn exponents_are_fitted_and_drawn() {
    let (folder, suite) = written();
    let chart = &suite.groups[0].subjects[0].charts[0];
    let slow = chart.exponents.iter().find(|e| e.series == "slow").unwrap();
    assert!((slow.value + 0.5).abs() < 1e-9 && slow.points == 3, "{slow:?}");
    assert!(chart.exponents.iter().all(|e| e.series != "fast"));
    let svg = fs::read_to_string(folder.path().join("plots/images-room-1.svg")).unwrap();
    for text in ["slow", "fast", "slope -0.50", "theory: -1/2", "noise", "hollow"] {
        assert!(svg.contains(text), "{text}");
    }
    // A dot for each point, a ring around it, and a sample of each in the legend.
    assert_eq!(svg.matches("<circle").count(), 2 * 6 + 2 + 1);
    let mut none = Subject::new("s", "t", "u");
    none.series.push(Series::new("empty", "n"));
    let chart = Chart::new("t", PARAMETER, "y", "");
    assert_eq!(twopass::report::plot::to_svg(&none, &chart).unwrap(), "");
}

#[test]
fn the_page_needs_no_other_file() {
    let (folder, _) = written();
    let html = fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(html.contains("A &lt;room&gt; &amp; its &quot;light&quot;") && !html.contains("<room>"));
    assert!(html.contains("src=\"data:image/png;base64,iVBOR"));
    assert!(html.contains("bench -o &quot;my dir&quot;"));
    // Whatever a page could fetch; namespaces of SVG are names, not addresses.
    let rest = html.replace("http://www.w3.org/2000/svg", "");
    for address in ["http:", "https:", "url(", "<script", "@import", "<link rel=\"stylesheet\""] {
        assert!(!rest.contains(address), "{address}");
    }
}

#[test]
fn tables_hold_words_beside_numbers() {
    let (folder, suite) = written();
    let cases = &suite.groups[0].subjects[1];
    let expected = "| | answer from | time | error |\n| --- | --- | --- | --- |\n\
                    | edge | closed / form | 2.00 s | 1.00 % |\n| hole | a warning | 2.00 s | - |\n";
    assert_eq!(markdown::table(cases, &markdown::Choice::default()), expected);
    let html = fs::read_to_string(folder.path().join("report.html")).unwrap();
    assert!(
        html.contains("<tr><td>edge</td><td title=\"\">closed | form</td><td title=\"[2.0]\">2.00 s</td>")
    );
    // Nothing is drawn: the table stands open.
    assert_eq!(html.matches("<details open>").count(), 1);
    let md = fs::read_to_string(folder.path().join("report.md")).unwrap();
    assert!(md.contains("![Errors](pictures/all.png)"), "{md}");
    assert_eq!(fs::read(folder.path().join("pictures/all.png")).unwrap()[1..4], *b"PNG");
}

#[test]
fn tables_replace_what_stands_between_marks() {
    let (folder, suite) = written();
    let table = markdown::table(&suite.groups[0].subjects[0], &markdown::Choice::default());
    assert!(
        table.contains("| fast | samples a pixel: 4 | 1.00 s (0.950 to 1.10) | 5.00 % (4.75 to 5.50) |"),
        "{table}"
    );
    let readme = folder.path().join("README.md");
    let old = "# A\n<!-- bench images/room -->\nold\n<!-- /bench -->\nmiddle\n\
               <!-- bench other/thing -->\nkept\n<!-- /bench -->\nend\n";
    fs::write(&readme, old).unwrap();
    let run = twopass(&["bench", "--tables", "README.md", "-o", "."], folder.path());
    assert_eq!(run.0, 0, "{}", run.2);
    let new = fs::read_to_string(&readme).unwrap();
    assert!(new.starts_with("# A\n<!-- bench images/room -->\n| | |"), "{new}");
    assert!(new.contains("`twopass bench images --quick -o DIR`; A processor"), "{new}");
    assert!(!new.contains("old") && new.contains("\nkept\n") && new.ends_with("end\n"));
    // Again: nothing but the same.
    assert_eq!(twopass(&["bench", "--tables", "README.md", "-o", "."], folder.path()).0, 0);
    assert_eq!(fs::read_to_string(&readme).unwrap(), new);

    let chosen = "<!-- bench images/room columns: relative RMSE; series: slow; at: 4, 16 --><!-- /bench -->";
    fs::write(&readme, chosen).unwrap();
    assert_eq!(twopass(&["bench", "--tables", "README.md", "-o", "."], folder.path()).0, 0);
    let part = fs::read_to_string(&readme).unwrap();
    let rows: Vec<&str> = part.lines().filter(|l| l.starts_with('|')).collect();
    let expected = [
        "| | | relative RMSE |",
        "| --- | --- | --- |",
        "| slow | samples a pixel: 4 | 5.00 % (4.75 to 5.50) |",
        "| slow | samples a pixel: 16 | 2.50 % (2.38 to 2.75) |",
    ];
    assert_eq!(rows, expected);
    fs::write(&readme, "<!-- bench images/room rows: 4 --><!-- /bench -->").unwrap();
    let run = twopass(&["bench", "--tables", "README.md", "-o", "."], folder.path());
    assert!(run.0 == 1 && run.2.contains("README.md:1") && run.2.contains("rows"), "{}", run.2);

    fs::write(&readme, "a\n<!-- bench images/room -->\nno end").unwrap();
    let run = twopass(&["bench", "--tables", "README.md", "-o", "."], folder.path());
    assert!(run.0 == 1 && run.2.contains("README.md:2"), "{}", run.2);
    fs::write(&readme, "nothing").unwrap();
    let run = twopass(&["bench", "--tables", "README.md", "-o", "."], folder.path());
    assert!(run.0 == 1 && run.2.contains("images/room"), "{}", run.2);
}

/// Exit code, standard output and standard error.
fn twopass(args: &[&str], folder: &Path) -> (i32, String, String) {
    let run = Command::new(env!("CARGO_BIN_EXE_twopass")).current_dir(folder).args(args).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (run.status.code().expect("no signal"), text(run.stdout), text(run.stderr))
}

#[test]
fn unknown_groups_are_named_beside_the_known() {
    let folder = tempfile::tempdir().unwrap();
    let (code, _, err) = twopass(&["bench", "embree", "imagse", "-o", "out"], folder.path());
    assert_eq!(code, 2);
    assert!(err.contains("\"imagse\""), "{err}");
    for group in Group::ALL {
        assert!(err.contains(group.name()), "{err}");
    }
    // Refused before anything is made.
    assert!(!folder.path().join("out").exists());
    fs::write(folder.path().join("file"), "").unwrap();
    let (code, _, err) = twopass(&["bench", "embree", "-o", "file"], folder.path());
    assert!(code == 1 && err.contains("file"), "{err}");
    let (code, _, err) = twopass(&["bench", "embree", "-o", "out", "--foreign", "none"], folder.path());
    assert!(code == 2 && err.contains("none"), "{err}");
}

/// A whole group through the command line: the memory of child processes, which hold the stated bytes.
#[test]
fn a_group_runs_to_its_report() {
    let folder = tempfile::tempdir().unwrap();
    let page = folder.path().join("page.md");
    let run = ["bench", "memory", "-o", "made/here", "--quick", "--quiet", "--tables", "page.md"];
    // A page that is not there is refused before anything is measured.
    let (code, _, err) = twopass(&run, folder.path());
    assert!(code == 1 && err.contains("page.md") && !folder.path().join("made").exists(), "{err}");
    fs::write(&page, "<!-- bench memory/solve -->\n<!-- /bench -->").unwrap();
    let (code, out, err) = twopass(&run, folder.path());
    assert_eq!((code, out.as_str(), err.as_str()), (0, "page.md: memory/solve\n", ""));
    assert_eq!(fs::read_to_string(&page).unwrap().matches("| 64 rays an element |").count(), 3);
    // Without groups nothing is measured, quickly or not.
    let (code, _, err) =
        twopass(&["bench", "--quick", "--tables", "page.md", "-o", "made/here"], folder.path());
    assert!(code == 2 && err.contains("--tables"), "{err}");
    let records = folder.path().join("made/here");
    for file in ["bench.csv", "report.md", "report.html", "plots/memory-solve-1.svg"] {
        assert!(records.join(file).is_file(), "{file}");
    }
    let suite = suite::read(&records).unwrap();
    let machine = &suite.machine;
    assert!(machine.quick && machine.command[1..3] == ["bench", "memory"], "{machine:?}");
    for name in ["twopass", "Embree", "OpenImageIO", "compiler"] {
        let version = machine.versions.iter().find(|v| v.0 == name).map(|v| v.1.as_str());
        assert!(version.is_some_and(|v| v.contains('.')), "{name}: {version:?}");
    }
    assert!(machine.date.starts_with("20") && machine.date.ends_with('Z'), "{}", machine.date);
    let points = &suite.groups[0].subjects[0].series[0].points;
    assert_eq!(points.len(), 3);
    for point in points {
        let value = |q: &str| point.get(q).unwrap().samples[0];
        // 4 bytes an entry, 112 an element and its share of a block of 32: the matrix's own layout.
        let expected = 4.0 * value("entries") + 114.0 * point.parameter;
        assert!((value("matrix") / expected - 1.0).abs() < 1e-3, "{point:?}");
        assert!(value("most memory held") > value("matrix"));
    }
}

/// References come from the cache when asked for again, and are made anew for another view or when damaged.
#[test]
fn references_are_cached() {
    let folder = tempfile::tempdir().unwrap();
    let settings =
        Settings { quick: true, seed: 0, cache: folder.path().join("cache"), program: None, foreign: None };
    let device = Device::new(1).unwrap();
    let said = std::sync::Mutex::new(0);
    let observer = |_: &str| *said.lock().unwrap() += 1;
    let context = Context { settings: &settings, device: &device, observer: &observer };
    let scene = bench::embedded("cornell").unwrap();
    let visibility = twopass::visibility::Visibility::new(&device, &scene).unwrap();
    let emitters = twopass::emitters::Emitters::new(&visibility);
    let camera = twopass::scene::Camera { size: [24, 24], ..scene.cameras[0].clone() };
    let get = |spp| bench::reference::reference(&context, &visibility, &emitters, &camera, spp).unwrap();
    let first = get(16);
    assert_eq!(*said.lock().unwrap(), 2);
    let again = get(16);
    assert_eq!(*said.lock().unwrap(), 2);
    assert_eq!(first.halves, again.halves);
    assert_ne!(first.halves[0], first.halves[1]);
    // The lamp hangs in sight, and little else.
    let hidden = first.mask.iter().filter(|m| !**m).count();
    assert!(hidden > 4 && hidden < 80, "{hidden}");
    // Four times the paths: half the noise, to 30 %.
    let more = get(64);
    assert_eq!(*said.lock().unwrap(), 4);
    let ratio = more.standard_error / first.standard_error;
    assert!((0.3..0.7).contains(&ratio), "{ratio}");
    for file in fs::read_dir(&settings.cache).unwrap() {
        fs::write(file.unwrap().path(), "damaged").unwrap();
    }
    assert_eq!(get(16).halves, first.halves);
    assert_eq!(*said.lock().unwrap(), 6);
}

/// Made scenes are what they say: a closed unit cube whose faces look inwards.
#[test]
fn made_rooms_are_closed() {
    let mut files = Files::default();
    for name in ["x0", "x1", "y0", "y1", "z0", "z1"] {
        files.diffuse(name, 0.5, 1.0);
    }
    let scene = files.room().load().unwrap();
    assert!((scene.faces.iter().map(|f| f.area).sum::<f64>() - 6.0).abs() < 1e-12);
    for face in &scene.faces {
        assert!(scene.face_frame(face).at(glam::DVec2::splat(0.5)).dot(face.normal) < -0.4);
    }
}

fn chromium() -> Option<PathBuf> {
    let names = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).flat_map(|dir| names.map(|n| dir.join(n))).find(|p| p.is_file())
}

/// The page in a real browser: no error on its console, every picture there, every plot drawn.
#[test]
fn the_report_opens_in_a_browser() {
    let Some(browser) = chromium() else {
        eprintln!("skipped: no Chromium on the PATH");
        return;
    };
    let (folder, _) = written();
    let open = |page: &Path| {
        let profile = tempfile::tempdir().unwrap();
        let run = Command::new(&browser)
            .args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync"])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
                "--enable-logging=stderr",
            ])
            .args(["--virtual-time-budget=2000", "--dump-dom"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg(format!("file://{}", page.display()))
            .output()
            .unwrap();
        let dom = String::from_utf8_lossy(&run.stdout).into_owned();
        let log = String::from_utf8_lossy(&run.stderr).into_owned();
        (dom, log.lines().filter(|l| l.contains("CONSOLE")).map(String::from).collect::<Vec<_>>())
    };
    // A script of the test's own reports what the browser made of the page.
    let probe = "<script>addEventListener('load', () => {\
        const images = [...document.images];\
        const broken = images.filter(i => !(i.complete && i.naturalWidth > 0)).length;\
        const plots = [...document.querySelectorAll('.plot svg')];\
        const flat = plots.filter(p => !(p.getBoundingClientRect().height > 100)).length;\
        document.body.dataset.found = `${images.length} images, ${broken} broken, ${plots.length} plots, ${flat} flat`;\
        })</script></body>";
    let html = fs::read_to_string(folder.path().join("report.html")).unwrap();
    let page = folder.path().join("probed.html");
    fs::write(&page, html.replace("</body>", probe)).unwrap();
    let (dom, console) = open(&page);
    assert!(dom.contains("1 images, 0 broken, 1 plots, 0 flat"), "{}", &dom[dom.len().saturating_sub(500)..]);
    assert!(console.is_empty(), "{console:?}");
    // The check can fail: a picture that is none, and an error on the console.
    let broken = html
        .replace("base64,iVBOR", "base64,xxxx")
        .replace("</body>", &format!("<script>nothing()</script>{probe}"));
    fs::write(&page, broken).unwrap();
    let (dom, console) = open(&page);
    assert!(dom.contains("1 images, 1 broken"), "{}", &dom[dom.len().saturating_sub(500)..]);
    assert!(console.iter().any(|l| l.contains("nothing is not defined")), "{console:?}");
}
