//! The page gets a small picture of the newest frame with a result, solved or not. It is made when somebody asks, at most once a second, and with
//! nothing that the solving needs.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::result::LiveFrame;
use crate::daemon::core::{DISPLAY_NICE, give_way};
use crate::pipeline::decode::decode;
use crate::pipeline::guard::guarded;
use crate::pipeline::shrink::small_jpeg;

/// Longer side, px.
const LONGER: usize = 1280;
/// Of the JPEG.
const QUALITY: u8 = 70;
/// The least time between two pictures.
const PAUSE: Duration = Duration::from_secs(1);

/// A small picture.
pub(crate) struct Picture {
    /// Of the frame.
    pub number: u64,
    /// Of the frame, px: the outlines are in it.
    pub size: (usize, usize),
    /// The file.
    pub jpeg: Vec<u8>,
}

#[derive(Default)]
struct State {
    frame: Option<Arc<LiveFrame>>,
    made: Option<(Instant, Arc<Picture>)>,
}

/// The newest frame and the last picture.
#[derive(Default)]
pub(crate) struct Preview {
    state: Mutex<State>,
    /// One picture at a time.
    making: Mutex<()>,
}

impl Preview {
    /// The newest frame with a result, solved or not.
    pub fn show(&self, frame: &Arc<LiveFrame>) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).frame = Some(frame.clone());
    }

    /// A picture that is at most a second old, or newly made; `None` before the first frame.
    pub fn newest(&self) -> Option<Arc<Picture>> {
        let _one = self.making.lock().unwrap_or_else(PoisonError::into_inner);
        let frame = {
            let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            match &state.made {
                Some((when, picture)) if when.elapsed() < PAUSE => return Some(picture.clone()),
                _ => state.frame.clone()?,
            }
        };
        let picture = Arc::new(at_low_priority(|| guarded(|| small(&frame)).flatten())?);
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.made = Some((Instant::now(), picture.clone()));
        Some(picture)
    }
}

/// On a thread of its own that gives way to all others.
fn at_low_priority<T: Send>(work: impl FnOnce() -> Option<T> + Send) -> Option<T> {
    std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().name("preview".to_owned());
        let made = thread.spawn_scoped(scope, || {
            give_way(DISPLAY_NICE);
            work()
        });
        made.ok()?.join().ok().flatten()
    })
}

fn small(frame: &LiveFrame) -> Option<Picture> {
    let raster = decode(&frame.taken.frame.bytes, Some(&frame.taken.frame.format)).ok()?;
    let jpeg = small_jpeg(&raster, LONGER, QUALITY)?;
    Some(Picture { number: frame.number, size: (raster.width(), raster.height()), jpeg })
}
