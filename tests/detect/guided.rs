//! Guided detection on bytes of real frames: the results of the full search, from windows alone.

use std::path::Path;

use nalgebra::{Cholesky, Vector2};
use wingd::installation;
use wingd::measure::detect::{Detection, Detections, MarkerPrediction, tiles_read};
use wingd::measure::identify::{self, MAX_DEFLECTION_CHANGE_M, WingView};
use wingd::measure::view::{SearchMode, search_guided};
use wingd::pipeline::decode::{DecodeError, decode_partial};
use wingd::pipeline::stages::{ProcessedFrame, detect_only};

/// A frame of a fixture with all detections, and its surveyed markers predicted with an error of some pixels.
struct Case {
    name: String,
    bytes: Vec<u8>,
    whole: ProcessedFrame,
    predictions: Vec<MarkerPrediction>,
}

fn cases(set: &str) -> Vec<Case> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures")
        .join(set);
    let setup = installation::load_without_orientation(&root.join("installation"))
        .unwrap()
        .setup;
    let mut names: Vec<String> = (std::fs::read_dir(root.join("frames")).unwrap())
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let read = |name: &String| {
        let bytes = std::fs::read(root.join("frames").join(name)).unwrap();
        let whole = detect_only(name, &bytes, None).0;
        (name.clone(), bytes, whole)
    };
    let frames: Vec<_> = names.iter().map(read).collect();
    let ground = frames
        .iter()
        .filter(|(name, ..)| name.starts_with("ground"));
    let ground: Vec<_> = ground
        .map(|(_, _, whole)| whole.detections.markers.clone())
        .collect();
    let orientation = identify::estimate_orientation(&setup, &ground)
        .unwrap()
        .orientation;
    frames
        .into_iter()
        .map(|(name, bytes, whole)| {
            let markers = &whole.detections.markers;
            let wing = WingView::in_flight(&setup, &orientation);
            let identities = wing.identify_markers(markers).unwrap();
            let mut predictions =
                wing.predict_next_frame(markers, &identities, MAX_DEFLECTION_CHANGE_M);
            for (k, p) in predictions.iter_mut().enumerate() {
                let (sin, cos) = (2.4 * k as f64).sin_cos();
                p.centre_px += 5.0 * Vector2::new(cos, sin);
                p.semi_major_px *= 1.02;
            }
            Case {
                name,
                bytes,
                whole,
                predictions,
            }
        })
        .collect()
}

/// Detects the predicted markers, of which only the surroundings are decoded.
fn detect_predicted(
    bytes: &[u8],
    predictions: &[MarkerPrediction],
) -> Result<(Detections, SearchMode), DecodeError> {
    let around = |width, height| tiles_read(predictions, width, height);
    let mut picture = decode_partial(bytes, None, &around)?;
    Ok(search_guided(
        &mut picture,
        predictions,
        |_| None,
        &mut |_| (),
    ))
}

/// Distance of two detections, in standard deviations of the first.
fn difference_in_sigma(one: &Detection, other: &Detection) -> f64 {
    let off = other.centre_px - one.centre_px;
    Cholesky::new(*one.covariance_px2)
        .unwrap()
        .solve(&off)
        .dot(&off)
        .sqrt()
}

#[test]
fn markers_of_the_previous_frame_are_found_again_with_equal_results() {
    let (mut count, mut equal) = (0, 0);
    for case in ["dev", "demo"].iter().flat_map(|set| cases(set)) {
        let (guided, search) = detect_predicted(&case.bytes, &case.predictions).unwrap();
        assert_eq!(
            search,
            SearchMode::Guided,
            "{}: a full search was made",
            case.name
        );
        let seen = case.predictions.iter().filter(|p| p.seen).count();
        assert!(guided.markers.len() >= seen, "{}", case.name);
        for marker in &guided.markers {
            let same = (case.whole.detections.markers.iter())
                .find(|m| (m.centre_px - marker.centre_px).norm() < 3.0)
                .unwrap_or_else(|| {
                    panic!("{}: {marker:?} is not found by the full search", case.name)
                });
            let apart = difference_in_sigma(same, marker);
            count += 1;
            equal += usize::from(apart < 0.01);
            assert!(
                apart < 1.0,
                "{}: {marker:?} is {apart} standard deviations off {same:?}",
                case.name
            );
        }
    }
    println!("{equal} of {count} within 0.01 standard deviations");
    assert!(
        count > 150 && 100 * equal >= 98 * count,
        "{equal} of {count}"
    );
}

#[test]
fn a_missing_marker_causes_a_full_search() {
    for mut case in cases("dev").into_iter().take(2) {
        let seen = case.predictions.iter().position(|p| p.seen).unwrap();
        case.predictions[seen].centre_px.y -= 150.0;
        let full = (case.whole.detections, SearchMode::Full);
        assert_eq!(
            detect_predicted(&case.bytes, &case.predictions).unwrap(),
            full
        );
        // A marker that was hidden before need not be found.
        case.predictions[seen].seen = false;
        assert_eq!(
            detect_predicted(&case.bytes, &case.predictions).unwrap().1,
            SearchMode::Guided
        );
        assert_eq!(detect_predicted(&case.bytes, &[]).unwrap(), full);
    }
}

#[test]
fn an_unreadable_frame_is_a_failure_without_results() {
    let case = cases("dev").swap_remove(0);
    let cut = &case.bytes[..case.bytes.len() / 2];
    let error = detect_predicted(cut, &case.predictions)
        .unwrap_err()
        .to_string();
    assert!(!error.contains(&case.name) && error.contains("cut short"));
}
