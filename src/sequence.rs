//! Many frames, one after the other: a thread of its own encodes and writes while the next ones are traced.

use crate::image::Image;
use crate::render::Traced;
use crate::{Error, Result};
use serde::Serialize;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Instant;

/// Pictures that wait for the encoder, at most: with the one that it has and the one being traced, four are in memory.
const QUEUE: usize = 2;

/// What one frame took.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FrameTime {
    /// Its number.
    pub frame: u32,
    /// Wall time of tracing and shading \[s\].
    pub trace_seconds: f64,
    /// Rays cast.
    pub rays: u64,
    /// [`Traced::dropped`].
    pub dropped: f64,
    /// Wall time of encoding and writing \[s\], while other frames were traced.
    pub write_seconds: f64,
}

/// Traces frames in their order and writes each as soon as it is there. `trace` gives a picture and what it took;
/// `write` runs on a thread of its own.
///
/// # Errors
/// The first that `write` returns. Nothing is traced any more then, and the frames written before stay.
pub fn render_frames(
    frames: impl Iterator<Item = u32>,
    mut trace: impl FnMut(u32) -> (Image, Traced),
    write: impl Fn(u32, &Image) -> Result<()> + Send,
) -> Result<Vec<FrameTime>> {
    thread::scope(|scope| {
        let (sender, receiver) = sync_channel::<(FrameTime, Image)>(QUEUE);
        let encoder = scope.spawn(move || {
            let mut written = Vec::new();
            for (mut time, image) in receiver {
                let start = Instant::now();
                write(time.frame, &image)?;
                time.write_seconds = start.elapsed().as_secs_f64();
                written.push(time);
            }
            Ok::<_, Error>(written)
        });
        for frame in frames {
            let start = Instant::now();
            let (image, Traced { rays, dropped, .. }) = trace(frame);
            let trace_seconds = start.elapsed().as_secs_f64();
            // The encoder hangs up where it failed, and says why below.
            let time = FrameTime { frame, trace_seconds, rays, dropped, write_seconds: 0.0 };
            if sender.send((time, image)).is_err() {
                break;
            }
        }
        drop(sender);
        encoder.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    #[test]
    fn frames_are_written_in_order() {
        let seen = Mutex::new(Vec::new());
        let trace =
            |frame| (Image::new(1, frame as usize), Traced { rays: u64::from(frame), ..Traced::default() });
        let times = render_frames(3..=9, trace, |frame, image| {
            seen.lock().unwrap().push((frame, image.height as u32));
            Ok(())
        });
        assert_eq!(seen.into_inner().unwrap(), (3..=9).map(|k| (k, k)).collect::<Vec<_>>());
        assert_eq!(times.unwrap().iter().map(|t| t.rays).collect::<Vec<_>>(), (3..=9).collect::<Vec<_>>());
    }

    /// Memory is bounded, and a failure ends the work: four pictures at most were traced after the one that failed.
    #[test]
    fn a_failure_ends_the_work() {
        let mut traced = 0;
        let trace = |_| {
            traced += 1;
            (Image::new(1, 1), Traced::default())
        };
        let write = |frame, _: &Image| match frame {
            2 => Err(Error::Usage("the disk is full".into())),
            _ => Ok(()),
        };
        let error = render_frames(0..1000, trace, write).unwrap_err();
        assert_eq!(error.to_string(), "the disk is full");
        assert!(traced <= 3 + QUEUE + 2, "{traced}");
    }
}
