//! Streams of an open device.
//!
//! Every shot of a series starts a stream of its own: buffers filled during a pause hold old images, and the binding's
//! stream cannot be used again after a timeout. Live frames come from one continuous stream; buffers filled before the
//! request are skipped.

use std::io;
use std::time::{Duration, Instant};

use v4l::Device;
use v4l::buffer::{Flags, Metadata, Type};
use v4l::io::mmap::Stream;
use v4l::io::traits::{CaptureStream, Stream as _};

use crate::camera::CameraError;
use crate::camera::deadline::Deadline;

/// Number of buffers; each is a full frame of kernel memory.
const BUFFERS: u32 = 3;
/// Maximum number of consecutive damaged frames before the shot fails.
const MAX_DAMAGED_FRAMES: u32 = 10;

/// Bytes of one frame and the driver's data on it.
pub struct GrabbedFrame {
    /// Bytes, truncated to the length given by the driver.
    pub bytes: Vec<u8>,
    /// Driver's counter since the stream started.
    pub sequence: u32,
    /// Driver's time stamp, s.
    pub time_s: f64,
    /// True if the stamp is in the machine's monotonic clock.
    pub monotonic: bool,
    /// True if the stamp marks the begin of the exposure, false for the end of the frame.
    pub stamped_at_start: bool,
    /// Frame period, s; an upper limit if there was only one frame.
    pub period_s: f64,
    /// Number of frames that the driver counted and did not deliver.
    pub dropped: u32,
    /// Number of frames before this one that were marked as damaged or too short.
    pub damaged: u32,
    /// Number of frames from before the shot that were skipped.
    pub stale: u32,
}

/// Running stream.
pub struct RunningStream {
    stream: Stream<'static>,
    period: FramePeriod,
    /// Number of frames still to be discarded while exposure and white level settle.
    settle: u32,
    /// True if a frame has been taken: buffers may have been filled since.
    taken: bool,
}

impl RunningStream {
    /// Starts a stream; its first `settle` frames will be discarded.
    pub fn start(device: &Device, settle: u32) -> Result<Self, CameraError> {
        let stream = Stream::with_buffers(device, Type::VideoCapture, BUFFERS);
        let stream = stream.map_err(|e| streaming_error(&e, "buffers"))?;
        Ok(Self {
            stream,
            period: FramePeriod::default(),
            settle,
            taken: false,
        })
    }

    /// Returns the first complete frame that arrives from now on. After an error the stream cannot be used.
    pub fn next_frame(
        &mut self,
        min_bytes: usize,
        deadline: &Deadline,
    ) -> Result<GrabbedFrame, CameraError> {
        next_whole_frame(self, min_bytes, deadline)
    }

    /// Stops the stream. Dropping a stream that cannot be stopped would panic; such a stream is left to the kernel, which
    /// frees it when the camera is closed.
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

/// Discards `settle` frames, then takes the first complete one.
pub fn grab_frame(
    device: &Device,
    settle: u32,
    min_bytes: usize,
    deadline: &Deadline,
) -> Result<GrabbedFrame, CameraError> {
    let mut running = RunningStream::start(device, settle)?;
    let result = running.next_frame(min_bytes, deadline);
    running.stop();
    result
}

/// Shortest time between consecutive frames, s.
#[derive(Default)]
struct FramePeriod {
    last: Option<(u32, f64)>,
    shortest_s: Option<f64>,
}

impl FramePeriod {
    fn add_frame_stamp(&mut self, sequence: u32, time_s: f64) {
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

/// Waiting time below which a buffer was filled before it was requested.
const IMMEDIATE: Duration = Duration::from_millis(1);

fn next_whole_frame(
    running: &mut RunningStream,
    min_bytes: usize,
    deadline: &Deadline,
) -> Result<GrabbedFrame, CameraError> {
    // A frame with an older stamp was taken before the shot.
    let begun_s = wingd_base::clock::monotonic_s();
    let RunningStream {
        stream,
        period,
        settle,
        taken,
    } = running;
    let (mut damaged, mut dropped, mut expected, mut stale) = (0, 0, None, 0);
    loop {
        // At least a millisecond, as 0 would not wait at all.
        stream.set_timeout(deadline.remaining("a frame")?.max(Duration::from_millis(1)));
        let asked = Instant::now();
        let (bytes, meta) = stream.next().map_err(|error| match error.kind() {
            io::ErrorKind::TimedOut => deadline.timeout_error("a frame"),
            _ => streaming_error(&error, "a frame"),
        })?;
        dropped += expected.map_or(0, |expected| {
            meta.sequence.wrapping_sub(expected).min(1 << 16)
        });
        expected = Some(meta.sequence.wrapping_add(1));
        let used = bytes.get(..meta.bytesused as usize).unwrap_or(bytes);
        if meta.flags.contains(Flags::ERROR) || used.len() < min_bytes {
            damaged += 1;
            if damaged > MAX_DAMAGED_FRAMES {
                return Err(CameraError::BadFrame(format!(
                    "{damaged} frames in a row, {}",
                    damaged_frame_text(meta, min_bytes)
                )));
            }
            continue;
        }
        let time_s = meta.timestamp.sec as f64 + meta.timestamp.usec as f64 * 1e-6;
        period.add_frame_stamp(meta.sequence, time_s);
        let monotonic = meta.flags.contains(Flags::TIMESTAMP_MONOTONIC);
        let old = if monotonic {
            time_s < begun_s
        } else {
            *taken && asked.elapsed() < IMMEDIATE
        };
        // At most as many as there are buffers, as a driver's clock may be wrong.
        if stale < BUFFERS && old {
            stale += 1;
        } else if *settle > 0 {
            *settle -= 1;
        } else {
            *taken = true;
            return Ok(GrabbedFrame {
                bytes: used.to_vec(),
                sequence: meta.sequence,
                time_s,
                monotonic,
                stamped_at_start: (meta.flags & Flags::TSTAMP_SRC_MASK) == Flags::TSTAMP_SRC_SOE,
                // In a stream that was just started, no frame is longer than that.
                period_s: period.shortest_s.unwrap_or((time_s - begun_s).max(0.0)),
                dropped,
                damaged,
                stale,
            });
        }
    }
}

fn damaged_frame_text(meta: &Metadata, min_bytes: usize) -> String {
    match meta.flags.contains(Flags::ERROR) {
        true => "marked as damaged by the driver; check cable and USB bandwidth".to_owned(),
        false => format!(
            "the last one of {} bytes; {min_bytes} are needed",
            meta.bytesused
        ),
    }
}

/// Classifies an error of an open device: a request that was valid before and is invalid now may succeed after reopening.
fn streaming_error(error: &io::Error, what: &str) -> CameraError {
    match error.raw_os_error() == Some(rustix::io::Errno::INVAL.raw_os_error()) {
        true => CameraError::Gone(format!(
            "{what}: {error}; the driver lost its buffers, and the camera is reopened"
        )),
        false => classify_error(error, what),
    }
}

/// Classifies an error by the caller's action.
pub fn classify_error(error: &io::Error, what: &str) -> CameraError {
    use rustix::io::Errno;
    let text = format!("{what}: {error}");
    match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::BUSY) => CameraError::Busy(format!(
            "{text}; another program has the camera (see: fuser -v /dev/video*)"
        )),
        Some(
            Errno::NODEV | Errno::NXIO | Errno::NOENT | Errno::IO | Errno::PIPE | Errno::PROTO,
        ) => CameraError::Gone(format!(
            "{text}; unplugged, or a fault of power supply or cable"
        )),
        Some(Errno::ACCESS | Errno::PERM) => CameraError::Refused(format!(
            "{text}; add the user that runs wingd to the group video"
        )),
        _ => CameraError::Refused(text),
    }
}
