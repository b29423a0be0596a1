//! Promise: one slip in a table or a TOML file that somebody wrote by hand is one fault, with its cause and the mend
//! (docs/interface.md).

use crate::program::{fixture, outcome};

/// An installation with another text for its survey.
fn checked(survey: &str) -> (Option<i32>, String) {
    let dir = tempfile::tempdir().unwrap();
    for name in ["camera.toml", "installation.toml"] {
        std::fs::copy(fixture("dev/installation").join(name), dir.path().join(name)).unwrap();
    }
    std::fs::write(dir.path().join("survey.csv"), survey).unwrap();
    outcome(&["check", "--installation", &dir.path().to_string_lossy()])
}

#[test]
fn one_cause_in_a_survey_is_one_fault() {
    let sound = std::fs::read_to_string(fixture("dev/installation/survey.csv")).unwrap().replace('\r', "");
    let (header, rows) = sound.split_once('\n').unwrap();
    let decimal = rows.replacen("38.6089", "38,6089", 1);
    for (survey, words) in [
        (format!("sep=,\n{sound}"), "line 1: is a spreadsheet's separator line"),
        (format!("{}\n{rows}", header.to_uppercase()), "write it in small letters: id,shape"),
        (format!("a,b,c\n{rows}"), "line 1: is no header with id, shape"),
        (sound.replace(',', ";"), "is separated by semicolons"),
        (format!("{header}\n{decimal}"), "line 2: has 8 cells under a header of 7"),
        (sound.replace(',', "|"), "is separated by bars"),
        (format!("{header}\n-,-,m,m,m,m,m\n{rows}"), "line 2: holds no numbers where its columns need them"),
        (format!("{sound}{header}\n"), "line 23: holds no numbers where its columns need them"),
        (format!("{sound}mean,,,,,,\n"), "line 23: holds no numbers where its columns need them"),
        (format!("{header},x_m\n{rows}"), "column x_m: stands twice"),
        (format!("{header}\n\"{rows}"), "line 2: a quote is not closed"),
    ] {
        let (status, said) = checked(&survey);
        assert!(
            status == Some(78) && said.contains(words) && said.contains("1 fault to mend"),
            "{words}: {said}"
        );
    }
    let quoted = format!(
        "{header},note\n{}",
        rows.lines().map(|l| format!("{l},\"near, the rib\"\n")).collect::<String>()
    );
    assert_eq!(checked(&quoted).0, checked(&sound).0);
}

#[test]
fn slips_of_the_pen_in_toml_are_named_with_the_mend() {
    let dir = tempfile::tempdir().unwrap();
    let main = dir.path().join("installation.toml");
    let sound = std::fs::read_to_string(fixture("dev/installation/installation.toml")).unwrap();
    let survey = sound.lines().find(|line| line.starts_with("survey")).unwrap();
    for (line, words) in [
        ("survey = \"C:\\wing\\survey.csv\"", "single quotes"),
        (
            "survey = \"C:\\new\\table.csv\"",
            "C:\\new\\table.csv: file: is no name: a backslash within double quotes",
        ),
        ("survey = “survey.csv”", "straight quotes"),
        ("root_offset_sigma_m = 0,01\nsurvey = \"survey.csv\"", "has a decimal comma; write a point"),
        ("survey = 2026-06-01", "is a date where a text or a number must be"),
    ] {
        std::fs::write(&main, sound.replace(survey, line)).unwrap();
        let (status, said) = outcome(&["check", "--installation", &dir.path().to_string_lossy()]);
        assert!(status == Some(78) && said.contains(words), "{words}: {said}");
    }
}

#[test]
fn another_programs_camera_in_the_place_of_ours_is_named_with_the_mend() {
    let dir = tempfile::tempdir().unwrap();
    for name in ["survey.csv", "installation.toml"] {
        std::fs::copy(fixture("dev/installation").join(name), dir.path().join(name)).unwrap();
    }
    let main = dir.path().join("installation.toml");
    let sound = std::fs::read_to_string(&main).unwrap();
    std::fs::write(&main, sound.replace("camera.toml", "opencv.yaml")).unwrap();
    std::fs::copy(fixture("cameras/opencv.yaml"), dir.path().join("opencv.yaml")).unwrap();
    let (status, said) = outcome(&["check", "--installation", &dir.path().to_string_lossy()]);
    assert!(
        status == Some(78) && said.contains("is no camera.toml") && said.contains("wingd convert"),
        "{said}"
    );
}

#[test]
fn a_boards_fault_has_its_line_and_the_mend() {
    let dir = tempfile::tempdir().unwrap();
    let (file, out) = (dir.path().join("board.toml"), dir.path().join("camera.toml"));
    let sound = "pattern = \"checkerboard\"\ncolumns = 8\nrows = 6\nsquare_m = 0.025\n";
    for (text, words) in [
        (sound.replace("0.025", "\"25 mm\""), "line 4 (`square_m = \"25 mm\"`)"),
        (format!("{sound}squares = 3\n"), "line 5 (`squares = 3`)"),
        (sound.replace("0.025", "2.5"), "0.0025 for 2.5 mm, 0.025 for 2.5 cm"),
        (sound.replace("0.025", "0,025"), "has a decimal comma"),
        (sound.replace("checkerboard", "chessboard"), "line 1 (`pattern = \"chessboard\"`)"),
    ] {
        std::fs::write(&file, text).unwrap();
        let (file, out) = (file.to_string_lossy(), out.to_string_lossy());
        let (status, said) = outcome(&["calibrate", "--board", &file, "--output", &out, "none.jpg"]);
        assert!(status == Some(78) && said.contains(words), "{words}: {said}");
    }
}

#[test]
fn files_whose_names_are_no_utf8_are_read_and_told_apart() {
    use std::os::unix::ffi::OsStrExt;
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join(std::ffi::OsStr::from_bytes(b"fl\xfcgel.yaml"));
    std::fs::copy(fixture("cameras/opencv.yaml"), &file).unwrap();
    let run = |file: &std::path::Path| {
        let mut convert = std::process::Command::new(env!("CARGO_BIN_EXE_wingd"));
        convert.arg("convert").arg(file).arg(dir.path().join("camera.toml")).output().unwrap()
    };
    let done = run(&file);
    let said = String::from_utf8(done.stdout).unwrap();
    assert!(done.status.success() && said.contains("fl\\xfcgel.yaml: OpenCV"), "{said}");
    let missing = run(&dir.path().join(std::ffi::OsStr::from_bytes(b"fl\xe4gel.yaml")));
    let said = String::from_utf8(missing.stderr).unwrap();
    assert!(
        missing.status.code() == Some(78) && said.contains("fl\\xe4gel.yaml: file: cannot be read"),
        "{said}"
    );
}
