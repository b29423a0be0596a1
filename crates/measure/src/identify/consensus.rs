//! Rotation of a ground frame without an initial guess: two matched directions determine a rotation, the others vote for
//! it.

use nalgebra::{Rotation3, Vector3};

use super::IdentifyError;
use super::attitude::{rotation_from_many, rotation_from_two};
use super::fit::{MatchedPair, SEEN_ODDS, clutter_per_px2, select_one_to_one};
use super::scene::{is_usable, looks_like};
use crate::detect::Detection;
use crate::ordering::sort_by_value;
use crate::setup::Setup;

/// Smallest angle between two directions that determine a rotation, rad: errors about the line between them are magnified
/// 30 times.
const MIN_ANGLE_RAD: f64 = 0.03;
/// Largest difference between the angles of a pair, in standard deviations: 6 of 100,000 true pairs are lost, of some
/// hundred that vote.
const ANGLE_GATE: f64 = 4.0;
/// Largest distance between a vote and its prediction, in standard deviations of two directions: 4 of 100,000 true votes
/// are lost.
const VOTE_GATE: f64 = 4.5;
/// Additional standard deviation for perspective bias and a coarse outline, px.
const EXTRA_PX: f64 = 1.0;
/// Maximum number of hypotheses, one per neighbourhood (assumption: more than the ambiguities of a symmetric layout).
const MAX_HYPOTHESES: usize = 24;
/// Distance below which two hypotheses are in one neighbourhood, rad: less than a marker's size at 5 m.
const NEIGHBOURHOOD_RAD: f64 = 3e-3;
/// Distance below which two refined solutions are equal, rad.
const SAME_RAD: f64 = 5e-3;
/// Minimum number of pairs of a hypothesis: two that determine the rotation and one vote.
const MIN_VOTES: usize = 3;
/// Error of a rotation from two directions over their errors, times the angle between them, rad: the tolerance of its votes
/// grows by it (assumption).
const TWO_DIRECTIONS_RAD: f64 = 0.1;
/// Factors on the tolerance in the rounds in which the rotation is refined from all pairs.
const REFINEMENT_SLACK: [f64; 4] = [1.5, 1.0, 1.0, 1.0];
/// Minimum log odds against the next solution: 160,000 to 1.
const MIN_LOG_ODDS_RIVAL: f64 = 12.0;
/// Minimum log odds against chance: 8,000 to 1.
const MIN_LOG_ODDS_CHANCE: f64 = 9.0;
/// Minimum log odds of a perfect match: a coarse one among many false detections still counts.
const MIN_GAIN: f64 = 0.5;

/// Directions of markers and detections with their standard deviations.
struct Directions<'a> {
    detections: &'a [Detection],
    setup: &'a Setup,
    /// Ray of each detection, camera frame; `None` if it has none.
    rays: Vec<Option<Vector3<f64>>>,
    /// Direction of each marker, survey frame, with its standard deviation, rad.
    targets: Vec<(Vector3<f64>, f64)>,
    /// Similar detections of each marker.
    similar: Vec<Vec<usize>>,
    /// Standard deviation of each detection's ray, rad.
    rays_sigma: Vec<f64>,
}

/// A rotation with its pairs.
#[derive(Clone, Debug)]
pub(super) struct Consensus {
    pub(super) camera_from_survey: Rotation3<f64>,
    pub(super) pairs: Vec<MatchedPair>,
    score: f64,
}

/// Finds the rotation on which most detections agree.
///
/// # Errors
/// Returns an error if too few markers are found, none or more than one solution fits.
pub(super) fn find_consensus(
    setup: &Setup,
    detections: &[Detection],
) -> Result<Consensus, IdentifyError> {
    let found = detections.iter().filter(|d| is_usable(d)).count();
    if found < super::flight::MIN_IDENTIFIED {
        return Err(IdentifyError::TooFew {
            found,
            needed: super::flight::MIN_IDENTIFIED,
        });
    }
    let (refined, tried) = list_candidates(setup, detections);
    let Some(best) = refined.first() else {
        return Err(IdentifyError::NoConsensus { matched: 0, found });
    };
    // Two pairs determine the rotation; every trial is a chance for a false solution.
    let per_pair = best.score / best.pairs.len().max(1) as f64;
    if best.pairs.len() < super::flight::MIN_IDENTIFIED
        || best.score - 2.0 * per_pair - (tried as f64).max(1.0).ln() < MIN_LOG_ODDS_CHANCE
    {
        return Err(IdentifyError::NoConsensus {
            matched: best.pairs.len(),
            found,
        });
    }
    let rivals = refined
        .iter()
        .filter(|c| c.score > best.score - MIN_LOG_ODDS_RIVAL)
        .count();
    if rivals > 1 {
        return Err(IdentifyError::Ambiguous { solutions: rivals });
    }
    Ok(best.clone())
}

/// Returns refined rotations, the best first, and the number of trials.
pub(super) fn list_candidates(setup: &Setup, detections: &[Detection]) -> (Vec<Consensus>, usize) {
    let directions = Directions::new(setup, detections);
    let (hypotheses, tried) = directions.find_hypotheses();
    let mut refined: Vec<Consensus> = Vec::new();
    for hypothesis in hypotheses {
        let next = directions.refine(hypothesis);
        let known = |c: &&mut Consensus| is_same_rotation(c, &next);
        match refined.iter_mut().find(known) {
            Some(old) if old.score < next.score => *old = next,
            Some(_) => {}
            None => refined.push(next),
        }
    }
    sort_by_value(&mut refined, |one| -one.score);
    (refined, tried)
}

/// Returns the pairs of a frame for a rotation from another frame.
pub(super) fn pairs_from_rotation(
    setup: &Setup,
    detections: &[Detection],
    rotation: &Rotation3<f64>,
) -> Vec<MatchedPair> {
    let mut pairs = Directions::new(setup, detections)
        .match_pairs(rotation, 1.0)
        .pairs;
    pairs.sort_by_key(|p| p.1);
    pairs
}

/// Returns true if two solutions have nearly equal rotations.
fn is_same_rotation(a: &Consensus, b: &Consensus) -> bool {
    rotation_distance(&a.camera_from_survey, &b.camera_from_survey) < SAME_RAD
}

/// Returns the angle between two rotations, rad; safe for equal ones.
fn rotation_distance(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
    (a.matrix() - b.matrix()).norm() / std::f64::consts::SQRT_2
}

impl<'a> Directions<'a> {
    fn new(setup: &'a Setup, detections: &'a [Detection]) -> Self {
        let focal = setup.lens.focal_px();
        let rays = detections
            .iter()
            .map(|d| {
                if is_usable(d) {
                    setup.lens.ray(&d.centre_px).ok()
                } else {
                    None
                }
            })
            .collect();
        let rays_sigma = detections
            .iter()
            .map(|d| (0.5 * d.covariance_px2.trace() + EXTRA_PX * EXTRA_PX).sqrt() / focal)
            .collect();
        let targets: Vec<_> = setup
            .markers
            .iter()
            .map(|m| {
                let to = m.position_m - setup.projection_centre_m;
                (
                    to.normalize(),
                    m.sigma_m.hypot(setup.projection_centre_sigma_m) / to.norm(),
                )
            })
            .collect();
        let similar = setup
            .markers
            .iter()
            .enumerate()
            .map(|(j, m)| {
                let range = (m.position_m - setup.projection_centre_m).norm();
                let major = 0.5 * m.diameter_m * focal / range;
                (0..detections.len())
                    .filter(|i| looks_like(&detections[*i], setup, j, major))
                    .collect()
            })
            .collect();
        Self {
            detections,
            setup,
            rays,
            targets,
            similar,
            rays_sigma,
        }
    }

    /// Returns rotations from pairs of markers and pairs of detections with equal angles, ordered by score, and the number
    /// of trials.
    fn find_hypotheses(&self) -> (Vec<Consensus>, usize) {
        let mut best: Vec<Consensus> = Vec::new();
        let mut tried = 0;
        for a in 0..self.targets.len() {
            for b in 0..a {
                let ((da, sa), (db, sb)) = (self.targets[a], self.targets[b]);
                let angle = da.angle(&db);
                if angle < MIN_ANGLE_RAD {
                    continue;
                }
                for &i in &self.similar[a] {
                    for &k in &self.similar[b] {
                        let (Some(ri), Some(rk)) = (self.rays[i], self.rays[k]) else {
                            continue;
                        };
                        let sigma2 = sa * sa
                            + sb * sb
                            + self.rays_sigma[i].powi(2)
                            + self.rays_sigma[k].powi(2);
                        if i == k || (ri.angle(&rk) - angle).abs() > ANGLE_GATE * sigma2.sqrt() {
                            continue;
                        }
                        let Some(rotation) = rotation_from_two([&da, &db], [&ri, &rk]) else {
                            continue;
                        };
                        tried += 1;
                        // Errors of two directions near each other grow with the distance from them.
                        let slack = 1.0 + TWO_DIRECTIONS_RAD / angle;
                        keep_best(&mut best, self.match_pairs(&rotation, slack));
                    }
                }
            }
        }
        (best, tried)
    }

    /// Pairs markers and detections for a rotation, one-to-one, nearest first, and computes their score.
    fn match_pairs(&self, rotation: &Rotation3<f64>, slack: f64) -> Consensus {
        let mut all: Vec<(f64, MatchedPair)> = Vec::new();
        for (j, (target, sigma)) in self.targets.iter().enumerate() {
            let predicted = rotation * target;
            for &i in &self.similar[j] {
                let Some(ray) = self.rays[i] else { continue };
                let off2 = (ray - predicted).norm_squared();
                let sigma2 = (sigma * sigma + self.rays_sigma[i].powi(2)) * slack * slack;
                if off2 < VOTE_GATE * VOTE_GATE * sigma2 {
                    all.push((off2 / sigma2, (i, j)));
                }
            }
        }
        all.sort_by(|x, y| x.0.total_cmp(&y.0));
        let selected = select_one_to_one(all);
        let score = selected.iter().fold(0.0, |score, (off2, pair)| {
            score + (self.log_odds_gain(*pair) - 0.5 * off2)
        });
        let pairs = selected.into_iter().map(|(_, pair)| pair).collect();
        Consensus {
            camera_from_survey: *rotation,
            pairs,
            score,
        }
    }

    /// Returns the log odds of a perfect match against a false detection.
    fn log_odds_gain(&self, (i, j): MatchedPair) -> f64 {
        let lens = &self.setup.lens;
        let density = clutter_per_px2(self.detections.len(), lens);
        let sigma_px = self.targets[j].1.hypot(self.rays_sigma[i]) * lens.focal_px();
        (SEEN_ODDS / (density * std::f64::consts::TAU * sigma_px * sigma_px))
            .ln()
            .max(MIN_GAIN)
    }

    /// Alternates between Arun's rotation from all pairs and new pairs for it.
    fn refine(&self, mut consensus: Consensus) -> Consensus {
        for slack in REFINEMENT_SLACK {
            let directions = consensus.pairs.iter().filter_map(|&(i, j)| {
                let (target, sigma) = self.targets[j];
                let weight = 1.0 / (sigma * sigma + self.rays_sigma[i].powi(2));
                Some((target, self.rays[i]?, weight))
            });
            let Some(rotation) = rotation_from_many(directions) else {
                break;
            };
            consensus = self.match_pairs(&rotation, slack);
        }
        consensus
    }
}

/// Adds a hypothesis to the best ones, of which each neighbourhood has one.
fn keep_best(best: &mut Vec<Consensus>, next: Consensus) {
    if next.pairs.len() < MIN_VOTES
        || (best.len() == MAX_HYPOTHESES && best[MAX_HYPOTHESES - 1].score >= next.score)
    {
        return;
    }
    match best.iter().position(|c| {
        rotation_distance(&c.camera_from_survey, &next.camera_from_survey) < NEIGHBOURHOOD_RAD
    }) {
        Some(at) if best[at].score >= next.score => return,
        Some(at) => best[at] = next,
        None => best.push(next),
    }
    best.sort_by(|a, b| b.score.total_cmp(&a.score));
    best.truncate(MAX_HYPOTHESES);
}
