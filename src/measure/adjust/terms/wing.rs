//! What the wing does in flight and what drawings leave open of it.

use nalgebra::{DMatrix, DVector};

use crate::adjust::beam::{Grid, MAX_TWIST_TERMS, RAISE_TERMS, TORQUES};
use crate::adjust::estimated::sigmas;
use crate::adjust::ground::GroundShape;
use crate::adjust::shapes::shape_covariance;
use crate::adjust::term::{Effect, Term};
use crate::estimation::Prior;
use crate::setup::{Thermal, UNSTATED_SCALE_SIGMA, Uncertainty};

/// Coefficients of the curvature, 1/m. Where an amplitude is given, their ratios to the first are weighed with it by what
/// beams look like.
pub fn curvature(terms: usize, amplitude_per_m: Option<f64>) -> Term {
    let shape = |a: f64| Prior::centred("shape of bending", 1, shape_covariance(terms) * (a * a));
    Term {
        name: "bending",
        missing: "bending cannot be determined from the markers at hand; markers along the whole span are needed",
        size: terms,
        priors: amplitude_per_m.filter(|_| terms > 1).map(shape).into_iter().collect(),
        enter: |x, values| values.curvature_per_m = x.to_vec(),
        effect: Effect::Wing {
            position: |state, k| state.by_curvature[k],
            deflections: |curve, k| curve.bent.iter().map(|section| section.axis_by_curvature[k].y).collect(),
            twist: |_, _| 0.0,
        },
    }
}

/// Standard deviation of the first two terms of the twist, rad: a few degrees.
const TWIST_SIGMA_RAD: f64 = 0.1;
/// Of the further ones, rad.
const TWIST_DETAIL_SIGMA_RAD: f64 = 0.02;

/// Coefficients of the twist, rad; they enter before the torques.
pub fn twist(terms: usize) -> Term {
    let sigma = |k: usize| if k < 2 { TWIST_SIGMA_RAD } else { TWIST_DETAIL_SIGMA_RAD };
    Term {
        name: "twist",
        missing: "twist cannot be determined; markers near the leading and the trailing edge are needed",
        size: terms,
        priors: (0..terms).map(|k| Prior::scalar("twist", k, 0.0, sigma(k))).collect(),
        enter: |x, values| values.twist_rad = x.to_vec(),
        effect: Effect::Wing {
            position: |state, k| state.by_twist[k],
            deflections: |_, _| vec![],
            twist: |section, k| section.twist_by_terms[k],
        },
    }
}

/// Torques of control surfaces, by the twist at their places, rad: those of [`TORQUES`].
pub fn torques(sigma_rad: f64) -> Option<Term> {
    let name = "torque of control surfaces";
    (sigma_rad > 0.0).then(|| Term {
        name,
        missing: "the torque of control surfaces cannot be determined; give wing.torque_sigma_deg",
        size: TORQUES.len(),
        priors: (0..TORQUES.len()).map(|k| Prior::scalar(name, k, 0.0, sigma_rad)).collect(),
        enter: |x, values| {
            values.twist_rad.resize(MAX_TWIST_TERMS + TORQUES.len(), 0.0);
            values.twist_rad.iter_mut().skip(MAX_TWIST_TERMS).zip(x).for_each(|(twist, x)| *twist += x);
        },
        effect: Effect::Wing {
            position: |state, k| state.by_twist[MAX_TWIST_TERMS + k],
            deflections: |_, _| vec![],
            twist: |section, k| section.twist_by_terms[MAX_TWIST_TERMS + k],
        },
    })
}

/// How the doubt of the axis' height is spread along the span: its mean, then Legendre's polynomials of degree
/// 1 to 3 over the span. A misjudged share of a section's height is misjudged alike along the wing: the difference from
/// root to tip, twice the second figure, is left two fifths of the mean's doubt, as much as sections differ in what
/// their spars look like; bends a half and a quarter of the slope. An assumption.
const SKIN_HEIGHT_DOUBT: [f64; RAISE_TERMS] = [1.0, 0.2, 0.1, 0.05];
/// Rows: Legendre's polynomials of degree 0 to 3 on (0, 1); columns: powers of s/L.
const LEGENDRE_BY_POWERS: [[f64; RAISE_TERMS]; RAISE_TERMS] =
    [[1.0, 0.0, 0.0, 0.0], [-1.0, 2.0, 0.0, 0.0], [1.0, -6.0, 6.0, 0.0], [-1.0, 12.0, -30.0, 20.0]];

/// Height of the bending axis over the surveyed one, coefficients of the powers of s/L, m: known as well as the surface
/// through the markers and the skin height.
pub fn axis_height(ground: &GroundShape) -> Term {
    let mut covariance =
        DMatrix::from_column_slice(RAISE_TERMS, RAISE_TERMS, ground.axis_covariance.as_slice());
    for (doubt, powers) in SKIN_HEIGHT_DOUBT.into_iter().zip(LEGENDRE_BY_POWERS) {
        let powers = DVector::from_column_slice(&powers) * (doubt * ground.skin_height_sigma_m);
        covariance += &powers * powers.transpose();
    }
    Term {
        name: "height of the bending axis",
        missing: "the height of the bending axis cannot be determined",
        size: RAISE_TERMS,
        priors: vec![Prior::centred("height of the bending axis", 0, covariance)],
        enter: |x, values| values.raise_m.iter_mut().zip(x).for_each(|(raise, x)| *raise += x),
        effect: Effect::Wing {
            position: |state, k| state.by_raise[k],
            deflections: |curve, k| {
                curve
                    .bent
                    .iter()
                    .map(|section| section.axis_by_raise[k].y - section.raise_by_terms[k])
                    .collect()
            },
            twist: |_, _| 0.0,
        },
    }
}

/// Thermal scale less its expected value; `None`: held.
pub fn thermal_scale(thermal: Option<&Thermal>) -> Option<Term> {
    let sigma = thermal.map_or(UNSTATED_SCALE_SIGMA, Thermal::scale_sigma);
    (sigma > 0.0).then(|| Term {
        name: "thermal scale",
        missing: "the thermal scale cannot be determined; give its standard deviation",
        size: 1,
        priors: vec![Prior::scalar("thermal scale", 0, 0.0, sigma)],
        enter: |x, values| values.scale += x[0],
        effect: Effect::Wing {
            position: |state, _| state.by_scale,
            deflections: |curve, _| {
                let above_root = curve.bent.iter().map(|section| section.axis_m.y - curve.root_m.y);
                above_root.map(|y| y / curve.values.scale).collect()
            },
            twist: |_, _| 0.0,
        },
    })
}

/// What a user takes from drawings, without what is held: where bending starts, where along the chord the axis lies, in
/// which direction the span runs.
pub fn drawn(uncertainty: &Uncertainty) -> impl Iterator<Item = Term> {
    let all = [
        one_drawn::<0>("root offset"),
        one_drawn::<1>("chord offset of the bending axis"),
        one_drawn::<2>("direction of the span"),
    ];
    let known = |(term, sigma): (Term, f64)| {
        (sigma > 0.0).then(|| Term { priors: vec![Prior::scalar(term.name, 0, 0.0, sigma)], ..term })
    };
    all.into_iter().zip(sigmas(uncertainty)).filter_map(known)
}

/// The one of this number among [`sigmas`]. Deflections are compared with those of a wing that differs in it, at the same places.
fn one_drawn<const WHICH: usize>(name: &'static str) -> Term {
    Term {
        name,
        missing: "root offset, chord offset or span direction cannot be determined; give their standard deviations in [wing]",
        size: 1,
        priors: vec![],
        enter: |x, values| values.estimated[WHICH] += x[0],
        effect: Effect::Wing {
            position: |state, _| state.by_estimated[WHICH],
            deflections: |curve, _| {
                let Some(neighbour) = &curve.scene.neighbours[WHICH] else { return vec![] };
                let own: Vec<f64> =
                    curve.arcs_m.iter().map(|arc| (arc - neighbour.root_m).max(0.0)).collect();
                let there = curve.deflections_on(&Grid::new(&neighbour.ground, &own)).into_iter();
                there
                    .zip(curve.deflections_m())
                    .map(|(there, here)| (there - here) / neighbour.step)
                    .collect()
            },
            twist: |_, _| 0.0,
        },
    }
}
