//! Promise: the targets and boards that docs/printing/print.py writes are of true size (docs/printing.md).
//!
//! The pages are read from the PDF by their operators: Bezier curves of circles, rectangles of squares, lines of rulers.

use std::path::Path;
use std::process::Command;

use tempfile::TempDir;

/// Millimetres in a point.
const MM: f64 = 25.4 / 72.0;
/// Largest error of a printed length, mm.
const MAX_ERROR_MM: f64 = 0.01;

/// A page of a PDF: its size, and the operators of its content with their numbers, mm.
struct PrintedPage {
    size: Vec<f64>,
    operators: Vec<(String, Vec<f64>)>,
}

fn print(folder: &TempDir, arguments: &[&str]) -> (bool, String) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/printing/print.py");
    let mut command = Command::new("python3");
    let command = command.arg(script).args(arguments);
    let output = command.current_dir(folder.path()).output().unwrap();
    let messages = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.success(), messages)
}

fn numbers(text: &str) -> Vec<f64> {
    let words = text.split_whitespace().rev();
    let mut found: Vec<f64> = words.map_while(|word| word.parse().ok()).collect();
    found.reverse();
    found.iter().map(|value| value * MM).collect()
}

fn read_pages(file: &Path) -> Vec<PrintedPage> {
    let bytes = std::fs::read(file).unwrap();
    let text: String = bytes.iter().map(|byte| char::from(*byte)).collect();
    assert!(text.contains("/PrintScaling /None"));
    let boxes = text.split("/MediaBox [").skip(1);
    let contents = text.split("stream\n").skip(1).step_by(2);
    let read = |(size, content): (&str, &str)| {
        let content = content.split("endstream").next().unwrap();
        let lines = content.lines().flat_map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let ends = words.iter().enumerate();
            let ends = ends.filter(|(_, word)| ["m", "c", "l", "re"].contains(word));
            let ends: Vec<usize> = ends.map(|(at, _)| at).collect();
            let of = |at: usize| (words[at].to_owned(), numbers(&words[..at].join(" ")));
            ends.into_iter().map(of).collect::<Vec<_>>()
        });
        PrintedPage {
            size: numbers(size.split(']').next().unwrap()),
            operators: lines.collect(),
        }
    };
    boxes.zip(contents).map(read).collect()
}

/// Lengths of the box around the ends of all curves, mm.
fn curve_extent(page: &PrintedPage) -> (f64, f64) {
    let curves = page.operators.iter().filter(|(name, _)| name == "c");
    let ends: Vec<(f64, f64)> = curves.map(|(_, at)| (at[4], at[5])).collect();
    let range = |values: Vec<f64>| {
        values.iter().copied().fold(f64::MIN, f64::max)
            - values.iter().copied().fold(f64::MAX, f64::min)
    };
    (
        range(ends.iter().map(|end| end.0).collect()),
        range(ends.iter().map(|end| end.1).collect()),
    )
}

fn assert_ruler(page: &PrintedPage) {
    let is_line = |pair: &&[(String, Vec<f64>)]| pair[0].0 == "m" && pair[1].0 == "l";
    let lines = page.operators.windows(2).filter(is_line);
    let lengths: Vec<f64> = lines.map(|p| (p[1].1[0] - p[0].1[0]).abs()).collect();
    let ruler = lengths
        .iter()
        .any(|length| (length - 100.0).abs() < MAX_ERROR_MM);
    assert!(ruler, "no line of 100 mm: {lengths:?}");
}

#[test]
fn targets_are_of_their_surveyed_diameter() {
    let folder = tempfile::tempdir().unwrap();
    let survey = "# planned\nid,shape,diameter_m,x_m,y_m,z_m,sigma_m\nM01,quadrant,0.2,1,2,3,0.002\n\
        M02,circle,0.3,1,2,3,0.002\nP01,point,,1,2,3,0.002\n";
    std::fs::write(folder.path().join("survey.csv"), survey).unwrap();
    let (ok, messages) = print(&folder, &["targets", "survey.csv", "targets.pdf"]);
    assert!(ok, "{messages}");
    let pages = read_pages(&folder.path().join("targets.pdf"));
    assert_eq!(pages.len(), 2);
    for (page, diameter) in pages.iter().zip([200.0, 300.0]) {
        let (width, height) = curve_extent(page);
        assert!((width - diameter).abs() < MAX_ERROR_MM, "{width} mm wide");
        assert!((height - diameter).abs() < MAX_ERROR_MM, "{height} mm high");
        assert!(page.size[2] > width && page.size[3] > height);
        assert_ruler(page);
    }
    let (ok, _) = print(&folder, &["targets", "survey.csv", "a3.pdf", "A3"]);
    assert!(!ok && !folder.path().join("a3.pdf").exists());
    let (ok, messages) = print(&folder, &["targets", "survey.csv", "a2.pdf", "A2"]);
    assert!(ok, "{messages}");
    let page = &read_pages(&folder.path().join("a2.pdf"))[0];
    let paper = [0.0, 0.0, 420.0, 594.0];
    let off = page.size.iter().zip(paper).map(|(a, b)| (a - b).abs());
    assert!(off.fold(0.0, f64::max) < MAX_ERROR_MM);
}

#[test]
fn a_board_has_the_squares_of_its_description() {
    let folder = tempfile::tempdir().unwrap();
    let board = "pattern = \"checkerboard\"\ncolumns = 9\nrows = 6\nsquare_m = 0.075\n";
    std::fs::write(folder.path().join("board.toml"), board).unwrap();
    let (ok, messages) = print(&folder, &["board", "board.toml", "board.pdf"]);
    assert!(ok, "{messages}");
    let pages = read_pages(&folder.path().join("board.pdf"));
    assert_eq!(pages.len(), 1);
    let squares = pages[0].operators.iter().filter(|(name, _)| name == "re");
    let squares: Vec<&Vec<f64>> = squares.map(|(_, at)| at).collect();
    assert_eq!(squares.len(), 10 * 7 / 2);
    for square in &squares {
        let sides = [square[2], square[3]];
        assert!(sides.iter().all(|side| (side - 75.0).abs() < MAX_ERROR_MM));
        let (column, row) = (square[0] / 75.0, square[1] / 75.0);
        let on_lattice = (column - column.round()).abs() < 1e-4 && (row - row.round()).abs() < 1e-4;
        assert!(on_lattice && (column.round() + row.round()) as i64 % 2 == 0);
    }
    assert_ruler(&pages[0]);
    std::fs::write(folder.path().join("tags.toml"), "pattern = \"aprilgrid\"\n").unwrap();
    let (ok, messages) = print(&folder, &["board", "tags.toml", "tags.pdf"]);
    assert!(!ok && messages.contains("checkerboard"), "{messages}");
}
