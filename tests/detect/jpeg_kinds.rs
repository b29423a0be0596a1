//! Every kind of JPEG is read with the values of libjpeg-turbo's djpeg, or refused in a sentence; what is missing from one
//! is noticed (fixtures/jpeg).

use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};
use wingd::pipeline::decode::decode;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/jpeg").join(name)
}

/// Width and height, px, and the luma's digest.
type Picture = (usize, usize, String);

/// Name, and what it holds where it is read.
fn kinds() -> Vec<(String, Option<Picture>)> {
    let text = std::fs::read_to_string(file("luma.csv")).unwrap();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let size = cells[1].parse().ok().zip(cells[2].parse().ok());
        (cells[0].to_owned(), size.map(|(w, h)| (w, h, cells[3].to_owned())))
    };
    text.lines().skip(1).map(row).collect()
}

#[test]
fn every_kind_has_the_values_of_djpeg_or_is_refused() {
    let rows = kinds();
    let files = std::fs::read_dir(file("")).unwrap();
    let pictures = files.filter(|f| f.as_ref().unwrap().path().extension().is_some_and(|e| e == "jpg"));
    assert_eq!(pictures.count(), rows.len(), "luma.csv lists every file");
    for (name, expected) in rows {
        let bytes = std::fs::read(file(&name)).unwrap();
        match (decode(&bytes, None), expected) {
            (Ok(picture), Some((width, height, digest))) => {
                assert_eq!((picture.width(), picture.height()), (width, height), "{name}");
                assert_eq!(hex::encode(Sha256::digest(picture.luma())), digest, "{name}");
            }
            (Err(error), None) => {
                let said = error.to_string();
                let mend = said.contains("set the camera to baseline JPEG") || said.contains("cut them off");
                assert!(mend && !said.contains("damaged"), "{name}: {said}");
            }
            (read, expected) => panic!("{name}: {:?} instead of {expected:?}", read.map(|p| p.width())),
        }
    }
}

/// Of 100 stretches of 200 bytes taken out of the coded data one may pass.
#[test]
fn a_stretch_lost_in_any_kind_is_noticed() {
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
            decode(&cut, None).is_ok()
        });
        let taken: Vec<usize> = taken.collect();
        assert!(taken.len() <= 1, "{name}: {taken:?} of 100 taken as whole");
    }
}
