//! Import of image series into a store, each image once.

use std::collections::BTreeMap;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde_json::Value;

use wingd_base::clock::Stamp;
use wingd_base::clock::exposure::Exposure;
use wingd_base::clock::written_time::duration_text;
use wingd_base::failure::{Failure, TaskResult};
use wingd_base::regular_file::{MAX_DATA_BYTES, read_regular_file};
use wingd_base::text::printable_path;
use wingd_evaluation::frame_format::file_extension;
use wingd_evaluation::frame_format::format_from_path;
use wingd_evaluation::inputs::image_files::split_at_pauses;
use wingd_evaluation::inputs::image_times::DatedImage;
use wingd_store::manifest::{SeriesCause, SeriesManifest, SeriesState, Shot};
use wingd_store::{
    FlightRef, NewFrame, OpenSeries, SeriesPlan, Store, StoreConfig, catalogue, layout, sha256_hex,
};

/// Outcome of a series of images.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportedSeries {
    pub pictures: Vec<DatedImage>,
    pub flight: String,
    /// Name of the series in the store; `None` if the store had all its images.
    pub series: Option<String>,
    /// Number of images copied.
    pub taken: usize,
    /// Number of images that the store had before.
    pub already: usize,
}

/// A flight of the store, with the time span of its imported images.
struct ExistingFlight {
    id: String,
    span: Option<(Timestamp, Timestamp)>,
}

/// An image that the store has.
struct StoredImage {
    flight: String,
    /// Time and standard deviation of the camera's clock; `None` if it was imported without a time.
    time: Option<(Timestamp, Option<f64>)>,
}

/// Importer of images into a store.
pub struct Importer<'a> {
    store: &'a Store,
    /// Flight requested by the user.
    requested: Option<String>,
    clock_sigma_s: Option<f64>,
    /// Images in the store, by digest.
    stored: BTreeMap<String, StoredImage>,
    flights: Vec<ExistingFlight>,
    pause: Duration,
    /// Receives the number of images finished since the last call.
    progress: &'a dyn Fn(u64),
}

impl<'a> Importer<'a> {
    /// Reads the store's flights. `wanted` is one of them, or the user's name for a new one.
    pub fn new(
        store: &'a Store,
        wanted: Option<String>,
        clock_sigma_s: Option<f64>,
        progress: &'a dyn Fn(u64),
    ) -> TaskResult<Self> {
        let mut import = Self {
            store,
            requested: None,
            clock_sigma_s,
            stored: BTreeMap::new(),
            flights: Vec::new(),
            pause: StoreConfig::new("").new_flight_after,
            progress,
        };
        for flight in catalogue::list_flights(store.disk(), store.root())? {
            import.index_existing_flight(&flight, wanted.as_deref())?;
        }
        if let Some(name) = wanted.filter(|_| import.requested.is_none()) {
            if layout::flight_number(&name).is_some() {
                let known: Vec<&str> = import.flights.iter().map(|f| f.id.as_str()).collect();
                let what = format!("there is no flight {name}; available: {}", known.join(", "));
                return Err(Failure::from_path_error(store.root(), what));
            }
            import.requested = Some(name);
        }
        Ok(import)
    }

    /// Notes digests and time span of a flight's images, and whether it is the requested flight.
    fn index_existing_flight(
        &mut self,
        flight: &FlightRef,
        wanted: Option<&str>,
    ) -> TaskResult<()> {
        let disk = self.store.disk();
        let mut span = None;
        for series in catalogue::list_series(disk, flight)? {
            let manifest = catalogue::read_series_manifest(disk, &series)?;
            for shot in &manifest.shots {
                let Some(frame) = &shot.frame else { continue };
                let time = shot
                    .exposure
                    .as_ref()
                    .map(|e| (shot.stamp.utc, e.clock_sigma_s));
                self.stored.insert(
                    frame.sha256.clone(),
                    StoredImage {
                        flight: flight.id.clone(),
                        time,
                    },
                );
            }
            span = merge_spans(span, imported_span(&manifest));
        }
        let name = catalogue::read_flight_manifest(disk, flight)
            .ok()
            .and_then(|manifest| manifest.name);
        if wanted.is_some_and(|wanted| wanted == flight.id || Some(wanted) == name.as_deref()) {
            self.requested = Some(flight.id.clone());
        }
        self.flights.push(ExistingFlight {
            id: flight.id.clone(),
            span,
        });
        Ok(())
    }

    /// Imports all series; each is added to `imported` when it is complete.
    ///
    /// # Errors
    /// Returns an error if the store has images with other times, or if an image or the store cannot be read or written;
    /// the next import resumes there.
    pub fn import_all(
        mut self,
        series: Vec<Vec<DatedImage>>,
        imported: &mut Vec<ImportedSeries>,
    ) -> TaskResult<()> {
        self.check_stored_times(&series)?;
        let begin = |series: &Vec<DatedImage>| series.first().and_then(|p| p.utc);
        let end = |series: &Vec<DatedImage>| series.last().and_then(|p| p.utc);
        for flight in split_at_pauses(series, self.pause, begin, end) {
            let mut id = self.find_flight(&flight)?;
            for pictures in flight {
                imported.push(self.import_series(pictures, &mut id)?);
            }
        }
        Ok(())
    }

    /// Checks that images which the store has would get the times that they have there: these are never changed.
    fn check_stored_times(&self, series: &[Vec<DatedImage>]) -> TaskResult<()> {
        let stored = |p: &DatedImage| self.stored.get(&p.digest)?.time;
        let shift_s = |p: &DatedImage| Some(p.utc?.duration_since(stored(p)?.0).as_secs_f64());
        let other_sigma = |p: &DatedImage| {
            self.clock_sigma_s.is_some()
                && stored(p).is_some_and(|known| known.1 != self.clock_sigma_s)
        };
        let changed = |p: &&DatedImage| match self.stored.get(&p.digest) {
            None => false,
            Some(known) if p.source.is_some() => {
                known.time.is_none()
                    || shift_s(p).is_some_and(|s| s.abs() > SAME_TIME_S)
                    || other_sigma(p)
            }
            Some(_) => false,
        };
        let changed: Vec<&DatedImage> = series.iter().flatten().filter(changed).collect();
        let Some(first) = changed.first() else {
            return Ok(());
        };
        let flight = self
            .stored
            .get(&first.digest)
            .map(|known| known.flight.as_str())
            .unwrap_or_default();
        let difference = match (
            stored(first),
            first.utc,
            shift_s(first).filter(|s| s.abs() > SAME_TIME_S),
        ) {
            (Some((then, _)), Some(now), Some(s)) => {
                let way = if s > 0.0 { "later" } else { "earlier" };
                format!(
                    "is there with {then}, and would now have {now}, {} {way}",
                    duration_text(s)
                )
            }
            (Some(_), ..) => "is there with another --clock-sigma".into(),
            (None, ..) => "is there without its time".into(),
        };
        let what = format!(
            "{} images are in the store with other times, which are never changed ({} of {flight} {difference}), so nothing \
             was imported; repeat --zone, --clock-offset, --clock-sigma, --times and --start of the first import, or import \
             into a new store",
            changed.len(),
            first.name
        );
        Err(Failure::from_path_error(self.store.root(), what))
    }

    /// Returns the flight that images belong to: the one requested; one that has some of them; one whose imported images
    /// are near in time. `None`: a new one.
    fn find_flight(&self, series: &[Vec<DatedImage>]) -> TaskResult<Option<String>> {
        if let Some(wanted) = &self.requested {
            return Ok(self
                .flights
                .iter()
                .any(|f| f.id == *wanted)
                .then(|| wanted.clone()));
        }
        let pictures = || series.iter().flatten();
        if let Some(held) = pictures().find_map(|p| self.stored.get(&p.digest)) {
            return Ok(Some(held.flight.clone()));
        }
        let span = pictures()
            .filter_map(|p| p.utc)
            .fold(None, |span, t| merge_spans(span, Some((t, t))));
        let near = |known: &&ExistingFlight| {
            known
                .span
                .zip(span)
                .is_some_and(|(a, b)| gap_between(a, b) <= self.pause)
        };
        Ok(self.flights.iter().find(near).map(|known| known.id.clone()))
    }

    /// Imports a series; its flight begins with the first image that the store does not have.
    fn import_series(
        &mut self,
        pictures: Vec<DatedImage>,
        flight: &mut Option<String>,
    ) -> TaskResult<ImportedSeries> {
        let new: Vec<&DatedImage> = pictures
            .iter()
            .filter(|p| !self.stored.contains_key(&p.digest))
            .collect();
        let already = pictures.len() - new.len();
        (self.progress)(already as u64);
        let Some(first) = new.first() else {
            let held = pictures
                .first()
                .and_then(|p| self.stored.get(&p.digest))
                .map(|known| known.flight.clone());
            return Ok(ImportedSeries {
                pictures,
                flight: held.unwrap_or_default(),
                series: None,
                taken: 0,
                already,
            });
        };
        let began = ImportClock::starting_with(first);
        let id = match flight {
            Some(id) => id.clone(),
            None => {
                let now = began.image_stamp(first, 0);
                let id = self.store.begin_flight(
                    &now,
                    "imported from images".into(),
                    self.requested.clone(),
                )?;
                self.flights.push(ExistingFlight {
                    id: id.clone(),
                    span: None,
                });
                self.requested = self.requested.take().map(|_| id.clone());
                flight.insert(id).clone()
            }
        };
        let plan = SeriesPlan {
            cause: SeriesCause::Imported,
            shots: u32::try_from(new.len()).unwrap_or(u32::MAX),
        };
        let (mut open, _) = self
            .store
            .begin_series_in(&id, plan, &began.image_stamp(first, 0))?;
        let name = open.id().to_owned();
        let copied = self.store_new_images(&mut open, &began, &new);
        let last = open
            .shots()
            .last()
            .map_or_else(|| began.image_stamp(first, 0), |shot| shot.stamp.clone());
        let (state, remark) = match &copied {
            Ok(()) => (SeriesState::Complete, None),
            Err(_) => (
                SeriesState::Interrupted,
                Some("the import was interrupted; import again to resume it".to_owned()),
            ),
        };
        self.store
            .close_series(open, state, &last, remark.into_iter().collect())?;
        copied?;
        let known = |p: &&DatedImage| {
            (
                p.digest.clone(),
                StoredImage {
                    flight: id.clone(),
                    time: None,
                },
            )
        };
        self.stored.extend(new.iter().map(known));
        Ok(ImportedSeries {
            taken: new.len(),
            flight: id,
            series: Some(name),
            already,
            pictures,
        })
    }

    fn store_new_images(
        &self,
        open: &mut OpenSeries,
        began: &ImportClock,
        new: &[&DatedImage],
    ) -> TaskResult<()> {
        let settings = new.iter().flat_map(|p| &p.taken.settings);
        let of_camera = settings.filter(|(name, _)| CAMERA_SETTINGS.contains(name));
        open.note_camera(
            of_camera
                .map(|(k, v)| ((*k).to_owned(), v.clone().into()))
                .collect(),
        )?;
        if began.utc.is_none() {
            open.add_remark(
                "the images have no time: they are in the order of the files, and their times have no meaning",
            )?;
        }
        for (k, picture) in new.iter().enumerate() {
            let shown = printable_path(&picture.file);
            let bytes = read_regular_file(&picture.file, MAX_DATA_BYTES).map_err(|e| {
                Failure::Failed(format!(
                    "{shown} cannot be read ({e}); import again to resume"
                ))
            })?;
            if sha256_hex(&bytes) != picture.digest {
                return Err(Failure::Failed(format!(
                    "{shown} changed while being read; check the card and import again"
                )));
            }
            let number = u32::try_from(k + 1).unwrap_or(u32::MAX);
            let stamp = began.image_stamp(picture, k);
            let exposure = picture.utc.is_some().then(|| {
                Exposure::from_camera_clock(&stamp, picture.clock_step_s(), self.clock_sigma_s)
            });
            let format = format_from_path(&picture.file);
            let frame = NewFrame {
                bytes: &bytes,
                extension: format.as_ref().map_or("bin", file_extension),
                format: serde_json::to_value(&format).unwrap_or(Value::Null),
                settings: picture.settings(),
            };
            let shot = Shot {
                shot: number,
                stamp,
                duration_s: None,
                exposure,
                frame: None,
                failures: Vec::new(),
            };
            open.add_shot(shot, Some(frame))?;
            (self.progress)(1);
        }
        Ok(())
    }
}

/// Largest difference between two readings of one time, s: stored times may be rounded.
const SAME_TIME_S: f64 = 1e-3;

/// Settings of an image that describe the camera.
const CAMERA_SETTINGS: [&str; 3] = ["make", "model", "serial_number"];

/// Time base of an imported series: separate for each, because the camera's clock is not tied to a computer's.
struct ImportClock {
    boot_id: String,
    utc: Option<Timestamp>,
}

impl ImportClock {
    fn starting_with(first: &DatedImage) -> Self {
        let short: String = first.digest.chars().take(16).collect();
        Self {
            boot_id: format!("import-{short}"),
            utc: first.utc,
        }
    }

    /// Returns the stamp of an image by its index in the series; without times, images are 1 s apart in 1970.
    fn image_stamp(&self, picture: &DatedImage, place: usize) -> Stamp {
        let since = match (self.utc, picture.utc) {
            (Some(first), Some(own)) => own.duration_since(first).as_secs_f64(),
            _ => place as f64,
        };
        let undated = || {
            let since = i64::try_from(place).unwrap_or(i64::MAX);
            Timestamp::from_second(since).unwrap_or_default()
        };
        Stamp {
            utc: picture.utc.unwrap_or_else(undated),
            utc_synchronised: false,
            boot_id: self.boot_id.clone(),
            since_boot_s: since.max(0.0),
        }
    }
}

type TimeSpan = (Timestamp, Timestamp);

/// Returns the span that covers both.
fn merge_spans(a: Option<TimeSpan>, b: Option<TimeSpan>) -> Option<TimeSpan> {
    match (a, b) {
        (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
        (one, other) => one.or(other),
    }
}

/// Returns the time between the end of one span and the beginning of the other; zero if they overlap.
fn gap_between(a: TimeSpan, b: TimeSpan) -> Duration {
    let gap = b.0.duration_since(a.1).max(a.0.duration_since(b.1));
    Duration::try_from(gap.max(SignedDuration::ZERO)).unwrap_or_default()
}

/// Returns the time span of a series that was imported with times.
fn imported_span(manifest: &SeriesManifest) -> Option<TimeSpan> {
    let dated = |shot: &&Shot| manifest.cause == SeriesCause::Imported && shot.exposure.is_some();
    let times = manifest
        .shots
        .iter()
        .filter(dated)
        .map(|shot| shot.stamp.utc);
    times.fold(None, |span, t| merge_spans(span, Some((t, t))))
}
