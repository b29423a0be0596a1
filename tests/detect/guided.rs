//! Guided detection on real frames' bytes: the answers of the whole frame, from windows alone.

use std::path::Path;

use nalgebra::{Cholesky, Vector2};
use wingd::installation;
use wingd::measure::detect::{Detection, MarkerPrediction};
use wingd::measure::identify;
use wingd::pipeline::guided::detect_predicted;
use wingd::pipeline::stages::{ProcessedFrame, Work, detect_only};

/// A frame of a fixture with all that it shows, and its surveyed markers seen some pixels off.
struct Case {
    name: String,
    bytes: Vec<u8>,
    whole: ProcessedFrame,
    predictions: Vec<MarkerPrediction>,
}

fn cases(set: &str) -> Vec<Case> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures").join(set);
    let setup = installation::load_without_orientation(&root.join("installation")).unwrap().setup;
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
    let ground = frames.iter().filter(|(name, ..)| name.starts_with("ground"));
    let ground: Vec<_> = ground.map(|(_, _, whole)| whole.detections.markers.clone()).collect();
    let orientation = identify::estimate_orientation(&setup, &ground).unwrap().orientation;
    frames
        .into_iter()
        .map(|(name, bytes, whole)| {
            let markers = &whole.detections.markers;
            let identities = identify::identify_markers(&setup, &orientation, markers).unwrap();
            let mut predictions = identify::predict_next_frame(&setup, &orientation, markers, &identities);
            for (k, p) in predictions.iter_mut().enumerate() {
                let (sin, cos) = (2.4 * k as f64).sin_cos();
                p.centre_px += 5.0 * Vector2::new(cos, sin);
                p.semi_major_px *= 1.02;
            }
            Case { name, bytes, whole, predictions }
        })
        .collect()
}

/// How far apart two answers are, in standard deviations of the first.
fn apart(one: &Detection, other: &Detection) -> f64 {
    let off = other.centre_px - one.centre_px;
    Cholesky::new(*one.covariance_px2).unwrap().solve(&off).dot(&off).sqrt()
}

#[test]
fn what_was_seen_is_found_again_with_the_same_answer() {
    let (mut count, mut alike) = (0, 0);
    for case in ["dev", "demo"].iter().flat_map(|set| cases(set)) {
        let guided = detect_predicted(&case.name, &case.bytes, None, &case.predictions);
        let stages: Vec<Work> = guided.stages.iter().map(|s| s.work).collect();
        assert_eq!(
            stages,
            [Work::Decode, Work::Detect],
            "{}: the whole frame was searched after all",
            case.name
        );
        let seen = case.predictions.iter().filter(|p| p.seen).count();
        assert!(guided.detections.markers.len() >= seen, "{}", case.name);
        for marker in &guided.detections.markers {
            let same = (case.whole.detections.markers.iter())
                .find(|m| (m.centre_px - marker.centre_px).norm() < 3.0)
                .unwrap_or_else(|| panic!("{}: {marker:?} is not in the whole frame", case.name));
            let apart = apart(same, marker);
            count += 1;
            alike += usize::from(apart < 0.01);
            assert!(apart < 1.0, "{}: {marker:?} is {apart} standard deviations off {same:?}", case.name);
        }
    }
    println!("{alike} of {count} within 0.01 standard deviations");
    assert!(count > 150 && 100 * alike >= 98 * count, "{alike} of {count}");
}

#[test]
fn where_one_that_was_seen_is_missing_the_whole_frame_is_searched() {
    for mut case in cases("dev").into_iter().take(2) {
        let seen = case.predictions.iter().position(|p| p.seen).unwrap();
        case.predictions[seen].centre_px.y -= 150.0;
        let guided = detect_predicted(&case.name, &case.bytes, None, &case.predictions);
        assert_eq!(guided.detections, case.whole.detections);
        assert_eq!(guided.stages.len(), 4);
        // One that was hidden before need not be there.
        case.predictions[seen].seen = false;
        let guided = detect_predicted(&case.name, &case.bytes, None, &case.predictions);
        assert_eq!(guided.stages.len(), 2);
        assert_eq!(detect_predicted(&case.name, &case.bytes, None, &[]).detections, case.whole.detections);
    }
}

#[test]
fn a_frame_that_cannot_be_read_is_a_failure_and_no_answer() {
    let case = cases("dev").swap_remove(0);
    let cut = &case.bytes[..case.bytes.len() / 2];
    let guided = detect_predicted(&case.name, cut, None, &case.predictions);
    assert!(guided.failure.is_some_and(|f| !f.text().contains(&case.name) && f.text().contains("cut short")));
    assert!(guided.detections.markers.is_empty());
}
