//! Promise: a camera of another program is read as its own program reads it, or refused with the cause by name
//! (fixtures/cameras; docs/calibration.md).

use std::path::Path;

use wingd::exchange::{CameraFormat, ReadCamera, read_exchange, write_exchange};
use wingd::measure::geometry::Lens;

use crate::program::{fixture, outcome};

/// A file of fixtures/cameras, and the expected reading: the camera constant, or words of the refusal.
const CASES: [(&str, Result<f64, &[&str]>); 16] = [
    ("oldvalues_camera_info.yaml", Ok(1133.1)),
    ("oldblock_camera_info.yaml", Ok(1133.1)),
    ("kalibr-commented-camchain.yaml", Ok(2410.5)),
    ("good.cameramodel", Ok(2410.5)),
    ("inline-comment-camchain.yaml", Ok(2410.5)),
    ("multi-line-comment.yaml", Ok(2410.5)),
    ("rational5_camera_info.yaml", Ok(1484.1)),
    (
        "comment_camera_info.yaml",
        Err(&[
            "line 9, distortion_model",
            "\"equidistant\" is not a supported lens model",
        ]),
    ),
    (
        "opencv-equidistant.yaml",
        Err(&[
            "distortion_model",
            "\"equidistant\" is not a supported lens model",
        ]),
    ),
    (
        "opencv-fisheye-flag.yml",
        Err(&["fisheye_model", "is not a supported lens model"]),
    ),
    (
        "cahvor.cameramodel",
        Err(&[
            "lensmodel",
            "\"LENSMODEL_CAHVOR\" is not a supported lens model",
        ]),
    ),
    (
        "nocomma_camera_info.yaml",
        Err(&["distortion_coefficients", "5 numbers without commas"]),
    ),
    (
        "zeros_camera_info.yaml",
        Err(&["camera_matrix", "never calibrated"]),
    ),
    (
        "skew_camera_info.yaml",
        Err(&["camera_matrix", "skew of 4.26 px (row 1, column 2)"]),
    ),
    (
        "transposed_camera_info.yaml",
        Err(&["camera_matrix", "is transposed"]),
    ),
    (
        "stereo-camchain.yaml",
        Err(&["2 cameras: cam0, cam1", "--camera cam0"]),
    ),
];

#[test]
fn every_case_is_read_correctly_or_refused_by_name() {
    let directory = tempfile::tempdir().unwrap();
    let camera = directory.path().join("camera.toml");
    for (name, expected) in CASES {
        let file = fixture("cameras").join(name);
        let (status, printed) = outcome(&[
            "convert",
            &file.to_string_lossy(),
            &camera.to_string_lossy(),
        ]);
        match expected {
            Ok(fx) => {
                assert_eq!(status, Some(0), "{name}: {printed}");
                let lens = read_exchange(&camera, None, None).unwrap().lens;
                assert_eq!(lens.fx, fx, "{name}");
                assert!(
                    printed.contains(&format!("fx {fx}")) && printed.contains("dropped: "),
                    "{name}: {printed}"
                );
                std::fs::remove_file(&camera).unwrap();
            }
            Err(words) => {
                assert_eq!(status, Some(78), "{name}: {printed}");
                assert!(
                    words.iter().all(|word| printed.contains(word)),
                    "{name}: {printed}"
                );
                assert!(!camera.exists(), "{name}");
            }
        }
    }
}

#[test]
fn parameters_of_other_models_are_refused_by_name() {
    let directory = tempfile::tempdir().unwrap();
    let (file, camera) = (
        directory.path().join("camera.yaml"),
        directory.path().join("camera.toml"),
    );
    let sound = std::fs::read_to_string(fixture("cameras/opencv.yaml")).unwrap();
    let convert = |more: &str| {
        std::fs::write(&file, format!("{sound}\n{more}\n")).unwrap();
        outcome(&[
            "convert",
            &file.to_string_lossy(),
            &camera.to_string_lossy(),
        ])
    };
    for (more, model) in [
        ("xi: 1.2", "xi: is a parameter of the omnidirectional model"),
        (
            "xi: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 1.2 ]",
            "omnidirectional",
        ),
        ("fov: 0.93", "FOV"),
        ("alpha: 0.6", "unified or double sphere"),
        ("thin_prism: [ 0.001, 0.002, 0., 0. ]", "thin prism"),
        ("tau: [ 0., 0.02 ]", "tilted sensor"),
    ] {
        let (status, printed) = convert(more);
        assert!(
            status == Some(78) && printed.contains(model) && !camera.exists(),
            "{more}: {printed}"
        );
    }
    for zero in [
        "xi: 0.",
        "thin_prism: [ 0., 0., 0., 0. ]",
        "tau: [ 0., 0. ]",
    ] {
        let (status, printed) = convert(zero);
        assert!(status == Some(0) && camera.exists(), "{zero}: {printed}");
    }
}

#[test]
fn one_of_several_cameras_is_read_by_its_name() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory
        .path()
        .join("camera.toml")
        .to_string_lossy()
        .into_owned();
    let file = fixture("cameras/stereo-camchain.yaml")
        .to_string_lossy()
        .into_owned();
    let (status, printed) = outcome(&["convert", "--camera", "cam0", &file, &out]);
    assert!(
        status == Some(0)
            && printed.contains("cam0, pinhole, radtan")
            && printed.contains("fx 1210.5"),
        "{printed}"
    );
    let (status, printed) = outcome(&["convert", "--camera", "cam7", &file, &out]);
    assert!(
        status == Some(78) && printed.contains("its cameras are cam0, cam1"),
        "{printed}"
    );
    let (status, printed) = outcome(&["convert", "--camera", "cam0", &out, &out]);
    assert!(
        status == Some(78) && printed.contains("omit --camera"),
        "{printed}"
    );
}

fn lens() -> Lens {
    let pinhole = Lens::pinhole(1920, 1200, 2410.5, 955.0, 610.0);
    Lens {
        fy: 2409.8,
        k1: -0.11,
        k2: 0.07,
        p1: 0.0003,
        p2: -0.0002,
        k3: 0.01,
        ..pinhole
    }
}

fn read(directory: &Path, name: &str, text: &str) -> Result<ReadCamera, String> {
    let file = directory.join(name);
    std::fs::write(&file, text).unwrap();
    read_exchange(&file, None, None).map_err(|faults| {
        faults
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join("\n")
            .replace(&file.display().to_string(), "")
    })
}

#[test]
fn a_written_camera_comes_back_from_every_format() {
    let directory = tempfile::tempdir().unwrap();
    let rational = Lens {
        k1: 0.63,
        k2: 0.005,
        k3: -0.004,
        denominator: [0.97, 0.13, -0.014],
        ..lens()
    };
    for (name, format) in [
        ("a.toml", CameraFormat::Wingd),
        ("a.yaml", CameraFormat::Opencv),
        ("camera_info.yaml", CameraFormat::Ros),
        ("a-camchain.yaml", CameraFormat::Kalibr),
        ("a.cameramodel", CameraFormat::Mrcal),
    ] {
        for lens in [Lens { k3: 0.0, ..lens() }, lens(), rational] {
            let file = directory.path().join(name);
            match write_exchange(&file, &lens, format) {
                Err(error) => assert!(
                    format == CameraFormat::Kalibr && lens.k3 != 0.0,
                    "{name}: {error}"
                ),
                Ok(()) => {
                    let read = read_exchange(&file, None, None).unwrap();
                    assert_eq!((read.lens, read.format), (lens, format), "{name}");
                }
            }
        }
    }
}

/// PyYAML, which reads for ROS and Kalibr, takes `1e-5` for a text and `955` for an integer.
#[test]
fn numbers_are_written_as_every_reader_takes_them() {
    let directory = tempfile::tempdir().unwrap();
    let small = Lens {
        k3: 0.0,
        p1: 1e-5,
        p2: -3e-7,
        ..lens()
    };
    for (name, format) in [
        ("camera_info.yaml", CameraFormat::Ros),
        ("camchain.yaml", CameraFormat::Kalibr),
    ] {
        let file = directory.path().join(name);
        write_exchange(&file, &small, format).unwrap();
        let text = std::fs::read_to_string(&file).unwrap();
        assert!(
            text.contains("0.00001, -0.0000003") && text.contains("955.0"),
            "{text}"
        );
        assert_eq!(
            read_exchange(&file, None, None).unwrap().lens,
            small,
            "{name}"
        );
    }
}

/// OpenCV 5.0's `FileStorage` wrote these three files of one camera.
#[test]
fn opencvs_xml_and_json_are_read_like_its_yaml() {
    let directory = tempfile::tempdir().unwrap();
    for name in ["opencv.xml", "opencv.json", "opencv.yaml"] {
        let text = std::fs::read_to_string(fixture("cameras").join(name)).unwrap();
        let read = read(directory.path(), name, &text).unwrap();
        assert_eq!(
            (read.lens, read.format),
            (lens(), CameraFormat::Opencv),
            "{name}"
        );
        let printed = read.remarks.join("\n");
        if name.ends_with("json") {
            let commented = text
                .replace("1920,", "1920, // \"image_width\": 1280,")
                .replace("{\n", "{\n// a, \"b\": c\n");
            assert_eq!(
                self::read(directory.path(), name, &commented).unwrap(),
                read
            );
        }
        assert!(
            read.remarks.len() == 1 && printed.contains("no lens model is declared"),
            "{name}: {printed}"
        );
    }
}

#[test]
fn unsupported_models_and_elements_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let ros = |model: &str, matrix: &str, terms: &str| {
        format!(
            "image_width: 1920\nimage_height: 1200\ncamera_matrix: {{rows: 3, cols: 3, data: [{matrix}]}}\n\
             distortion_model: {model}\ndistortion_coefficients: {{rows: 1, cols: {}, data: [{terms}]}}\n",
            terms.split(',').count()
        )
    };
    let good = "2410.5, 0, 955, 0, 2409.8, 610, 0, 0, 1";
    let brown = "-0.11, 0.07, 0.0003, -0.0002, 0.01";
    let prism = format!("{brown}, 0, 0, 0, 0.001, 0, 0, 0");
    let tilt = format!("{brown}, 0, 0, 0, 0, 0, 0, 0, 0.02, 0");
    let zero = format!("{brown}, 0, 0, 0, 0, 0, 0, 0, 0, 0");
    for (text, words) in [
        (
            ros("thin_prism", good, brown),
            "\"thin_prism\" is not a supported lens model",
        ),
        (
            ros("rational_polynomial", good, &prism),
            "s1 = 0.001, a term of the thin prism model",
        ),
        (
            ros("rational_polynomial", good, &tilt),
            "tau_x = 0.02, a term of the tilt model",
        ),
        (
            ros("plumb_bob", good, &zero),
            "are 14 numbers, but distortion_model is plumb_bob",
        ),
        (
            ros("KannalaBrandt8", good, brown),
            "\"KannalaBrandt8\" is not a supported lens model",
        ),
        (
            ros("none", good, brown),
            "are not all 0, but distortion_model is none",
        ),
        (
            ros("~", good, brown),
            "is empty: this camera was never calibrated",
        ),
        (
            ros("plumb_bob", good, brown) + "lens: {maker: x, type: Kannala-Brandt4}\n",
            "\"Kannala-Brandt4\" is not a supported",
        ),
        (
            ros("plumb_bob", good, brown) + "lens: {fisheye: yes}\n",
            "line 6, fisheye: \"fisheye\" is not a supported",
        ),
        (
            ros("plumb_bob", good, brown) + "base: &b {x: 1}\n<<: *b\n",
            "<<: merges keys from elsewhere",
        ),
        (
            "M1: {rows: 3}\nD1: [0]\nM2: {rows: 3}\n".into(),
            "camera_matrix: is missing; the file has M1, D1, M2",
        ),
        (
            ros("''", good, brown),
            "is empty: this camera was never calibrated",
        ),
        (
            ros("plumb_bob", "2.4, 0, 0.9, 0, 2.4, 0.6, 0, 0, 1", brown),
            "camera constants of 2.4 and 2.4 px",
        ),
        (
            ros("plumb_bob", "2410, 0, 2955, 0, 2410, 610, 0, 0, 1", brown),
            "principal point at (2955, 610)",
        ),
        (
            ros("plumb_bob", "2410, 0, 955, 0, 2410, 610, 0, 0, 2", brown),
            "has 2 in row 3, column 3, not 1",
        ),
        (
            ros("plumb_bob", good, "-0.11, 0.07, .nan, 0, 0"),
            "\".nan\" is not a finite number",
        ),
        (ros("plumb_bob", good, "-0.11, 0.07, 0"), "has 3 numbers"),
        (
            ros("plumb_bob", good, brown) + "image_width: 1920\n",
            "image_width: occurs twice",
        ),
        (
            ros("plumb_bob", good, brown) + "---\nx: 1\n",
            "several documents",
        ),
        (ros("plumb_bob", good, brown) + "\tx: 1\n", "is not YAML"),
    ] {
        let refused = read(directory.path(), "x_camera_info.yaml", &text).unwrap_err();
        assert!(refused.contains(words), "{words}: {refused}");
    }
    let whole = read(
        directory.path(),
        "x_camera_info.yaml",
        &ros("rational_polynomial", good, &zero),
    )
    .unwrap();
    assert_eq!(whole.lens, lens(), "terms of 0 are no other model");
    for (model, left) in [
        ("radtan", ""),
        ("Brown Conrady", "---\n"),
        ("Plumb Bob", "...\n---\n~\n"),
    ] {
        let text = ros(model, good, brown) + left;
        let read = read(directory.path(), "x_camera_info.yaml", &text).unwrap();
        assert_eq!(
            (read.lens, read.model.as_str()),
            (lens(), "plumb_bob"),
            "{model}"
        );
    }
    let within: String = ros("plumb_bob", good, brown)
        .lines()
        .map(|line| format!("  {line}\n"))
        .collect();
    let text = format!("meta:\n  date: 2026-06-01\ncamera:\n{within}");
    let one = read(directory.path(), "x_camera_info.yaml", &text).unwrap();
    assert_eq!(
        (one.lens, one.name.as_deref()),
        (lens(), Some("camera")),
        "files other than cameras need no name"
    );
    let aliased = ros("plumb_bob", "*m", brown).replace("[*m]", "*m") + "";
    let anchored = format!("x: &m [{good}]\n{aliased}");
    let read = read(directory.path(), "x_camera_info.yaml", &anchored).unwrap();
    assert!(
        read.lens == lens() && read.remarks[0].contains("the key x is unknown"),
        "{:?}",
        read.remarks
    );
}

#[test]
fn every_unsupported_kalibr_and_mrcal_model_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let kalibr = |projection: &str, distortion: &str| {
        format!(
            "cam0:\n  camera_model: {projection}\n  distortion_model: {distortion}\n  intrinsics: [2410.5, 2409.8, 955, 610]\n  \
             distortion_coeffs: [-0.11, 0.07, 0.0003, -0.0002]\n  resolution: [1920, 1200]\n"
        )
    };
    for (projection, distortion) in [
        ("omni", "radtan"),
        ("eucm", "none"),
        ("ds", "none"),
        ("pinhole", "equidistant"),
        ("pinhole", "fov"),
        ("double_sphere", "radtan"),
    ] {
        let refused = read(
            directory.path(),
            "camchain.yaml",
            &kalibr(projection, distortion),
        )
        .unwrap_err();
        assert!(
            refused.contains("is not a supported lens model"),
            "{refused}"
        );
    }
    for model in [
        "CAHVOR",
        "CAHVORE_linearity=0.37",
        "STEREOGRAPHIC",
        "LONLAT",
        "SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=18_fov_x_deg=150",
    ] {
        let text = format!(
            "{{'lensmodel': 'LENSMODEL_{model}', 'intrinsics': [2410.5, 2409.8, 955, 610, 0, 0, 0, 0], 'imagersize': [1920, 1200]}}"
        );
        let refused = read(directory.path(), "x.cameramodel", &text).unwrap_err();
        assert!(
            refused.contains(model) && refused.contains("is not a supported lens model"),
            "{refused}"
        );
    }
}

#[test]
fn a_board_of_kalibr_is_read_and_other_targets_are_named() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("target.yaml");
    let board = |text: &str| {
        std::fs::write(&file, text).unwrap();
        wingd::exchange::load_board(&file)
            .map(|described| format!("{:?}", described.board))
            .unwrap_or_else(|faults| faults[0].to_string())
    };
    let grid = "target_type: 'aprilgrid' # gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088 # m\ntagSpacing: 0.3\ncodeOffset: 0\n";
    assert_eq!(
        board(grid),
        "AprilGrid { columns: 6, rows: 5, tag_m: 0.088, spacing: 0.3 }"
    );
    let checks = "target_type: checkerboard\ntargetCols: 8\ntargetRows: 6\nrowSpacingMeters: 0.025\ncolSpacingMeters: 0.025\n";
    assert_eq!(
        board(checks),
        "Checkerboard { columns: 8, rows: 6, square_m: 0.025 }"
    );
    for (text, words) in [
        (
            checks.replace("colSpacingMeters: 0.025", "colSpacingMeters: 0.03"),
            "only squares are supported",
        ),
        (
            grid.replace("aprilgrid", "circlegrid"),
            "\"circlegrid\" is not a supported target",
        ),
        (
            grid.replace("codeOffset: 0", "codeOffset: 36"),
            "line 6, codeOffset: is not 0",
        ),
        (
            format!("{grid}tagFamily: t25h9\n"),
            "line 7, tagFamily: is not a known key of a target",
        ),
        (grid.replace("tagCols: 6", "tagCols: 6.5"), "is 6.5"),
        (grid.replace("0.088", "88"), "tags of 88 m"),
        (
            grid.replace("tagRows: 5", "tagRow: 5"),
            "tagRows: is missing",
        ),
    ] {
        assert!(board(&text).contains(words), "{words}: {}", board(&text));
    }
}
