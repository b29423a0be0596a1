//! Promise: a changed camera file of another program is never silently read as another camera.
//!
//! Method: a lens is written in each format by this test's own code, piece by piece; a seeded change is made; the reading
//! must then give
//! - the lens itself, if the change has no meaning (a comment, another order, layout or quotes);
//! - a refusal, the lens itself, or another lens **with a remark**, if the change is one that no program makes (a key
//!   renamed, a list transposed, reversed, cut or lengthened, another model, a unit, a word for a number, a line moved);
//! - exactly the lens with the other value, if a value was changed to another plausible one.
//!
//! "Another" is decided by the lens that the text was made from, never by the reader. For changes of single characters,
//! which may produce any number, a parameter that differs must occur in the text as a number more often
//! than before the change. 3,000 of each format, from the seed `WINGD_SEED` on (0).

mod pieces;

use std::path::Path;

use self::pieces::{FORMATS, Format, Pieces, lens};
use crate::mutations::first_seed;

use rand::prelude::*;
use rand::rngs::StdRng;
use wingd::exchange::{ReadCamera, read_exchange};
use wingd::measure::geometry::Lens;

/// Number of changes of each format.
const CHANGES: u64 = 3000;

/// Expected reading of a changed text.
#[derive(Debug)]
enum Expected {
    /// The lens.
    Same,
    /// This lens.
    Exactly(Box<Lens>),
    /// A refusal, the lens, or another lens with a remark.
    NotOtherInSilence,
    /// As `Remarked`, or another lens whose new values occur in the text.
    AsWritten,
}

/// Unsupported models, by their names in the formats' own programs.
const FOREIGN: [&str; 12] = [
    "equidistant",
    "fisheye",
    "omni",
    "eucm",
    "ds",
    "fov",
    "LENSMODEL_CAHVOR",
    "LENSMODEL_STEREOGRAPHIC",
    "LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=18_fov_x_deg=150",
    "thin_prism",
    "KannalaBrandt8",
    "double_sphere",
];

fn comment(rng: &mut StdRng, format: Format) -> String {
    let inside = [
        "image_width: 1280",
        "'lensmodel': 'LENSMODEL_CAHVOR',",
        "data: [999.0, 0.0, 640.0, 0.0, 999.0, 360.0, 0.0, 0.0, 1.0]",
        "intrinsics: [999.0, 999.0, 640.0, 360.0]",
        "distortion_model: equidistant",
        "note: before the lens was changed:",
        "[ ] { } , : ' \"",
    ];
    let text = inside.choose(rng).unwrap();
    match format {
        Format::OpencvXml => format!("<!-- {text} -->\n"),
        Format::OpencvJson => format!("// {text}\n"),
        _ => format!("# {text}\n"),
    }
}

/// A change of a text by a kind, and the expected reading.
fn change(rng: &mut StdRng, format: Format) -> (String, Expected) {
    let mut pieces = Pieces::new(format);
    match rng.random_range(0..12) {
        0 => {
            let mut blocks = pieces.blocks();
            for _ in 0..rng.random_range(1..4) {
                let at = rng.random_range(0..=blocks.len());
                blocks.insert(at, comment(rng, format));
            }
            (pieces.framed(&blocks), Expected::Same)
        }
        1 => {
            let mut blocks = pieces.blocks();
            blocks.shuffle(rng);
            (pieces.framed(&blocks), Expected::Same)
        }
        2 => (layout(rng, &pieces), Expected::Same),
        3 => (renamed(rng, &pieces), Expected::NotOtherInSilence),
        4 | 5 => (listed(rng, pieces), Expected::NotOtherInSilence),
        6 => (other_model(rng, pieces), Expected::NotOtherInSilence),
        7 => (other_unit(rng, pieces), Expected::NotOtherInSilence),
        8 => {
            let words = [
                "nan", "inf", "-inf", "NCD", "1e400", "", "0x10", "1,5", "1_0", "[1]", "~", "'",
            ];
            let word = (*words.choose(rng).unwrap()).to_owned();
            **cells(&mut pieces).choose_mut(rng).unwrap() = word;
            (pieces.text(), Expected::NotOtherInSilence)
        }
        9 => other_value(rng, pieces),
        10 => (
            lines_moved(rng, &pieces.text()),
            Expected::NotOtherInSilence,
        ),
        _ => (characters(rng, &pieces.text()), Expected::AsWritten),
    }
}

fn cells(pieces: &mut Pieces) -> Vec<&mut String> {
    let of_core = pieces.matrix.as_mut().unwrap_or(&mut pieces.core);
    of_core
        .iter_mut()
        .chain(&mut pieces.terms)
        .chain(&mut pieces.size)
        .collect()
}

/// Other blanks, quotes, line breaks in lists, comments behind lines.
fn layout(rng: &mut StdRng, pieces: &Pieces) -> String {
    let text = pieces.text();
    let xml = pieces.format == Format::OpencvXml;
    match rng.random_range(0..4) {
        0 if !xml => text
            .lines()
            .map(|l| {
                if l.starts_with(['%', '-']) {
                    format!("{l}\n")
                } else {
                    format!("{l}  # x: 1\n")
                }
            })
            .collect(),
        1 if !xml => text.replace(", ", ",\n      "),
        2 if !xml => text
            .replace("[ ", "[")
            .replace('[', "[   ")
            .replace(", ", " , "),
        2 => text
            .replace(' ', "\n ")
            .replace("<?xml\n ", "<?xml ")
            .replace("\n type_id", " type_id"),
        3 if pieces.format != Format::Mrcal && !xml => text
            .replace("image_width:", "\"image_width\":")
            .replace("intrinsics:", "'intrinsics':"),
        _ => text.replace('\n', "\n\n"),
    }
}

/// A key with one letter added, removed or replaced.
fn renamed(rng: &mut StdRng, pieces: &Pieces) -> String {
    let keys = [
        "image_width",
        "image_height",
        "camera_matrix",
        "distortion_model",
        "distortion_coefficients",
        "rows",
        "cols",
        "data",
        "camera_model",
        "intrinsics",
        "distortion_coeffs",
        "resolution",
        "lensmodel",
        "imagersize",
        "cam0",
        "camera_name",
        "dt",
    ];
    let text = pieces.text();
    let there: Vec<&str> = keys.into_iter().filter(|key| text.contains(key)).collect();
    let key = there.choose(rng).unwrap();
    let at = rng.random_range(1..key.len());
    let other = match rng.random_range(0..4) {
        0 => format!("{key}s"),
        1 => format!("{}{}", &key[..at], &key[at + 1..]),
        2 => format!("{}x{}", &key[..at], &key[at..]),
        _ => format!("old_{key}"),
    };
    if rng.random() {
        text.replace(key, &other)
    } else {
        text.replacen(key, &other, 1)
    }
}

/// A list transposed, reversed, cut or lengthened.
fn listed(rng: &mut StdRng, mut pieces: Pieces) -> String {
    let of_core = pieces.matrix.is_some() && rng.random();
    if let Some(m) = pieces.matrix.as_mut().filter(|_| of_core) {
        *m = (0..9).map(|k| m[3 * (k % 3) + k / 3].clone()).collect();
        return pieces.text();
    }
    let list = match rng.random_range(0..3) {
        0 => &mut pieces.terms,
        1 => &mut pieces.size,
        _ => pieces.matrix.as_mut().unwrap_or(&mut pieces.core),
    };
    match rng.random_range(0..4) {
        0 => list.reverse(),
        1 => drop(list.pop()),
        2 => drop(list.remove(0)),
        _ => list.push("0.5".into()),
    }
    pieces.text()
}

fn other_model(rng: &mut StdRng, mut pieces: Pieces) -> String {
    let name = (*FOREIGN.choose(rng).unwrap()).to_owned();
    if pieces.format == Format::Kalibr && rng.random() {
        return pieces.text().replace("pinhole", &name);
    }
    if pieces.model.is_empty() {
        let mut blocks = pieces.blocks();
        let flag = [
            "fisheye_model",
            "distortion_model",
            "camera_model",
            "model_type",
        ]
        .choose(rng)
        .unwrap();
        let value = if *flag == "fisheye_model" {
            "1".to_owned()
        } else {
            name
        };
        let xml = pieces.format == Format::OpencvXml;
        let block = if xml {
            format!("<{flag}>{value}</{flag}>\n")
        } else {
            format!("{flag}: {value}\n")
        };
        blocks.insert(rng.random_range(0..=blocks.len()), block);
        return pieces.framed(&blocks);
    }
    pieces.model = name;
    pieces.text()
}

/// A length in another unit than px: of one element, of all camera constants, or of all that is px in the core.
fn other_unit(rng: &mut StdRng, mut pieces: Pieces) -> String {
    let factor = *[1e-3, 1e3, 25.4, 1.0 / 25.4, 0.3048, 0.1, 10.0, 1e-6]
        .choose(rng)
        .unwrap();
    let which = match rng.random_range(0..4) {
        0 => vec![rng.random_range(0..4)],
        1 => vec![0, 1],
        2 => vec![2, 3],
        _ => vec![0, 1, 2, 3],
    };
    for k in which {
        let value: f64 = pieces.core[k].parse().unwrap();
        pieces.core[k] = format!("{:?}", value * factor);
    }
    pieces.with_core().text()
}

/// One parameter with another plausible value: the file then describes that camera.
fn other_value(rng: &mut StdRng, mut pieces: Pieces) -> (String, Expected) {
    let mut lens = lens(pieces.format);
    let by = 1.0 + rng.random_range(-0.01..0.01);
    if rng.random() {
        let k = rng.random_range(0..4);
        let parameter = [&mut lens.fx, &mut lens.fy, &mut lens.cx, &mut lens.cy]
            .into_iter()
            .nth(k)
            .unwrap();
        *parameter *= by;
        pieces.core[k] = format!("{parameter:?}");
        pieces = pieces.with_core();
    } else {
        let k = rng.random_range(0..pieces.terms.len());
        let all = [
            &mut lens.k1,
            &mut lens.k2,
            &mut lens.p1,
            &mut lens.p2,
            &mut lens.k3,
        ];
        let parameter = all.into_iter().nth(k).unwrap();
        *parameter *= by;
        pieces.terms[k] = format!("{parameter:?}");
    }
    (pieces.text(), Expected::Exactly(Box::new(lens)))
}

/// A line removed, duplicated or moved.
fn lines_moved(rng: &mut StdRng, text: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    let at = rng.random_range(0..lines.len());
    let line = lines[at];
    match rng.random_range(0..3) {
        0 => drop(lines.remove(at)),
        1 => lines.insert(at, line),
        _ => {
            lines.remove(at);
            lines.insert(rng.random_range(0..=lines.len()), line);
        }
    }
    lines.join("\n") + "\n"
}

/// Some characters removed, duplicated or replaced.
fn characters(rng: &mut StdRng, text: &str) -> String {
    let mut all: Vec<char> = text.chars().collect();
    for _ in 0..rng.random_range(1..3) {
        let at = rng.random_range(0..all.len());
        match rng.random_range(0..4) {
            0 => drop(all.remove(at)),
            1 => all.insert(
                at,
                *b" \n:,[]{}'\"#-&*!|>%@`0.9eE\t".choose(rng).unwrap() as char,
            ),
            2 => all[at] = rng.random_range(' '..='~'),
            _ => all.truncate(at.max(1)),
        }
    }
    all.into_iter().collect()
}

fn values(lens: &Lens) -> Vec<f64> {
    let [k4, k5, k6] = lens.denominator;
    let size = [f64::from(lens.width), f64::from(lens.height)];
    [
        &size[..],
        &[
            lens.fx, lens.fy, lens.cx, lens.cy, lens.k1, lens.k2, lens.p1, lens.p2, lens.k3, k4,
            k5, k6,
        ],
    ]
    .concat()
}

/// The numbers in a text, as they are written.
fn tokens(text: &str) -> Vec<f64> {
    let part = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
    text.split(|c| !part(c))
        .filter_map(|token| token.parse().ok())
        .collect()
}

/// The error of a reading, if any.
fn wrong(expected: &Expected, format: Format, text: &str, read: Option<&ReadCamera>) -> bool {
    let own = lens(format);
    let Some(read) = read else {
        return matches!(expected, Expected::Same | Expected::Exactly(_));
    };
    match expected {
        Expected::Same => read.lens != own,
        Expected::Exactly(lens) => read.lens != **lens,
        Expected::NotOtherInSilence => {
            read.lens != own && specific_remarks(read, format).is_empty()
        }
        Expected::AsWritten => {
            let (before, after) = (tokens(&Pieces::new(format).text()), tokens(text));
            let pairs = values(&read.lens).into_iter().zip(values(&own));
            let count = |tokens: &[f64], v: f64| tokens.iter().filter(|token| **token == v).count();
            let new = |v: f64| count(&after, v) > count(&before, v);
            let differ = pairs.filter(|(v, own)| v != own && !new(*v)).count();
            differ > 0 && specific_remarks(read, format).is_empty()
        }
    }
}

/// Remarks except the one that every OpenCV file gets.
fn specific_remarks(read: &ReadCamera, format: Format) -> Vec<&String> {
    let opencv = matches!(
        format,
        Format::OpencvYaml | Format::OpencvXml | Format::OpencvJson
    );
    read.remarks
        .iter()
        .filter(|r| !(opencv && r.contains("no lens model is declared")))
        .collect()
}

#[test]
fn a_changed_camera_file_is_never_silently_another_camera() {
    let directory = tempfile::tempdir().unwrap();
    let mut failures = vec![];
    for format in FORMATS {
        let (mut refused, mut with_a_word) = (0, 0);
        for seed in first_seed()..first_seed() + CHANGES {
            let mut rng = StdRng::seed_from_u64(seed);
            let (text, expected) = change(&mut rng, format);
            let file: &Path = &directory.path().join(Pieces::new(format).name());
            std::fs::write(file, &text).unwrap();
            let read = read_exchange(file, None, None);
            refused += usize::from(read.is_err());
            with_a_word += usize::from(
                read.as_ref()
                    .is_ok_and(|r| !specific_remarks(r, format).is_empty()),
            );
            if wrong(&expected, format, &text, read.as_ref().ok()) {
                eprintln!("{format:?}, seed {seed}, {expected:?}:\n{text}\n{read:?}\n");
                failures.push((format, seed));
            }
        }
        eprintln!(
            "{format:?}: {CHANGES} changes, {refused} refused, {with_a_word} read with a remark"
        );
    }
    assert!(failures.is_empty(), "{failures:?}");
}

#[test]
fn unchanged_files_are_read() {
    let directory = tempfile::tempdir().unwrap();
    for format in FORMATS {
        let pieces = Pieces::new(format);
        let file = directory.path().join(pieces.name());
        std::fs::write(&file, pieces.text()).unwrap();
        assert_eq!(
            read_exchange(&file, None, None).unwrap().lens,
            lens(format),
            "{format:?}"
        );
    }
}
