//! Promise: one mistake in a manually edited table or TOML file is one fault, with its cause and the remedy
//! (docs/reference/files.md).

use crate::program::{fixture, outcome};

/// An installation with another text as its survey.
fn check_survey(survey: &str) -> (Option<i32>, String) {
    let dir = tempfile::tempdir().unwrap();
    for name in ["camera.toml", "installation.toml"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            dir.path().join(name),
        )
        .unwrap();
    }
    std::fs::write(dir.path().join("survey.csv"), survey).unwrap();
    outcome(&["check", "--installation", &dir.path().to_string_lossy()])
}

#[test]
fn one_cause_in_a_survey_is_one_fault() {
    let sound = std::fs::read_to_string(fixture("dev/installation/survey.csv"))
        .unwrap()
        .replace('\r', "");
    let (header, rows) = sound.split_once('\n').unwrap();
    let decimal = rows.replacen("38.6089", "38,6089", 1);
    for (survey, words) in [
        (
            format!("sep=,\n{sound}"),
            "line 1: is a spreadsheet's separator line",
        ),
        (
            format!("{}\n{rows}", header.to_uppercase()),
            "write it in lower case: id,shape",
        ),
        (
            format!("a,b,c\n{rows}"),
            "line 1: is not a header with id, shape",
        ),
        (sound.replace(',', ";"), "is separated by semicolons"),
        (
            format!("{header}\n{decimal}"),
            "line 2: has 8 cells under a header of 7",
        ),
        (sound.replace(',', "|"), "is separated by bars"),
        (
            format!("{header}\n-,-,m,m,m,m,m\n{rows}"),
            "line 2: has no numbers in columns that need them",
        ),
        (
            format!("{sound}{header}\n"),
            "line 23: has no numbers in columns that need them",
        ),
        (
            format!("{sound}mean,,,,,,\n"),
            "line 23: has no numbers in columns that need them",
        ),
        (format!("{header},x_m\n{rows}"), "column x_m: occurs twice"),
        (
            format!("{header}\n\"{rows}"),
            "line 2: a quote is not closed",
        ),
    ] {
        let (status, printed) = check_survey(&survey);
        assert!(
            status == Some(78)
                && printed.contains(words)
                && printed.contains("1 error in the configuration or installation"),
            "{words}: {printed}"
        );
    }
    let quoted = format!(
        "{header},note\n{}",
        rows.lines()
            .map(|l| format!("{l},\"near, the rib\"\n"))
            .collect::<String>()
    );
    assert_eq!(check_survey(&quoted).0, check_survey(&sound).0);
}

#[test]
fn typing_mistakes_in_toml_are_named_with_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let main = dir.path().join("installation.toml");
    let sound = std::fs::read_to_string(fixture("dev/installation/installation.toml")).unwrap();
    let survey = sound
        .lines()
        .find(|line| line.starts_with("survey"))
        .unwrap();
    for (line, words) in [
        ("survey = \"C:\\wing\\survey.csv\"", "single quotes"),
        (
            "survey = \"C:\\new\\table.csv\"",
            "C:\\new\\table.csv: file: is not a valid path: within double quotes a backslash",
        ),
        ("survey = “survey.csv”", "straight quotes"),
        (
            "root_offset_sigma_m = 0,01\nsurvey = \"survey.csv\"",
            "has a decimal comma; use a decimal point",
        ),
        (
            "survey = 2026-06-01",
            "is a date, but a text or a number is expected",
        ),
    ] {
        std::fs::write(&main, sound.replace(survey, line)).unwrap();
        let (status, printed) =
            outcome(&["check", "--installation", &dir.path().to_string_lossy()]);
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}: {printed}"
        );
    }
}

#[test]
fn a_camera_file_of_another_program_is_named_with_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["survey.csv", "installation.toml"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            dir.path().join(name),
        )
        .unwrap();
    }
    let main = dir.path().join("installation.toml");
    let sound = std::fs::read_to_string(&main).unwrap();
    std::fs::write(&main, sound.replace("camera.toml", "opencv.yaml")).unwrap();
    std::fs::copy(
        fixture("cameras/opencv.yaml"),
        dir.path().join("opencv.yaml"),
    )
    .unwrap();
    let (status, printed) = outcome(&["check", "--installation", &dir.path().to_string_lossy()]);
    assert!(
        status == Some(78)
            && printed.contains("is not a camera.toml")
            && printed.contains("wingd convert"),
        "{printed}"
    );
}

#[test]
fn a_fault_of_a_board_file_has_its_line_and_the_remedy() {
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (
        dir.path().join("board.toml"),
        dir.path().join("camera.toml"),
    );
    let sound = "pattern = \"checkerboard\"\ncolumns = 8\nrows = 6\nsquare_m = 0.025\n";
    for (text, words) in [
        (
            sound.replace("0.025", "\"25 mm\""),
            "line 4 (`square_m = \"25 mm\"`)",
        ),
        (format!("{sound}squares = 3\n"), "line 5 (`squares = 3`)"),
        (
            sound.replace("0.025", "2.5"),
            "0.0025 for 2.5 mm, 0.025 for 2.5 cm",
        ),
        (sound.replace("0.025", "0,025"), "has a decimal comma"),
        (
            sound.replace("checkerboard", "chessboard"),
            "line 1 (`pattern = \"chessboard\"`)",
        ),
    ] {
        std::fs::write(&file, text).unwrap();
        let (file, out) = (file.to_string_lossy(), out.to_string_lossy());
        let (status, printed) =
            outcome(&["calibrate", "--board", &file, "--output", &out, "none.jpg"]);
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}: {printed}"
        );
    }
}

#[test]
fn files_whose_names_are_not_utf8_are_read_and_distinguished() {
    use std::os::unix::ffi::OsStrExt;
    let dir = tempfile::tempdir().unwrap();
    let image = |name: &[u8]| dir.path().join(std::ffi::OsStr::from_bytes(name));
    let files = [image(b"fl\xfcgel.jpg"), image(b"fl\xe4gel.jpg")];
    for file in &files {
        std::fs::copy(fixture("jpeg/baseline-2x1.jpg"), file).unwrap();
    }
    let detect = |files: &[std::path::PathBuf]| {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_wingd"));
        command
            .args(["detect", "--json"])
            .args(files)
            .output()
            .unwrap()
    };
    let printed = String::from_utf8(detect(&files).stdout).unwrap();
    assert!(
        printed.contains("fl\\\\xfcgel.jpg") && printed.contains("fl\\\\xe4gel.jpg"),
        "{printed}"
    );
    let missing = detect(&[image(b"fl\xf6gel.jpg")]);
    let printed = String::from_utf8(missing.stdout).unwrap();
    assert!(
        missing.status.code() == Some(1) && printed.contains("fl\\\\xf6gel.jpg cannot be read"),
        "{printed}"
    );
}
