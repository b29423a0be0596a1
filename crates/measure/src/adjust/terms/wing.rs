//! Wing terms: deformation in flight, motion of the root, and dimensions from drawings.

use nalgebra::{DMatrix, Vector3};

use crate::adjust::beam::{
    BeamGrid, BeamSection, JOINTS, MAX_CURVATURE_TERMS, MAX_TWIST_TERMS, RAISE_TERMS,
    SectionMotion, TORQUE_POSITIONS,
};
use crate::adjust::causes::axis_height_covariance;
use crate::adjust::curve::AxisCurve;
use crate::adjust::estimated_dimensions::dimension_sigmas;
use crate::adjust::ground::GroundShape;
use crate::adjust::shapes::shape_covariance;
use crate::adjust::term::{ParameterTerm, TermEffect};
use crate::estimation::Prior;
use crate::setup::{DEFAULT_SCALE_SIGMA, Setup, SetupUncertainty, Thermal};
use crate::widths::{Unknown, Width};

/// Coefficients of the curvature, 1/m. If an amplitude is given, their ratios to the first have the prior of beam shapes.
pub fn curvature_term(terms: usize, amplitude_per_m: Option<f64>) -> ParameterTerm {
    let shape = |a: f64| Prior::centred(Unknown::Shape, 1, shape_covariance(terms) * (a * a));
    ParameterTerm {
        unknown: Unknown::Bending,
        missing: "bending cannot be determined from the available markers; markers along the whole span are needed",
        size: terms,
        priors: amplitude_per_m
            .filter(|_| terms > 1)
            .map(shape)
            .into_iter()
            .collect(),
        add_values: |x, values| values.curvature_per_m = x.to_vec(),
        effect: TermEffect::Wing {
            position: |state, k| state.by_bending[k],
            sections: bending_motions,
        },
    }
}

/// Motions of the sections by one function of bending.
fn bending_motions(curve: &AxisCurve, function: usize) -> Vec<SectionMotion> {
    let motion = |section: &BeamSection| SectionMotion {
        displacement_m: section.axis_by_bending[function],
        rotation_rad: Vector3::z() * section.slope_by_bending[function],
        twist_rad: section.twist_by_bending[function],
    };
    curve.bent.iter().map(motion).collect()
}

/// Compliances `FIRST`, ... with these means and standard deviations.
fn compliance_term<const FIRST: usize>(unknown: Unknown, known: &[(f64, f64)]) -> ParameterTerm {
    let prior = |(k, (mean, sigma)): (usize, &(f64, f64))| Prior::scalar(unknown, k, *mean, *sigma);
    ParameterTerm {
        unknown,
        missing: "what root and joints give with the load cannot be determined; give wing.root_flexibility_sigma_m",
        size: known.len(),
        priors: known.iter().enumerate().map(prior).collect(),
        add_values: |x, values| {
            values
                .compliances
                .iter_mut()
                .skip(FIRST)
                .zip(x)
                .for_each(|(value, x)| *value += x);
        },
        effect: TermEffect::Wing {
            position: |state, k| state.by_bending[MAX_CURVATURE_TERMS + FIRST + k],
            sections: |curve, k| bending_motions(curve, MAX_CURVATURE_TERMS + FIRST + k),
        },
    }
}

/// Mean of the root's flexibility over its standard deviation: a root gives with the load and never against it, and the mean of
/// the positive half of a normal distribution is 0.8 of its root mean square.
const ROOT_MEAN: f64 = 0.8;
/// Standard deviation of the place of the pivot about which the root rotates, from the root, as a fraction of the length: half
/// the width of a fuselage.
const PIVOT_SIGMA: f64 = 0.06;
/// Standard deviation of the rotation of a joint over that of the root: 1.5 mrad on an airliner whose tip rises by 3 m.
const JOINT_RATIO: f64 = 1.0;

/// Root and joints that give with the load, without those that are fixed.
pub fn compliance_terms(
    uncertainty: &SetupUncertainty,
    length_m: f64,
) -> impl Iterator<Item = ParameterTerm> {
    let root_m = Some(uncertainty[Width::RootFlexibility]).filter(|sigma_m| *sigma_m > 0.0);
    root_m.into_iter().flat_map(move |root_m| {
        let pivot = (0.0, PIVOT_SIGMA * length_m * root_m);
        let root = compliance_term::<0>(
            Unknown::RootFlexibility,
            &[(ROOT_MEAN * root_m, root_m), pivot],
        );
        [
            root,
            compliance_term::<2>(
                Unknown::Joints,
                &[(0.0, JOINT_RATIO * root_m); JOINTS.len()],
            ),
        ]
    })
}

/// Standard deviation of the first two terms of the twist, rad: a few degrees.
const TWIST_SIGMA_RAD: f64 = 0.1;
/// Standard deviation of the further terms of the twist, rad.
const TWIST_DETAIL_SIGMA_RAD: f64 = 0.02;

/// Motions of the sections by one function of the twist.
fn twist_motions(curve: &AxisCurve, function: usize) -> Vec<SectionMotion> {
    curve
        .bent
        .iter()
        .map(|section| section.by_twist[function])
        .collect()
}

/// Coefficients of the twist, rad; they precede the torques.
pub fn twist_term(terms: usize) -> ParameterTerm {
    let sigma = |k: usize| {
        if k < 2 {
            TWIST_SIGMA_RAD
        } else {
            TWIST_DETAIL_SIGMA_RAD
        }
    };
    ParameterTerm {
        unknown: Unknown::Twist,
        missing: "twist cannot be determined; markers near the leading and the trailing edge are needed",
        size: terms,
        priors: (0..terms)
            .map(|k| Prior::scalar(Unknown::Twist, k, 0.0, sigma(k)))
            .collect(),
        add_values: |x, values| values.twist_rad = x.to_vec(),
        effect: TermEffect::Wing {
            position: |state, k| state.by_twist[k],
            sections: |curve, k| twist_motions(curve, k),
        },
    }
}

/// Torques of control surfaces, as the twist at [`TORQUE_POSITIONS`], rad.
pub fn torque_term(sigma_rad: f64) -> Option<ParameterTerm> {
    (sigma_rad > 0.0).then(|| ParameterTerm {
        unknown: Unknown::Torque,
        missing: "the torque of control surfaces cannot be determined; give wing.torque_sigma_deg",
        size: TORQUE_POSITIONS.len(),
        priors: ParameterTerm::equal_priors(Unknown::Torque, TORQUE_POSITIONS.len(), sigma_rad),
        add_values: |x, values| {
            values
                .twist_rad
                .resize(MAX_TWIST_TERMS + TORQUE_POSITIONS.len(), 0.0);
            values
                .twist_rad
                .iter_mut()
                .skip(MAX_TWIST_TERMS)
                .zip(x)
                .for_each(|(twist, x)| *twist += x);
        },
        effect: TermEffect::Wing {
            position: |state, k| state.by_twist[MAX_TWIST_TERMS + k],
            sections: |curve, k| twist_motions(curve, MAX_TWIST_TERMS + k),
        },
    })
}

/// Height of the bending axis above the surveyed axis, coefficients of the powers of s/L, m. The prior combines the
/// uncertainty of the surface through the markers and of the skin height.
pub fn axis_height(ground: &GroundShape) -> ParameterTerm {
    let surface =
        DMatrix::from_column_slice(RAISE_TERMS, RAISE_TERMS, ground.axis_covariance.as_slice());
    let covariance = surface + axis_height_covariance(ground.skin_height_sigma_m);
    ParameterTerm {
        unknown: Unknown::AxisHeight,
        missing: "the height of the bending axis cannot be determined",
        size: RAISE_TERMS,
        priors: vec![Prior::centred(Unknown::AxisHeight, 0, covariance)],
        add_values: |x, values| {
            values
                .raise_m
                .iter_mut()
                .zip(x)
                .for_each(|(raise, x)| *raise += x)
        },
        effect: TermEffect::Wing {
            position: |state, k| state.by_raise[k],
            sections: |curve, k| {
                let moved = |section: &BeamSection| {
                    section.axis_by_raise[k] - Vector3::y() * section.raise_by_terms[k]
                };
                curve
                    .bent
                    .iter()
                    .map(|section| SectionMotion::displacement(moved(section)))
                    .collect()
            },
        },
    }
}

/// Thermal scale minus its expected value; `None`: fixed.
pub fn thermal_scale(thermal: Option<&Thermal>) -> Option<ParameterTerm> {
    let sigma = thermal.map_or(DEFAULT_SCALE_SIGMA, Thermal::scale_sigma);
    (sigma > 0.0).then(|| ParameterTerm {
        unknown: Unknown::ThermalScale,
        missing: "the thermal scale cannot be determined; give its standard deviation",
        size: 1,
        priors: vec![Prior::scalar(Unknown::ThermalScale, 0, 0.0, sigma)],
        add_values: |x, values| values.scale += x[0],
        effect: TermEffect::Wing {
            position: |state, _| state.by_scale,
            sections: |curve, _| {
                let moved =
                    |section: &BeamSection| (section.axis_m - curve.root_m) / curve.values.scale;
                curve
                    .bent
                    .iter()
                    .map(|section| SectionMotion::displacement(moved(section)))
                    .collect()
            },
        },
    })
}

/// Dimensions that the user takes from drawings, without those that are fixed: bending root, chordwise position of the
/// axis, direction of the span, sweep.
pub fn dimension_terms(setup: &Setup) -> impl Iterator<Item = ParameterTerm> {
    let all = [
        dimension_term::<0>(Unknown::RootOffset),
        dimension_term::<1>(Unknown::ChordOffset),
        dimension_term::<2>(Unknown::SpanDirection),
        dimension_term::<3>(Unknown::Sweep),
    ];
    let known = |(term, sigma): (ParameterTerm, f64)| {
        (sigma > 0.0).then(|| ParameterTerm {
            priors: vec![Prior::scalar(term.unknown, 0, 0.0, sigma)],
            ..term
        })
    };
    all.into_iter()
        .zip(dimension_sigmas(setup))
        .filter_map(known)
}

/// Estimated dimension with the index `WHICH` in [`dimension_sigmas`]. Motions are compared with those of a wing with another
/// value, of the same points.
fn dimension_term<const WHICH: usize>(unknown: Unknown) -> ParameterTerm {
    ParameterTerm {
        unknown,
        missing: "root offset, chord offset, span direction or sweep cannot be determined; give their standard deviations in [wing]",
        size: 1,
        priors: vec![],
        add_values: |x, values| values.estimated[WHICH] += x[0],
        effect: TermEffect::Wing {
            position: |state, _| state.by_estimated[WHICH],
            sections: |curve, _| {
                let Some(neighbour) = &curve.scene.neighbours[WHICH] else {
                    return vec![];
                };
                let own: Vec<f64> = curve
                    .arcs_m
                    .iter()
                    .map(|arc| (arc - neighbour.root_m).max(0.0))
                    .collect();
                let (there, sections) = curve.motions_on(&BeamGrid::new(&neighbour.ground, &own));
                let scale = curve.values.scale;
                let pairs = curve
                    .motions
                    .iter()
                    .zip(&curve.flat)
                    .zip(there.iter().zip(&sections));
                pairs
                    .map(|(here, there)| neighbour.motion_derivative(here, there, scale))
                    .collect()
            },
        },
    }
}

/// Rotation of the root relative to the cabin since the ground frame, about the wing frame's axes, rad. Targets fixed to
/// the cabin do not move.
fn root_rotation(sigma_rad: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::RootRotation,
        missing: "the root's rotation cannot be determined; give wing.root_rotation_sigma_mrad",
        size: 3,
        priors: ParameterTerm::equal_priors(Unknown::RootRotation, 3, sigma_rad),
        add_values: |x, values| values.root_rotation_rad += Vector3::from_column_slice(x),
        effect: TermEffect::Wing {
            position: |state, k| {
                state
                    .from_root_m
                    .map_or_else(Vector3::zeros, |from| Vector3::ith(k, 1.0).cross(&from))
            },
            sections: |curve, k| {
                let rotation_rad = Vector3::ith(k, 1.0);
                let motion = |section: &BeamSection| SectionMotion {
                    displacement_m: rotation_rad.cross(&(section.axis_m - curve.root_m)),
                    rotation_rad,
                    twist_rad: 0.0,
                };
                curve.bent.iter().map(motion).collect()
            },
        },
    }
}

/// Shift of the root relative to the cabin since the ground frame, m.
fn root_shift(sigma_m: f64) -> ParameterTerm {
    ParameterTerm {
        unknown: Unknown::RootShift,
        missing: "the root's shift cannot be determined; give wing.root_translation_sigma_m",
        size: 3,
        priors: ParameterTerm::equal_priors(Unknown::RootShift, 3, sigma_m),
        add_values: |x, values| values.root_translation_m += Vector3::from_column_slice(x),
        effect: TermEffect::Wing {
            position: |state, k| {
                state
                    .from_root_m
                    .map_or_else(Vector3::zeros, |_| Vector3::ith(k, 1.0))
            },
            sections: |curve, k| {
                vec![SectionMotion::displacement(Vector3::ith(k, 1.0)); curve.bent.len()]
            },
        },
    }
}

/// Terms of the root's motion relative to the cabin, without those that are fixed.
pub fn root_motion(uncertainty: &SetupUncertainty) -> impl Iterator<Item = ParameterTerm> {
    let turn = Some(uncertainty[Width::RootRotation])
        .filter(|sigma| *sigma > 0.0)
        .map(root_rotation);
    turn.into_iter().chain(
        Some(uncertainty[Width::RootTranslation])
            .filter(|sigma| *sigma > 0.0)
            .map(root_shift),
    )
}
