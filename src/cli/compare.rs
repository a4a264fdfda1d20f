//! `twopass compare`.

use super::args::CompareArgs;
use super::{check_outputs, print};
use crate::image::{
    self, Difference, Errors, Image, Options, error_within, mean_image, read_any, read_mask_npy,
    signed_difference,
};
use crate::output::{place, write_whole};
use crate::{Error, Result};
use serde_json::json;
use std::path::Path;

/// Share of the pixels that stay within the colours of `--diff` where nobody says otherwise.
const WITHIN: f64 = 0.99;

pub fn run(args: &CompareArgs) -> Result<()> {
    if !args.exposure.is_finite() {
        return Err(Error::Usage("--exposure must be a finite number".into()));
    }
    if let Some(diff) = &args.diff {
        if diff.extension().is_none_or(|e| !e.eq_ignore_ascii_case("png")) {
            return Err(Error::Usage(format!(
                "{}: the picture of --diff is written as .png",
                diff.display()
            )));
        }
        let inputs =
            [Some(&args.image), Some(&args.reference), args.reference_b.as_ref(), args.mask.as_ref()];
        check_outputs(inputs.into_iter().flatten(), [diff])?;
    }
    if let Some(b) = args.reference_b.as_ref().filter(|b| place(b) == place(&args.reference)) {
        return Err(Error::Usage(format!(
            "{}: is given as both references, whose noise must be independent; leave out the second",
            b.display()
        )));
    }
    let x = read_any(&args.image)?;
    let a = read_any(&args.reference)?;
    let b = args.reference_b.as_deref().map(read_any).transpose()?;
    let mask = args.mask.as_deref().map(|path| read_mask(path, &x)).transpose()?;
    let b_path = args.reference_b.as_ref();
    for (path, image) in [(&args.image, &x), (&args.reference, &a)].into_iter().chain(b_path.zip(b.as_ref()))
    {
        refuse_without_numbers(path, image, mask.as_deref())?;
    }
    let options = Options { mask: mask.as_deref(), exposure: args.exposure };
    let difference = Difference::new(&x, &a, b.as_ref(), &options)?;
    let scale =
        args.diff.as_deref().map(|path| picture(args, path, &x, &a, b.as_ref(), &options, &difference));
    let scale = scale.transpose()?;
    if args.json {
        let mut value = json!({
            "image": args.image.display().to_string(),
            "reference": args.reference.display().to_string(),
            "reference_b": args.reference_b.as_ref().map(|p| p.display().to_string()),
            "mask": args.mask.as_ref().map(|p| p.display().to_string()),
            "size": [x.width, x.height],
            "exposure": args.exposure,
            "diff_scale": scale,
        });
        let found =
            serde_json::to_value(&difference).map_err(|e| Error::parse(&args.image, None, e.to_string()))?;
        if let (Some(all), serde_json::Value::Object(found)) = (value.as_object_mut(), found) {
            all.extend(found);
        }
        return print(&value.to_string());
    }
    // A copy of the first reference has its noise too.
    let independent = b.as_ref().map(|b| *b != a);
    print(&text(args, &x, &difference, independent, scale))
}

/// Refuses an image none of whose pixels that count is finite: what is wrong is the file, not the comparison.
fn refuse_without_numbers(path: &Path, image: &Image, mask: Option<&[bool]>) -> Result<()> {
    let mut pixels =
        (0..).zip(image.data.chunks_exact(3)).filter(|(i, _)| mask.is_none_or(|m| m.get(*i) == Some(&true)));
    let mut some = false;
    let finite = pixels.any(|(_, p)| {
        some = true;
        p.iter().all(|v| v.is_finite())
    });
    if finite || !some {
        return Ok(());
    }
    let message = "no pixel of it is finite (NaN or infinite throughout): there is nothing to compare";
    Err(Error::Image { path: path.into(), message: message.into() })
}

fn read_mask(path: &Path, x: &Image) -> Result<Vec<bool>> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("npy")) {
        return read_mask_npy(path, x.width, x.height);
    }
    let mask = read_any(path)?;
    if (mask.width, mask.height) != (x.width, x.height) {
        return Err(Error::Usage(format!(
            "the mask {} has {} x {} pixels, but the image has {} x {}",
            path.display(),
            mask.width,
            mask.height,
            x.width,
            x.height
        )));
    }
    Ok(mask.data.chunks_exact(3).map(|p| p.iter().any(|v| *v > 0.0)).collect())
}

/// Writes the false colours; returns the error at their ends over the mean of the reference.
fn picture(
    args: &CompareArgs,
    path: &Path,
    x: &Image,
    a: &Image,
    b: Option<&Image>,
    options: &Options,
    difference: &Difference,
) -> Result<f64> {
    let reference = mean_image(a, b);
    let mean = difference.all.reference_mean;
    let found = || error_within(x, &reference, options.mask, WITHIN) / mean;
    let scale = args.diff_scale.unwrap_or_else(found);
    // Equal images: any scale shows that.
    let scale = if scale > 0.0 { scale } else { 1.0 };
    let bytes = signed_difference(x, &reference, options.mask, scale * mean);
    write_whole(path, &image::png(x.width, x.height, &bytes)?)?;
    Ok(scale)
}

/// `independent`: whether the two references, where there are two, differ.
fn text(
    args: &CompareArgs,
    x: &Image,
    d: &Difference,
    independent: Option<bool>,
    scale: Option<f64>,
) -> String {
    let all = &d.all;
    let mut lines =
        vec![format!("{} x {} pixels, {} count, {} masked", x.width, x.height, d.pixels, d.masked)];
    for bad in &d.not_finite {
        lines.push(format!(
            "warning: {} pixels of the {} are not finite, the first at ({}, {}); they are left out",
            bad.pixels, bad.image, bad.first[0], bad.first[1]
        ));
    }
    let noise = match independent {
        Some(true) => "free of the references' noise",
        Some(false) => "the references are equal: their noise, if any, counts as error",
        None => "the reference's noise counts as error; give a second one to be free of it",
    };
    lines.push(format!(
        "relative RMSE        {:.4} % (standard error +{:.4} %; {noise})",
        100.0 * all.relative_rmse,
        100.0 * all.standard_error
    ));
    lines.push(format!("bias                 {:+.4} %", 100.0 * all.bias));
    lines.push(format!("mean absolute error  {:.4} %", 100.0 * all.mean_absolute_error));
    let m = &d.maximum;
    let channel = ["red", "green", "blue"][m.channel];
    lines.push(format!(
        "largest error        {:+.4} % at ({}, {}), {channel}",
        100.0 * m.error,
        m.pixel[0],
        m.pixel[1]
    ));
    lines.push(format!("mean FLIP            {:.4} (0 equal, 1 as unlike as can be)", d.flip));
    lines.push(format!(
        "reference mean       {:.6} W m^-2 sr^-1; errors are relative to it",
        all.reference_mean
    ));
    for (name, errors) in ["red", "green", "blue"].iter().zip(&d.channels) {
        lines.push(channel_line(name, errors.as_ref()));
    }
    if let (Some(path), Some(scale)) = (&args.diff, scale) {
        lines.push(format!(
            "{}: dark blue -{:.4} % of the mean (too dark), white 0, dark red +{:.4} % (too bright), grey masked",
            path.display(),
            100.0 * scale,
            100.0 * scale
        ));
    }
    lines.join("\n")
}

fn channel_line(name: &str, errors: Option<&Errors>) -> String {
    match errors {
        Some(e) => format!(
            "{name:20} relative RMSE {:.4} %, bias {:+.4} %, mean absolute error {:.4} %",
            100.0 * e.relative_rmse,
            100.0 * e.bias,
            100.0 * e.mean_absolute_error
        ),
        None => format!("{name:20} the reference is black here: no relative error"),
    }
}
