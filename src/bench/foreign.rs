//! The references, against another renderer's images of the same scenes.

use super::Context;
use super::reference::reference;
use crate::emitters::Emitters;
use crate::image::{Image, read_exr, read_mask_npy, relative_rmse_of_halves};
use crate::report::record::{Subject, Unit};
use crate::scene::load;
use crate::visibility::Visibility;
use crate::{Error, Result};
use std::path::Path;

/// The path tracer against another renderer's images of known scenes.
pub(super) fn references(context: &Context) -> Result<Subject> {
    let mut subject = Subject::new(
        "references",
        "The references themselves, against another renderer",
        "References made by the program under test could share its mistakes. Here its path tracer is set against images of the same \
         scenes by another renderer (Mitsuba 3), both as two independent halves, so that the noise of neither counts: what is left is \
         the difference of what the two converge to.",
    );
    let Some(folder) = &context.settings.foreign else {
        subject
            .notes
            .push("skipped: the other renderer's images are not there (--foreign names their folder)".into());
        return Ok(subject);
    };
    let names: &[&str] = context.choose(
        &["ours/cornell_diffuse"],
        &["ours/cornell_diffuse", "ours/cornell_glossy", "ours/cornell_mirror", "mcguire/original"],
    );
    let spp = context.choose(16, 256);
    for name in names {
        let file = |end: &str| folder.join(format!("{name}{end}"));
        if !file("_A.exr").is_file() {
            subject.notes.push(format!("skipped: {name} is not there"));
            continue;
        }
        compare(context, &mut subject, name, &file, spp)?;
    }
    Ok(subject)
}

fn compare(
    context: &Context,
    subject: &mut Subject,
    name: &str,
    file: &dyn Fn(&str) -> std::path::PathBuf,
    spp: u32,
) -> Result<()> {
    let scene = load(&file(".toml"))?;
    let camera = scene.camera(None)?;
    let visibility = Visibility::new(context.device, &scene)?;
    let emitters = Emitters::new(&visibility);
    let own = reference(context, &visibility, &emitters, camera, spp)?;
    let half = |path: &Path| -> Result<Image> {
        let image = read_exr(path)?;
        if [image.width as u32, image.height as u32] != camera.size {
            return Err(Error::Image { path: path.into(), message: "is not of the camera's size".into() });
        }
        Ok(image)
    };
    let (a, b) = (half(&file("_A.exr"))?, half(&file("_B.exr"))?);
    let mask = read_mask_npy(&file("_mask.npy"), a.width, a.height)?;
    let c = relative_rmse_of_halves([&own.halves[0], &own.halves[1]], [&a, &b], Some(&mask))?;
    let point = subject.series(name, "paths a pixel in a half").at(f64::from(spp));
    point.push("difference (relative RMS)", Unit::Share, c.relative_rmse);
    point.push("standard error", Unit::Share, c.standard_error);
    point.push("difference of the means", Unit::Share, c.mean_bias);
    point.push("noise of ours", Unit::Share, own.standard_error);
    point.unresolved = c.relative_mse <= 0.0;
    Ok(())
}
