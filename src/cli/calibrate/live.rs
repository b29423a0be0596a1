//! Live calibration: the configured camera takes images until the verdict is good.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::{CalibrateArgs, Failure, TaskResult};
use crate::camera::freshness::Freshness;
use crate::clock::SystemClock;
use crate::config;
use crate::desk::calibration::{BoardImage, calibrate_and_judge};
use crate::exchange::DescribedBoard;
use crate::measure::calibrate::Verdict;
use crate::report::number::count_text;

/// Maximum time for a shot.
const SHOT_DEADLINE: Duration = Duration::from_secs(20);

/// Takes images until the verdict is good, the camera ends, or the limit is reached.
pub(super) fn take_images(
    args: &CalibrateArgs,
    file: &Path,
    board: &DescribedBoard,
) -> TaskResult<Vec<BoardImage>> {
    let section = config::load_camera(file)?;
    let mut camera = section.factory(Arc::new(SystemClock::new()), Duration::ZERO)();
    let opened = camera.open().map_err(Failure::from_error)?;
    eprintln!(
        "{}: show the board in all parts of the image, tilted by 20 to 40 degrees",
        opened.name
    );
    let mut freshness = Freshness::default();
    let mut taken: Vec<BoardImage> = vec![];
    for shot in 1..=args.shots {
        let frame = match camera
            .shoot(SHOT_DEADLINE)
            .and_then(|f| freshness.check(&f.bytes).map(|_| f))
        {
            Ok(frame) => frame,
            // If a replay ends or the camera is unplugged, the images taken so far are used.
            Err(error) => {
                eprintln!("image {shot}: {error}");
                break;
            }
        };
        // The copy is enough; a camera that keeps its own does no harm.
        let _ = camera.release_last();
        let found = BoardImage::detect(&format!("shot {shot}"), Ok(&frame.bytes), &board.board);
        eprintln!("image {shot}: {}", describe_image(&found));
        taken.push(found);
        if is_good_enough(&mut taken, board, args.select) {
            break;
        }
    }
    camera.close();
    Ok(taken)
}

fn describe_image(picture: &BoardImage) -> String {
    match &picture.view {
        Ok(view) => format!("{} of the board", count_text(view.len(), "point")),
        Err(reason) => reason.to_string(),
    }
}

/// Returns whether the calibration is good; otherwise prints the verdict and the main reason.
fn is_good_enough(taken: &mut [BoardImage], board: &DescribedBoard, select: bool) -> bool {
    if taken.last().is_none_or(|p| p.view.is_err()) {
        return false;
    }
    match calibrate_and_judge(taken, board, select) {
        Ok(judged) => {
            let missing = judged
                .reasons
                .first()
                .map_or(String::new(), |r| format!(": {r}"));
            eprintln!("{}{missing}", judged.verdict.name());
            judged.verdict == Verdict::Good
        }
        Err(reason) => {
            eprintln!("{}", reason.text().lines().next().unwrap_or_default());
            false
        }
    }
}
