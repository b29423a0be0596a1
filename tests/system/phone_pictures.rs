//! Promise: images of phones and cameras are read as the sensor has them, or named (docs/reference/files.md, Images).

use std::path::Path;

use image::{DynamicImage, GrayImage, ImageBuffer, Luma, Rgba};
use wingd::pipeline::decode::decode_image;

use crate::program::{fixture, outcome};

fn jpeg() -> Vec<u8> {
    std::fs::read(fixture("jpeg/baseline-2x1.jpg")).unwrap()
}

/// The JPEG with an Exif block that gives the rotation of the image.
fn with_orientation(orientation: u8) -> Vec<u8> {
    let entry = [0x01, 0x12, 0, 3, 0, 0, 0, 1, 0, orientation, 0, 0];
    let tiff = [b"MM\0*".as_slice(), &[0, 0, 0, 8, 0, 1], &entry, &[0; 4]].concat();
    let length = u16::try_from(tiff.len() + 8).unwrap().to_be_bytes();
    let jpeg = jpeg();
    [
        &jpeg[..2],
        &[0xff, 0xe1],
        &length,
        b"Exif\0\0",
        &tiff,
        &jpeg[2..],
    ]
    .concat()
}

fn png(picture: impl Into<DynamicImage>) -> Vec<u8> {
    let mut bytes = vec![];
    picture
        .into()
        .write_to(
            &mut std::io::Cursor::new(&mut bytes),
            image::ImageFormat::Png,
        )
        .unwrap();
    bytes
}

/// A ramp from black to white of 16 bits, down to its lower bits.
fn slope(shift: u32) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    ImageBuffer::from_fn(64, 48, |x, _| Luma([((x * 1040) >> shift) as u16]))
}

#[test]
fn an_orientation_tag_rotates_nothing_and_data_after_an_image_are_ignored() {
    let plain = decode_image(&jpeg(), None).unwrap();
    for orientation in 1..=8 {
        assert!(
            decode_image(&with_orientation(orientation), None)
                .unwrap()
                .luma()
                == plain.luma(),
            "{orientation}"
        );
    }
    let other = std::fs::read(fixture("dev/frames/ground.jpg")).unwrap();
    for behind in [&other[..], b"\0\0\0\x18ftypmp42 a film"] {
        assert!(
            decode_image(&[&jpeg(), behind].concat(), None)
                .unwrap()
                .luma()
                == plain.luma()
        );
    }
}

#[test]
fn sixteen_bit_images_are_read_by_their_upper_bits_and_named_if_those_are_empty() {
    let grey = |bytes: &[u8]| decode_image(bytes, None).map(|r| r.luma()[63]);
    // 63 x 1040 of 65535 is 254.9 of 255.
    assert_eq!(grey(&png(slope(0))), Ok(255));
    assert_eq!(grey(&png(slope(2))), Ok(64), "14 bits may be a dark image");
    let translucent = ImageBuffer::from_fn(64, 48, |x, _| Rgba([(4 * x) as u8; 4]));
    assert_eq!(grey(&png(translucent)), Ok(252));
    for (shift, bits) in [(4, 12), (6, 10)] {
        let reason = grey(&png(slope(shift))).unwrap_err().to_string();
        assert!(
            reason.contains(&format!("16 bits, of which only {bits} are used")),
            "{reason}"
        );
    }
    let black = GrayImage::new(64, 48);
    assert_eq!(grey(&png(black)), Ok(0));
    let samples: Vec<u8> = slope(6)
        .into_raw()
        .iter()
        .flat_map(|v| v.to_be_bytes())
        .collect();
    let ten_bits = [b"P5\n64 48\n1023\n".as_slice(), &samples].concat();
    assert!(
        matches!(grey(&ten_bits), Ok(250..)),
        "a PNM declared as 10 bits: {:?}",
        grey(&ten_bits)
    );
}

/// A TIFF with a reduced image of 8 x 8, like the beginning of a DNG.
fn raw_file() -> Vec<u8> {
    let entry = |tag: u16, kind: u16, count: u32, value: u32| -> Vec<u8> {
        [
            &tag.to_le_bytes()[..],
            &kind.to_le_bytes(),
            &count.to_le_bytes(),
            &value.to_le_bytes(),
        ]
        .concat()
    };
    let entries = [
        entry(254, 4, 1, 1),
        entry(256, 3, 1, 8),
        entry(257, 3, 1, 8),
        entry(258, 3, 1, 8),
        entry(259, 3, 1, 1),
        entry(262, 3, 1, 1),
        entry(273, 4, 1, 8),
        entry(277, 3, 1, 1),
        entry(278, 3, 1, 8),
        entry(279, 4, 1, 64),
    ];
    let count = u16::try_from(entries.len()).unwrap().to_le_bytes();
    [
        &b"II*\0\x48\0\0\0"[..],
        &[7; 64],
        &count,
        &entries.concat(),
        &[0; 4],
    ]
    .concat()
}

#[test]
fn unreadable_files_are_named_by_detect_and_calibrate() {
    let folder = tempfile::tempdir().unwrap();
    let board = folder.path().join("board.toml");
    std::fs::write(
        &board,
        "pattern = \"checkerboard\"\ncolumns = 8\nrows = 6\nsquare_m = 0.025\n",
    )
    .unwrap();
    let path = |file: &Path| file.to_string_lossy().into_owned();
    for (name, bytes, words) in [
        ("a.dng", raw_file(), "raw file"),
        (
            "a.heic",
            b"\0\0\0\x18ftypheic\0\0\0\0mif1heic, then \xff\xd8\xff a preview".to_vec(),
            "it is HEIC",
        ),
        (
            "a.webp",
            b"RIFF\x24\0\0\0WEBPVP8 and so on, not to be decoded".to_vec(),
            "use JPEG, PNG, PNM or TIFF",
        ),
        (
            "ten.png",
            png(slope(6)),
            "16 bits, of which only 10 are used",
        ),
    ] {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes).unwrap();
        let (status, printed) = outcome(&["detect", "--json", &path(&file)]);
        assert!(
            status == Some(1) && printed.contains(words),
            "{name}: {printed}"
        );
        let as_jpeg = folder.path().join(format!("{name}.jpg"));
        std::fs::copy(&file, &as_jpeg).unwrap();
        let store = folder.path().join("store");
        let (status, printed) = outcome(&["import", &path(&as_jpeg), "--store", &path(&store)]);
        assert!(
            status == Some(1) && printed.contains(words) && !store.exists(),
            "{name}: {printed}"
        );
        let out = path(&folder.path().join("camera.toml"));
        let (status, printed) = outcome(&[
            "calibrate",
            "--board",
            &path(&board),
            "--output",
            &out,
            &path(&file),
        ]);
        assert!(
            status == Some(1) && printed.contains(words) && printed.contains(name),
            "{name}: {printed}"
        );
    }
}

#[test]
fn names_that_are_not_utf8_stay_distinct() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let names = [b"fl\xfcgel.jpg".as_slice(), b"fl\xe4gel.jpg"].map(std::ffi::OsStr::from_bytes);
    let files = names.map(|name| folder.path().join(name));
    files
        .iter()
        .for_each(|file| std::fs::write(file, jpeg()).unwrap());
    let mut detect = std::process::Command::new(env!("CARGO_BIN_EXE_wingd"));
    let done = detect
        .args(["detect", "--json"])
        .args(&files)
        .output()
        .unwrap();
    let printed = String::from_utf8(done.stdout).unwrap();
    let images = printed
        .lines()
        .map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap()["image"].clone());
    assert_eq!(
        images.collect::<Vec<_>>(),
        ["fl\\xfcgel.jpg", "fl\\xe4gel.jpg"]
    );
}

#[test]
fn import_copies_readable_images_byte_by_byte_and_names_skipped_files() {
    let folder = tempfile::tempdir().unwrap();
    let (card, store) = (folder.path().join("card"), folder.path().join("store"));
    std::fs::create_dir(&card).unwrap();
    let mpo = [
        &jpeg()[..],
        &std::fs::read(fixture("dev/frames/ground.jpg")).unwrap(),
    ]
    .concat();
    let taken = [with_orientation(6), mpo, png(slope(0))];
    for (name, bytes) in ["a.jpg", "b.MPO", "c.png"].iter().zip(&taken) {
        std::fs::write(card.join(name), bytes).unwrap();
    }
    for name in ["a.dng", "d.heic"] {
        std::fs::write(card.join(name), raw_file()).unwrap();
    }
    let arguments = [
        "import",
        &card.to_string_lossy(),
        "--store",
        &store.to_string_lossy(),
    ];
    let (status, printed) = outcome(&arguments);
    assert!(
        status == Some(0) && printed.contains("3 imported"),
        "{printed}"
    );
    assert!(
        printed.contains("1 images of unsupported formats are skipped, first d.heic"),
        "{printed}"
    );
    let series = store.join("flights/f0001");
    let mut kept: Vec<Vec<u8>> = vec![];
    for folder in std::fs::read_dir(series)
        .unwrap()
        .map(|e| e.unwrap().path())
        .filter(|p| p.is_dir())
    {
        kept.extend(
            std::fs::read_dir(folder)
                .unwrap()
                .map(|e| std::fs::read(e.unwrap().path()).unwrap()),
        );
    }
    assert!(
        taken.iter().all(|bytes| kept.contains(bytes)),
        "{} files",
        kept.len()
    );
}
