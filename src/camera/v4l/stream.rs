//! A stream of an open device gives one frame.
//!
//! Every shot of a series starts a stream of its own: buffers that were filled in an idle hour are old pictures,
//! and the binding's stream cannot be used again after a time-out. Live frames come from one stream that goes on; what
//! lies in its buffers from before a frame is asked for is passed over.

use std::io;
use std::time::{Duration, Instant};

use v4l::Device;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::io::mmap::Stream;
use v4l::io::traits::{CaptureStream, Stream as _};

use crate::camera::CameraError;
use crate::camera::deadline::Deadline;

/// Buffers asked for; each is a whole frame of kernel memory.
const BUFFERS: u32 = 3;
/// Damaged frames in a row before the shot fails.
const DAMAGED: u32 = 10;

/// Bytes of one frame and what the driver says of it.
pub struct Grabbed {
    /// Cut at the length that the driver gives.
    pub bytes: Vec<u8>,
    /// The driver's counter since the stream started.
    pub sequence: u32,
    /// The driver's time, s.
    pub time_s: f64,
    /// Whether that is the machine's monotonic clock.
    pub monotonic: bool,
    /// Whether it is of the exposure's beginning, not of the frame's end.
    pub stamped_at_start: bool,
    /// From one frame to the next, s; at most so much where only one came.
    pub period_s: f64,
    /// Frames that the driver counted and did not deliver.
    pub dropped: u32,
    /// Frames that came flagged as damaged, or too short, before this one.
    pub damaged: u32,
    /// Frames from before the shot that came first.
    pub stale: u32,
}

/// A stream that was started.
pub struct Running {
    stream: Stream<'static>,
    period: Period,
    /// Frames that are to be thrown away still, while exposure and white level settle.
    settle: u32,
    /// A frame has been taken: buffers may have filled since.
    taken: bool,
}

impl Running {
    /// `settle` frames will be discarded, once.
    pub fn start(device: &Device, settle: u32) -> Result<Self, CameraError> {
        let stream = Stream::with_buffers(device, Type::VideoCapture, BUFFERS);
        let stream = stream.map_err(|e| streaming(&e, "buffers"))?;
        Ok(Self { stream, period: Period::default(), settle, taken: false })
    }

    /// The first whole frame that comes from now on. After an error the stream is of no use.
    pub fn next(&mut self, shortest: usize, deadline: &Deadline) -> Result<Grabbed, CameraError> {
        first_whole(self, shortest, deadline)
    }

    /// Stopped here, since dropping a stream that cannot be stopped panics. What cannot be stopped is
    /// left to the kernel, which frees it when the camera is closed.
    pub fn stop(mut self) {
        match self.stream.stop() {
            Ok(()) => drop(self.stream),
            Err(error) if error.raw_os_error() == Some(rustix::io::Errno::NODEV.raw_os_error()) => {
                drop(self.stream);
            }
            Err(error) => {
                tracing::warn!(%error, "the video stream could not be stopped");
                std::mem::forget(self.stream);
            }
        }
    }
}

/// Discards `settle` frames, then takes the first whole one.
pub fn grab(
    device: &Device,
    settle: u32,
    shortest: usize,
    deadline: &Deadline,
) -> Result<Grabbed, CameraError> {
    let mut running = Running::start(device, settle)?;
    let result = running.next(shortest, deadline);
    running.stop();
    result
}

/// The shortest time from one of these frames to the next, s.
#[derive(Default)]
struct Period {
    last: Option<(u32, f64)>,
    shortest_s: Option<f64>,
}

impl Period {
    fn see(&mut self, sequence: u32, time_s: f64) {
        if let Some((before, at_s)) = self.last {
            let frames = sequence.wrapping_sub(before);
            let one = (time_s - at_s) / f64::from(frames.max(1));
            if frames > 0 && one > 0.0 {
                self.shortest_s = Some(self.shortest_s.map_or(one, |known| known.min(one)));
            }
        }
        self.last = Some((sequence, time_s));
    }
}

/// A buffer that is there at once was filled before it was asked for.
const AT_ONCE: Duration = Duration::from_millis(1);

fn first_whole(running: &mut Running, shortest: usize, deadline: &Deadline) -> Result<Grabbed, CameraError> {
    // An older frame was taken before the shot.
    let begun_s = crate::clock::monotonic_s();
    let Running { stream, period, settle, taken } = running;
    let (mut damaged, mut dropped, mut expected, mut stale) = (0, 0, None, 0);
    loop {
        // At least a millisecond: 0 would not wait at all.
        stream.set_timeout(deadline.remaining("a frame")?.max(Duration::from_millis(1)));
        let asked = Instant::now();
        let (bytes, meta) = stream.next().map_err(|error| match error.kind() {
            io::ErrorKind::TimedOut => deadline.timeout_error("a frame"),
            _ => streaming(&error, "a frame"),
        })?;
        dropped += expected.map_or(0, |expected| meta.sequence.wrapping_sub(expected).min(1 << 16));
        expected = Some(meta.sequence.wrapping_add(1));
        let used = bytes.get(..meta.bytesused as usize).unwrap_or(bytes);
        if meta.flags.contains(Flags::ERROR) || used.len() < shortest {
            damaged += 1;
            if damaged > DAMAGED {
                return Err(CameraError::BadFrame(format!(
                    "{damaged} frames in a row, {}",
                    fault(meta, shortest)
                )));
            }
            continue;
        }
        let time_s = meta.timestamp.sec as f64 + meta.timestamp.usec as f64 * 1e-6;
        period.see(meta.sequence, time_s);
        let monotonic = meta.flags.contains(Flags::TIMESTAMP_MONOTONIC);
        let old = if monotonic { time_s < begun_s } else { *taken && asked.elapsed() < AT_ONCE };
        // No more than there are buffers: a driver's clock may be wrong.
        if stale < BUFFERS && old {
            stale += 1;
        } else if *settle > 0 {
            *settle -= 1;
        } else {
            *taken = true;
            return Ok(Grabbed {
                bytes: used.to_vec(),
                sequence: meta.sequence,
                time_s,
                monotonic,
                stamped_at_start: (meta.flags & Flags::TSTAMP_SRC_MASK) == Flags::TSTAMP_SRC_SOE,
                // Of a stream that has just been started, a frame is no longer than that.
                period_s: period.shortest_s.unwrap_or((time_s - begun_s).max(0.0)),
                dropped,
                damaged,
                stale,
            });
        }
    }
}

fn fault(meta: &Metadata, shortest: usize) -> String {
    match meta.flags.contains(Flags::ERROR) {
        true => "marked as damaged by the driver; check cable and USB bandwidth".to_owned(),
        false => format!("the last of {} bytes where {shortest} are needed", meta.bytesused),
    }
}

/// The same of an open device: what was accepted before and is invalid now may be mended by opening anew.
fn streaming(error: &io::Error, what: &str) -> CameraError {
    match error.raw_os_error() == Some(rustix::io::Errno::INVAL.raw_os_error()) {
        true => CameraError::Gone(format!("{what}: {error}; its driver lost its buffers, it is opened anew")),
        false => sort(error, what),
    }
}

/// An error by what the caller does about it.
pub fn sort(error: &io::Error, what: &str) -> CameraError {
    use rustix::io::Errno;
    let text = format!("{what}: {error}");
    match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::BUSY) => {
            CameraError::Busy(format!("{text}; another program has the camera (see: fuser -v /dev/video*)"))
        }
        Some(Errno::NODEV | Errno::NXIO | Errno::NOENT | Errno::IO | Errno::PIPE | Errno::PROTO) => {
            CameraError::Gone(format!("{text}; unplugged, or its power or cable is bad"))
        }
        Some(Errno::ACCESS | Errno::PERM) => {
            CameraError::Refused(format!("{text}; add the user that runs wingd to the group video"))
        }
        _ => CameraError::Refused(text),
    }
}
