//! One kind of unknown of the spatial methods, and where its columns stand.

use std::sync::Arc;

use nalgebra::{DVector, Vector2, Vector3};

use super::beam::Section;
use super::curve::Curve;
use super::marker_state::MarkerState;
use super::scene::Predicted;
use super::values::Values;
use crate::estimation::Prior;

/// One kind of unknown: its columns, what is known of them beforehand, how the model takes them, and how all that is
/// measured or reported answers to them.
#[derive(Clone, Debug)]
pub struct Term {
    /// In a budget of variance.
    pub name: &'static str,
    /// What is missing where it cannot be determined; ends the sentence "the adjustment has no unique solution: …".
    pub missing: &'static str,
    /// Number of columns.
    pub size: usize,
    /// What is known of it beforehand, its columns counted from 0.
    pub priors: Vec<Prior>,
    /// Adds its values to the model's.
    pub enter: fn(&[f64], &mut Values),
    /// What answers to it.
    pub effect: Effect,
}

/// What answers to a term: derivatives by its k-th column.
#[derive(Clone, Debug)]
pub enum Effect {
    /// The wing in flight.
    Wing {
        /// d position of a marker, wing frame, m per its unit.
        position: fn(&MarkerState, usize) -> Vector3<f64>,
        /// d deflection of the axis along the curve, m per its unit; empty where it does not deflection the axis.
        deflections: fn(&Curve, usize) -> Vec<f64>,
        /// d twist of a section, rad per its unit.
        twist: fn(&Section, usize) -> f64,
    },
    /// The camera's picture.
    Picture {
        /// d pixel, px per its unit.
        pixel: fn(&Predicted, usize) -> Vector2<f64>,
        /// Whether it is the same in the ground frame, which else does not answer.
        on_ground: bool,
    },
    /// Markers are moved by a little.
    Moves(Displacement),
    /// The direction that deflections are counted along, in which the wing bends.
    Vertical {
        /// d deflection, m per its unit, where a marker is displaced by so much (wing frame, m).
        deflection: fn(&Vector3<f64>, usize) -> f64,
        /// d position of a marker, wing frame, m per its unit.
        position: fn(&MarkerState, usize) -> Vector3<f64>,
    },
}

/// When markers are displaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DisplacementEpoch {
    /// In flight: a part of a marker's position.
    InFlight,
    /// In the ground frame.
    OnGround,
    /// In flight at the instant of the marker's row, against that of the middle row, at which positions are given.
    AtItsRow,
}

/// Displacements of markers that go with an unknown, wing frame, m per its unit.
#[derive(Clone, Debug)]
pub struct Displacement {
    /// When.
    pub instant: DisplacementEpoch,
    /// Per column, per marker.
    pub fields: Vec<Vec<Vector3<f64>>>,
}

impl Displacement {
    fn by(&self, k: usize, marker: usize, instant: DisplacementEpoch) -> Vector3<f64> {
        if instant == self.instant { self.fields[k][marker] } else { Vector3::zeros() }
    }

    fn enter(&self, x: &[f64], values: &mut Values) {
        let target = match self.instant {
            DisplacementEpoch::InFlight => &mut values.moved_m,
            DisplacementEpoch::OnGround => &mut values.moved_on_ground_m,
            DisplacementEpoch::AtItsRow => &mut values.moved_at_row_m,
        };
        for (field, x) in self.fields.iter().zip(x) {
            target.resize(field.len(), Vector3::zeros());
            target.iter_mut().zip(field).for_each(|(moved, by)| *moved += by * *x);
        }
    }
}

impl Term {
    /// d position of a marker in flight, wing frame, m per the unknown's unit.
    pub fn position(&self, k: usize, state: &MarkerState) -> Vector3<f64> {
        match self.effect {
            Effect::Wing { position, .. } | Effect::Vertical { position, .. } => position(state, k),
            Effect::Moves(ref moves) => moves.by(k, state.marker, DisplacementEpoch::InFlight),
            Effect::Picture { .. } => Vector3::zeros(),
        }
    }

    /// d place of a marker in the ground frame, wing frame, m per the unknown's unit.
    pub fn ground(&self, k: usize, marker: usize) -> Vector3<f64> {
        match &self.effect {
            Effect::Moves(moves) => moves.by(k, marker, DisplacementEpoch::OnGround),
            _ => Vector3::zeros(),
        }
    }

    /// d deflection of a marker that is displaced by so much (wing frame, m), where the unknown changes what it is counted
    /// along, m per its unit.
    pub fn along_vertical(&self, k: usize, displacement_m: &Vector3<f64>) -> f64 {
        match &self.effect {
            Effect::Vertical { deflection, .. } => deflection(displacement_m, k),
            _ => 0.0,
        }
    }

    /// d deflection of the axis along the curve, m per the unknown's unit; empty where it does not deflection the axis.
    pub fn deflections(&self, k: usize, curve: &Curve) -> Vec<f64> {
        match &self.effect {
            Effect::Wing { deflections, .. } => deflections(curve, k),
            _ => vec![],
        }
    }

    /// d twist of a section, rad per the unknown's unit.
    pub fn twist(&self, k: usize, section: &Section) -> f64 {
        match &self.effect {
            Effect::Wing { twist, .. } => twist(section, k),
            _ => 0.0,
        }
    }

    /// d pixel in flight, px per the unknown's unit.
    pub fn in_flight(&self, k: usize, state: &MarkerState, predicted: &Predicted) -> Vector2<f64> {
        match self.effect {
            Effect::Wing { position, .. } | Effect::Vertical { position, .. } => {
                predicted.by_point * position(state, k)
            }
            Effect::Picture { pixel, .. } => pixel(predicted, k),
            Effect::Moves(ref moves) => {
                let at_row = moves.by(k, state.marker, DisplacementEpoch::AtItsRow);
                predicted.by_point * (at_row + moves.by(k, state.marker, DisplacementEpoch::InFlight))
            }
        }
    }

    /// d pixel in the ground frame, px per the unknown's unit.
    pub fn on_ground(&self, k: usize, marker: usize, predicted: &Predicted) -> Vector2<f64> {
        match self.effect {
            Effect::Picture { pixel, on_ground: true } => pixel(predicted, k),
            Effect::Moves(_) => predicted.by_point * self.ground(k, marker),
            _ => Vector2::zeros(),
        }
    }
}

/// First column of a set of unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterScope {
    /// Among the global parameters.
    Global(usize),
    /// Among the group's local parameters.
    Local(usize),
}

/// A term with its columns.
#[derive(Clone, Debug)]
pub struct Placed {
    /// What it is.
    pub term: Arc<Term>,
    /// Where it stands.
    pub place: ParameterScope,
}

impl Placed {
    /// Adds its values to the model's.
    pub fn enter(&self, global: &DVector<f64>, local: &DVector<f64>, values: &mut Values) {
        let (vector, first) = match self.place {
            ParameterScope::Global(first) => (global, first),
            ParameterScope::Local(first) => (local, first),
        };
        let x = &vector.as_slice()[first..first + self.term.size];
        (self.term.enter)(x, values);
        if let Effect::Moves(moves) = &self.term.effect {
            moves.enter(x, values);
        }
    }
}

/// Columns handed out one after the other, with what is known of them.
#[derive(Default)]
pub struct Columns {
    /// Per column: what is missing where it cannot be determined.
    pub missing: Vec<&'static str>,
    /// On the columns so far.
    pub priors: Vec<Prior>,
    is_local: bool,
}

impl Columns {
    /// For a group's own parameters.
    pub fn local() -> Self {
        Self { is_local: true, ..Self::default() }
    }

    /// Takes `n` columns that no term describes.
    pub fn take(&mut self, n: usize, missing: &'static str) -> usize {
        let first = self.missing.len();
        self.missing.extend(std::iter::repeat_n(missing, n));
        first
    }

    /// Takes a term's columns.
    pub fn place(&mut self, term: Term) -> Placed {
        let first = self.take(term.size, term.missing);
        self.priors.extend(term.priors.iter().map(|prior| prior.clone().shift_columns(first)));
        let place = if self.is_local { ParameterScope::Local(first) } else { ParameterScope::Global(first) };
        Placed { term: Arc::new(term), place }
    }
}
