//! Images on disk, through the C shim around OpenImageIO.
//!
//! OpenImageIO encodes to memory and this module writes the bytes: every failure of the disk is
//! seen, and a file appears under its name only when it is whole.
//!
//! The program holds the shim as a shared library and loads it, and OpenImageIO with it, when it is first
//! needed: who solves or asks for form factors does not wait for it.

#![allow(unsafe_code)]

use super::Image;
use crate::color::{srgb_decode, srgb_encode};
use crate::error::{Error, Result};
use crate::output;
use std::ffi::{CStr, CString, c_char};
use std::fs::File;
use std::io::Write;
use std::os::fd::AsRawFd;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;
use std::ptr::{self, NonNull};
use std::sync::OnceLock;

/// The shim as build.rs linked it.
const SHIM: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/twopass_oiio_shim.so"));
/// The version of OpenImageIO whose headers the shim was made from.
const BUILT: &str = env!("TWOPASS_OIIO_BUILT");

static LOADED: OnceLock<std::result::Result<sys::Shim, String>> = OnceLock::new();

mod sys {
    //! What bindgen made of the shim's header.
    #![allow(
        non_camel_case_types,
        non_snake_case,
        non_upper_case_globals,
        missing_docs,
        dead_code,
        unsafe_op_in_unsafe_fn,
        clippy::all
    )]
    include!(concat!(env!("OUT_DIR"), "/oiio.rs"));
}

/// How an image is written.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WriteOptions {
    /// Exposure in EV of 8-bit formats: radiance is multiplied by 2 to this power before encoding.
    pub exposure: f64,
    /// Text attributes by name, kept by the formats that can.
    pub metadata: Vec<(String, String)>,
}

/// A file format that this program writes.
struct Format {
    extensions: &'static [&'static str],
    plugin: &'static str,
    /// sRGB after exposure in 8 bits; linear float otherwise.
    eight_bit: bool,
    compression: Option<&'static str>,
    /// Most pixels across or down, where that is less than any image that is rendered.
    most: Option<usize>,
}

/// Larger images make libjpeg end the process (its JPEG_MAX_DIMENSION, "a tad under 64K to prevent overflows").
const MOST_JPEG: usize = 65_500;

const FORMATS: [Format; 5] = [
    // The mantissas of rendered radiance are noise: "zip" saves 6 % more than "rle", for eight times its time (100 ms and
    // 12 ms for 512 x 512 pixels), and would keep many frames waiting.
    Format {
        extensions: &["exr"],
        plugin: "openexr",
        eight_bit: false,
        compression: Some("rle"),
        most: None,
    },
    Format {
        extensions: &["tif", "tiff"],
        plugin: "tiff",
        eight_bit: false,
        compression: Some("zip"),
        most: None,
    },
    Format { extensions: &["hdr"], plugin: "hdr", eight_bit: false, compression: None, most: None },
    Format { extensions: &["png"], plugin: "png", eight_bit: true, compression: None, most: None },
    Format {
        extensions: &["jpg", "jpeg"],
        plugin: "jpeg",
        eight_bit: true,
        compression: Some("jpeg:95"),
        most: Some(MOST_JPEG),
    },
];

/// The format that a file's extension names.
fn format_of(path: &Path) -> Result<&'static Format> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    FORMATS.iter().find(|f| f.extensions.contains(&extension.as_str())).ok_or_else(|| {
        let known: Vec<String> = FORMATS.iter().flat_map(|f| f.extensions).map(|e| format!(".{e}")).collect();
        Error::Usage(format!(
            "{}: the image format is unknown; use one of {}",
            path.display(),
            known.join(", ")
        ))
    })
}

fn image_error(path: &Path, message: impl Into<String>) -> Error {
    Error::Image { path: path.into(), message: message.into() }
}

/// Loads OpenImageIO where that has not happened yet.
///
/// Takes a third of a second the first time. An error says what the system's loader says.
pub fn ready() -> Result<()> {
    shim().map(|_| ())
}

/// [`ready`] on a thread of its own, for who has other work meanwhile. Dropping it waits: a program that ends while libraries
/// are initialised runs their destructors too early.
#[must_use]
pub fn prepare() -> Preparing {
    Preparing(Some(std::thread::spawn(|| drop(ready()))))
}

/// OpenImageIO on its way.
pub struct Preparing(Option<std::thread::JoinHandle<()>>);

impl Drop for Preparing {
    fn drop(&mut self) {
        // A loader that panicked is told of by the next `ready`.
        let _ = self.0.take().map(std::thread::JoinHandle::join);
    }
}

fn shim() -> Result<&'static sys::Shim> {
    let loaded = LOADED.get_or_init(|| load().map_err(|e| e.to_string()));
    loaded.as_ref().map_err(|e| Error::scene("OpenImageIO", format!("it cannot be loaded: {e}")))
}

/// Loads the shim from memory that has a file's name: no file of its own could be lost or replaced. Where there is no /proc,
/// it takes a temporary file.
fn load() -> std::result::Result<sys::Shim, Box<dyn std::error::Error>> {
    let memory = rustix::fs::memfd_create("twopass_oiio_shim", rustix::fs::MemfdFlags::CLOEXEC)?;
    let mut file = File::from(memory);
    file.write_all(SHIM)?;
    let name = format!("/proc/self/fd/{}", file.as_raw_fd());
    if Path::new(&name).exists() {
        return open(Path::new(&name));
    }
    let mut file = tempfile::NamedTempFile::new()?;
    file.write_all(SHIM)?;
    open(file.path())
}

fn open(path: &Path) -> std::result::Result<sys::Shim, Box<dyn std::error::Error>> {
    // SAFETY: the file holds the library that build.rs linked from the shim whose header the bindings were made from.
    // The initialisers that run are OpenImageIO's and those of its dependencies, which may run on any thread.
    Ok(unsafe { sys::Shim::new(path)? })
}

/// The version of OpenImageIO that runs, for example `2.5.18`; where none is loaded, the one that this program was built for.
pub fn version() -> String {
    let Some(Ok(shim)) = LOADED.get() else { return BUILT.into() };
    let mut text: [c_char; 32] = [0; 32];
    // SAFETY: the shim writes at most the given size, with its terminator.
    unsafe { shim.twopass_oiio_version(text.as_mut_ptr(), text.len()) };
    message(&text)
}

/// Whether an image can be written at `path`: a known format in a folder that takes files.
///
/// For a command to refuse before it renders; what changes meanwhile is found by [`write()`].
pub fn supported(path: &Path) -> Result<()> {
    format_of(path)?;
    output::check(path)
}

/// Whether the format of `path` can hold an image of so many pixels across and down: JPEG ends below 65536.
///
/// # Errors
/// It cannot, or it is unknown; says what to do.
pub fn fits(path: &Path, size: [usize; 2]) -> Result<()> {
    within(path, format_of(path)?, size)
}

fn within(path: &Path, format: &Format, [width, height]: [usize; 2]) -> Result<()> {
    let Some(most) = format.most.filter(|most| width.max(height) > *most) else { return Ok(()) };
    Err(Error::Usage(format!(
        "{}: {} holds at most {most} pixels across and down, not {width} x {height}; write another format, such as .png or .exr",
        path.display(),
        format.plugin.to_uppercase()
    )))
}

/// Whether [`WriteOptions::exposure`] changes what is written at `path`: an 8-bit format.
pub fn has_exposure(path: &Path) -> bool {
    format_of(path).is_ok_and(|format| format.eight_bit)
}

/// Writes an image in the format of `path`'s extension.
///
/// `exr`, `tif`, `tiff` and `hdr` hold linear radiance, `png`, `jpg` and `jpeg` 8-bit sRGB after
/// exposure. The file is written beside its name and renamed: it is whole or does not exist, and a
/// file that was there before stays until then.
pub fn write(image: &Image, path: &Path, options: &WriteOptions) -> Result<()> {
    let format = format_of(path)?;
    let bytes = encode(image, path, format, options)?;
    output::write_whole(path, bytes.as_slice())
}

/// Reads an image that OpenImageIO can read, as linear RGB.
///
/// sRGB samples are decoded, mantissas of Radiance's format are read as the middle of what they stand for, a single grey channel is
/// spread over the three, and what follows the third channel is left out.
pub fn read(path: &Path) -> Result<Image> {
    // A file that is missing or closed to us says so better by itself.
    File::open(path).map_err(|e| Error::io(path, e))?;
    let (reader, header) = Reader::open(path)?;
    let size = |n: i32| usize::try_from(n).ok().filter(|&n| n > 0);
    let (Some(width), Some(height), Some(channels)) =
        (size(header.width), size(header.height), size(header.channels))
    else {
        return Err(image_error(path, "holds no pixels"));
    };
    let too_large = || image_error(path, format!("is too large: {width} x {height} x {channels}"));
    let count = width.checked_mul(height).and_then(|n| n.checked_mul(channels)).ok_or_else(too_large)?;
    let mut raw: Vec<f32> = Vec::new();
    raw.try_reserve_exact(count).map_err(|_| too_large())?;
    raw.resize(count, 0.0);
    reader.read(path, &mut raw)?;

    if header.rgbe != 0 {
        raw.chunks_exact_mut(channels).for_each(to_middle);
    }
    let mut image = Image::new(width, height);
    for (to, from) in image.data.chunks_exact_mut(3).zip(raw.chunks_exact(channels)) {
        for (k, value) in to.iter_mut().enumerate() {
            let sample = if channels < 3 { from[0] } else { from[k] };
            *value = if header.srgb != 0 { srgb_decode(f64::from(sample)) as f32 } else { sample };
        }
    }
    Ok(image)
}

/// Moves a pixel whose channels share an exponent from the lower ends of its steps to their middle: mantissas are written without what
/// comes after their 8 bits, so Radiance reads m as m + 1/2, and OpenImageIO as m. A channel without light stays dark.
fn to_middle(pixel: &mut [f32]) {
    let largest = pixel.iter().copied().fold(0.0, f32::max);
    if largest.is_normal() {
        // The largest mantissa has its highest bit set.
        let step = f32::from_bits(largest.to_bits() & (0xff << 23)) / 128.0;
        pixel.iter_mut().filter(|v| **v > 0.0).for_each(|v| *v += 0.5 * step);
    }
}

/// Bytes that the shim owns.
struct Bytes(&'static sys::Shim, NonNull<sys::TwopassBytes>);

impl Bytes {
    fn as_slice(&self) -> &[u8] {
        // SAFETY: the handle is live for as long as `self`, and its bytes do not change.
        unsafe {
            let (data, size) =
                (self.0.twopass_bytes_data(self.1.as_ptr()), self.0.twopass_bytes_size(self.1.as_ptr()));
            if data.is_null() { &[] } else { std::slice::from_raw_parts(data, size) }
        }
    }
}

impl Drop for Bytes {
    fn drop(&mut self) {
        // SAFETY: the handle came from `twopass_encode` and is freed once.
        unsafe { self.0.twopass_bytes_free(self.1.as_ptr()) }
    }
}

/// Pixels as the shim takes them, row by row from the top.
enum Samples<'a> {
    Bytes(&'a [u8]),
    Floats(&'a [f32]),
}

/// sRGB bytes of an image as 8-bit formats hold them, after exposure \[EV\].
pub fn srgb_bytes(image: &Image, exposure: f64) -> Vec<u8> {
    let scale = exposure.exp2();
    image.data.iter().map(|&v| (srgb_encode(f64::from(v) * scale) * 255.0).round() as u8).collect()
}

/// A PNG file in memory, from `3 * width * height` bytes of sRGB.
pub fn png(width: usize, height: usize, rgb: &[u8]) -> Result<Vec<u8>> {
    let path = Path::new("picture.png");
    let bytes = encode_samples([width, height, 3], &Samples::Bytes(rgb), path, format_of(path)?, &[])?;
    Ok(bytes.as_slice().to_vec())
}

fn encode(image: &Image, path: &Path, format: &Format, options: &WriteOptions) -> Result<Bytes> {
    let eight_bit = if format.eight_bit { srgb_bytes(image, options.exposure) } else { Vec::new() };
    let samples = if format.eight_bit { Samples::Bytes(&eight_bit) } else { Samples::Floats(&image.data) };
    encode_samples([image.width, image.height, image.channels], &samples, path, format, &options.metadata)
}

/// Encodes `[width, height, channels]` samples.
fn encode_samples(
    shape: [usize; 3],
    samples: &Samples,
    path: &Path,
    format: &Format,
    metadata: &[(String, String)],
) -> Result<Bytes> {
    within(path, format, [shape[0], shape[1]])?;
    let size = |n: usize| i32::try_from(n).ok().filter(|&n| n > 0);
    let [Some(width), Some(height), Some(channels)] = shape.map(size) else {
        return Err(image_error(path, format!("cannot hold {} x {} pixels", shape[0], shape[1])));
    };
    let (count, eight_bit, pixels) = match samples {
        Samples::Bytes(bytes) => (bytes.len(), true, bytes.as_ptr().cast()),
        Samples::Floats(floats) => (floats.len(), false, floats.as_ptr().cast()),
    };
    if shape[0].checked_mul(shape[1]).and_then(|n| n.checked_mul(shape[2])) != Some(count) {
        return Err(image_error(path, "the image's samples do not match its size"));
    }

    let text = |s: &str| {
        CString::new(s).map_err(|_| image_error(path, format!("metadata holds a null character: {s:?}")))
    };
    let plugin = text(format.plugin)?;
    let compression = format.compression.map(text).transpose()?;
    let metadata: Vec<(CString, CString)> =
        metadata.iter().map(|(name, value)| Ok((text(name)?, text(value)?))).collect::<Result<_>>()?;
    let attributes: Vec<sys::TwopassAttribute> = metadata
        .iter()
        .map(|(name, value)| sys::TwopassAttribute { name: name.as_ptr(), value: value.as_ptr() })
        .collect();

    let what = sys::TwopassEncode {
        format: plugin.as_ptr(),
        width,
        height,
        channels,
        eight_bit: i32::from(eight_bit),
        pixels,
        compression: compression.as_ref().map_or(ptr::null(), |c| c.as_ptr()),
        attributes: attributes.as_ptr(),
        attribute_count: attributes.len(),
    };
    let shim = shim()?;
    let mut error: [c_char; 512] = [0; 512];
    // SAFETY: the strings, attributes and pixels that `what` points to outlive the call, the pixels
    // number width * height * channels of the stated type, and the buffer has the stated size.
    let bytes = unsafe { shim.twopass_encode(&what, error.as_mut_ptr(), error.len()) };
    NonNull::new(bytes).map(|bytes| Bytes(shim, bytes)).ok_or_else(|| image_error(path, message(&error)))
}

/// An open image file.
struct Reader(&'static sys::Shim, NonNull<sys::TwopassReader>);

impl Reader {
    fn open(path: &Path) -> Result<(Reader, sys::TwopassHeader)> {
        let name = CString::new(path.as_os_str().as_bytes())
            .map_err(|_| image_error(path, "the name holds a null character"))?;
        let shim = shim()?;
        let mut header = sys::TwopassHeader::default();
        let mut error: [c_char; 512] = [0; 512];
        // SAFETY: the name is terminated, and name, header and buffer outlive the call.
        let reader =
            unsafe { shim.twopass_reader_open(name.as_ptr(), &mut header, error.as_mut_ptr(), error.len()) };
        match NonNull::new(reader) {
            Some(reader) => Ok((Reader(shim, reader), header)),
            None => Err(image_error(path, message(&error))),
        }
    }

    /// Fills `pixels`, which must be as long as the header says.
    fn read(&self, path: &Path, pixels: &mut [f32]) -> Result<()> {
        let mut error: [c_char; 512] = [0; 512];
        // SAFETY: the handle is live, and the only caller sized `pixels` by the header.
        let failed = unsafe {
            self.0.twopass_reader_read(self.1.as_ptr(), pixels.as_mut_ptr(), error.as_mut_ptr(), error.len())
        };
        if failed == 0 { Ok(()) } else { Err(image_error(path, message(&error))) }
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        // SAFETY: the handle came from `twopass_reader_open` and is freed once.
        unsafe { self.0.twopass_reader_free(self.1.as_ptr()) }
    }
}

/// The terminated text in a buffer that the shim wrote, in one line.
fn message(buffer: &[c_char]) -> String {
    let bytes: Vec<u8> = buffer.iter().map(|&c| c as u8).collect();
    let text = CStr::from_bytes_until_nul(&bytes).unwrap_or_default().to_string_lossy();
    text.trim().replace('\n', "; ")
}

#[cfg(test)]
mod tests;
