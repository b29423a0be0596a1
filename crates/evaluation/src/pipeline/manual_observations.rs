//! Conversion of manual marks between the store's form and the adjustment's.

use nalgebra::{Matrix2, Vector2};

use crate::installation::{ManualObservation, ManualPosition};
use wingd_measure::setup::Setup;
use wingd_store::manual_marks::{ManualMark, MarkAction, MarkPosition, MarkSource};

/// Converts a mark into an observation; `None` if it is withdrawn or its marker is not in the survey.
pub fn observation_from_mark(mark: &ManualMark, setup: &Setup) -> Option<ManualObservation> {
    let marker = setup.markers.iter().position(|m| m.id == mark.id)?;
    let place = match mark.act {
        MarkAction::Withdraw => return None,
        MarkAction::Reject => None,
        MarkAction::Place(MarkPosition {
            u_px,
            v_px,
            covariance_px2: [[uu, uv], [vu, vv]],
            ..
        }) => Some(ManualPosition {
            pixel: Vector2::new(u_px, v_px),
            covariance_px2: Matrix2::new(uu, uv, vu, vv),
        }),
    };
    let when = mark.at.map_or(String::new(), |at| at.to_string());
    let image = Some(mark.image.clone()).filter(|image| !image.is_empty());
    Some(ManualObservation {
        image,
        marker,
        place,
        note: [mark.who.clone(), when, mark.why.clone()],
    })
}

/// Returns a covariance as an array of its rows.
pub fn covariance_rows(covariance: &Matrix2<f64>) -> [[f64; 2]; 2] {
    covariance.transpose().into()
}

/// Converts a manual position into the position of a mark with this source.
pub fn mark_position(at: &ManualPosition, source: MarkSource) -> MarkPosition {
    MarkPosition {
        u_px: at.pixel.x,
        v_px: at.pixel.y,
        covariance_px2: covariance_rows(&at.covariance_px2),
        source,
    }
}

/// Converts an observation read from a file into a mark.
pub fn mark_from_observation(observation: &ManualObservation, setup: &Setup) -> ManualMark {
    let act = observation.place.map_or(MarkAction::Reject, |at| {
        MarkAction::Place(mark_position(&at, MarkSource::Manual))
    });
    let [who, when, why] = observation.note.clone();
    ManualMark {
        image: observation.image.clone().unwrap_or_default(),
        frame_sha256: String::new(),
        id: setup
            .markers
            .get(observation.marker)
            .map_or(String::new(), |m| m.id.clone()),
        act,
        who,
        at: when.parse().ok(),
        why,
    }
}
