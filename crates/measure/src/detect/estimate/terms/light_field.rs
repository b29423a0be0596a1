//! Light field: light and darkness that are not planes, as under the edge of a shadow, a soft smear or a bright patch.
//!
//! `L (1 + f) (1 - (k + d) c)^g`: `f` is bilinear between 9 x 3 knots over the marker, `d` linear between 6 knots along it,
//! all with the prior 0 and a standard deviation of 15 %: 33 unknowns in addition to those of the formula. The field is
//! accepted by the reduction of the weighted squares ([`super::super::lack_of_fit`]): in part from 120 variances, fully
//! from 280. Checked by `tests/detect/bad_light.rs` and, for its effect on standard deviations with JPEG,
//! `tests/detect/fixtures.rs`. Knots outside the outline would also follow dirt, and random structure in frames with JPEG.

use nalgebra::{Cholesky, DVector};

use super::knot_field::{
    self, CentreEstimate, JacobianRows, KnotCell, KnotLinearisation, KnotProblem, KnotTerm,
};
use crate::detect::appearance::formula::{GreyDerivatives, MarkerModel, Tone};
use crate::detect::appearance::parameters::{
    BLUR, GAMMA, LIGHT, MarkerParameters, MarkerPattern, N, WHITEST, X, Y,
};
use crate::detect::estimate::options::{ITERATION, TERM};
use crate::detect::estimate::prior::FitUnknowns;
use crate::detect::estimate::sandwich::{REACH, ResidualBlocks};
use crate::detect::estimate::{
    bounds::is_sharp, gauss_newton::MarkerFit, residuals::ResidualAnalysis,
};
use crate::detect::estimate::{normal_equations::biweight_roots, scale::robust_sigma};
use crate::detect::hypothesis::prior::PriorValue;
use crate::detect::numbers::TINY;
use crate::detect::sample::pixels::Pixels;
use crate::detect::simd::batch::Batch;
use crate::detect::simd::lanes::{LANES, each};

/// Knots of the light field along the marker. Chosen: the edge of a shadow is a few tenths of a marker wide;
/// `tests/detect/bad_light.rs`.
const LIGHT_ALONG: usize = 9;
/// Knots of the light field across the marker, along which light changes less.
const LIGHT_ACROSS: usize = 3;
/// Knots of the darkness along the marker.
const DARK_KNOTS: usize = 6;
/// Unknowns of the field.
const FIELD_UNKNOWNS: usize = LIGHT_ALONG * LIGHT_ACROSS + DARK_KNOTS;
/// Knots around a pixel: four of light, two of darkness.
const PIXEL_KNOTS: usize = 6;
/// Minimum number of foreign pixels around a position for the foreign object to reach it; one or two are noise.
const MIN_FOREIGN_PIXELS: usize = 3;

/// State of a fit with a light field: the parameters of the model, then those of the field. Pixels count from `origin`.
struct LightField {
    pattern: MarkerPattern,
    origin: [f64; 2],
    m: MarkerParameters,
    extra: [f64; FIELD_UNKNOWNS],
}

/// Returns batch and lane of the pixels that are farther than the blur from foreign pixels, to which the fit gave no
/// weight. A line that touches the marker also darkens the pixels next to it, by too little to be noticed in each.
fn clean_pixels(pixels: &Pixels, seen: &ResidualAnalysis, blur: f64) -> Vec<[usize; 2]> {
    let mut foreign = Vec::new();
    for (batch, tukey) in pixels.batches.iter().zip(&seen.biweights) {
        foreign.extend(
            (0..batch.len)
                .filter(|&i| tukey[i] <= 0.0)
                .map(|i| [batch.x[i], batch.y[i]]),
        );
    }
    let reach2 = TERM.foreign.at(blur).powi(2) as f32;
    let near = |x: f32, y: f32| {
        let near = foreign
            .iter()
            .filter(|f| (f[0] - x).powi(2) + (f[1] - y).powi(2) < reach2);
        near.take(MIN_FOREIGN_PIXELS).count() >= MIN_FOREIGN_PIXELS
    };
    let mut out = Vec::with_capacity(pixels.count());
    for (k, batch) in pixels.batches.iter().enumerate() {
        out.extend(
            (0..batch.len)
                .filter(|&i| !near(batch.x[i], batch.y[i]))
                .map(|i| [k, i]),
        );
    }
    out
}

/// Fits the marker with a light field, without the pixels of foreign objects. Returns `None` if the first step is predicted
/// to reduce the squared residuals by less than `least`, in variances of one residual. `least` is `None` if foreign pixels
/// distort the first step.
pub fn fit_light_field(
    pixels: &Pixels,
    fit: &MarkerFit,
    seen: &ResidualAnalysis,
    unknowns: &FitUnknowns,
    floor: f64,
    least: Option<f64>,
) -> Option<MarkerFit> {
    let mut list = Vec::with_capacity(N);
    list.extend((0..N).filter(|&k| unknowns.free[k]));
    let own = clean_pixels(pixels, seen, fit.parameters[BLUR]);
    if own.len() < 3 * N {
        return None;
    }
    let cells = group_pixels(pixels, own);
    let Pixels {
        pattern, origin, ..
    } = *pixels;
    let mut field = LightField {
        pattern,
        origin,
        m: fit.parameters,
        extra: [0.0; FIELD_UNKNOWNS],
    };
    let mut sizes: Vec<f32> = Vec::with_capacity(pixels.count());
    for (batch, r) in pixels.batches.iter().zip(&seen.residuals) {
        sizes.extend(r.iter().take(batch.len).map(|r| r.abs()));
    }
    let mut scale = floor.max(robust_sigma(&mut sizes))
        * if least.is_none() {
            ITERATION.scale_with_foreign
        } else {
            1.0
        };
    for iteration in 0..ITERATION.max_field_steps {
        let mut step = field.linearise(&cells, unknowns, &list, scale);
        for i in 0..step.normal.nrows() {
            step.normal[(i, i)] *=
                1.0 + ITERATION.field_damping[usize::from(iteration >= ITERATION.damped_steps)];
        }
        let change = Cholesky::new(step.normal)?.solve(&step.right);
        // The reduction of the squared residuals if the model is linear.
        if iteration == 0
            && least.is_some_and(|least| change.dot(&step.right) < least * fit.variance)
        {
            return None;
        }
        let worst = field.apply_step(&change, &list);
        let new = floor.max(robust_sigma(&mut step.sizes));
        if worst < ITERATION.field_tolerance_px && new > ITERATION.scale_ratio_converged * scale {
            break;
        }
        scale = new.max(0.5 * scale);
    }
    let m = &field.m;
    let step = field.linearise(&cells, unknowns, &list, scale);
    let variance = step.variance(list.len());
    let factor = Cholesky::new(step.normal.clone()).filter(|_| is_sharp(m))?;
    let centre = CentreEstimate::from_factor(&factor, &list, variance)?;
    let mut blocks = ResidualBlocks::new(pixels, m);
    let over = KnotProblem {
        cells: &cells,
        term: &field,
        list: &list,
        scale,
    };
    knot_field::add_centre_shifts(over, &centre.influence, &mut blocks);
    centre.to_marker_fit(m, &step, list.len(), &blocks, pixels.weight())
}

/// Returns the knot before a position on [-REACH, REACH], of `count` knots, and the weight of the next one.
#[inline(always)]
fn hat_position(at: f32, count: usize) -> (f32, f32) {
    let place = (at * (0.5 / REACH as f32) + 0.5) * (count - 1) as f32;
    let place = place.clamp(0.0, (count - 1) as f32);
    let low = place.floor().min((count - 2) as f32);
    (low, place - low)
}

/// Groups the pixels by the knots around them.
fn group_pixels(pixels: &Pixels, own: Vec<[usize; 2]>) -> Vec<KnotCell<PIXEL_KNOTS>> {
    let knots = |p: f32, q: f32| {
        [
            hat_position(p, LIGHT_ALONG),
            hat_position(q, LIGHT_ACROSS),
            hat_position(p, DARK_KNOTS),
        ]
        .map(|h| h.0 as usize)
    };
    knot_field::group_by_knots(
        pixels,
        own.into_iter(),
        LIGHT_ALONG * LIGHT_ACROSS * DARK_KNOTS,
        |batch, i| {
            let [along, across, dark] = knots(batch.p[i], batch.q[i]);
            let (first, after) = (
                along * LIGHT_ACROSS + across,
                LIGHT_ALONG * LIGHT_ACROSS + dark,
            );
            let knots = [
                first,
                first + 1,
                first + LIGHT_ACROSS,
                first + LIGHT_ACROSS + 1,
                after,
                after + 1,
            ];
            Some((first * DARK_KNOTS + dark, knots))
        },
    )
}

impl LightField {
    /// Applies a step, of at most 2 px of the centre. Returns the full step of the centre, px.
    fn apply_step(&mut self, change: &DVector<f64>, list: &[usize]) -> f64 {
        let place = |k: usize| list.iter().position(|&l| l == k).map_or(0.0, |i| change[i]);
        let worst = place(X).hypot(place(Y));
        let factor = (ITERATION.max_field_step_px / worst.max(TINY)).min(1.0);
        for (i, &k) in list.iter().enumerate() {
            self.m[k] += factor * change[i];
        }
        for (i, extra) in self.extra.iter_mut().enumerate() {
            *extra += factor * change[list.len() + i];
        }
        worst
    }

    /// Returns the normal equations including the priors.
    fn linearise(
        &self,
        cells: &[KnotCell<PIXEL_KNOTS>],
        unknowns: &FitUnknowns,
        list: &[usize],
        scale: f64,
    ) -> KnotLinearisation {
        let mut out = knot_field::linearise_term(KnotProblem {
            cells,
            term: self,
            list,
            scale,
        });
        list.iter()
            .enumerate()
            .for_each(|(i, &k)| out.add_prior(i, self.m[k], unknowns.prior[k], scale));
        for (k, &extra) in self.extra.iter().enumerate() {
            out.add_prior(list.len() + k, extra, PriorValue::zero(TERM.field), scale);
        }
        out
    }
}

impl KnotTerm<PIXEL_KNOTS> for LightField {
    const SHARED: usize = 0;

    fn knot_count(&self) -> usize {
        FIELD_UNKNOWNS
    }

    fn constrains_scale(_: f32) -> bool {
        true
    }

    #[inline(always)]
    fn model(&self) -> MarkerModel {
        MarkerModel::new(self.pattern, &self.m, self.origin)
    }

    #[inline(always)]
    fn jacobian_rows(
        &self,
        model: &MarkerModel,
        cell: &KnotCell<PIXEL_KNOTS>,
        batch: &Batch,
        scale: f64,
    ) -> JacobianRows<PIXEL_KNOTS> {
        let (s, t) = model.along_and_across(batch);
        let share = model.black_fraction(&s, &t);
        let extra = cell.knots.map(|k| self.extra[k] as f32);
        let (mut out, mut slopes) = (JacobianRows::new(), GreyDerivatives::default());
        for i in 0..LANES {
            let (p, q, c) = (batch.p[i], batch.q[i], share.c[i]);
            let (u, v, w) = (
                hat_position(p, LIGHT_ALONG).1,
                hat_position(q, LIGHT_ACROSS).1,
                hat_position(p, DARK_KNOTS).1,
            );
            let hats = [
                (1.0 - u) * (1.0 - v),
                (1.0 - u) * v,
                u * (1.0 - v),
                u * v,
                1.0 - w,
                w,
            ];
            let uneven =
                hats[0] * extra[0] + hats[1] * extra[1] + hats[2] * extra[2] + hats[3] * extra[3];
            let light = model.light_value([p, q]) + model.k[LIGHT] * uneven;
            let dark = model.darkness([p, q]) + hats[4] * extra[4] + hats[5] * extra[5];
            let Tone {
                linear,
                log,
                through,
            } = model.apply_tone_curve(1.0 - dark * c);
            let value = light * through;
            let open = if value < WHITEST { 1.0 } else { 0.0 };
            out.r[i] = batch.value[i] - if value < WHITEST { value } else { WHITEST };
            let (value, through) = (open * value, open * through);
            let slope = model.k[GAMMA] * value / linear;
            let (by_share, by_dark) = (-slope * dark, -slope * c);
            (slopes.black_fraction[i], slopes.dark[i]) = (by_share, by_dark);
            (slopes.light[i], slopes.gamma[i]) = (through, value * log);
            for (k, hat) in hats.into_iter().enumerate() {
                out.knots[k][i] = hat
                    * if k < 4 {
                        through * model.k[LIGHT]
                    } else {
                        by_dark
                    };
            }
        }
        slopes.write_gradient(model, &share, [&s, &t], batch, &mut out.gradient);
        let tukey = biweight_roots(&out.r, &out.gradient[X], &out.gradient[Y], scale);
        out.root = each(|i| batch.root[i] * tukey[i]);
        out
    }
}
