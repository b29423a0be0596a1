//! What people mark in frames, as the store keeps it and as the adjustment takes it.

use nalgebra::{Matrix2, Vector2};

use crate::installation::{ManualObservation, ManualPosition};
use crate::measure::setup::Setup;
use crate::store::manual_marks::{ManualMark, MarkAction, MarkSource, MarkPosition};

/// A mark as the adjustment takes it; `None` for one that is withdrawn, or of a marker that the survey does not have.
pub fn observation(mark: &ManualMark, setup: &Setup) -> Option<ManualObservation> {
    let marker = setup.markers.iter().position(|m| m.id == mark.id)?;
    let place = match mark.act {
        MarkAction::Withdraw => return None,
        MarkAction::Reject => None,
        MarkAction::Place(MarkPosition { u_px, v_px, covariance_px2: [[uu, uv], [vu, vv]], .. }) => {
            Some(ManualPosition {
                pixel: Vector2::new(u_px, v_px),
                covariance_px2: Matrix2::new(uu, uv, vu, vv),
            })
        }
    };
    let when = mark.at.map_or(String::new(), |at| at.to_string());
    let image = Some(mark.image.clone()).filter(|image| !image.is_empty());
    Some(ManualObservation { image, marker, place, note: [mark.who.clone(), when, mark.why.clone()] })
}

/// A covariance by its rows.
pub fn rows(covariance: &Matrix2<f64>) -> [[f64; 2]; 2] {
    covariance.transpose().into()
}

/// A place as a mark has it, told in this way.
pub fn place(at: &ManualPosition, by: MarkSource) -> MarkPosition {
    MarkPosition { u_px: at.pixel.x, v_px: at.pixel.y, covariance_px2: rows(&at.covariance_px2), source: by }
}

/// A line of a file as a mark.
pub fn mark(of: &ManualObservation, setup: &Setup) -> ManualMark {
    let act = of.place.map_or(MarkAction::Reject, |at| MarkAction::Place(place(&at, MarkSource::Manual)));
    let [who, when, why] = of.note.clone();
    ManualMark {
        image: of.image.clone().unwrap_or_default(),
        frame_sha256: String::new(),
        id: setup.markers.get(of.marker).map_or(String::new(), |m| m.id.clone()),
        act,
        who,
        at: when.parse().ok(),
        why,
    }
}
