//! Every kind of JPEG is read with the values of libjpeg-turbo's djpeg, or refused with a message; missing data
//! are noticed (fixtures/jpeg).

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use wingd::pipeline::decode::decode_image;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fixtures/jpeg")
        .join(name)
}

/// Width and height, px, and the luma's digest.
type Picture = (usize, usize, String);

/// Name, and expected content if it is readable.
fn kinds() -> Vec<(String, Option<Picture>)> {
    let text = std::fs::read_to_string(file("luma.csv")).unwrap();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let size = cells[1].parse().ok().zip(cells[2].parse().ok());
        (
            cells[0].to_owned(),
            size.map(|(w, h)| (w, h, cells[3].to_owned())),
        )
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn every_kind_has_the_values_of_djpeg_or_is_refused() {
    let rows = kinds();
    let files = std::fs::read_dir(file("")).unwrap();
    let pictures = files.filter(|f| {
        f.as_ref()
            .unwrap()
            .path()
            .extension()
            .is_some_and(|e| e == "jpg")
    });
    assert_eq!(pictures.count(), rows.len(), "luma.csv lists every file");
    for (name, expected) in rows {
        let bytes = std::fs::read(file(&name)).unwrap();
        match (decode_image(&bytes, None), expected) {
            (Ok(picture), Some((width, height, digest))) => {
                assert_eq!(
                    (picture.width(), picture.height()),
                    (width, height),
                    "{name}"
                );
                assert_eq!(
                    hex::encode(Sha256::digest(picture.luma())),
                    digest,
                    "{name}"
                );
            }
            (Err(error), None) => {
                let message = error.to_string();
                let has_remedy = message.contains("set the camera to baseline JPEG")
                    || message.contains("remove them");
                assert!(
                    has_remedy && !message.contains("damaged"),
                    "{name}: {message}"
                );
            }
            (read, expected) => panic!(
                "{name}: {:?} instead of {expected:?}",
                read.map(|p| p.width())
            ),
        }
    }
}

/// Of 100 removals of 200 bytes of coded data, one may be undetected.
#[test]
fn missing_bytes_in_any_kind_are_noticed() {
    for (name, read) in kinds() {
        let whole = std::fs::read(file(&name)).unwrap();
        if read.is_none() || whole.len() < 2000 || name == "bytes-after.jpg" {
            continue;
        }
        let scan = whole.windows(2).position(|w| w == [0xff, 0xda]).unwrap() + 14;
        let room = whole.len() - 2 - 200 - scan;
        let taken = (0..100).filter(|k| {
            let start = scan + room * k / 100;
            let cut = [&whole[..start], &whole[start + 200..]].concat();
            decode_image(&cut, None).is_ok()
        });
        let taken: Vec<usize> = taken.collect();
        assert!(
            taken.len() <= 1,
            "{name}: {taken:?} of 100 read as complete"
        );
    }
}
