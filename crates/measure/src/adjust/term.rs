//! Terms: the kinds of unknowns of the spatial methods, and their columns.

use std::sync::Arc;

use nalgebra::{DVector, Vector2, Vector3};

use super::beam::{BeamSection, SectionMotion};
use super::causes::WidenedPriors;
use super::curve::AxisCurve;
use super::marker_state::MarkerState;
use super::scene::PredictedPixel;
use super::values::UnknownValues;
use crate::estimation::{Prior, PriorName};
use crate::widths::Unknown;

impl From<Unknown> for PriorName {
    fn from(unknown: Unknown) -> Self {
        Self {
            unknown: unknown.name(),
            source: unknown.source(),
        }
    }
}

/// Kind of unknown: its columns and priors, its effect on the model, and the derivatives of all measured and reported
/// quantities.
#[derive(Clone, Debug)]
pub struct ParameterTerm {
    pub unknown: Unknown,
    /// Text for the case that the term cannot be determined; ends the sentence "the adjustment has no unique solution: …".
    pub missing: &'static str,
    /// Number of columns.
    pub size: usize,
    /// Priors, with columns counted from 0.
    pub priors: Vec<Prior>,
    /// Adds the term's values to the model's.
    pub add_values: fn(&[f64], &mut UnknownValues),
    pub effect: TermEffect,
}

/// Effect of a term: derivatives with respect to its k-th column.
#[derive(Clone, Debug)]
pub enum TermEffect {
    /// Effect on the wing in flight.
    Wing {
        /// d position of a marker, wing frame, m per unit.
        position: fn(&MarkerState, usize) -> Vector3<f64>,
        /// d motion of the sections along the curve, per unit; empty if they are not affected.
        sections: fn(&AxisCurve, usize) -> Vec<SectionMotion>,
    },
    /// Effect on the camera image.
    Image {
        /// d pixel, px per unit.
        pixel: fn(&PredictedPixel, usize) -> Vector2<f64>,
        /// True if the ground frame is affected in the same way; otherwise it is not affected.
        on_ground: bool,
    },
    /// Small displacements of markers.
    Displacement(Displacement),
    /// Effect on the direction along which deflections are counted and in which the wing bends.
    Vertical {
        /// d deflection of a marker with the given displacement (wing frame, m), m per unit.
        deflection: fn(&Vector3<f64>, usize) -> f64,
        /// d position of a marker, wing frame, m per unit.
        position: fn(&MarkerState, usize) -> Vector3<f64>,
        /// d motion of the sections along the curve, per unit.
        sections: fn(&AxisCurve, usize) -> Vec<SectionMotion>,
    },
}

/// Time at which markers are displaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DisplacementEpoch {
    /// In flight; part of a marker's position.
    InFlight,
    /// In the ground frame.
    OnGround,
    /// In flight at the time of the marker's image row, relative to the middle row, to which positions refer.
    AtMarkerRow,
}

/// Displacements of markers that belong to an unknown, wing frame, m per unit.
#[derive(Clone, Debug)]
pub struct Displacement {
    pub epoch: DisplacementEpoch,
    /// Displacements per column and marker.
    pub fields: Vec<Vec<Vector3<f64>>>,
    /// d motion of the section at a fraction of a length (m), per unit of a column, if the whole wing moves.
    pub of_section: Option<fn(usize, f64, f64) -> SectionMotion>,
}

impl Displacement {
    fn displacement_of(&self, k: usize, marker: usize, instant: DisplacementEpoch) -> Vector3<f64> {
        if instant == self.epoch {
            self.fields[k][marker]
        } else {
            Vector3::zeros()
        }
    }

    fn add_displacements_to(&self, x: &[f64], values: &mut UnknownValues) {
        let target = match self.epoch {
            DisplacementEpoch::InFlight => &mut values.moved_m,
            DisplacementEpoch::OnGround => &mut values.moved_on_ground_m,
            DisplacementEpoch::AtMarkerRow => &mut values.moved_at_row_m,
        };
        for (field, x) in self.fields.iter().zip(x) {
            target.resize(field.len(), Vector3::zeros());
            target
                .iter_mut()
                .zip(field)
                .for_each(|(moved, by)| *moved += by * *x);
        }
    }
}

impl ParameterTerm {
    /// Priors of `count` columns with mean 0 and this standard deviation.
    pub fn equal_priors(unknown: Unknown, count: usize, sigma: f64) -> Vec<Prior> {
        (0..count)
            .map(|k| Prior::scalar(unknown, k, 0.0, sigma))
            .collect()
    }

    /// d position of a marker in flight, wing frame, m per unit of the unknown.
    pub fn position_derivative(&self, k: usize, state: &MarkerState) -> Vector3<f64> {
        match self.effect {
            TermEffect::Wing { position, .. } | TermEffect::Vertical { position, .. } => {
                position(state, k)
            }
            TermEffect::Displacement(ref moves) => {
                moves.displacement_of(k, state.marker, DisplacementEpoch::InFlight)
            }
            TermEffect::Image { .. } => Vector3::zeros(),
        }
    }

    /// d position of a marker in the ground frame, wing frame, m per unit of the unknown.
    pub fn ground_derivative(&self, k: usize, marker: usize) -> Vector3<f64> {
        match &self.effect {
            TermEffect::Displacement(moves) => {
                moves.displacement_of(k, marker, DisplacementEpoch::OnGround)
            }
            _ => Vector3::zeros(),
        }
    }

    /// d height of the sections along the curve in the ground frame, m per unit of the unknown; empty if they are not affected.
    pub fn ground_rise(&self, curve: &AxisCurve) -> Vec<f64> {
        let sections = curve.flat.iter();
        match self.unknown {
            Unknown::GroundTwist => sections.map(|s| s.by_twist[0].displacement_m.y).collect(),
            Unknown::GroundBend => {
                let rise = |s: &BeamSection| s.axis_by_bending[0].y;
                let (Some(tip), Some(arc_m)) = (curve.flat.last(), curve.arcs_m.last()) else {
                    return vec![];
                };
                // Scaled as the markers' displacements: 1 m at the tip, extrapolated with the square of the length.
                let eta = arc_m / curve.scene.ground.axis.length_m;
                sections.map(|s| rise(s) * eta * eta / rise(tip)).collect()
            }
            _ => vec![],
        }
    }

    /// d deflection of a marker with the given displacement (wing frame, m), due to a change of the vertical, m per unit of
    /// the unknown.
    pub fn vertical_derivative(&self, k: usize, displacement_m: &Vector3<f64>) -> f64 {
        match &self.effect {
            TermEffect::Vertical { deflection, .. } => deflection(displacement_m, k),
            _ => 0.0,
        }
    }

    /// d motion of the sections along the curve, per unit of the unknown; empty if they are not affected.
    pub fn section_derivatives(&self, k: usize, curve: &AxisCurve) -> Vec<SectionMotion> {
        match &self.effect {
            TermEffect::Wing { sections, .. } | TermEffect::Vertical { sections, .. } => {
                sections(curve, k)
            }
            TermEffect::Displacement(Displacement {
                epoch: DisplacementEpoch::InFlight,
                of_section: Some(of),
                ..
            }) => {
                let length_m = curve.scene.ground.axis.length_m;
                curve
                    .arcs_m
                    .iter()
                    .map(|arc_m| of(k, arc_m / length_m, length_m))
                    .collect()
            }
            _ => vec![],
        }
    }

    /// Returns whether the values of the model omit the term's effect on the sections, which is linear.
    pub fn is_added_to_sections(&self) -> bool {
        let is_dimension = matches!(
            self.unknown,
            Unknown::RootOffset | Unknown::ChordOffset | Unknown::SpanDirection | Unknown::Sweep
        );
        is_dimension || !matches!(self.effect, TermEffect::Wing { .. })
    }

    /// d pixel in flight, px per unit of the unknown.
    pub fn flight_pixel_derivative(
        &self,
        k: usize,
        state: &MarkerState,
        predicted: &PredictedPixel,
    ) -> Vector2<f64> {
        match self.effect {
            TermEffect::Wing { position, .. } | TermEffect::Vertical { position, .. } => {
                predicted.by_point * position(state, k)
            }
            TermEffect::Image { pixel, .. } => pixel(predicted, k),
            TermEffect::Displacement(ref moves) => {
                let at_row = moves.displacement_of(k, state.marker, DisplacementEpoch::AtMarkerRow);
                predicted.by_point
                    * (at_row + moves.displacement_of(k, state.marker, DisplacementEpoch::InFlight))
            }
        }
    }

    /// d pixel in the ground frame, px per unit of the unknown.
    pub fn ground_pixel_derivative(
        &self,
        k: usize,
        marker: usize,
        predicted: &PredictedPixel,
    ) -> Vector2<f64> {
        match self.effect {
            TermEffect::Image {
                pixel,
                on_ground: true,
            } => pixel(predicted, k),
            TermEffect::Displacement(_) => predicted.by_point * self.ground_derivative(k, marker),
            _ => Vector2::zeros(),
        }
    }
}

/// First column of a term or other set of unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterScope {
    /// First column among the global parameters.
    Global(usize),
    /// First column among the group's local parameters.
    Local(usize),
}

/// Term with its allocated columns.
#[derive(Clone, Debug)]
pub struct PlacedTerm {
    pub term: Arc<ParameterTerm>,
    /// First column.
    pub scope: ParameterScope,
}

impl PlacedTerm {
    fn values<'x>(&self, global: &'x DVector<f64>, local: &'x DVector<f64>) -> &'x [f64] {
        let (vector, first) = match self.scope {
            ParameterScope::Global(first) => (global, first),
            ParameterScope::Local(first) => (local, first),
        };
        &vector.as_slice()[first..first + self.term.size]
    }

    /// Value of the term's `k`-th column.
    pub fn value(&self, k: usize, global: &DVector<f64>, local: &DVector<f64>) -> f64 {
        self.values(global, local)[k]
    }

    /// Adds the term's values to the model's.
    pub fn add_values(
        &self,
        global: &DVector<f64>,
        local: &DVector<f64>,
        values: &mut UnknownValues,
    ) {
        let x = self.values(global, local);
        (self.term.add_values)(x, values);
        if let TermEffect::Displacement(moves) = &self.term.effect {
            moves.add_displacements_to(x, values);
        }
    }
}

/// Allocator of consecutive columns, with their priors.
#[derive(Default)]
pub struct ColumnAllocator {
    /// Text per column for the case that it cannot be determined.
    pub missing: Vec<&'static str>,
    /// Priors on the columns allocated so far.
    pub priors: Vec<Prior>,
    /// Stated widths that are increased.
    widened: WidenedPriors,
    is_local: bool,
}

impl ColumnAllocator {
    /// Creates an allocator of global parameters.
    pub fn global(widened: &WidenedPriors) -> Self {
        Self {
            widened: widened.clone(),
            ..Self::default()
        }
    }

    /// Creates an allocator for a group's local parameters.
    pub fn local() -> Self {
        Self {
            is_local: true,
            ..Self::default()
        }
    }

    /// Allocates `n` columns without a term; returns the first.
    pub fn allocate(&mut self, n: usize, missing: &'static str) -> usize {
        let first = self.missing.len();
        self.missing.extend(std::iter::repeat_n(missing, n));
        first
    }

    /// Allocates the columns of a term.
    pub fn allocate_term(&mut self, term: ParameterTerm) -> PlacedTerm {
        let first = self.allocate(term.size, term.missing);
        let prior = |prior: &Prior| {
            self.widened
                .apply_to(term.unknown, prior.clone())
                .shift_columns(first)
        };
        self.priors.extend(term.priors.iter().map(prior));
        let scope = if self.is_local {
            ParameterScope::Local(first)
        } else {
            ParameterScope::Global(first)
        };
        PlacedTerm {
            term: Arc::new(term),
            scope,
        }
    }
    /// Allocates the columns of terms, in their order.
    pub fn allocate_terms(
        &mut self,
        terms: impl IntoIterator<Item = ParameterTerm>,
    ) -> Vec<PlacedTerm> {
        terms
            .into_iter()
            .map(|term| self.allocate_term(term))
            .collect()
    }
}
