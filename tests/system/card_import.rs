//! Promise: images of a card have the time that they state anywhere, or the missing or impossible time is named; nothing
//! that is not an image of the flight becomes a frame (docs/evaluation.md, Images from a card).

use std::path::{Path, PathBuf};

use exif::experimental::Writer;
use exif::{Field, In, Rational, Tag, Value as ExifValue};
use serde_json::Value;

use crate::program::{fixture, outcome, run, stdout};

fn text(tag: Tag, text: &str) -> Field {
    Field {
        tag,
        ifd_num: In::PRIMARY,
        value: ExifValue::Ascii(vec![text.as_bytes().to_vec()]),
    }
}

/// A position fix at this time of 1 June 2026, UTC.
fn fix(hour: u32, minute: u32) -> [Field; 2] {
    let parts = [hour, minute, 0].map(|num| Rational { num, denom: 1 });
    let time = Field {
        tag: Tag::GPSTimeStamp,
        ifd_num: In::PRIMARY,
        value: ExifValue::Rational(parts.to_vec()),
    };
    [text(Tag::GPSDateStamp, "2026:06:01"), time]
}

/// A JPEG with an Exif block; `mark` distinguishes images with equal blocks.
fn jpeg(fields: &[Field], mark: usize) -> Vec<u8> {
    let mut block = std::io::Cursor::new(vec![]);
    let mut writer = Writer::new();
    fields.iter().for_each(|field| writer.push_field(field));
    if !fields.is_empty() {
        writer.write(&mut block, false).unwrap();
    }
    with_block(&block.into_inner(), mark)
}

fn with_block(block: &[u8], mark: usize) -> Vec<u8> {
    let jpeg = std::fs::read(fixture("jpeg/baseline-2x1.jpg")).unwrap();
    let segment = |kind: u8, bytes: &[u8]| -> Vec<u8> {
        [
            &[0xff, kind][..],
            &u16::try_from(bytes.len() + 2).unwrap().to_be_bytes(),
            bytes,
        ]
        .concat()
    };
    let exif = if block.is_empty() {
        vec![]
    } else {
        segment(0xe1, &[b"Exif\0\0", block].concat())
    };
    [
        &jpeg[..2],
        &exif,
        &segment(0xfe, mark.to_string().as_bytes()),
        &jpeg[2..],
    ]
    .concat()
}

struct Card(tempfile::TempDir);

impl Card {
    fn new(images: &[(&str, Vec<u8>)]) -> Self {
        let card = Self(tempfile::tempdir().unwrap());
        for (name, bytes) in images {
            let file = card.0.path().join("card").join(name);
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, bytes).unwrap();
        }
        card
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Imports the card into a store: exit status, and both outputs.
    fn import(&self, store: &str, more: &[&str]) -> (Option<i32>, String) {
        let [card, store] =
            [self.path("card"), self.path(store)].map(|p| p.to_string_lossy().into_owned());
        outcome(&[&["import", &card, "--store", &store], more].concat())
    }

    /// Times, empty if unknown, and names of the shots of a store.
    fn shots(&self, store: &str) -> Vec<(String, String)> {
        let lines = stdout(&[
            "export",
            &self.path(store).to_string_lossy(),
            "--format",
            "jsonl",
        ]);
        let manifests = series_manifests(&self.path(store));
        let sources = manifests
            .iter()
            .flat_map(|m| m["shots"].as_array().unwrap().clone());
        let sources = sources.map(|shot| {
            shot["frame"]["settings"]["source"]
                .as_str()
                .unwrap_or_default()
                .to_owned()
        });
        let time = |line: &str| {
            serde_json::from_str::<Value>(line).unwrap()["utc"]
                .as_str()
                .unwrap_or_default()
                .to_owned()
        };
        lines.lines().map(time).zip(sources).collect()
    }
}

fn series_manifests(store: &Path) -> Vec<Value> {
    let folders = |path: &Path| {
        let mut all: Vec<PathBuf> = std::fs::read_dir(path)
            .unwrap()
            .map(|e| e.unwrap().path())
            .collect();
        all.retain(|p| p.is_dir());
        all.sort();
        all
    };
    let series = folders(&store.join("flights"))
        .into_iter()
        .flat_map(|flight| folders(&flight));
    let files = series
        .map(|folder| folder.join("series.json"))
        .filter(|file| file.exists());
    files
        .map(|file| serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap())
        .collect()
}

#[test]
fn every_standard_tag_and_spelling_gives_the_time() {
    let original = |written: &str| text(Tag::DateTimeOriginal, written);
    let zone = text(Tag::OffsetTimeOriginal, "+02:00");
    let images = [
        (
            "a.jpg",
            jpeg(&[original("2026:06:01 10:00:00"), zone.clone()], 0),
        ),
        (
            "b.jpg",
            jpeg(
                &[
                    original("2026-06-01 10:00:01"),
                    text(Tag::OffsetTime, "+0200"),
                ],
                1,
            ),
        ),
        (
            "c.jpg",
            jpeg(&[original("2026:06:01 10:00:02.500+02:00")], 2),
        ),
        (
            "d.jpg",
            jpeg(
                &[
                    text(Tag::DateTimeDigitized, "2026:06:01 10:00:03"),
                    zone.clone(),
                ],
                3,
            ),
        ),
        (
            "e.jpg",
            jpeg(
                &[
                    text(Tag::DateTime, "2026:06:01 10:00:04"),
                    text(Tag::SubSecTime, "25"),
                    zone,
                ],
                4,
            ),
        ),
        ("f.jpg", jpeg(&fix(8, 1), 5)),
    ];
    let card = Card::new(&images);
    let (status, printed) = card.import("store", &[]);
    assert!(
        status == Some(0) && printed.contains("6 imported") && !printed.contains("wingd:"),
        "{printed}"
    );
    let times: Vec<String> = card
        .shots("store")
        .into_iter()
        .map(|(time, _)| time)
        .collect();
    let expected = [
        "00:00.000000",
        "00:01.000000",
        "00:02.500000",
        "00:03.000000",
        "00:04.250000",
        "01:00.000000",
    ];
    assert_eq!(times, expected.map(|rest| format!("2026-06-01T08:{rest}Z")));
    // Every table has its times in one width: programs infer the format from the first line.
    let store = card.path("store").to_string_lossy().into_owned();
    let table = stdout(&["export", &store, "--format", "csv", "--table", "shots"]);
    let mut rows = csv::Reader::from_reader(table.as_bytes());
    for column in ["utc", "exposure_time"] {
        let k = rows
            .headers()
            .unwrap()
            .iter()
            .position(|name| name == column)
            .unwrap();
        let widths: Vec<usize> = csv::Reader::from_reader(table.as_bytes())
            .records()
            .map(|r| r.unwrap()[k].len())
            .collect();
        assert_eq!(widths, [27; 6], "{column}");
    }
}

#[test]
fn a_damaged_block_is_named_and_its_image_has_no_time() {
    let at = |second: usize| {
        jpeg(
            &[text(
                Tag::DateTimeOriginal,
                &format!("2026:06:01 10:00:0{second}"),
            )],
            second,
        )
    };
    let images = [
        ("IMG_0.JPG", at(0)),
        ("IMG_1.JPG", with_block(b"MM\0*\xff\xff\xff\xff", 1)),
        ("IMG_2.JPG", at(2)),
        ("IMG_3.JPG", jpeg(&[], 3)),
    ];
    let card = Card::new(&images);
    let (status, printed) = card.import("store", &["--zone", "+02:00"]);
    assert!(status == Some(0), "{printed}");
    for words in [
        "the Exif block of 1 images (first IMG_1.JPG) without a time is damaged",
        "2 images have no time: kept in the order of the files",
        "f0001/s000001  2 imported",
    ] {
        assert!(printed.contains(words), "{words}: {printed}");
    }
}

#[test]
fn impossible_clocks_are_named_and_an_offset_corrects_them() {
    let taken = |written: &str, more: &[Field]| {
        jpeg(&[&[text(Tag::DateTimeOriginal, written)], more].concat(), 0)
    };
    for (written, more, options, words) in [
        (
            "2016:01:01 00:03:10",
            vec![],
            vec![],
            "dated 2016-01-01, the day from which a clock counts",
        ),
        ("1980:01:06 00:00:00", vec![], vec![], "dated 1980-01-06"),
        (
            "2099:12:31 00:00:00",
            vec![],
            vec![],
            "dated in the future: 2099-12-31T00:00:00Z",
        ),
        (
            "2026:06:01 10:00:00",
            fix(8, 0).to_vec(),
            vec![],
            "2h ahead of its own position fixes",
        ),
        (
            "2026:06:01 10:00:00",
            fix(8, 0).to_vec(),
            vec!["--zone", "+01:00"],
            "give --zone +02:00",
        ),
        (
            "2026:06:01 10:20:00",
            fix(8, 12).to_vec(),
            vec!["--zone", "+02:00"],
            "give --clock-offset 480s",
        ),
    ] {
        let card = Card::new(&[("a.jpg", taken(written, &more))]);
        let (status, printed) = card.import("store", &options);
        assert!(
            status == Some(0) && printed.contains(words),
            "{words}: {printed}"
        );
    }
    let card = Card::new(&[("a.jpg", taken("2016:01:01 00:03:10", &[]))]);
    let (status, printed) = card.import(
        "store",
        &["--zone", "+00:00", "--clock-offset", "-3804d 8h"],
    );
    assert!(
        status == Some(0) && !printed.contains("wingd:"),
        "{printed}"
    );
    assert_eq!(card.shots("store")[0].0, "2026-06-01T08:03:10.000000Z");
    let sound = Card::new(&[("a.jpg", taken("2026:06:01 10:00:00", &fix(8, 1)))]);
    let (_, printed) = sound.import("store", &["--zone", "+02:00"]);
    assert!(!printed.contains("wingd:"), "{printed}");
}

#[test]
fn times_of_names_and_lists_count_and_lists_are_checked() {
    let names = ["1780300800250000000.jpg", "1780300800750000000.jpg"];
    let card = Card::new(&[(names[0], jpeg(&[], 0)), (names[1], jpeg(&[], 1))]);
    let (status, printed) = card.import("store", &[]);
    assert!(
        status == Some(0)
            && printed.contains("2 images (first 1780300800250000000.jpg) have their times from"),
        "{printed}"
    );
    assert_eq!(card.shots("store")[1].0, "2026-06-01T08:00:00.750000Z");
    let list = card.path("times.csv");
    let attempt = |store: &str, text: &str| {
        std::fs::write(&list, text).unwrap();
        card.import(store, &["--times", &list.to_string_lossy()])
    };
    let (status, printed) = attempt(
        "listed",
        &format!(
            "image,utc\n{},2026-06-01T09:00:00Z\nother.jpg,2026-06-01T09:00:01Z\n",
            names[0]
        ),
    );
    assert_eq!(
        (status, card.shots("listed")[1].0.as_str()),
        (Some(0), "2026-06-01T09:00:00.000000Z"),
        "{printed}"
    );
    assert!(
        printed.contains("1 images (first 1780300800750000000.jpg) are not in"),
        "{printed}"
    );
    assert!(
        printed.contains("1 lines of") && printed.contains("name no image"),
        "{printed}"
    );
    for (text, words) in [
        (
            "a,b\n1,2\n",
            "column image: is missing; the header must have image,utc",
        ),
        ("image,utc\nx.jpg,noon\n", "line 2: has no time (\"noon\")"),
        (
            "image,utc\nx.jpg,2026-06-01T09:00:00Z\nx.jpg,2026-06-01T09:00:01Z\n",
            "line 3: repeats x.jpg of line 2",
        ),
        (
            "image,utc\nx.jpg,2026-06-01T09:00:00Z\n",
            "names none of the images",
        ),
    ] {
        let (status, printed) = attempt("refused", text);
        assert!(
            status == Some(78) && printed.contains(words),
            "{words}: {printed}"
        );
    }
    assert!(!card.path("refused").exists());
    // The same name in two folders needs the folder.
    let two = Card::new(&[
        ("100CANON/IMG_1.JPG", jpeg(&[], 0)),
        ("101CANON/IMG_1.JPG", jpeg(&[], 1)),
    ]);
    let list = two.path("times.csv");
    std::fs::write(&list, "image,utc\nIMG_1.JPG,2026-06-01T09:00:00Z\n").unwrap();
    let (status, printed) = two.import("store", &["--times", &list.to_string_lossy()]);
    let words = "names two images, 100CANON/IMG_1.JPG and 101CANON/IMG_1.JPG";
    assert!(status == Some(78) && printed.contains(words), "{printed}");
}

#[test]
fn thumbnails_and_deleted_images_are_skipped_and_other_sizes_named() {
    let image = |mark: usize| {
        jpeg(
            &[text(
                Tag::DateTimeOriginal,
                &format!("2026:06:01 10:00:0{mark}"),
            )],
            mark,
        )
    };
    let small = std::fs::read(fixture("jpeg/no-huffman-tables-32x16.jpg")).unwrap();
    let card = Card::new(&[
        ("DCIM/100CANON/IMG_1.JPG", image(1)),
        ("DCIM/100CANON/IMG_2.jfif", image(2)),
        ("DCIM/101CANON/IMG_1.JPG", image(3)),
        ("DCIM/101CANON/small.jpg", small),
        (
            "DCIM/100CANON/@eaDir/IMG_1.JPG/SYNOPHOTO_THUMB_M.jpg",
            image(4),
        ),
        ("$RECYCLE.BIN/S-1-5/$R1.JPG", image(5)),
        (".Trashes/501/IMG_9.JPG", image(6)),
        ("DCIM/100CANON/._IMG_1.JPG", image(7)),
        ("MISC/THM/100/IMG_1.JPG", image(8)),
    ]);
    let (status, printed) = card.import("store", &["--zone", "+02:00"]);
    assert!(status == Some(0), "{printed}");
    let words = "5 thumbnails, deleted and hidden images are skipped ($RECYCLE.BIN, .Trashes, @eaDir, MISC, hidden files)";
    assert!(printed.contains(words), "{printed}");
    assert!(
        printed.contains("1 images have another size than the others: small.jpg has 32 x 16 px"),
        "{printed}"
    );
    let names: Vec<String> = card
        .shots("store")
        .into_iter()
        .map(|(_, name)| name)
        .collect();
    assert_eq!(
        names[..3],
        ["100CANON/IMG_1.JPG", "IMG_2.jfif", "101CANON/IMG_1.JPG"]
    );
}

#[test]
fn times_of_stored_images_are_not_changed_silently() {
    let image = |mark: usize| {
        jpeg(
            &[text(
                Tag::DateTimeOriginal,
                &format!("2026:06:01 10:00:0{mark}"),
            )],
            mark,
        )
    };
    let card = Card::new(&[("a.jpg", image(1)), ("b.jpg", image(2))]);
    assert_eq!(card.import("store", &["--zone", "+02:00"]).0, Some(0));
    std::fs::write(card.path("card/c.jpg"), image(3)).unwrap();
    for (options, words) in [
        (vec![], "2 images are in the store with other times"),
        (
            vec!["--zone", "+01:00"],
            "a.jpg of f0001 is there with 2026-06-01T08:00:01Z, and would now have 2026-06-01T09:00:01Z, 1h later",
        ),
        (
            vec!["--zone", "+02:00", "--clock-offset", "30s"],
            "30s earlier",
        ),
        (
            vec!["--zone", "+02:00", "--clock-sigma", "1"],
            "is there with another --clock-sigma",
        ),
    ] {
        let (status, printed) = card.import("store", &options);
        assert!(
            status == Some(1)
                && printed.contains(words)
                && printed.contains("nothing was imported"),
            "{words}: {printed}"
        );
    }
    assert_eq!(card.shots("store").len(), 2);
    let (status, printed) = card.import("store", &["--zone", "+02:00"]);
    assert!(
        status == Some(0) && printed.contains("1 imported, 2 already there"),
        "{printed}"
    );
    // An error of UTC cannot be stated for a clock in an unknown zone.
    let done = run(&[
        "import",
        &card.path("card").to_string_lossy(),
        "--store",
        "x",
        "--clock-sigma",
        "1",
    ]);
    let message = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(
        done.status.code() == Some(2)
            && message.contains("3 images have no time zone; give --zone"),
        "{message}"
    );
}
