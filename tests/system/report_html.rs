//! The report of a store: complete, well formed, without external resources, hostile names harmless.

use crate::common::report_store::{failed, solved, store_with};
use wingd_desk::report as html;
use wingd_evaluation::results::source;

fn page(root: &std::path::Path) -> String {
    html::report_page(&source::read_flight(root, source::ResultChoice::default(), None).unwrap())
}

/// The page without its own script and its values, which are checked exactly.
fn without_scripts(html: &str) -> String {
    let own = format!("<script>{}</script>", html::SCRIPT);
    assert_eq!(
        html.matches(&own).count(),
        1,
        "the report's own script, once"
    );
    let mut rest = html.replace(&own, "");
    while let Some(start) = rest.find("<script ") {
        let end = start + rest[start..].find("</script>").expect("the values end");
        let (head, values) = rest[start..end].split_once('>').unwrap();
        assert!(head.contains("type=\"application/json\""), "{head}");
        assert!(
            !values.contains('<'),
            "nothing in the values ends their element"
        );
        serde_json::from_str::<serde_json::Value>(values).unwrap();
        rest.replace_range(start..end + "</script>".len(), "");
    }
    rest
}

/// Every tag is closed in order; attributes are quoted.
fn check_well_formed(html: &str) {
    let html = without_scripts(html);
    let voids = ["meta", "link", "br", "img", "!DOCTYPE"];
    let mut open: Vec<String> = Vec::new();
    let mut rest = html.as_str();
    while let Some(start) = rest.find('<') {
        let end = start + rest[start..].find('>').expect("a tag ends");
        let tag = &rest[start + 1..end];
        assert_eq!(tag.matches('"').count() % 2, 0, "quotes in <{tag}>");
        let name = tag
            .trim_start_matches('/')
            .split_whitespace()
            .next()
            .unwrap();
        if tag.starts_with('/') {
            assert_eq!(open.pop().as_deref(), Some(name));
        } else if !voids.contains(&name) {
            open.push(name.to_owned());
        }
        rest = &rest[end + 1..];
    }
    assert!(open.is_empty(), "not closed: {open:?}");
}

fn check_harmless(html: &str) {
    let html = without_scripts(html);
    for outside in [
        "http://", "https://", "//cdn", "@import", "<script", "<iframe", "url(",
    ] {
        assert!(!html.contains(outside), "{outside} is in the page");
    }
    for word in ["NaN", ">inf<", "Infinity"] {
        assert!(!html.contains(word), "{word} is in the page");
    }
}

#[test]
fn a_flight_gives_all_sections_with_the_stores_numbers() {
    let store = store_with(&[
        &[solved(2.9312, 0.0061), solved(2.9338, 0.0061)],
        &[solved(2.1234, 0.0052)],
    ]);
    let html = page(store.path());
    check_well_formed(&html);
    check_harmless(&html);
    for section in [
        "Deflection along the span",
        "Deflection and torsion over time",
        "Series",
        "A frame and its markers",
        "Quality",
        "Provenance",
    ] {
        assert!(
            html.contains(&format!("\">{section}</h2>")),
            "{section} is missing"
        );
    }
    for number in [
        "2.9325",
        "0.0061",
        "2.1234",
        "0.0052",
        "2.70",
        "hidden by glare",
        "survey.csv.sha256",
    ] {
        assert!(html.contains(number), "{number} is missing");
    }
    assert!(
        html.contains("href=\"#quality\"") && html.contains("id=\"quality\""),
        "contents"
    );
    assert!(
        html.contains("UTC, from 2026-03-01 08:00") && html.contains(">08:00</text>"),
        "times on the axis"
    );
    assert!(
        html.contains("data:image/jpeg;base64,"),
        "the frame is embedded"
    );
    assert!(html.matches("<svg").count() >= 6);
}

/// A record with three deflections, the most precise relative to the root tangent, and a budget.
fn with_deflections(deflection_m: f64, sigma_m: f64) -> serde_json::Value {
    let mut record = solved(deflection_m, sigma_m);
    let deflections = serde_json::json!({"deflection_ground_m": deflection_m - 0.01, "sigma_deflection_ground_m": 0.8 * sigma_m,
        "deflection_root_m": deflection_m - 0.02, "sigma_deflection_root_m": 0.5 * sigma_m, "reference": "root"});
    record["tip"]
        .as_object_mut()
        .unwrap()
        .extend(deflections.as_object().unwrap().clone());
    for point in record["curve"].as_array_mut().unwrap() {
        for name in ["ground", "root"] {
            let point = point.as_object_mut().unwrap();
            for key in ["deflection", "sigma_deflection"] {
                let value = point[&format!("{key}_m")].clone();
                point.insert(format!("{key}_{name}_m"), value);
            }
        }
    }
    record["budget"] = serde_json::json!([{"source": "mounting", "share": 0.7, "sigma_if_known_m": 0.2 * sigma_m},
        {"source": "image", "share": 0.3}]);
    record
}

#[test]
fn headlines_name_their_quantities() {
    let store = store_with(&[&[with_deflections(1.4, 0.006), with_deflections(3.0, 0.02)]]);
    let html = page(store.path());
    check_well_formed(&html);
    // 3.0 minus 0.02 from the root's tangent, with that frame's own sigma; the mean carries the scatter.
    assert!(
        html.contains("mean tip deflection from the root's tangent / m")
            && html.contains(">1.1</td>"),
        "mean and scatter, with the reference"
    );
    assert!(
        html.contains("Tip deflection (M03) up to 2.980 ± 0.010 m from the root's tangent: the results may be used"),
        "the answer"
    );
    assert!(
        html.contains("deflection from the root's tangent / m</text>")
            && html.contains("the other references"),
        "axes have the same reference"
    );
    assert!(html.contains("consistent with the model") && html.contains("cannot rule out"));
    assert!(!html.contains("deviations hold"));
    assert!(
        html.contains("Uncertainty budget") && html.contains(">mounting<"),
        "budget"
    );
    assert!(
        html.contains("if mounting were known without error"),
        "possible improvements"
    );

    let older = store_with(&[&[with_deflections(1.4, 0.006), solved(2.0, 0.006)]]);
    let html = page(older.path());
    assert!(
        html.contains("m against the survey: the results may be used"),
        "the one deflection that both have"
    );
}

#[test]
fn the_causes_of_unusable_frames_are_counted_and_come_first() {
    let doubtful = |percent: f64| {
        let cause =
            format!("the image is {percent} % larger; use the settings of the ground frames");
        let mut record = solved(1.85, 0.16);
        record["status"] = "doubtful".into();
        record["reason"] = format!("only 8 of 21 visible markers fit; {cause}").into();
        record["cause"] = cause.into();
        record
    };
    let store = store_with(&[&[doubtful(3.8), doubtful(3.9), failed("too dark")]]);
    let html = page(store.path());
    check_well_formed(&html);
    let answer = "No deflection may be used, because 2 of 3 results are doubtful and the others missing: the image is 3.8 % larger; \
                  use the settings of the ground frames.";
    assert!(html.contains(answer));
    assert!(html.contains("<b>2 frames</b>: the image is 3.8 % larger"));
    assert!(html.contains("<b>1 frame</b>: too dark"));
    let at = |text: &str| html.find(text).unwrap();
    assert!(at(answer) < at("too dark") && at("too dark") < at("Deflection along the span"));
}

#[test]
fn remarks_come_before_the_figures_each_kind_once() {
    let remarked = |turn_px: f64| {
        let mut record = solved(2.0, 0.01);
        record["remarks"] = serde_json::json!([format!("the camera is turned by {turn_px} px")]);
        record
    };
    let html = page(store_with(&[&[remarked(62.0), remarked(63.0)]]).path());
    check_well_formed(&html);
    let at = |text: &str| html.find(text).unwrap();
    assert!(at("turned by 62 px") < at("Deflection along the span"));
    assert!(html.contains("(2 times, first in s000001/0001.jpg)"));
    assert!(!html.contains("turned by 63 px"));
    assert!(!page(store_with(&[&[solved(2.0, 0.01)]]).path()).contains("of remarks"));
}

#[test]
fn frames_that_scatter_by_more_than_their_band_are_drawn_singly() {
    let steady = page(store_with(&[&[solved(2.0, 0.1), solved(2.01, 0.1)]]).path());
    assert!(!steady.contains("singly"));
    let moving = page(store_with(&[&[solved(2.0, 0.01), solved(2.5, 0.01)]]).path());
    assert!(moving.contains("2 of 2 frames singly, because frames scatter by more than the band"));
}

#[test]
fn another_flight_of_the_store_is_named() {
    let store = store_with(&[&[solved(2.0, 0.01)]]);
    assert!(!page(store.path()).contains("Other flights"));
    let (from, to) = ("flights/f0001", "flights/f0000");
    let copied = std::process::Command::new("cp")
        .args(["-r", from, to])
        .current_dir(store.path())
        .status();
    assert!(copied.unwrap().success());
    assert!(page(store.path()).contains("Other flights of the store: f0000."));
}

#[test]
fn an_empty_store_and_one_of_failures_say_so() {
    let empty = store_with(&[]);
    let html = page(empty.path());
    check_well_formed(&html);
    check_harmless(&html);
    assert!(html.contains("holds no series yet"));

    let reason =
        "only 3 markers found, at least 6 are needed; check exposure and focus of the frame";
    let dark = store_with(&[&[failed(reason), failed(reason)]]);
    let html = page(dark.path());
    check_well_formed(&html);
    check_harmless(&html);
    assert!(html.contains(reason) && html.contains("No frame has been solved"));
}

#[test]
fn hostile_texts_stay_text() {
    let hostile = "</style><script>alert(1)</script>\"><img src=x onerror=\u{1}>&amp;";
    let mut record = solved(2.0, 0.01);
    record["markers"][0]["id"] = hostile.into();
    record["markers"][1]["reason"] = hostile.into();
    record["torsion"][0]["name"] = hostile.into();
    record["provenance"][hostile] = hostile.into();
    record["remarks"] = serde_json::json!([hostile]);
    let html = page(store_with(&[&[record, failed(hostile)]]).path());
    check_well_formed(&html);
    let html = without_scripts(&html);
    assert!(!html.contains("<script") && !html.contains("<img"));
    assert!(html.contains("&lt;script&gt;"));
}

#[test]
fn a_damaged_manifest_is_noted_and_the_rest_is_shown() {
    let store = store_with(&[&[solved(2.9, 0.006)], &[solved(2.1, 0.006)]]);
    let damaged = store.path().join("flights/f0001/s000001/series.json");
    std::fs::write(&damaged, "{").unwrap();
    let html = page(store.path());
    assert!(html.contains("series.json") && html.contains("2.1000"));
    check_well_formed(&html);
}

#[test]
fn extreme_numbers_do_not_break_the_page() {
    let mut record = solved(1e300, 1e-300);
    record["curve"][3]["deflection_m"] = (-1e300).into();
    record["variance_factor"] = 1e308.into();
    record["markers"][0]["position_m"] = serde_json::json!([1e200, -1e200, 0.0]);
    let html = page(store_with(&[&[record]]).path());
    check_well_formed(&html);
    check_harmless(&html);
}

/// Values of the frames, as read by the page's script.
fn frames(html: &str) -> serde_json::Value {
    let start = html
        .find("id=\"frames-data\"")
        .expect("values of the frames");
    let start = start + html[start..].find('>').unwrap() + 1;
    let end = start + html[start..].find("</script>").unwrap();
    serde_json::from_str(&html[start..end]).unwrap()
}

#[test]
fn every_frame_is_listed_and_the_suspicious_one_is_first() {
    let mut rejected = solved(2.2, 0.006);
    rejected["global_test"] = "rejected".into();
    rejected["variance_factor"] = 3.1.into();
    let reason = "only 3 markers found";
    let store = store_with(&[
        &[solved(2.9, 0.006), failed(reason)],
        &[solved(2.1, 0.006), rejected],
    ]);
    let html = page(store.path());
    let frames = frames(&html);
    let all = frames["frames"].as_array().unwrap();
    assert_eq!(all.len(), 4);
    assert_eq!(
        (&all[0]["series"], &all[0]["image"]),
        (&"s000002".into(), &"0002.jpg".into())
    );
    assert_eq!(all[0]["doubt"], "global test rejected");
    let said = |k: usize| all[k]["said"].as_str().unwrap();
    assert!(
        said(0).contains("2.2000 ± 0.0060 m") && said(0).contains("global test rejected"),
        "{}",
        said(0)
    );
    assert!(said(3).contains(reason), "{}", said(3));
    assert!(
        html.contains(said(0)),
        "the first frame is shown without a script"
    );
    let marker = &all[0]["markers"][0];
    assert!(
        marker[2].is_null() && marker[3].is_null(),
        "without an installation there are no positions: {marker}"
    );
    assert!(
        html.contains("data-frame=\"s000002/0002.jpg\""),
        "its image is there"
    );
}
