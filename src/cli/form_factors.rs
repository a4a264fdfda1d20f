//! `twopass form-factors`.

use super::args::{EnforceArg, FactorMethodArg, FormFactorArgs, MirrorArg, ViewArg};
use super::progress::Progress;
use super::render::{of_element_size, pass1};
use super::{check_outputs, options, spare_inputs};
use crate::embree::Device;
use crate::form_factor::export::{self, View};
use crate::form_factor::{
    AtSpecular, Casting, Enforce, Factors, Found, HemicubeErrors, HemicubeSettings, Request, cast_images,
    cast_rows, correct, estimate_rows, hemicube, size_for_pairs, unoccluded,
};
use crate::image::{self, WriteOptions};
use crate::mesh::{Mesh, Sides, default_element_size};
use crate::output::{write_whole, write_whole_with};
use crate::pipeline::{self, Event, Pass1, Stage};
use crate::report::{FactorReport, Report, Versions, command_line};
use crate::scene::{Scene, load};
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Independent randomisations: enough that four standard errors hold almost always (15 degrees of freedom).
const BATCHES: u32 = 16;
/// Pixels along the top of a hemi-cube where nobody says otherwise.
const RESOLUTION: u32 = 256;
/// An enclosure that loses less than this share is closed on purpose.
const CLOSED: f64 = 1e-4;
/// Smallest factor that an error is asked for where nobody says otherwise.
const FLOOR: f64 = 1e-3;
/// View3D's format writes every pair: beyond this many elements it would fill the disk unasked.
const MOST_DENSE: usize = 20_000;

/// What is written to an output.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    Npz,
    Csv,
    Json,
    View3d,
    Picture,
}

pub fn run(args: &FormFactorArgs) -> Result<()> {
    let outputs = outputs(args)?;
    options::of_form_factors(args, &outputs)?;
    let files = outputs.iter().map(|o| &o.0).filter(|path| !is_stdout(path)).chain(&args.report);
    check_outputs([&args.scene], files.clone())?;
    let progress = Progress::new(args.common.quiet);
    let observer = &|e| progress.tell(e);
    let mut stages: Vec<Stage> = Vec::new();
    let scene = pipeline::stage("load", 0, observer, &mut stages, || (load(&args.scene), 0))?;
    spare_inputs(&scene.files, files)?;
    if args.two_sided && args.view.is_none() {
        export::check_names_of_backs(&scene)?;
    }
    let mut warnings = options::idle_of_form_factors(args);
    warnings.extend(scene.warnings.iter().cloned());
    warnings.iter().for_each(|w| progress.warn(w));
    let settings = pass1(&args.pass1, &scene, args.common.seed);
    let mut sides = if args.two_sided { Sides::all(&scene) } else { Sides::fronts(&scene) };
    if args.mirror != MirrorArg::None {
        sides = sides.without_purely_specular(&scene);
    }
    let size = match settings.element_size {
        Some(size) => size,
        None => default_size(args, &scene, &sides, settings.rays)?,
    };
    let mesh = Mesh::new(&scene, &sides, size, true)
        .map_err(|e| of_element_size(&args.pass1.elements, &scene, e))?;
    let rows = selected(args, &scene, &mesh)?;
    let viewed = args.view.as_deref().map(|v| viewed(v, &scene, &mesh)).transpose()?;
    let dense = outputs.iter().any(|o| o.1 == Format::View3d) && !args.by_object;
    if dense && mesh.len() > MOST_DENSE {
        return Err(Error::Usage(format!(
            "View3D's format holds every pair of {} elements: more than {MOST_DENSE} are too many; write .npz, add --by-object or \
             choose a larger --element-size",
            mesh.len()
        )));
    }

    let device = Device::new(rayon::current_num_threads())?;
    let mut report = None;
    if let Some(element) = viewed {
        let visibility =
            pipeline::stage("build", 0, observer, &mut stages, || (Visibility::new(&device, &scene), 0))?;
        let how = match args.view_as {
            ViewArg::Fisheye => View::Fisheye,
            ViewArg::Hemicube => View::Hemicube(args.hemicube.resolution.unwrap_or(RESOLUTION)),
        };
        let picture = pipeline::stage("trace", 0, observer, &mut stages, || {
            (export::view(&visibility, &mesh, element, how), 0)
        });
        pipeline::stage("write", 0, observer, &mut stages, || {
            (outputs.iter().try_for_each(|(path, _)| image::write(&picture, path, &metadata())), 0)
        })?;
    } else {
        let mut run = Run { args, scene: &scene, mesh: &mesh, progress: &progress, stages: &mut stages };
        let start = Instant::now();
        let found = run.find(&device, &settings, rows.as_deref())?;
        let range = args.rows.clone();
        let seconds = start.elapsed().as_secs_f64();
        let all = if args.by_object {
            scene.objects.len() * if args.two_sided { 2 } else { 1 }
        } else {
            mesh.len()
        };
        let kept = (args.by_object, range.unwrap_or(0..all));
        let mut factors = Factors::of_found(&scene, &mesh, &found, kept, seconds);
        found.lines(args.floor.unwrap_or(FLOOR)).iter().for_each(|l| progress.line(l));
        let said = found.warnings(&scene, args.error);
        said.iter().for_each(|w| progress.warn(w));
        warnings.extend(said);
        let losses = losses(&factors, args.two_sided);
        losses.iter().for_each(|w| progress.warn(w));
        warnings.extend(losses);
        let method = match args.method {
            FactorMethodArg::Ray => "ray",
            FactorMethodArg::Hemicube => "hemicube",
            FactorMethodArg::Analytic => "analytic",
        };
        let numbers = || FactorReport::new(&scene, &mesh, &found, (method, rows.is_some()), &factors);
        let mut numbers = args.report.as_ref().map(|_| numbers());
        drop(found);
        if let Some(enforce) = enforced(args.enforce) {
            let correction = correct(&mut factors, enforce)?;
            progress.line(&correction.line());
            if let Some(numbers) = &mut numbers {
                (numbers.written, numbers.correction) = (factors.written, Some(correction));
            }
        }
        if args.method == FactorMethodArg::Hemicube {
            let settings = hemicube_settings(args);
            if let Some(numbers) = &mut numbers {
                numbers.hemicube = Some(settings);
            }
            if args.hemicube.hemicube_errors {
                let errors = HemicubeErrors::measure(&scene, &mesh, &settings);
                progress.line(&format!(
                    "RMS error of a factor from aliasing {:.1e}, proximity {:.1e}, visibility from a point {:.1e}",
                    errors.aliasing_rms, errors.proximity_rms, errors.visibility_rms
                ));
                if let Some(numbers) = &mut numbers {
                    numbers.hemicube_errors = Some(errors);
                }
            }
        }
        pipeline::stage("write", 0, observer, &mut stages, || {
            (outputs.iter().try_for_each(|(path, format)| write(&factors, path, *format)), 0)
        })?;
        report = numbers;
    }
    if let Some(path) = &args.report {
        let mut whole = Report::new(&scene, Versions::new(&device), args.common.seed, stages, warnings);
        whole.elements = mesh.len();
        whole.form_factors = report;
        whole.write(path)?;
    }
    Ok(())
}

/// Size of elements where none is given. Factors between objects do not depend on elements: these are whole faces where factors are
/// exact whatever the elements are, and so few that every pair is looked at where that is possible.
fn default_size(args: &FormFactorArgs, scene: &Scene, sides: &Sides, rays: u32) -> Result<f64> {
    let size = match args.method {
        FactorMethodArg::Analytic if args.by_object => Some(f64::MAX),
        FactorMethodArg::Ray if args.by_object && !by_chains(args, scene) => {
            size_for_pairs(scene, sides, rays, args.error.is_some())?
        }
        FactorMethodArg::Analytic | FactorMethodArg::Ray | FactorMethodArg::Hemicube => None,
    };
    Ok(size.unwrap_or_else(|| default_element_size(scene, true)))
}

/// Whether factors take hemisphere rays because of specular surfaces. Where nothing is specular no chain begins.
fn by_chains(args: &FormFactorArgs, scene: &Scene) -> bool {
    let specular = || scene.faces.iter().any(|f| scene.material(f).is_specular());
    args.mirror == MirrorArg::Image || args.mirror == MirrorArg::Chain && specular()
}

/// The stage that finds the matrix, by either method.
struct Run<'a> {
    args: &'a FormFactorArgs,
    scene: &'a Scene,
    mesh: &'a Mesh,
    progress: &'a Progress,
    stages: &'a mut Vec<Stage>,
}

impl Run<'_> {
    fn find(&mut self, device: &Device, settings: &Pass1, rows: Option<&[bool]>) -> Result<Found> {
        let progress = self.progress;
        let observer = &|e| progress.tell(e);
        let advance = |n| progress.tell(Event::Advance(n));
        let count = rows.map_or(self.mesh.len(), |r| r.iter().filter(|r| **r).count()) as u64;
        match self.args.method {
            FactorMethodArg::Ray => {
                let visibility = pipeline::stage("build", 0, observer, self.stages, || {
                    (Visibility::new(device, self.scene), 0)
                })?;
                if self.args.mirror == MirrorArg::Image {
                    return pipeline::stage("form-factors", count, observer, self.stages, || {
                        let work = (settings.rays, BATCHES);
                        let matrix = cast_images(&visibility, self.mesh, work, settings.seed, &advance);
                        let rays = matrix.as_ref().map_or(0, |m| m.rays);
                        (matrix.map(Found::by_rows), rays)
                    });
                }
                if !by_chains(self.args, self.scene) {
                    return Ok(pipeline::stage("form-factors", count, observer, self.stages, || {
                        let request = Request {
                            rays: settings.rays,
                            error: self.args.error,
                            floor: self.args.floor.unwrap_or(FLOOR),
                            by_object: self.args.by_object,
                            seed: settings.seed,
                            progress: &advance,
                        };
                        let found = estimate_rows(&visibility, self.mesh, &request, rows);
                        let rays = found.rays;
                        (found, rays)
                    }));
                }
                Ok(pipeline::stage("form-factors", count, observer, self.stages, || {
                    let casting = Casting {
                        rays: settings.rays,
                        batches: BATCHES,
                        seed: settings.seed,
                        specular: AtSpecular::GoOn,
                        reached: None,
                        emitters: None,
                        progress: &advance,
                    };
                    let (matrix, _) = cast_rows(&visibility, self.mesh, &casting, rows);
                    let rays = matrix.rays;
                    (Found::by_rows(matrix), rays)
                }))
            }
            FactorMethodArg::Hemicube => {
                let settings = hemicube_settings(self.args);
                Ok(pipeline::stage("form-factors", count, observer, self.stages, || {
                    (Found::by_rows(hemicube(self.scene, self.mesh, &settings, rows, &advance)), 0)
                }))
            }
            FactorMethodArg::Analytic => {
                let visibility = pipeline::stage("build", 0, observer, self.stages, || {
                    (Visibility::new(device, self.scene), 0)
                })?;
                pipeline::stage("form-factors", count, observer, self.stages, || {
                    let found = unoccluded(&visibility, self.mesh, settings.seed, &advance);
                    let rays = found.as_ref().map_or(0, |f| f.rays);
                    (found, rays)
                })
            }
        }
    }
}

fn hemicube_settings(args: &FormFactorArgs) -> HemicubeSettings {
    HemicubeSettings {
        resolution: args.hemicube.resolution.unwrap_or(RESOLUTION),
        grid: args.hemicube.hemicube_grid.unwrap_or(1),
        rotations: args.hemicube.rotate.unwrap_or(0),
        seed: args.common.seed,
    }
}

fn enforced(arg: EnforceArg) -> Option<Enforce> {
    match arg {
        EnforceArg::None => None,
        EnforceArg::Reciprocity => Some(Enforce::Reciprocity),
        EnforceArg::Closure => Some(Enforce::Closure),
    }
}

pub fn is_stdout(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// Outputs and their formats.
fn outputs(args: &FormFactorArgs) -> Result<Vec<(PathBuf, Format)>> {
    if args.output.is_empty() {
        return match (args.view.is_some(), args.by_object) {
            (true, _) => Err(Error::Usage("--view draws a picture: name it with -o VIEW.png".into())),
            (false, true) => Ok(vec![(PathBuf::from("-"), Format::Json)]),
            (false, false) => Err(Error::Usage(
                "name an output: -o F.npz, .csv, .json, .vf or .png; or add --by-object for a table on standard output".into(),
            )),
        };
    }
    let format = |path: &PathBuf| {
        let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        let format = match extension.as_str() {
            _ if is_stdout(path) => Format::Json,
            "npz" => Format::Npz,
            "csv" => Format::Csv,
            "json" => Format::Json,
            "vf" | "out" => Format::View3d,
            // Whether it can be written there is asked later, of all outputs.
            _ => match image::supported(path) {
                Err(Error::Usage(_)) => {
                    let known = ".npz, .csv, .json, .vf (View3D) or a picture (.png, .exr, .tif, .jpg)";
                    return Err(Error::Usage(format!("{}: write {known}", path.display())));
                }
                _ => Format::Picture,
            },
        };
        Ok((path.clone(), format))
    };
    args.output.iter().map(format).collect()
}

/// Elements whose rows are computed; none: all.
fn selected(args: &FormFactorArgs, scene: &Scene, mesh: &Mesh) -> Result<Option<Vec<bool>>> {
    let Some(rows) = &args.rows else { return Ok(None) };
    let objects = scene.objects.len();
    let (count, what) = match (args.by_object, args.two_sided) {
        (false, _) => (mesh.len(), "elements"),
        (true, false) => (objects, "objects"),
        (true, true) => (2 * objects, "sides of objects"),
    };
    if rows.end > count {
        return Err(Error::Usage(format!(
            "--rows {}..{}: there are {count} {what}, so rows go from 0 to {count} at most",
            rows.start, rows.end
        )));
    }
    let row = |e: u32| {
        let (face, front, _) = mesh.place(e);
        match args.by_object {
            false => e as usize,
            true => scene.faces[face as usize].object as usize + if front { 0 } else { objects },
        }
    };
    Ok(Some((0..mesh.len() as u32).map(|e| rows.contains(&row(e))).collect()))
}

/// The element that `--view` names.
fn viewed(name: &str, scene: &Scene, mesh: &Mesh) -> Result<u32> {
    let object = scene.objects.iter().position(|o| o == name);
    if let (None, Ok(element)) = (object, name.parse::<u32>()) {
        if (element as usize) < mesh.len() {
            return Ok(element);
        }
        return Err(Error::Usage(format!(
            "--view {element}: there are {} elements, numbered from 0",
            mesh.len()
        )));
    }
    let Some(object) = object else {
        return Err(Error::Usage(format!(
            "--view {name}: no element or object of that name; objects are {}",
            scene.objects.join(", ")
        )));
    };
    let own: Vec<u32> = (0..mesh.len() as u32)
        .filter(|e| {
            let (face, front, _) = mesh.place(*e);
            front && scene.faces[face as usize].object as usize == object
        })
        .collect();
    let middle = own.iter().map(|e| mesh.centroid(scene, *e)).sum::<glam::DVec3>() / own.len().max(1) as f64;
    let distance = |e: &u32| mesh.centroid(scene, *e).distance_squared(middle);
    own.iter()
        .copied()
        .min_by(|a, b| distance(a).total_cmp(&distance(b)))
        .ok_or_else(|| Error::Usage(format!("--view {name}: the object has no elements")))
}

/// What the user should know of rows that do not sum to one.
fn losses(factors: &Factors, two_sided: bool) -> Vec<String> {
    let most = |objects: &[(String, f64)]| {
        let named: Vec<String> = objects
            .iter()
            .take(3)
            .map(|(name, share)| format!("\"{name}\" {:.3} %", 100.0 * share))
            .collect();
        format!("{}{}", named.join(", "), if objects.len() > 3 { ", ..." } else { "" })
    };
    let mut warnings = Vec::new();
    let (share, objects) = factors.loss(&factors.escaped);
    if share > CLOSED {
        warnings.push(format!(
            "the enclosure is open: {:.3} % of what leaves its surfaces escapes, most from {}; rows sum to 1 less that share",
            100.0 * share,
            most(&objects)
        ));
    }
    let (share, objects) = factors.loss(&factors.absorbed);
    if share > CLOSED && !two_sided {
        warnings.push(format!(
            "{:.3} % of what leaves the surfaces lands on backs of faces, most from {}; turn faces that look the wrong way, or give \
             both sides factors with --two-sided",
            100.0 * share,
            most(&objects)
        ));
    }
    warnings
}

fn metadata() -> WriteOptions {
    let text = [
        ("Software", format!("twopass {}", env!("CARGO_PKG_VERSION"))),
        ("twopass:command", command_line().join(" ")),
    ];
    WriteOptions { exposure: 0.0, metadata: text.map(|(k, v)| (k.to_string(), v)).to_vec() }
}

fn write(factors: &Factors, path: &Path, format: Format) -> Result<()> {
    let bytes = match format {
        Format::Npz => return write_whole_with(path, |file| export::write_npz(factors, file)),
        Format::Csv => export::to_csv(factors)?,
        Format::Json => export::to_json(factors)?,
        Format::View3d => export::to_view3d(factors),
        Format::Picture => return image::write(&export::heat_map(factors), path, &metadata()),
    };
    if is_stdout(path) {
        // A closed pipe is the reader's choice, but it must not look like success.
        let mut out = std::io::stdout();
        let written = out.write_all(&bytes).and_then(|()| out.flush());
        return written.map_err(|e| Error::io("standard output", e));
    }
    write_whole(path, &bytes)
}
