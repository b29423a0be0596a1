//! Live calibration: the configured camera takes images until the verdict is good.

use std::path::Path;

use super::CalibrateArgs;
use crate::board_camera::OpenCamera;
use crate::calibration::{BoardImage, calibrate_and_judge};
use wingd_base::failure::TaskResult;
use wingd_evaluation::boards::DescribedBoard;
use wingd_evaluation::number::count_text;
use wingd_measure::calibrate::Verdict;

/// Takes images until the verdict is good, the camera ends, or the limit is reached.
pub(super) fn take_images(
    args: &CalibrateArgs,
    file: &Path,
    board: &DescribedBoard,
    open_camera: OpenCamera,
) -> TaskResult<Vec<BoardImage>> {
    let mut camera = open_camera(file)?;
    eprintln!(
        "{}: show the board in all parts of the image, tilted by 20 to 40 degrees",
        camera.name()
    );
    let mut taken: Vec<BoardImage> = vec![];
    for shot in 1..=args.shots {
        let bytes = match camera.shoot() {
            Ok(bytes) => bytes,
            // If a replay ends or the camera is unplugged, the images taken so far are used.
            Err(error) => {
                eprintln!("image {shot}: {error}");
                break;
            }
        };
        let found = BoardImage::detect(&format!("shot {shot}"), Ok(&bytes), &board.board);
        eprintln!("image {shot}: {}", describe_image(&found));
        taken.push(found);
        if is_good_enough(&mut taken, board, args.select) {
            break;
        }
    }
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
