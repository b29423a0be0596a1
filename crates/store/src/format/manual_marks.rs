//! Manual marks in frames: `marks-NNNNNN.jsonl`. The first line names the flight, every further line is one mark. Marks are
//! never changed; the last mark of a marker in a frame is valid.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// First line of a file with manual marks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManualMarksHead {
    /// Flight of the marks.
    pub flight: String,
}

/// Mark by one person for one marker in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManualMark {
    /// Name of the frame as in results; in a store `s000012/0001.jpg`.
    pub image: String,
    /// SHA-256 of the frame's bytes, hex: the mark is valid for these pixels only.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame_sha256: String,
    /// Id of the marker in the survey.
    pub id: String,
    #[serde(flatten)]
    pub act: MarkAction,
    /// Name of the person.
    pub who: String,
    /// Time, UTC; `None` if unknown.
    pub at: Option<Timestamp>,
    /// Reason in the person's words; may be empty.
    #[serde(default)]
    pub why: String,
}

/// Statement of a manual mark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mark", rename_all = "lowercase")]
pub enum MarkAction {
    /// Position of the marker's centre; replaces the detection.
    Place(MarkPosition),
    /// The detection of the marker is not used.
    Reject,
    /// Earlier marks of the marker are void.
    Withdraw,
}

/// Position of a marker's centre in the image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MarkPosition {
    /// Image coordinates of the centre, px.
    pub u_px: f64,
    pub v_px: f64,
    /// Covariance of (u, v), px².
    pub covariance_px2: [[f64; 2]; 2],
    pub source: MarkSource,
}

/// Measuring method of a marked position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkSource {
    /// Position set by a person.
    Manual,
    /// Fit of the detector at the marked position.
    Fit,
    /// Detection that was identified as another marker.
    Renamed,
}

/// Returns the valid marks: the last one of each marker in each frame, without withdrawn ones.
pub fn effective_marks(marks: &[ManualMark]) -> Vec<&ManualMark> {
    let last: BTreeMap<_, _> = marks
        .iter()
        .map(|mark| ((&mark.image, &mark.id), mark))
        .collect();
    last.into_values()
        .filter(|mark| mark.act != MarkAction::Withdraw)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::append_file_kinds::MANUAL_MARKS;
    use super::super::jsonl;
    use super::*;

    fn mark(id: &str, act: MarkAction) -> ManualMark {
        let (image, who) = ("s000001/0001.jpg".to_owned(), "ada".to_owned());
        ManualMark {
            image,
            frame_sha256: "ab".into(),
            id: id.into(),
            act,
            who,
            at: None,
            why: String::new(),
        }
    }

    #[test]
    fn the_last_mark_of_a_marker_counts_and_a_withdrawn_one_does_not() {
        let place = MarkPosition {
            u_px: 1.5,
            v_px: 2.5,
            covariance_px2: [[4.0, 0.0], [0.0, 4.0]],
            source: MarkSource::Manual,
        };
        let all = [
            mark("M01", MarkAction::Place(place)),
            mark("M02", MarkAction::Reject),
            mark("M01", MarkAction::Reject),
            mark("M02", MarkAction::Withdraw),
        ];
        assert_eq!(effective_marks(&all), [&all[2]]);
        let line = jsonl::encode_line(&all[0]).unwrap();
        let text = String::from_utf8(line.clone()).unwrap();
        assert!(
            text.contains(r#""mark":"place","u_px":1.5"#) && text.contains(r#""source":"manual""#),
            "{text}"
        );
        let file = [
            &jsonl::encode_line(&ManualMarksHead {
                flight: "f0001".into(),
            })
            .unwrap()[..],
            &line,
            b"{\"image\":",
        ]
        .concat();
        assert_eq!(
            jsonl::parse_headed::<ManualMarksHead, ManualMark>(&file)
                .unwrap()
                .1,
            [all[0].clone()]
        );
        assert_eq!(
            (MANUAL_MARKS.intact_prefix)(&file).unwrap(),
            (file.len() - 9, "f0001".to_owned())
        );
    }
}
