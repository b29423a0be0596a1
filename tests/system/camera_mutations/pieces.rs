//! A camera as the pieces of a file of each format, written by this test's own code.

use wingd::measure::geometry::Lens;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Format {
    OpencvYaml,
    OpencvXml,
    OpencvJson,
    Ros,
    Kalibr,
    Mrcal,
}

pub const FORMATS: [Format; 6] = [
    Format::OpencvYaml,
    Format::OpencvXml,
    Format::OpencvJson,
    Format::Ros,
    Format::Kalibr,
    Format::Mrcal,
];

/// A camera as named lists of numbers and texts: the content of a file.
#[derive(Clone, Debug)]
pub struct Pieces {
    pub format: Format,
    pub size: Vec<String>,
    /// fx fy cx cy.
    pub core: Vec<String>,
    pub terms: Vec<String>,
    /// The number of terms in the file.
    pub stated: usize,
    pub model: String,
    /// For formats with a matrix: its nine elements in the file's order.
    pub matrix: Option<Vec<String>>,
}

pub fn lens(format: Format) -> Lens {
    let k3 = if format == Format::Kalibr {
        0.0
    } else {
        0.0123
    };
    let pinhole = Lens::pinhole(1920, 1200, 2410.5, 955.25, 610.75);
    Lens {
        fy: 2409.8,
        k1: -0.1123,
        k2: 0.0745,
        p1: 0.00031,
        p2: -0.00027,
        k3,
        ..pinhole
    }
}

impl Pieces {
    pub fn new(format: Format) -> Self {
        let l = lens(format);
        let texts = |values: &[f64]| values.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>();
        let terms = [l.k1, l.k2, l.p1, l.p2, l.k3];
        let terms = texts(if format == Format::Kalibr {
            &terms[..4]
        } else {
            &terms
        });
        let model = match format {
            Format::Ros => "plumb_bob",
            Format::Kalibr => "radtan",
            Format::Mrcal => "LENSMODEL_OPENCV5",
            _ => "",
        };
        let matrix = !matches!(format, Format::Kalibr | Format::Mrcal);
        let matrix = matrix.then(|| texts(&[l.fx, 0.0, l.cx, 0.0, l.fy, l.cy, 0.0, 0.0, 1.0]));
        let size = vec!["1920".to_owned(), "1200".to_owned()];
        let core = texts(&[l.fx, l.fy, l.cx, l.cy]);
        Self {
            format,
            size,
            core,
            stated: terms.len(),
            terms,
            model: model.into(),
            matrix,
        }
    }

    pub fn name(&self) -> &'static str {
        match self.format {
            Format::OpencvYaml => "camera.yaml",
            Format::OpencvXml => "camera.xml",
            Format::OpencvJson => "camera.json",
            Format::Ros => "wing_camera_info.yaml",
            Format::Kalibr => "wing-camchain.yaml",
            Format::Mrcal => "wing.cameramodel",
        }
    }

    /// The blocks of the file, each of complete lines; their order has no meaning.
    pub fn blocks(&self) -> Vec<String> {
        let list = |values: &[String]| values.join(", ");
        let matrix = self.matrix.clone().unwrap_or_default();
        let (m, d, n) = (list(&matrix), list(&self.terms), self.stated);
        let size = |k: usize| self.size.get(k).cloned().unwrap_or_default();
        match self.format {
            Format::OpencvYaml => vec![
                format!("image_width: {}\n", size(0)),
                format!("image_height: {}\n", size(1)),
                format!("camera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ {m} ]\n"),
                format!(
                    "distortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: {n}\n   dt: d\n   data: [ {d} ]\n"
                ),
                "avg_reprojection_error: 0.21\n".into(),
            ],
            Format::Ros => vec![
                format!("image_width: {}\n", size(0)),
                format!("image_height: {}\n", size(1)),
                "camera_name: wing\n".into(),
                format!("camera_matrix:\n  rows: 3\n  cols: 3\n  data: [{m}]\n"),
                format!("distortion_model: {}\n", self.model),
                format!("distortion_coefficients:\n  rows: 1\n  cols: {n}\n  data: [{d}]\n"),
                "rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n".into(),
            ],
            Format::OpencvXml => {
                let words = |values: &[String]| values.join(" ");
                let matrix = |name: &str, rows: usize, cols: usize, data: &str| {
                    format!(
                        "<{name} type_id=\"opencv-matrix\">\n  <rows>{rows}</rows>\n  <cols>{cols}</cols>\n  <dt>d</dt>\n  \
                         <data>\n    {data}</data>\n</{name}>\n"
                    )
                };
                vec![
                    format!("<image_width>{}</image_width>\n", size(0)),
                    format!("<image_height>{}</image_height>\n", size(1)),
                    matrix("camera_matrix", 3, 3, &words(&self.matrix.clone().unwrap_or_default())),
                    matrix("distortion_coefficients", 1, n, &words(&self.terms)),
                ]
            }
            // Keys and values as blocks without the commas between them, which [`Pieces::framed`] adds.
            Format::OpencvJson => {
                vec![
                    format!("    \"image_width\": {}\n", size(0)),
                    format!("    \"image_height\": {}\n", size(1)),
                    json_matrix("camera_matrix", 3, 3, &m),
                    json_matrix("distortion_coefficients", 1, n, &d),
                ]
            }
            Format::Kalibr => vec![
                "  camera_model: pinhole\n".into(),
                format!("  intrinsics: [{}]\n", list(&self.core)),
                format!("  distortion_model: {}\n", self.model),
                format!("  distortion_coeffs: [{d}]\n"),
                format!("  resolution: [{}]\n", list(&self.size)),
                "  rostopic: /wing/image_raw\n".into(),
            ],
            Format::Mrcal => vec![
                format!("    'lensmodel':  '{}',\n", self.model),
                format!("    'intrinsics': [ {}, {d},],\n", list(&self.core)),
                "    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n".into(),
                format!("    'imagersize': [ {},],\n", list(&self.size)),
            ],
        }
    }

    pub fn framed(&self, blocks: &[String]) -> String {
        let body = blocks.concat();
        match self.format {
            Format::OpencvYaml => format!("%YAML:1.0\n---\n{body}"),
            Format::OpencvXml => {
                format!("<?xml version=\"1.0\"?>\n<opencv_storage>\n{body}</opencv_storage>\n")
            }
            Format::OpencvJson => {
                let blocks: Vec<&str> = blocks
                    .iter()
                    .map(|block| block.trim_end_matches('\n'))
                    .collect();
                format!("{{\n{}\n}}\n", blocks.join(",\n"))
            }
            Format::Ros => body,
            Format::Kalibr => format!("cam0:\n{body}"),
            Format::Mrcal => format!("{{\n{body}}}\n"),
        }
    }

    pub fn text(&self) -> String {
        self.framed(&self.blocks())
    }

    /// The matrix again, if the core was changed.
    pub fn with_core(mut self) -> Self {
        if let Some(m) = &mut self.matrix {
            for (at, k) in [(0, 0), (4, 1), (2, 2), (5, 3)] {
                m[at] = self.core[k].clone();
            }
        }
        self
    }
}

fn json_matrix(name: &str, rows: usize, cols: usize, data: &str) -> String {
    format!(
        "    \"{name}\": {{\n        \"type_id\": \"opencv-matrix\",\n        \"rows\": {rows},\n        \
                         \"cols\": {cols},\n        \"dt\": \"d\",\n        \"data\": [ {data} ]\n    }}\n"
    )
}
