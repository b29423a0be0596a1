//! What people marked in frames. The first line of a file says whose flight it is, each further one is a mark; of several of
//! one marker in one frame the last counts, and none is ever changed.

use std::collections::BTreeMap;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};

use super::jsonl;

/// The first line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Head {
    /// The flight that the marks belong to.
    pub flight: String,
}

/// What one person said of one marker in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mark {
    /// The frame, as results name it: in a store `s000012/0001.jpg`.
    pub image: String,
    /// SHA-256 of the frame's bytes, hex: marks are of these pixels.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub frame_sha256: String,
    /// The marker, by its id in the survey.
    pub id: String,
    /// What is said of it.
    #[serde(flatten)]
    pub act: MarkAction,
    /// Who said it.
    pub who: String,
    /// When, UTC; `None` where it is not known.
    pub at: Option<Timestamp>,
    /// Why, in the person's words; may be empty.
    #[serde(default)]
    pub why: String,
}

/// What is said of a marker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "mark", rename_all = "lowercase")]
pub enum MarkAction {
    /// Its centre is here; stands for what was detected of it.
    Place(Place),
    /// What was detected of it is not to be used.
    Reject,
    /// What was said of it before holds no more.
    Withdraw,
}

/// Where a marker's centre is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// Image of the centre, px.
    pub u_px: f64,
    /// px.
    pub v_px: f64,
    /// Covariance of the two, px^2.
    pub covariance_px2: [[f64; 2]; 2],
    /// What measured it.
    pub source: MarkSource,
}

/// What measured a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MarkSource {
    /// The eye.
    Manual,
    /// The detector, where the hand showed it.
    Fit,
    /// The detector, under another marker's name.
    Renamed,
}

/// The marks that count: of each marker in each frame the last, and none that is withdrawn.
pub fn standing(marks: &[Mark]) -> Vec<&Mark> {
    let mut last: BTreeMap<(&str, &str), &Mark> = BTreeMap::new();
    for mark in marks {
        last.insert((&mark.image, &mark.id), mark);
    }
    last.into_values().filter(|mark| mark.act != MarkAction::Withdraw).collect()
}

/// Head and whole lines; `None` where the first line is damaged.
pub(crate) fn parse(bytes: &[u8]) -> Option<(Head, Vec<Mark>)> {
    let first = bytes.split_inclusive(|byte| *byte == b'\n').next()?;
    let head = serde_json::from_slice(first).ok()?;
    let lines = jsonl::parse::<Mark>(bytes.get(first.len()..)?).good;
    Some((head, lines.into_iter().map(|(_, line)| line).collect()))
}

/// How many bytes are whole lines, and the flight that they belong to; `None` where not even the first line is.
pub(crate) fn whole(bytes: &[u8]) -> Option<(usize, String)> {
    let good = jsonl::parse::<serde_json::Value>(bytes).good_length;
    let (head, _) = parse(bytes.get(..good)?)?;
    Some((good, head.flight))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
    use super::*;

    fn mark(id: &str, act: MarkAction) -> Mark {
        let (image, who) = ("s000001/0001.jpg".to_owned(), "ada".to_owned());
        Mark { image, frame_sha256: "ab".into(), id: id.into(), act, who, at: None, why: String::new() }
    }

    #[test]
    fn the_last_mark_of_a_marker_counts_and_a_withdrawn_one_does_not() {
        let place = Place {
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
        assert_eq!(standing(&all), [&all[2]]);
        let line = jsonl::line(&all[0]).unwrap();
        let text = String::from_utf8(line.clone()).unwrap();
        assert!(
            text.contains(r#""mark":"place","u_px":1.5"#) && text.contains(r#""source":"manual""#),
            "{text}"
        );
        let file =
            [&jsonl::line(&Head { flight: "f0001".into() }).unwrap()[..], &line, b"{\"image\":"].concat();
        assert_eq!(parse(&file).unwrap().1, [all[0].clone()]);
        assert_eq!(whole(&file).unwrap(), (file.len() - 9, "f0001".to_owned()));
    }
}
