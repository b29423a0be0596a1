//! One kind of unknown of the spatial methods, and where its columns stand.

use std::sync::Arc;

use nalgebra::{DVector, Vector2, Vector3};

use super::beam::Section;
use super::curve::Curve;
use super::marker_state::MarkerState;
use super::scene::Predicted;
use super::values::Values;
use crate::measure::estimation::Prior;

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
#[derive(Clone, Copy, Debug)]
pub enum Effect {
    /// The wing in flight.
    Wing {
        /// d position of a marker, wing frame, m per its unit.
        position: fn(&MarkerState, usize) -> Vector3<f64>,
        /// d lift of the axis along the curve, m per its unit; empty where it does not lift the axis.
        lifts: fn(&Curve, usize) -> Vec<f64>,
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
}

impl Term {
    /// d position of a marker in flight, wing frame, m per the unknown's unit.
    pub fn position(&self, k: usize, state: &MarkerState) -> Vector3<f64> {
        match self.effect {
            Effect::Wing { position, .. } => position(state, k),
            Effect::Picture { .. } => Vector3::zeros(),
        }
    }

    /// d pixel in flight, px per the unknown's unit.
    pub fn in_flight(&self, k: usize, state: &MarkerState, predicted: &Predicted) -> Vector2<f64> {
        match self.effect {
            Effect::Wing { position, .. } => predicted.by_point * position(state, k),
            Effect::Picture { pixel, .. } => pixel(predicted, k),
        }
    }

    /// d pixel in the ground frame, px per the unknown's unit.
    pub fn on_ground(&self, k: usize, predicted: &Predicted) -> Vector2<f64> {
        match self.effect {
            Effect::Picture { pixel, on_ground: true } => pixel(predicted, k),
            _ => Vector2::zeros(),
        }
    }
}

/// First column of a set of unknowns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
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
    pub place: Place,
}

impl Placed {
    /// Adds its values to the model's.
    pub fn enter(&self, global: &DVector<f64>, local: &DVector<f64>, values: &mut Values) {
        let (vector, first) = match self.place {
            Place::Global(first) => (global, first),
            Place::Local(first) => (local, first),
        };
        (self.term.enter)(&vector.as_slice()[first..first + self.term.size], values);
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
        self.priors.extend(term.priors.iter().map(|prior| prior.clone().moved(first)));
        let place = if self.is_local { Place::Local(first) } else { Place::Global(first) };
        Placed { term: Arc::new(term), place }
    }
}
