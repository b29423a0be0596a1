//! First guesses in flight: deflections of a family of shapes, with any shift of the mount.

use nalgebra::Vector2;

use super::beam::WingState;
use super::fit::{MatchedPair, StatePrior, select_one_to_one};
use super::matching::MatchingProblem;

/// Cell size of the vote over the image shift, px; a vote counts in a block of 3 x 3 cells.
const CELL_PX: f64 = 20.0;
const MAX_CELLS: usize = 31;
/// Motion of the outermost marker between two deflections of the scan, px.
const STEP_PX: f64 = 30.0;
/// Range of the tip deflection over span.
pub(super) const DEFLECTION_RANGE: (f64, f64) = (-0.11, 0.22);
/// Curvature over the span as coefficients, and L^2 * curvature / tip deflection: (1 - x)(1 + 3x) for a strong taper, 1, 1
/// - x, (1 - x)^2.
pub(super) const FAMILY: [([f64; 3], f64); 4] = [
    ([1.0, 0.0, 3.0], 12.0 / 7.0),
    ([1.0, 1.0, 0.0], 2.0),
    ([1.0, 0.0, 0.0], 3.0),
    ([1.0, 0.0, -1.0], 4.0),
];
const MAX_GUESSES: usize = 8;

/// A deflection and a shift, with the pairs that agree on it.
#[derive(Clone, Debug)]
pub(super) struct StateGuess {
    pub(super) prior: StatePrior,
    pub(super) pairs: Vec<MatchedPair>,
    cell: usize,
}

/// Returns the half width of the vote, px: mounts shift by 40 px, or more if the installation says so.
fn window_px(mount_repeatability_px: f64) -> f64 {
    (3.0 * mount_repeatability_px).clamp(60.0, 0.5 * CELL_PX * (MAX_CELLS - 3) as f64)
}

/// Returns the best guesses, best first.
pub(super) fn scan_deflections(problem: &MatchingProblem<'_>) -> Vec<StateGuess> {
    let beam = &problem.scene.beam;
    let setup = problem.scene.setup;
    let tip = problem.scene.outermost_marker();
    let span_m = beam.length_m;
    let range_m = beam.ground_m.get(tip).map_or(span_m, |p| p.norm());
    let step_m = STEP_PX * range_m / setup.lens.focal_px();
    let steps = (((DEFLECTION_RANGE.1 - DEFLECTION_RANGE.0) * span_m / step_m).ceil())
        .clamp(8.0, 400.0) as usize;
    let window = window_px(setup.mount_repeatability_px);
    let mut guesses: Vec<StateGuess> = Vec::new();
    for step in 0..=steps {
        let fraction = step as f64 / steps as f64;
        let deflection_m =
            span_m * (DEFLECTION_RANGE.0 + (DEFLECTION_RANGE.1 - DEFLECTION_RANGE.0) * fraction);
        let best = FAMILY
            .iter()
            .filter_map(|(shape, unit)| {
                let amplitude = unit * deflection_m / (span_m * span_m);
                let mut state = WingState::zeros();
                for (k, s) in shape.iter().enumerate() {
                    state[k] = s * amplitude;
                }
                vote_shift(problem, &state, amplitude, window, step)
            })
            .max_by_key(|g| g.pairs.len());
        guesses.extend(best);
    }
    select_apart(guesses)
}

/// Selects the best guesses that are not neighbours in deflection.
fn select_apart(mut guesses: Vec<StateGuess>) -> Vec<StateGuess> {
    guesses.sort_by_key(|g| (std::cmp::Reverse(g.pairs.len()), g.cell));
    let mut selected: Vec<StateGuess> = Vec::new();
    for guess in guesses {
        if selected.iter().all(|k| k.cell.abs_diff(guess.cell) > 1) {
            selected.push(guess);
        }
        if selected.len() == MAX_GUESSES {
            break;
        }
    }
    selected
}

/// Finds the shift on which most markers agree.
fn vote_shift(
    problem: &MatchingProblem<'_>,
    state: &WingState,
    amplitude: f64,
    window: f64,
    cell: usize,
) -> Option<StateGuess> {
    let pixels = problem.scene.project_markers(state);
    let cells = (2.0 * window / CELL_PX).ceil() as usize + 2;
    let cells = cells.min(MAX_CELLS);
    let mut votes = vec![(0u16, usize::MAX); cells * cells];
    for (j, pixel) in pixels.iter().enumerate() {
        let Some(pixel) = pixel else { continue };
        for &i in problem.candidates(j) {
            let shift = problem.detections[i].centre_px - pixel;
            let Some((a, b)) = vote_cell_of_shift(&shift, window, cells) else {
                continue;
            };
            for at in (a - 1..=a + 1).flat_map(|a| (b - 1..=b + 1).map(move |b| a * cells + b)) {
                let (count, last) = &mut votes[at];
                *count += u16::from(*last != j);
                *last = j;
            }
        }
    }
    let (count, best) = votes
        .iter()
        .enumerate()
        .map(|(at, v)| (v.0, at))
        .max_by_key(|(n, at)| (*n, usize::MAX - at))?;
    if count < 3 {
        return None;
    }
    let coordinate = |cell: usize| (cell as f64 - 0.5) * CELL_PX - window;
    let centre = Vector2::new(coordinate(best / cells), coordinate(best % cells));
    Some(StateGuess {
        prior: guess_prior(problem, state, amplitude),
        pairs: agreeing_pairs(problem, &pixels, &centre),
        cell,
    })
}

fn vote_cell_of_shift(shift: &Vector2<f64>, window: f64, cells: usize) -> Option<(usize, usize)> {
    if shift.x.abs() >= window || shift.y.abs() >= window {
        return None;
    }
    let index = |s: f64| 1 + ((s + window) / CELL_PX) as usize;
    let (a, b) = (index(shift.x), index(shift.y));
    (a + 1 < cells.max(3) && b + 1 < cells.max(3)).then_some((a, b))
}

/// Pairs each marker with the detection nearest to the common shift, each detection once.
fn agreeing_pairs(
    problem: &MatchingProblem<'_>,
    pixels: &[Option<Vector2<f64>>],
    shift: &Vector2<f64>,
) -> Vec<MatchedPair> {
    let mut pairs = Vec::new();
    for (j, pixel) in pixels.iter().enumerate() {
        let Some(pixel) = pixel else { continue };
        let off = |i: &usize| (problem.detections[*i].centre_px - pixel - shift).amax();
        let best = problem
            .candidates(j)
            .iter()
            .min_by(|a, b| off(a).total_cmp(&off(b)));
        if let Some(&i) = best.filter(|i| off(i) < 1.5 * CELL_PX) {
            pairs.push((off(&i), (i, j)));
        }
    }
    pairs.sort_by(|a: &(f64, MatchedPair), b| a.0.total_cmp(&b.0));
    let mut once: Vec<MatchedPair> = select_one_to_one(pairs)
        .into_iter()
        .map(|(_, pair)| pair)
        .collect();
    once.sort_by_key(|p| p.1);
    once
}

/// Returns the prior around a guessed wing state; its standard deviations grow with the bending amplitude.
fn guess_prior(problem: &MatchingProblem<'_>, state: &WingState, amplitude: f64) -> StatePrior {
    let a = amplitude.abs();
    let [x, y, z] = problem.scene.turn_sigmas();
    let sigma = WingState::from([
        0.4 * a + 6e-4,
        0.5 * a + 4e-4,
        0.9 * a + 6e-4,
        0.06,
        0.05,
        x,
        y,
        z,
    ]);
    StatePrior {
        mean: *state,
        sigma,
    }
}
