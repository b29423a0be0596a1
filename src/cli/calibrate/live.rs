//! The configured camera takes pictures until the verdict is good.

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::pictures::{Picture, picture};
use super::{Args, Failure, judged};
use crate::camera::freshness::Freshness;
use crate::clock::System;
use crate::config;
use crate::installation::DescribedBoard;
use crate::measure::calibrate::Verdict;
use crate::report::number::count;

/// Longest time for a shot.
const DEADLINE: Duration = Duration::from_secs(20);

/// Pictures until the verdict is good, the camera has no more, or enough were taken.
pub(super) fn pictures(args: &Args, file: &Path, board: &DescribedBoard) -> Result<Vec<Picture>, Failure> {
    let section = config::load_camera(file)?;
    let mut camera = section.factory(Arc::new(System::new()), Duration::ZERO)();
    let opened = camera.open().map_err(|e| Failure::Failed(e.to_string()))?;
    eprintln!("{}: show the board, tilted by 20 to 40 degrees, all over the image", opened.name);
    let mut freshness = Freshness::default();
    let mut taken: Vec<Picture> = vec![];
    for shot in 1..=args.shots {
        let frame = match camera.shoot(DEADLINE).and_then(|f| freshness.check(&f.bytes).map(|_| f)) {
            Ok(frame) => frame,
            // A replay ends, a camera is unplugged: what was taken still counts.
            Err(error) => {
                eprintln!("picture {shot}: {error}");
                break;
            }
        };
        // The copy here is all that is wanted of it; a camera that keeps its own does no harm.
        let _ = camera.release_last();
        let found = picture(&format!("shot {shot}"), Ok(&frame.bytes), &board.board);
        eprintln!("picture {shot}: {}", said(&found));
        taken.push(found);
        if good(&mut taken, board, args.select) {
            break;
        }
    }
    camera.close();
    Ok(taken)
}

fn said(picture: &Picture) -> String {
    match &picture.view {
        Ok(view) => format!("{} of the board", count(view.len(), "point")),
        Err(reason) => reason.to_string(),
    }
}

/// Whether that is enough; says what is missing where it is not.
fn good(taken: &mut [Picture], board: &DescribedBoard, select: bool) -> bool {
    if taken.last().is_none_or(|p| p.view.is_err()) {
        return false;
    }
    match judged(taken, board, select) {
        Ok(judged) => {
            let missing = judged.reasons.first().map_or(String::new(), |r| format!(": {r}"));
            eprintln!("{}{missing}", judged.verdict.name());
            judged.verdict == Verdict::Good
        }
        Err(reason) => {
            eprintln!("{}", reason.text().lines().next().unwrap_or_default());
            false
        }
    }
}
