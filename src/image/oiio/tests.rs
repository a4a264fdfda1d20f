use super::*;
use crate::image::read_exr;
use std::fs;

fn gradient(width: usize, height: usize) -> Image {
    let mut image = Image::new(width, height);
    for y in 0..height {
        for x in 0..width {
            // Values that no 16-bit or 8-bit format holds, negative and large ones among them.
            let v = (x + y * width) as f32;
            image.set(x, y, [0.1 + v, -1.0 / (v + 3.0), 1e5 * v]);
        }
    }
    image
}

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn another_reader_finds_the_same_floats_in_exr() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let image = gradient(33, 17);
    let options = WriteOptions { exposure: 3.0, metadata: vec![] };
    write(&image, &path, &options).unwrap();
    assert_eq!(read_exr(&path).unwrap(), image);
    assert_eq!(files(folder.path()), ["a.exr"]);
}

#[test]
fn exr_keeps_metadata() {
    use exr::prelude::*;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let metadata = vec![("Software".into(), "twopass 1.2".into()), ("twopass:seed".into(), "42".into())];
    write(&gradient(4, 4), &path, &WriteOptions { exposure: 0.0, metadata }).unwrap();
    let meta = MetaData::read_from_file(&path, false).unwrap();
    let attributes = &meta.headers[0].own_attributes.other;
    for (name, value) in [("Software", "twopass 1.2"), ("twopass:seed", "42")] {
        let found = attributes.iter().find(|(key, _)| **key == *name).map(|(_, value)| value);
        assert_eq!(found, Some(&AttributeValue::Text(value.into())), "{name} in {attributes:?}");
    }
}

#[test]
fn float_formats_return_what_they_were_given() {
    let folder = tempfile::tempdir().unwrap();
    let image = gradient(19, 7);
    for name in ["a.exr", "a.tif", "A.TIFF"] {
        let path = folder.path().join(name);
        write(&image, &path, &WriteOptions::default()).unwrap();
        assert_eq!(read(&path).unwrap(), image, "{name}");
    }
    // Eight bits of mantissa, shared by the channels of a pixel; no negative values.
    let path = folder.path().join("a.hdr");
    let mut image = gradient(64, 64);
    image.data.iter_mut().for_each(|v| *v = v.abs());
    write(&image, &path, &WriteOptions::default()).unwrap();
    let back = read(&path).unwrap();
    for (a, b) in image.data.chunks(3).zip(back.data.chunks(3)) {
        let largest = a.iter().copied().fold(0.0, f32::max);
        let within =
            |(a, b): (&f32, &f32)| (a - b).abs() <= largest / 256.0 || (*b == 0.0 && *a < largest / 128.0);
        assert!(a.iter().zip(b).all(within), "{a:?} {b:?}");
    }
    // No darker than it was: of 12,288 errors, uniform within steps of less than a hundredth, the mean is within 5e-5.
    let sum = |image: &Image| image.data.iter().map(|v| f64::from(*v)).sum::<f64>();
    let off = sum(&back) / sum(&image) - 1.0;
    assert!(off.abs() < 2e-4, "{off}");
}

#[test]
fn png_holds_known_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let mut image = Image::new(2, 1);
    // Linear 0.5 is 188 in sRGB; one stop up it is 1.
    image.set(0, 0, [0.5, 0.25, 0.0]);
    image.set(1, 0, [-1.0, f32::NAN, 100.0]);
    for (exposure, expected) in [(0.0, [188, 137, 0, 0, 0, 255]), (1.0, [255, 188, 0, 0, 0, 255])] {
        write(&image, &path, &WriteOptions { exposure, metadata: vec![] }).unwrap();
        let back = read(&path).unwrap();
        let bytes: Vec<u8> =
            back.data.iter().map(|&v| (srgb_encode(f64::from(v)) * 255.0).round() as u8).collect();
        assert_eq!(bytes, expected);
        let file = fs::read(&path).unwrap();
        assert_eq!(file[..8], *b"\x89PNG\r\n\x1a\n");
        // IHDR: 2 x 1, 8 bits, colour type 2 (RGB).
        assert_eq!(file[16..26], [0, 0, 0, 2, 0, 0, 0, 1, 8, 2]);
    }
}

#[test]
fn jpeg_is_close() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jpg");
    let mut image = Image::new(16, 16);
    image.data.fill(0.3);
    write(&image, &path, &WriteOptions::default()).unwrap();
    assert!(read(&path).unwrap().data.iter().all(|v| (v - 0.3).abs() < 0.01));
}

#[test]
fn failure_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let image = gradient(4, 4);

    let missing = folder.path().join("none/a.exr");
    let error = write(&image, &missing, &WriteOptions::default()).unwrap_err();
    assert!(matches!(&error, Error::Io { path, .. } if *path == missing), "{error}");

    // A folder in the way: the rename fails after the temporary was written.
    let in_the_way = folder.path().join("b.png");
    fs::create_dir(&in_the_way).unwrap();
    fs::write(in_the_way.join("x"), "").unwrap();
    assert!(write(&image, &in_the_way, &WriteOptions::default()).is_err());

    let mut broken = image.clone();
    broken.data.pop();
    let error = write(&broken, &folder.path().join("c.exr"), &WriteOptions::default()).unwrap_err();
    assert!(error.to_string().contains("do not match"), "{error}");
    assert!(write(&Image::new(0, 4), &folder.path().join("d.exr"), &WriteOptions::default()).is_err());
    let nul = WriteOptions { exposure: 0.0, metadata: vec![("a\0b".into(), String::new())] };
    assert!(write(&image, &folder.path().join("e.exr"), &nul).is_err());
    assert_eq!(files(folder.path()), ["b.png"]);
}

#[test]
fn a_failed_write_keeps_the_old_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write(&gradient(4, 4), &path, &WriteOptions::default()).unwrap();
    let before = fs::read(&path).unwrap();
    assert!(write(&Image::new(0, 0), &path, &WriteOptions::default()).is_err());
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn refused_before_rendering() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["a.exr", "a.PNG", "a.tiff", "a.hdr", "a.jpeg"] {
        supported(&folder.path().join(name)).unwrap();
    }
    assert!(files(folder.path()).is_empty());
    for name in ["a.bmp", "a", "exr"] {
        let error = supported(&folder.path().join(name)).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(".exr, .tif, .tiff, .hdr, .png, .jpg, .jpeg"), "{error}");
    }
    let error = supported(&folder.path().join("none/a.exr")).unwrap_err();
    assert!(error.to_string().contains("does not exist"), "{error}");
    // No file can be made there, not even by root; a bare root directory may lack it.
    if Path::new("/proc/self").exists() {
        let error = supported(Path::new("/proc/a.exr")).unwrap_err();
        assert!(error.to_string().contains("cannot be written to"), "{error}");
    }
}

#[test]
fn unreadable_files_are_errors() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(read(&folder.path().join("none.png")), Err(Error::Io { .. })));
    let whole = folder.path().join("whole.exr");
    write(&gradient(64, 64), &whole, &WriteOptions::default()).unwrap();
    let bytes = fs::read(&whole).unwrap();
    for (name, content) in [
        ("text.png", &b"not an image"[..]),
        ("empty.exr", &b""[..]),
        ("header.exr", &bytes[..200]),
        ("half.exr", &bytes[..bytes.len() / 2]),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        let error = read(&path).unwrap_err();
        assert!(matches!(&error, Error::Image { path: p, message } if *p == path && !message.is_empty()));
    }
}

#[test]
fn the_version_that_runs() {
    println!("OpenImageIO {}", version());
    assert_eq!(version().split('.').count(), 3);
}
