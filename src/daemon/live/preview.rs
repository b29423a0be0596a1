//! Small image of the newest frame with a result, solved or not, for the page. It is made on request, at most once per
//! second, and uses nothing that the solving needs.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::result::LiveFrame;
use crate::daemon::core::{DISPLAY_NICE, lower_priority};
use wingd_evaluation::pipeline::decode::decode_image;
use wingd_evaluation::pipeline::guard::catch_panic;
use wingd_evaluation::pipeline::shrink::small_jpeg;
use wingd_pages::recorder::PreviewImage;

/// Longer side of the preview, px.
const LONGER_SIDE_PX: usize = 1280;
/// JPEG quality of the preview, 1 to 100.
const JPEG_QUALITY: u8 = 70;
/// Minimum time between two previews.
const MIN_INTERVAL: Duration = Duration::from_secs(1);

#[derive(Default)]
struct PreviewState {
    frame: Option<Arc<LiveFrame>>,
    made: Option<(Instant, Arc<PreviewImage>)>,
}

/// The newest frame and the last preview.
#[derive(Default)]
pub(crate) struct Preview {
    state: Mutex<PreviewState>,
    /// Lock that lets one preview be made at a time.
    making: Mutex<()>,
}

impl Preview {
    /// Sets the newest frame with a result, solved or not.
    pub fn set_frame(&self, frame: &Arc<LiveFrame>) {
        self.state
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .frame = Some(frame.clone());
    }

    /// Returns a preview that is at most one second old, or a new one; `None` before the first frame.
    pub fn image(&self) -> Option<Arc<PreviewImage>> {
        let _one = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        let frame = {
            let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            match &state.made {
                Some((when, preview)) if when.elapsed() < MIN_INTERVAL => {
                    return Some(preview.clone());
                }
                _ => state.frame.clone()?,
            }
        };
        let preview = Arc::new(at_low_priority(|| {
            catch_panic(|| make_preview(&frame)).flatten()
        })?);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.made = Some((Instant::now(), preview.clone()));
        Some(preview)
    }
}

/// Runs `work` on a thread of its own with low priority.
fn at_low_priority<T: Send>(work: impl FnOnce() -> Option<T> + Send) -> Option<T> {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("preview".to_owned());
        let made = thread.spawn_scoped(scope, || {
            lower_priority(DISPLAY_NICE);
            work()
        });
        made.ok()?.join().ok().flatten()
    })
}

fn make_preview(frame: &LiveFrame) -> Option<PreviewImage> {
    let raster = decode_image(&frame.taken.frame.bytes, Some(&frame.taken.frame.format)).ok()?;
    let jpeg = small_jpeg(&raster, LONGER_SIDE_PX, JPEG_QUALITY)?;
    Some(PreviewImage {
        number: frame.number,
        size: (raster.width(), raster.height()),
        jpeg,
    })
}
