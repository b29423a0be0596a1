//! A flight set up for the engine: shared unknowns, one group per frame, survey and ground frame last.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::{Flight, TERMS};
use crate::measure::adjust::beam::{MAX_CURVATURE_TERMS, MAX_TWIST_TERMS};
use crate::measure::adjust::gauss_helmert::{
    Block, Course, Fit, Group, GroupPoint, Linearised, Prior, Problem, solve_from,
};
use crate::measure::adjust::layout::{Layout, Place, Rows, Seen, Survey};
use crate::measure::adjust::model_error::image_covariance;
use crate::measure::adjust::outcome::Member;
use crate::measure::adjust::scene::Scene;
use crate::measure::adjust::shapes::{RATIOS, shortening};
use crate::measure::adjust::unknowns::{self, Columns};
use crate::measure::adjust::{AdjustError, Observation};
use crate::measure::setup::Thermal;

const MISSING_RATIO: &str =
    "the shape of bending cannot be determined; markers along the whole span are needed";
const MISSING_MOUNT: &str =
    "the mounting's rotation cannot be determined; give camera.mount_repeatability_px";
const MISSING_GROUND: &str = "a marker on ground is not determined";

/// A flight whose amplitudes spread less, over the largest, burns no fuel worth speaking of.
const SMALLEST_RANGE: f64 = 0.1;

/// What is known of the share of the net load that stays vertical while the wing bends: weight does, lift
/// turns with the wing.
const VERTICAL_SHARE: f64 = 0.5;
const VERTICAL_SHARE_SIGMA: f64 = 0.5;

/// Drift in pitch over that about the other axes, which tell it: the mean of a variance that some f degrees of freedom tell
/// is f / (f - 2) times what they show. A random walk of ten frames leaves about five in yaw and roll together.
const PITCH_DRIFT: f64 = 1.3;

/// How much of the ratios' changes a frame has.
pub(super) enum Progress {
    /// Per frame, as its amplitude in an earlier solution tells.
    OfFrames(Vec<f64>),
    /// The amplitude's distance from the middle over this, 1/m.
    OfAmplitude(f64),
}

/// A flight set up for the engine.
pub(super) struct Setting {
    pub(super) layouts: Vec<Layout>,
    pub(super) members: Vec<Vec<Member>>,
    pub(super) ground_members: Vec<Member>,
    pub(super) problem: Problem,
    pub(super) ratios: usize,
    /// Changes of the ratios from the heaviest frame to the lightest.
    pub(super) changes: usize,
    /// Share of the load that stays vertical while the wing bends.
    pub(super) lever: usize,
    /// What that does to the ratios, times the square of the amplitude's distance from the middle, m^2. What goes
    /// with the distance itself is far below what burning fuel may do, and left to that.
    pub(super) shortening: [f64; RATIOS],
    /// Amplitude half-way between the heaviest frame and the lightest, 1/m.
    pub(super) middle: f64,
    /// Where a frame stands between the two, -0.5 to 0.5.
    pub(super) progress: Progress,
}

impl Flight<'_> {
    pub(super) fn setting(&self, from: Option<&Fit>) -> Setting {
        let mut columns = Columns::default();
        let terms = self.input.options.curvature_terms.map_or(TERMS, |t| t.clamp(2, MAX_CURVATURE_TERMS));
        let twist_terms = self.input.options.twist_terms.min(MAX_TWIST_TERMS);
        let common = unknowns::common(&self.input, &mut columns);
        let mut priors = common.priors;
        let head = columns.missing.len();
        let ratios = columns.take(terms - 1, MISSING_RATIO);
        priors.extend(unknowns::shape_prior(ratios, terms, 1.0));
        let changes = columns.take(terms - 1, MISSING_RATIO);
        priors.push(unknowns::burning_prior(changes, terms));
        let lever = columns.take(1, MISSING_RATIO);
        priors.push(Prior::scalar(lever, VERTICAL_SHARE, VERTICAL_SHARE_SIGMA));
        let mut mounts = vec![];
        let mut shifts = vec![];
        for mounting in 0..self.mounting_count() {
            let first = columns.take(3, MISSING_MOUNT);
            mounts.push(first);
            if self.stayed(mounting) {
                priors.push(unknowns::stayed_prior(&self.input, first));
                shifts.push(None);
            } else {
                priors.push(unknowns::mount_prior(&self.input, first));
                shifts.push(unknowns::shift_columns(&self.input, &mut columns, &mut priors));
            }
        }
        let markers = &self.input.setup.markers;
        let survey = columns.take(3 * markers.len(), MISSING_GROUND);
        let local = terms + twist_terms + 3;
        let layout = |frame: usize| Layout {
            curvature: Place::Local(0),
            curvature_terms: terms,
            twist: Place::Local(terms),
            twist_terms,
            mount: Place::Local(terms + twist_terms),
            common_mount: Some(Place::Global(mounts[self.mounting(frame)])),
            shift: shifts[self.mounting(frame)].map(Place::Global),
            lens: common.lens.map(Place::Global),
            estimated: common.estimated.map(|e| e.map(Place::Global)),
            own: (mounts[self.mounting(frame)], if shifts[self.mounting(frame)].is_some() { 6 } else { 3 }),
            ground: common.ground.map(Place::Global),
            centre: common.centre.map(Place::Global),
            window: common.window.map(Place::Global),
            bow: common.bow.map(Place::Global),
            scale: common.scale.map(Place::Global),
            raise: Place::Global(common.raise),
            nominal_scale: self.input.setup.thermal.as_ref().map_or(1.0, Thermal::scale),
            survey: Survey::Global(survey),
            head,
            local,
        };
        let layouts: Vec<Layout> = (0..self.frames.len()).map(layout).collect();
        let mut start = DVector::zeros(columns.missing.len());
        for (k, station) in self.input.scene.ground.stations.iter().enumerate() {
            start.rows_mut(survey + 3 * k, 3).copy_from(&station.surveyed_m);
        }
        start[lever] = VERTICAL_SHARE;
        if let Some(fit) = from {
            let (shared, tail) = (lever + 1, 3 * markers.len());
            start.rows_mut(0, shared).copy_from(&fit.global.rows(0, shared));
            for (mounting, &first) in mounts.iter().enumerate() {
                start.rows_mut(first, 3).copy_from(&self.mean_pose(mounting).0);
                if let Some(first) = shifts[mounting] {
                    start.rows_mut(first, 3).copy_from(&self.mean_pose(mounting).1);
                }
            }
            start.rows_mut(survey, tail).copy_from(&fit.global.rows(fit.global.len() - tail, tail));
        }
        let mut groups = vec![];
        let mut members = vec![];
        for (frame, layout) in layouts.iter().enumerate() {
            let (group, list) = self.frame_group(frame, layout, from);
            groups.push(group);
            members.push(list);
        }
        let (ground, ground_members) = self.ground_group();
        groups.push(ground);
        let problem = Problem { start, missing: columns.missing, priors, known: None, groups };
        let axis = &self.input.scene.ground.axis;
        // It counts from the middle amplitude, which nothing tells before the first solution.
        let shortening = match from {
            Some(_) => shortening(axis.length_m, |eta| axis.slope_rad(eta * axis.length_m)),
            None => [0.0; RATIOS],
        };
        let (low, high) = self.range();
        let (middle, progress) = (0.5 * (low + high), Progress::OfFrames(self.progress()));
        Setting {
            layouts,
            members,
            ground_members,
            problem,
            ratios,
            changes,
            lever,
            shortening,
            middle,
            progress,
        }
    }

    /// Of a frame's rotation about its mounting's, camera frame, rad^2.
    pub(super) fn drift_covariance(&self) -> Matrix3<f64> {
        let pitch = self.input.scene.camera_from_wing * Vector3::z();
        let more = pitch * pitch.transpose() * (PITCH_DRIFT * PITCH_DRIFT - 1.0);
        (Matrix3::identity() + more) * (self.drift_rad * self.drift_rad)
    }

    /// Mean rotation and shift of a mounting's frames in the last solution.
    pub(super) fn mean_pose(&self, mounting: usize) -> (Vector3<f64>, Vector3<f64>) {
        let own: Vec<_> =
            (0..self.frames.len()).filter(|f| self.mounting(*f) == mounting).map(|f| self.poses[f]).collect();
        let sum = own.iter().fold((Vector3::zeros(), Vector3::zeros()), |s, p| (s.0 + p.0, s.1 + p.1));
        let count = own.len().max(1) as f64;
        (sum.0 / count, sum.1 / count)
    }

    fn mounting_count(&self) -> usize {
        self.mountings.iter().flatten().max().map_or(1, |m| m + 1)
    }

    pub(super) fn mounting(&self, frame: usize) -> usize {
        self.mountings.as_ref().map_or(0, |list| list[frame])
    }

    /// Smallest and largest amplitude.
    fn range(&self) -> (f64, f64) {
        self.amplitudes.iter().fold((f64::INFINITY, 0.0), |(low, high), &a| (low.min(a), high.max(a)))
    }

    /// Fuel burns while the lift falls: what its loss does to the shape goes with the amplitude, and
    /// nothing but knowledge of beams tells that from another shape seen with another pitch.
    fn progress(&self) -> Vec<f64> {
        let (low, high) = self.range();
        let range = (high - low).max(SMALLEST_RANGE * high);
        self.amplitudes.iter().map(|a| (a - 0.5 * (low + high)) / range).collect()
    }

    /// One frame: the images, and last the tie of its curvature to the shared shape.
    pub(super) fn frame_group(
        &self,
        frame: usize,
        layout: &Layout,
        from: Option<&Fit>,
    ) -> (Group, Vec<Member>) {
        let mut members = vec![];
        let mut blocks = vec![];
        for (marker, seen) in self.frames[frame].iter().enumerate() {
            if let Some(seen) = seen.filter(|_| self.used[frame][marker]) {
                members.push(Member { marker, flight: Some(0), ground: None });
                blocks.push(image_block(seen));
            }
        }
        let n = layout.curvature_terms;
        let spread = self.departure * self.amplitudes[frame];
        let covariance = unknowns::shape_covariance(n) * (spread * spread);
        blocks.push(Block { observed: DVector::zeros(n - 1), covariance });
        let mut local = DVector::zeros(layout.local);
        if let Some(fit) = from {
            let old = &fit.groups[frame].local;
            local.copy_from(old);
            let own = self.poses[frame].0 - self.mean_pose(self.mounting(frame)).0;
            local.rows_mut(n + layout.twist_terms, 3).copy_from(&own);
        }
        let mut priors: Vec<_> = unknowns::twist_priors(n, layout.twist_terms).collect();
        // Where the mount's repeatability puts them all is counted once, not once for each.
        let prior = unknowns::mount_prior(&self.input, n + layout.twist_terms);
        let covariance = match self.mountings {
            None => prior.covariance,
            Some(_) => DMatrix::from_column_slice(3, 3, self.drift_covariance().as_slice()),
        };
        priors.push(Prior { mean: DVector::zeros(3), covariance, ..prior });
        (Group { local, priors, blocks }, members)
    }

    /// Survey and ground frame.
    fn ground_group(&self) -> (Group, Vec<Member>) {
        let mut members = vec![];
        let mut blocks = vec![];
        for (marker, surveyed) in self.input.setup.markers.iter().enumerate() {
            let sight = self.input.scene.ground_sights[marker].as_ref().filter(|_| self.ground_used[marker]);
            let station = self.input.scene.ground.stations[marker].surveyed_m;
            let mut observed = station.as_slice().to_vec();
            observed.extend(sight.iter().flat_map(|s| [s.pixel.x, s.pixel.y]));
            let mut covariance = DMatrix::identity(observed.len(), observed.len()) * surveyed.sigma_m.powi(2);
            if let Some(sight) = sight {
                covariance.fixed_view_mut::<2, 2>(3, 3).copy_from(&image_covariance(&sight.covariance_px2));
            }
            members.push(Member { marker, flight: None, ground: sight.map(|_| 3) });
            blocks.push(Block { observed: DVector::from_vec(observed), covariance });
        }
        (Group { local: DVector::zeros(0), priors: vec![], blocks }, members)
    }
}

fn image_block(seen: &Observation) -> Block {
    Block {
        observed: DVector::from_column_slice(seen.pixel.as_slice()),
        covariance: DMatrix::from_column_slice(2, 2, image_covariance(&seen.covariance_px2).as_slice()),
    }
}

impl Setting {
    fn linearise(
        &self,
        scene: &Scene,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), AdjustError> {
        match self.layouts.get(at.group) {
            Some(layout) => self.frame(scene, layout, at, blocks),
            None => self.ground(scene, at, blocks),
        }
    }

    fn frame(
        &self,
        scene: &Scene,
        layout: &Layout,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), AdjustError> {
        let values = layout.values(at.global, at.local);
        let bent = scene.bend(&values.bending());
        let camera = scene.camera(&values.pose);
        for (block, (member, observed)) in self.members[at.group].iter().zip(at.observed).enumerate() {
            let seen = Seen {
                marker: member.marker,
                bent: &bent,
                values: &values,
                ground_m: layout.on_ground(member.marker, at.global, observed),
                observed,
                observation: 0,
            };
            Rows::new(layout, (blocks, block), member.marker, 2, 2).flight(0, &seen, scene, &camera)?;
        }
        let Some(departure) = at.observed.last() else { return Ok(()) };
        let last = self.members[at.group].len();
        if blocks.len() == last {
            blocks.push(self.empty_shape(layout));
        }
        self.shape(layout, at, departure, &mut blocks[last]);
        Ok(())
    }

    /// Conditions of the departures, less the derivatives that change.
    fn empty_shape(&self, layout: &Layout) -> Linearised {
        let n = layout.curvature_terms - 1;
        let columns = (self.ratios..self.ratios + n).chain(self.changes..self.changes + n);
        let columns = columns.chain([self.lever]).collect();
        let mut empty = Linearised::empty(n, columns, layout.local, n);
        empty.observations = -DMatrix::identity(n, n);
        (0..n).for_each(|k| empty.local[(k, k + 1)] = 1.0);
        empty
    }

    /// c_k = (r_k + progress * change_k + lever * shortening_k * (c_0 - middle)^2) c_0 + departure.
    fn shape(&self, layout: &Layout, at: &GroupPoint, departure: &DVector<f64>, out: &mut Linearised) {
        let n = layout.curvature_terms - 1;
        let (amplitude, lever) = (at.local[0], at.global[self.lever]);
        let off = amplitude - self.middle;
        let (progress, grows) = match &self.progress {
            Progress::OfFrames(list) => (list[at.group], 0.0),
            Progress::OfAmplitude(range) => (off / range, 1.0 / range),
        };
        for k in 0..n {
            let shortened = self.shortening[k] * off * off;
            let by_amplitude = 2.0 * self.shortening[k] * off;
            let change = at.global[self.changes + k];
            let ratio = at.global[self.ratios + k] + progress * change + lever * shortened;
            out.misclosure[k] = at.local[k + 1] - ratio * amplitude - departure[k];
            out.local[(k, 0)] = -ratio - (grows * change + lever * by_amplitude) * amplitude;
            out.global[(k, k)] = -amplitude;
            out.global[(k, n + k)] = -amplitude * progress;
            out.global[(k, 2 * n)] = -amplitude * shortened;
        }
    }

    fn ground(
        &self,
        scene: &Scene,
        at: &GroupPoint,
        blocks: &mut Vec<Linearised>,
    ) -> Result<(), AdjustError> {
        let Some(frame) = self.layouts.first() else { return Ok(()) };
        // The ground frame knows neither bending nor mounting.
        let layout = Layout {
            local: 0,
            curvature_terms: 0,
            twist_terms: 0,
            mount: Place::Global(0),
            common_mount: None,
            shift: None,
            own: (0, 0),
            ..*frame
        };
        let values = layout.values(at.global, at.local);
        let flat = scene.bend(&values.bending());
        let camera = scene.ground_camera(&values.pose);
        for (block, (member, observed)) in self.ground_members.iter().zip(at.observed).enumerate() {
            let sights = member.ground.map_or(0, |_| 2);
            let mut rows = Rows::new(&layout, (blocks, block), member.marker, 3 + sights, 3 + sights);
            let ground_m = layout.on_ground(member.marker, at.global, observed);
            rows.surveyed(0, &ground_m, observed);
            if let Some(observation) = member.ground {
                let (marker, bent) = (member.marker, &flat);
                let seen = Seen { marker, bent, values: &values, ground_m, observed, observation };
                rows.ground(3, &seen, scene, &camera)?;
            }
        }
        Ok(())
    }

    pub(super) fn solve(&self, scene: &Scene, course: &Course) -> Result<Fit, AdjustError> {
        solve_from(&self.problem, course, |at, blocks| self.linearise(scene, at, blocks))
    }
}
