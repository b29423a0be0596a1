//! Causes of a mismatch: small parametric modifications of setup and images, each with its correction.

use nalgebra::{Rotation3, Vector2, Vector3};

use super::subject::Subject;
use crate::observation::Estimate;
use crate::setup::Setup;

/// Error of an installation, of a frame or of manual marks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// Camera constants, relative; equal to a scale of the image about its principal point.
    ImageScale,
    /// Principal point, px.
    PrincipalPoint,
    /// Projection centre: one coordinate, or all three, m.
    Centre(Option<usize>),
    /// Lengths of survey and projection centre relative to the markers' diameters.
    SurveyScale,
    /// Coordinates of the survey relative to those of the projection centre.
    PointScale,
    /// Axes of the survey relative to those of the projection centre: index of a signed permutation.
    Axes(usize),
    /// Bend of the wing since the survey, at the tip, m.
    Bend,
    /// Rotation of the camera relative to the ground frames, rad.
    Turn,
    /// Image turned by 180 degrees relative to the ground frames.
    UpsideDown,
    /// Mirrored image, or left-handed axes of the survey.
    Mirrored,
    /// One coordinate of one surveyed marker, m.
    Point(usize, usize),
    /// Position of one manual mark, px.
    Mark(usize),
    /// Two exchanged names of the survey or of manual marks.
    Exchange(usize, usize),
    /// Image axes in which manual marks are counted: index in [`MARK_AXES`].
    MarkAxes(usize),
    /// Scale and projection centre at once with wide priors, for the search of identities only.
    Flexible,
}

/// Image axes of manual marks: description, and pixel from the coordinates of a mark and the size of the image, px.
type MarkAxesRow = (&'static str, fn(Vector2<f64>, Vector2<f64>) -> Vector2<f64>);

/// Image axes in which other programs count.
const MARK_AXES: [MarkAxesRow; 9] = [
    ("v is counted from below", |p, s| {
        Vector2::new(p.x, s.y - 1.0 - p.y)
    }),
    ("u is counted from the right", |p, s| {
        Vector2::new(s.x - 1.0 - p.x, p.y)
    }),
    ("u and v are exchanged", |p, _| p.yx()),
    ("they are of an image of half the size", |p, _| 2.0 * p),
    ("they are of an image of double size", |p, _| 0.5 * p),
    ("they are fractions of width and height", |p, s| {
        p.component_mul(&s)
    }),
    (
        "they are fractions of width and height with v from below",
        |p, s| Vector2::new(p.x * s.x, (1.0 - p.y) * s.y),
    ),
    ("they are counted from the middle of the image", |p, s| {
        p + 0.5 * s
    }),
    (
        "they are counted from the middle of the image with v upwards",
        |p, s| Vector2::new(p.x + 0.5 * s.x, 0.5 * s.y - p.y),
    ),
];

/// Number of signed permutations of three axes.
const AXES: usize = 48;
/// Orders of three axes.
const ORDERS: [[usize; 3]; 6] = [
    [0, 1, 2],
    [0, 2, 1],
    [1, 0, 2],
    [1, 2, 0],
    [2, 0, 1],
    [2, 1, 0],
];

/// Returns the axis and the sign that each coordinate is taken from.
fn axis_sources(index: usize) -> [(usize, f64); 3] {
    let order = ORDERS[index / 8 % ORDERS.len()];
    std::array::from_fn(|k| (order[k], if index >> k & 1 == 1 { -1.0 } else { 1.0 }))
}

impl Cause {
    /// Lists causes with continuous size that a ground frame or a frame in flight may have.
    pub(super) fn list_continuous(in_flight: bool) -> Vec<Self> {
        let mut all = vec![Self::ImageScale, Self::SurveyScale];
        all.extend([None, Some(0), Some(1), Some(2)].map(Self::Centre));
        // In flight the image's shift is one of the mounting.
        if in_flight {
            all.push(Self::Turn);
        } else {
            all.extend([Self::PrincipalPoint, Self::PointScale, Self::Bend]);
        }
        all
    }

    /// Lists permutations of the survey's axes other than the given one.
    pub(super) fn list_axes() -> impl Iterator<Item = Self> {
        (1..AXES).map(Self::Axes)
    }

    /// Lists image axes of manual marks.
    pub(super) fn list_mark_axes() -> impl Iterator<Item = Self> {
        (0..MARK_AXES.len()).map(Self::MarkAxes)
    }

    /// Returns the number of its parameters.
    pub(super) fn parameters(self) -> usize {
        match self {
            Self::ImageScale | Self::SurveyScale | Self::PointScale | Self::Bend => 1,
            Self::Point(..) | Self::Centre(Some(_)) => 1,
            Self::PrincipalPoint | Self::Mark(_) => 2,
            Self::Centre(None) | Self::Turn => 3,
            Self::Flexible => 4,
            Self::Axes(_)
            | Self::UpsideDown
            | Self::Mirrored
            | Self::Exchange(..)
            | Self::MarkAxes(_) => 0,
        }
    }

    /// Returns the number of causes of its kind that are tried, for `markers` of the survey.
    pub(super) fn alternatives(self, markers: usize) -> usize {
        match self {
            Self::Point(..) => 3 * markers,
            Self::Mark(_) => markers,
            Self::Exchange(..) => markers * markers,
            Self::Axes(_) => AXES,
            Self::Centre(_) => 4,
            Self::MarkAxes(_) => MARK_AXES.len(),
            _ => 1,
        }
    }

    /// Returns whether two causes are corrected at one place.
    pub(super) fn is_same_place(self, other: Self) -> bool {
        match (self, other) {
            (Self::Point(a, _), Self::Point(b, _)) => a == b,
            (Self::Centre(_), Self::Centre(_)) => true,
            _ => self == other,
        }
    }

    /// Returns steps of the parameters for differences: some hundredths of a pixel.
    pub(super) fn step(self) -> f64 {
        match self {
            Self::PrincipalPoint | Self::Mark(_) => 1e-2,
            Self::ImageScale
            | Self::SurveyScale
            | Self::PointScale
            | Self::Turn
            | Self::Flexible => 1e-6,
            _ => 1e-5,
        }
    }

    /// Returns the prior standard deviation of a parameter; infinite except for [`Cause::Flexible`]: 10 % of scale, and
    /// 0.3 m of the projection centre.
    pub(super) fn prior_sigma(self, parameter: usize) -> f64 {
        match (self, parameter) {
            (Self::Flexible, 0) => 0.1,
            (Self::Flexible, _) => 0.3,
            _ => f64::INFINITY,
        }
    }

    /// Returns the subject with the error corrected. Scales are logarithms.
    pub(super) fn apply(self, subject: &Subject, values: &[f64]) -> Subject {
        let mut new = subject.clone();
        let value = |k: usize| values.get(k).copied().unwrap_or(0.0);
        let setup = &mut new.setup;
        let size = Vector2::new(f64::from(setup.lens.width), f64::from(setup.lens.height));
        match self {
            Self::ImageScale | Self::Flexible => {
                setup.lens = setup
                    .lens
                    .with_flight_change(&Vector2::repeat(value(0).exp()), &Vector2::zeros());
                if self == Self::Flexible {
                    setup.projection_centre_m += Vector3::new(value(1), value(2), value(3));
                }
            }
            Self::PrincipalPoint => {
                setup.lens = setup
                    .lens
                    .with_flight_change(&Vector2::repeat(1.0), &Vector2::new(value(0), value(1)));
            }
            Self::Centre(Some(axis)) => setup.projection_centre_m[axis] += value(0),
            Self::Centre(None) => {
                setup.projection_centre_m += Vector3::new(value(0), value(1), value(2))
            }
            // Angles depend on ratios of lengths alone.
            Self::SurveyScale => setup
                .markers
                .iter_mut()
                .for_each(|m| m.diameter_m *= (-value(0)).exp()),
            Self::PointScale => setup
                .markers
                .iter_mut()
                .for_each(|m| m.position_m *= value(0).exp()),
            Self::Axes(index) => {
                let sources = axis_sources(index);
                for marker in &mut setup.markers {
                    let given = marker.position_m;
                    marker.position_m =
                        Vector3::from(sources.map(|(axis, sign)| sign * given[axis]));
                }
            }
            Self::Bend => new.bend_m += value(0),
            Self::Turn => {
                new.turn = Rotation3::new(Vector3::new(value(0), value(1), value(2))) * new.turn
            }
            Self::UpsideDown => new.map_pixels(|_, p| size - Vector2::repeat(1.0) - p),
            Self::Mirrored => new.map_pixels(|_, p| Vector2::new(size.x - 1.0 - p.x, p.y)),
            Self::Point(marker, axis) => setup.markers[marker].position_m[axis] += value(0),
            Self::Mark(marker) => {
                new.map_pixels(|m, p| {
                    if m == marker {
                        p + Vector2::new(value(0), value(1))
                    } else {
                        p
                    }
                });
            }
            Self::Exchange(a, b) => new.exchange_names(a, b),
            Self::MarkAxes(index) => {
                new.map_pixels(|_, p| MARK_AXES[index % MARK_AXES.len()].1(p, size))
            }
        }
        new
    }

    /// Describes the cause with its size and the correction, one sentence. `in_flight`: of a frame in flight.
    pub(super) fn describe(self, size: &[Estimate], setup: &Setup, in_flight: bool) -> String {
        let sizes = CauseSize {
            size,
            setup,
            in_flight,
        };
        sizes
            .camera_text(self)
            .or_else(|| sizes.survey_text(self))
            .unwrap_or_else(|| sizes.image_text(self))
    }
}

/// Size of a cause, for its description.
struct CauseSize<'a> {
    size: &'a [Estimate],
    setup: &'a Setup,
    in_flight: bool,
}

impl CauseSize<'_> {
    fn value(&self, k: usize) -> f64 {
        self.size.get(k).map_or(0.0, |e| e.value)
    }

    fn with_sigma(&self, k: usize, factor: f64, decimals: usize) -> String {
        let sigma = self.size.get(k).and_then(|e| e.sigma);
        let sigma = sigma.map_or(String::new(), |s| {
            format!(" ± {:.decimals$}", factor.abs() * s)
        });
        format!("{:.decimals$}{sigma}", factor * self.value(k))
    }

    fn id(&self, marker: usize) -> &str {
        self.setup.markers.get(marker).map_or("", |m| m.id.as_str())
    }

    fn camera_text(&self, cause: Cause) -> Option<String> {
        Some(match cause {
            Cause::ImageScale | Cause::Flexible if self.in_flight => {
                let (sign, word) = if self.value(0) < 0.0 {
                    (-100.0, "smaller")
                } else {
                    (100.0, "larger")
                };
                format!(
                    "the image is {} % {word} than that of the ground frames: zoom, focus, stabilisation or a correction \
                     of images has changed; use the settings of the ground frames, or take new ones",
                    self.with_sigma(0, sign, 2)
                )
            }
            Cause::ImageScale | Cause::Flexible => format!(
                "the focal length is off by {} %: camera.toml (fx, fy) is of another lens, zoom or size of image; \
                 calibrate this one",
                self.with_sigma(0, 100.0, 2)
            ),
            Cause::PrincipalPoint => format!(
                "the principal point is off by {} and {} px: check cx and cy of camera.toml, or whether the image was cropped",
                self.with_sigma(0, 1.0, 1),
                self.with_sigma(1, 1.0, 1)
            ),
            Cause::Centre(axis) => {
                let [off, axes] = match axis {
                    Some(axis) => [self.with_sigma(0, 1.0, 3), AXIS_NAMES[axis].to_owned()],
                    None => [
                        [0, 1, 2].map(|k| self.with_sigma(k, 1.0, 3)).join(", "),
                        AXIS_NAMES.join(", "),
                    ],
                };
                let or = if self.in_flight {
                    ", or take a ground frame from this place"
                } else {
                    ""
                };
                format!(
                    "the lens is off by {off} m in {axes}: correct camera.projection_centre_m of installation.toml{or}"
                )
            }
            Cause::Turn => {
                let axis_rad = Vector3::new(self.value(0), self.value(1), self.value(2));
                format!(
                    "the camera is turned by {:.0} px ({:.1} degrees) relative to the ground frames, but \
                     mount_repeatability_px is {}: take a ground frame with this mounting (`wingd orient`)",
                    self.setup.lens.focal_px() * axis_rad.xy().norm(),
                    axis_rad.norm().to_degrees(),
                    self.setup.mount_repeatability_px
                )
            }
            _ => return None,
        })
    }

    fn survey_text(&self, cause: Cause) -> Option<String> {
        Some(match cause {
            Cause::SurveyScale => {
                let (factor, sigma) = (
                    (-self.value(0)).exp(),
                    self.size.first().and_then(|e| e.sigma).unwrap_or(0.0),
                );
                format!(
                    "the markers look {factor:.3} ± {:.3} times as large as their distances predict: {}",
                    factor * sigma,
                    unit_hint(
                        self.value(0),
                        "check the scale of x_m, y_m, z_m, or diameter_m of survey.csv"
                    )
                )
            }
            Cause::PointScale => format!(
                "the coordinates of survey.csv need a factor of {:.4} to fit camera.projection_centre_m: {}",
                self.value(0).exp(),
                unit_hint(self.value(0), "check their scale and origin")
            ),
            Cause::Axes(index) => {
                let name = |(k, sign): (usize, f64)| {
                    format!("{}{}", if sign < 0.0 { "-" } else { "" }, AXIS_NAMES[k])
                };
                let axes = axis_sources(index).map(name).join(", ");
                format!(
                    "the axes of survey.csv are not those of camera.projection_centre_m, whose x, y, z are its {axes}"
                )
            }
            Cause::Bend if is_bent(self.value(0), self.setup) => format!(
                "the wing is bent by {:.1} m at the tip relative to the survey: the frame is from a flight",
                self.value(0)
            ),
            Cause::Bend => format!(
                "the wing tip is {} m higher than in the survey (fuel, jacks, sun): repeat the survey in the same state, or \
                 set [survey] bend_sigma_m",
                self.with_sigma(0, 1.0, 3)
            ),
            Cause::Point(marker, axis) => format!(
                "the survey of {} is off by {} m: check its {}_m in survey.csv, and survey it again",
                self.id(marker),
                self.with_sigma(0, -1.0, 3),
                AXIS_NAMES[axis]
            ),
            _ => return None,
        })
    }

    fn image_text(&self, cause: Cause) -> String {
        match cause {
            Cause::UpsideDown => "the image is upside down relative to the ground frames: turn it by 180 degrees, or mount \
                 the camera as before"
                .into(),
            Cause::Mark(marker) => format!(
                "the manual mark of {} is off by {:.1} px: mark it again, or check its name",
                self.id(marker),
                self.value(0).hypot(self.value(1))
            ),
            Cause::Exchange(a, b) => {
                format!("{} and {} have each other's names: exchange them", self.id(a), self.id(b))
            }
            Cause::MarkAxes(index) => format!(
                "the manual marks are in other image axes ({}): give u_px to the right and v_px downwards from the middle \
                 of the first pixel of the full image",
                MARK_AXES[index % MARK_AXES.len()].0
            ),
            _ => "the image fits the survey as its mirror image only: it was mirrored, it shows the other wing, or an axis \
                 of the survey points the wrong way"
                .into(),
        }
    }
}

/// Names of the axes of the survey.
const AXIS_NAMES: [&str; 3] = ["x", "y", "z"];

/// Smallest deflection of the outermost marker over its distance that a flight causes: jacks and fuel move it by less.
const MIN_BEND: f64 = 0.01;

/// Returns whether a wing is bent as in flight.
pub(super) fn is_bent(tip_m: f64, setup: &Setup) -> bool {
    tip_m.abs() > MIN_BEND * span_m(setup)
}

/// Returns the span from the projection centre to the outermost marker, m.
pub(crate) fn span_m(setup: &Setup) -> f64 {
    setup
        .wing_markers()
        .iter()
        .map(|(_, point)| point.x)
        .fold(1.0, f64::max)
}

/// Units of length that are confused with metres, in metres.
pub const UNITS: [(&str, f64); 4] = [
    ("feet", 0.3048),
    ("inches", 0.0254),
    ("centimetres", 0.01),
    ("millimetres", 1e-3),
];

/// Returns the remedy for a scale that is the logarithm of metres per unit, or of its inverse.
fn unit_hint(log_scale: f64, otherwise: &str) -> String {
    let is_unit = |(_, m): &&(&str, f64)| (log_scale.abs() + m.ln()).abs() < 0.03;
    match UNITS.iter().find(is_unit) {
        Some((name, _)) => {
            format!("a part of survey.csv and installation.toml is in {name}; give metres")
        }
        None => otherwise.to_owned(),
    }
}
