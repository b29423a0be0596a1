//! Drawing for applying the decals: the wing from above, to scale, with position and size of every marker, and the view of
//! the camera.

use maud::{Markup, PreEscaped, html};
use nalgebra::{Vector2, Vector3};

use wingd_evaluation::figures::plot::px;
use wingd_measure::setup::{Orientation, Setup, SurveyMarker};

/// Width of the drawing, mm: an A3 sheet in landscape format without margins.
const WIDTH_MM: f64 = 390.0;
/// Scales of a standard scale ruler.
const RULER_SCALES: [f64; 9] = [5.0, 10.0, 20.0, 25.0, 50.0, 100.0, 200.0, 250.0, 500.0];
const MARGIN_MM: f64 = 12.0;
/// Width of the camera view in the drawing, mm.
const PICTURE_MM: f64 = 220.0;
/// Minimum diameter of a drawn marker, mm.
const MIN_DIMENSION_MM: f64 = 0.9;
/// Number of corners of a drawn disc.
const DISC_CORNERS: usize = 24;
const STYLE: &str = "text{font:3.2px 'Segoe UI',Arial,'DejaVu Sans',sans-serif;fill:#17202c}\
.title{font-size:4.4px;font-weight:600}.thin{stroke:#9aa3af;stroke-width:.2;fill:none}\
.deflected{stroke:#c2571a;stroke-width:.25;fill:none}.marker{fill:#17202c}.cabin{fill:#c2571a}.window{fill:#f4f6f8;stroke:#9aa3af;stroke-width:.3}";

/// Returns a complete SVG file with lengths in mm. The camera view shows the wing at rest and with the tip deflected by
/// `tip_deflection_m`.
pub fn layout_svg(setup: &Setup, attitude: &Orientation, tip_deflection_m: f64) -> String {
    let plan = PlanView::from_setup(setup);
    let below = MARGIN_MM + plan.height_mm() + 20.0;
    let scale = PICTURE_MM / f64::from(setup.lens.width.max(1));
    let picture = CameraView {
        setup,
        attitude,
        tip_deflection_m,
        scale,
        left: MARGIN_MM,
        top: below,
    };
    let list = marker_list(setup, MARGIN_MM + PICTURE_MM + 8.0, below);
    let rows = 4.4 * (setup.markers.len() + 1) as f64;
    let height = below + (scale * f64::from(setup.lens.height)).max(rows) + MARGIN_MM;
    let content = html! {
        style { (PreEscaped(STYLE)) }
        rect width=(px(WIDTH_MM)) height=(px(height)) fill="#fff" {}
        (plan.draw())
        (picture.draw())
        (list)
    };
    let view = format!("0 0 {} {}", px(WIDTH_MM), px(height));
    let (width, height) = (format!("{}mm", px(WIDTH_MM)), format!("{}mm", px(height)));
    html! { svg xmlns="http://www.w3.org/2000/svg" viewBox=(view) width=(width) height=(height) { (content) } }
        .into_string()
}

/// Marker with its position in the wing frame, m.
type WingMarker<'a> = (&'a SurveyMarker, Vector3<f64>);

/// Wing from above: outboard to the right, aft downwards for a right wing.
struct PlanView<'a> {
    setup: &'a Setup,
    markers: Vec<WingMarker<'a>>,
    /// Scale denominator: metres on the wing per metre of the drawing.
    scale: f64,
    /// Smallest and largest position across the span, m.
    across: (f64, f64),
    /// Smallest and largest position along the span, m.
    along: (f64, f64),
}

impl<'a> PlanView<'a> {
    /// Chooses the extent and the scale of the drawing from the markers' positions.
    fn from_setup(setup: &'a Setup) -> Self {
        let frame = setup.wing_frame();
        let markers: Vec<WingMarker> = setup
            .markers
            .iter()
            .map(|m| (m, frame.wing_point(&m.position_m)))
            .collect();
        let range = |coordinate: fn(&Vector3<f64>) -> f64| {
            let all = markers
                .iter()
                .map(|(_, p)| coordinate(p))
                .filter(|v| v.is_finite());
            all.fold((0.0, 0.0), |(low, high): (f64, f64), v| {
                (low.min(v), high.max(v))
            })
        };
        let (along, across) = (range(|p| p.x), range(|p| p.z));
        let least = 1e3 * (along.1 - along.0 + 1.0) / (WIDTH_MM - 2.0 * MARGIN_MM);
        let scale = RULER_SCALES
            .into_iter()
            .find(|s| *s >= least)
            .unwrap_or(least);
        let (along, across) = (
            (along.0 - 0.5, along.1 + 0.5),
            (across.0 - 0.7, across.1 + 0.7),
        );
        Self {
            setup,
            markers,
            scale,
            across,
            along,
        }
    }

    fn height_mm(&self) -> f64 {
        1e3 * (self.across.1 - self.across.0) / self.scale
    }

    fn drawing_position_mm(&self, along_m: f64, across_m: f64) -> (f64, f64) {
        let mm = |m: f64| 1e3 * m / self.scale;
        (
            MARGIN_MM + mm(along_m - self.along.0),
            MARGIN_MM + mm(across_m - self.across.0),
        )
    }

    fn draw(&self) -> Markup {
        let (camera, tip) = (
            self.drawing_position_mm(0.0, 0.0),
            self.drawing_position_mm(self.along.1, 0.0),
        );
        let root = self.setup.root_offset_m;
        let (above, below) = (
            self.drawing_position_mm(root, self.across.0),
            self.drawing_position_mm(root, self.across.1),
        );
        let title = format!(
            "{}: from above, 1 : {:.0}. Outboard to the right; positions relative to the lens along and across the span, m",
            self.setup.name, self.scale
        );
        html! {
            text.title x=(px(MARGIN_MM)) y="8" { (title) }
            line.thin x1=(px(camera.0)) y1=(px(camera.1)) x2=(px(tip.0)) y2=(px(tip.1)) stroke-dasharray="2 1" {}
            line.thin x1=(px(above.0)) y1=(px(above.1)) x2=(px(below.0)) y2=(px(below.1)) {}
            text x=(px(above.0 + 1.0)) y=(px(below.1)) { "bending root" }
            circle cx=(px(camera.0)) cy=(px(camera.1)) r="1.2" fill="#17456f" {}
            text x=(px(camera.0 + 1.6)) y=(px(camera.1 - 1.6)) { "camera" }
            @for (marker, p) in &self.markers {
                @let (x, y) = self.drawing_position_mm(p.x, p.z);
                @let r = (0.5e3 * marker.diameter_m / self.scale).max(0.5 * MIN_DIMENSION_MM);
                circle class=(marker_css_class(marker)) cx=(px(x)) cy=(px(y)) r=(px(r)) {}
                text x=(px(x - 3.0)) y=(px(y - r - 1.0)) { (marker.id) }
            }
        }
    }
}

fn marker_css_class(marker: &SurveyMarker) -> &'static str {
    if marker.fixed { "cabin" } else { "marker" }
}

/// Camera view of the wing, at rest and deflected.
struct CameraView<'a> {
    setup: &'a Setup,
    attitude: &'a Orientation,
    tip_deflection_m: f64,
    scale: f64,
    left: f64,
    top: f64,
}

impl CameraView<'_> {
    /// Projects a point of the wing frame into the drawing; `None` if it is outside the image.
    fn image_point(&self, point_m: &Vector3<f64>) -> Option<(f64, f64)> {
        let survey = self.setup.wing_frame().wing_from_survey.inverse() * point_m;
        let pixel: Vector2<f64> = self
            .setup
            .lens
            .project(&(self.attitude.camera_from_survey * survey))?;
        let is_visible = self.setup.lens.contains(&pixel);
        is_visible.then_some((
            self.left + self.scale * pixel.x,
            self.top + self.scale * pixel.y,
        ))
    }

    /// Deflects a point in proportion to the square of its spanwise distance from the root, with the full deflection at
    /// `tip_m`.
    fn deflect_point(&self, point_m: &Vector3<f64>, tip_m: f64) -> Vector3<f64> {
        let root = self.setup.root_offset_m;
        let share = ((point_m.x - root) / (tip_m - root).max(1e-3)).max(0.0);
        point_m + Vector3::y() * (self.tip_deflection_m * share * share)
    }

    /// Returns the outline of a horizontal disc as polygon points; empty if part of it is outside the image.
    fn disc_outline(&self, centre_m: &Vector3<f64>, diameter_m: f64) -> String {
        let corner = |k: usize| {
            let (sin, cos) = (std::f64::consts::TAU * k as f64 / DISC_CORNERS as f64).sin_cos();
            self.image_point(&(centre_m + 0.5 * diameter_m * Vector3::new(cos, 0.0, sin)))
        };
        let Some(corners) = (0..DISC_CORNERS).map(corner).collect::<Option<Vec<_>>>() else {
            return String::new();
        };
        corners
            .iter()
            .map(|(x, y)| format!("{},{} ", px(*x), px(*y)))
            .collect()
    }

    fn draw(&self) -> Markup {
        let frame = self.setup.wing_frame();
        let placed: Vec<WingMarker> = self
            .setup
            .markers
            .iter()
            .map(|m| (m, frame.wing_point(&m.position_m)))
            .collect();
        let tip_m = placed
            .iter()
            .filter(|(m, _)| !m.fixed)
            .map(|(_, p)| p.x)
            .fold(0.0, f64::max);
        let size = (
            self.scale * f64::from(self.setup.lens.width),
            self.scale * f64::from(self.setup.lens.height),
        );
        html! {
            text.title x=(px(self.left)) y=(px(self.top - 3.0)) {
                "Camera view: at rest, and (outlined) with the tip deflected by " (self.tip_deflection_m) " m"
            }
            rect.window x=(px(self.left)) y=(px(self.top)) width=(px(size.0)) height=(px(size.1)) {}
            @for (marker, p) in &placed {
                polygon class=(marker_css_class(marker)) points=(self.disc_outline(p, marker.diameter_m)) {}
                @if !marker.fixed {
                    polygon.deflected points=(self.disc_outline(&self.deflect_point(p, tip_m), marker.diameter_m)) {}
                }
                @if let Some((x, y)) = self.image_point(p) { text x=(px(x + 2.0)) y=(px(y - 1.5)) { (marker.id) } }
            }
        }
    }
}

/// Lists the markers with shape, diameter and position.
fn marker_list(setup: &Setup, left: f64, top: f64) -> Markup {
    let frame = setup.wing_frame();
    let row = |k: usize| top + 4.4 * (k as f64 + 1.0);
    html! {
        text x=(px(left)) y=(px(top)) font-weight="600" { "marker, shape and diameter / m, along / m, across / m, below lens / m" }
        @for (k, m) in setup.markers.iter().enumerate() {
            @let p = frame.wing_point(&m.position_m);
            text x=(px(left)) y=(px(row(k))) {
                (m.id) "  " (m.shape.name()) " " (format!("{:.2}", m.diameter_m))
                (format!("   {:.2}   {:.2}   {:.2}", p.x, p.z, -p.y))
                @if m.fixed { "  fixed target" }
            }
        }
    }
}
