//! Series of pictures become series of the store, each picture once.

use std::collections::BTreeMap;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde_json::Value;

use crate::camera::extension;
use crate::camera::replay::format_of;
use crate::cli::pictures::Picture;
use crate::cli::{Failure, frames};
use crate::clock::Stamp;
use crate::clock::exposure::Exposure;
use crate::installation::shown_path;
use crate::store::manifest::{Cause, SeriesManifest, Shot, State};
use crate::store::{FlightRef, NewFrame, OpenSeries, Plan, Store, StoreConfig, catalogue, layout, sha256};

/// What became of a series of pictures.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Taken {
    /// Where they went.
    pub flight: String,
    /// The store's name of it; `None` where all of it was there.
    pub series: Option<String>,
    /// Pictures copied.
    pub taken: usize,
    /// Pictures that the store held before.
    pub already: usize,
}

/// A flight of the store as far as imports are concerned.
struct Known {
    id: String,
    /// From the first to the last picture that was imported with a time.
    span: Option<(Timestamp, Timestamp)>,
}

/// Pictures on their way into a store.
pub(super) struct Import<'a> {
    store: &'a Store,
    /// As the user names the flight.
    wanted: Option<String>,
    clock_sigma_s: Option<f64>,
    /// Flight of each picture there is, by digest.
    held: BTreeMap<String, String>,
    flights: Vec<Known>,
    pause: Duration,
    bar: indicatif::ProgressBar,
}

impl<'a> Import<'a> {
    /// `wanted` is a flight of the store, or the user's name of one.
    pub fn new(
        store: &'a Store,
        wanted: Option<String>,
        clock_sigma_s: Option<f64>,
        pictures: usize,
    ) -> Result<Self, Failure> {
        let mut import = Self {
            store,
            wanted: None,
            clock_sigma_s,
            held: BTreeMap::new(),
            flights: Vec::new(),
            pause: StoreConfig::at("").new_flight_after,
            bar: frames::progress(pictures, "copying"),
        };
        for flight in catalogue::flights(store.disk(), store.root())? {
            import.look_at(&flight, wanted.as_deref())?;
        }
        if let Some(name) = wanted.filter(|_| import.wanted.is_none()) {
            if layout::flight_number(&name).is_some() {
                let known: Vec<&str> = import.flights.iter().map(|f| f.id.as_str()).collect();
                let what = format!("there is no flight {name}, only: {}", known.join(", "));
                return Err(Failure::Failed(format!("{}: {what}", store.root().display())));
            }
            import.wanted = Some(name);
        }
        Ok(import)
    }

    fn look_at(&mut self, flight: &FlightRef, wanted: Option<&str>) -> Result<(), Failure> {
        let disk = self.store.disk();
        let mut span = None;
        for series in catalogue::series(disk, flight)? {
            let manifest = catalogue::manifest(disk, &series)?;
            let digests = manifest.frames().map(|frame| (frame.sha256.clone(), flight.id.clone()));
            self.held.extend(digests);
            span = joined(span, imported(&manifest));
        }
        let name = catalogue::flight_manifest(disk, flight).ok().and_then(|manifest| manifest.name);
        if wanted.is_some_and(|wanted| wanted == flight.id || Some(wanted) == name.as_deref()) {
            self.wanted = Some(flight.id.clone());
        }
        self.flights.push(Known { id: flight.id.clone(), span });
        Ok(())
    }

    /// Takes every series in; what became of each is given as it is done.
    pub fn all(
        mut self,
        series: Vec<Vec<Picture>>,
        mut done: impl FnMut(Vec<Picture>, Taken),
    ) -> Result<(), Failure> {
        for flight in flights(series, self.pause) {
            let mut id = self.flight_of(&flight)?;
            for pictures in flight {
                let taken = self.one(&pictures, &mut id)?;
                done(pictures, taken);
            }
        }
        self.bar.finish_and_clear();
        Ok(())
    }

    /// The flight that pictures belong to: that which is named; that which holds some of them; that whose imported
    /// pictures lie about them in time. `None`: a new one.
    fn flight_of(&self, series: &[Vec<Picture>]) -> Result<Option<String>, Failure> {
        if let Some(wanted) = &self.wanted {
            return Ok(self.flights.iter().any(|f| f.id == *wanted).then(|| wanted.clone()));
        }
        let pictures = || series.iter().flatten();
        if let Some(held) = pictures().find_map(|p| self.held.get(&p.digest)) {
            return Ok(Some(held.clone()));
        }
        let span = pictures().filter_map(|p| p.utc).fold(None, |span, t| joined(span, Some((t, t))));
        let near = |known: &&Known| known.span.zip(span).is_some_and(|(a, b)| apart(a, b) <= self.pause);
        Ok(self.flights.iter().find(near).map(|known| known.id.clone()))
    }

    /// A series; its flight is begun with the first picture that is not there yet.
    fn one(&mut self, pictures: &[Picture], flight: &mut Option<String>) -> Result<Taken, Failure> {
        let new: Vec<&Picture> = pictures.iter().filter(|p| !self.held.contains_key(&p.digest)).collect();
        let already = pictures.len() - new.len();
        self.bar.inc(already as u64);
        let Some(first) = new.first() else {
            let held = pictures.first().and_then(|p| self.held.get(&p.digest)).cloned();
            return Ok(Taken { flight: held.unwrap_or_default(), series: None, taken: 0, already });
        };
        let began = Began::of(first);
        let id = match flight {
            Some(id) => id.clone(),
            None => {
                let now = began.stamp(first, 0);
                let id =
                    self.store.begin_flight(&now, "imported from pictures".into(), self.wanted.clone())?;
                self.flights.push(Known { id: id.clone(), span: None });
                self.wanted = self.wanted.take().map(|_| id.clone());
                flight.insert(id).clone()
            }
        };
        let plan = Plan { cause: Cause::Imported, shots: u32::try_from(new.len()).unwrap_or(u32::MAX) };
        let (mut open, _) = self.store.begin_series_of(&id, plan, &began.stamp(first, 0))?;
        let name = open.id().to_owned();
        let copied = self.copy(&mut open, &began, &new);
        let last = open.shots().last().map_or_else(|| began.stamp(first, 0), |shot| shot.stamp.clone());
        let (state, remark) = match &copied {
            Ok(()) => (State::Complete, None),
            Err(_) => {
                (State::Interrupted, Some("the import was broken off; import again to go on".to_owned()))
            }
        };
        self.store.close_series(open, state, &last, remark.into_iter().collect())?;
        copied?;
        self.held.extend(new.iter().map(|p| (p.digest.clone(), id.clone())));
        Ok(Taken { flight: id, series: Some(name), taken: new.len(), already })
    }

    fn copy(&self, open: &mut OpenSeries, began: &Began, new: &[&Picture]) -> Result<(), Failure> {
        let settings = new.iter().flat_map(|p| &p.taken.settings);
        let of_camera = settings.filter(|(name, _)| CAMERA.contains(name));
        open.note_camera(of_camera.map(|(k, v)| ((*k).to_owned(), v.clone().into())).collect())?;
        if began.utc.is_none() {
            open.remark("the pictures do not say when they were taken: their order is that of the files, their times mean nothing")?;
        }
        for (k, picture) in new.iter().enumerate() {
            let shown = shown_path(&picture.file);
            let bytes = std::fs::read(&picture.file).map_err(|e| {
                Failure::Failed(format!("{shown} cannot be read ({e}); import again to go on"))
            })?;
            if sha256(&bytes) != picture.digest {
                return Err(Failure::Failed(format!(
                    "{shown} changed while it was read; check the card and import again"
                )));
            }
            let number = u32::try_from(k + 1).unwrap_or(u32::MAX);
            let stamp = began.stamp(picture, k);
            let exposure = (picture.says_when() && picture.utc.is_some())
                .then(|| Exposure::by_camera(&stamp, picture.step_s(), self.clock_sigma_s));
            let format = format_of(&picture.file);
            let frame = NewFrame {
                bytes: &bytes,
                extension: format.as_ref().map_or("bin", extension),
                format: serde_json::to_value(&format).unwrap_or(Value::Null),
                settings: picture.settings(),
            };
            let shot =
                Shot { shot: number, stamp, duration_s: None, exposure, frame: None, failures: Vec::new() };
            open.add_shot(shot, Some(frame))?;
            self.bar.inc(1);
        }
        Ok(())
    }
}

/// What of a picture's settings is the camera's own.
const CAMERA: [&str; 3] = ["make", "model", "serial_number"];

/// Where a series' times count from: a clock of its own, for nothing ties the camera's to a machine's.
struct Began {
    boot_id: String,
    utc: Option<Timestamp>,
}

impl Began {
    fn of(first: &Picture) -> Self {
        let short: String = first.digest.chars().take(16).collect();
        Self { boot_id: format!("import-{short}"), utc: first.utc }
    }

    /// Of the picture at a place in the series; without times the pictures are a second apart in 1970.
    fn stamp(&self, picture: &Picture, place: usize) -> Stamp {
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

type Span = (Timestamp, Timestamp);

/// Both spans and what lies between.
fn joined(a: Option<Span>, b: Option<Span>) -> Option<Span> {
    match (a, b) {
        (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
        (one, other) => one.or(other),
    }
}

/// From the end of one span to the beginning of the other; zero where they overlap.
fn apart(a: Span, b: Span) -> Duration {
    let gap = b.0.duration_since(a.1).max(a.0.duration_since(b.1));
    Duration::try_from(gap.max(SignedDuration::ZERO)).unwrap_or_default()
}

/// From the first to the last picture of a series that was imported with times.
fn imported(manifest: &SeriesManifest) -> Option<Span> {
    let dated = |shot: &&Shot| manifest.cause == Cause::Imported && shot.exposure.is_some();
    let times = manifest.shots.iter().filter(dated).map(|shot| shot.stamp.utc);
    times.fold(None, |span, t| joined(span, Some((t, t))))
}

/// Series between which no pause is longer than `pause`; those without a time are one.
fn flights(series: Vec<Vec<Picture>>, pause: Duration) -> Vec<Vec<Vec<Picture>>> {
    let end = |s: &[Picture]| s.last().and_then(|p| p.utc);
    let begin = |s: &[Picture]| s.first().and_then(|p| p.utc);
    let mut all: Vec<Vec<Vec<Picture>>> = Vec::new();
    for one in series {
        let last = all.last().and_then(|flight| flight.last());
        let goes_on = last.is_some_and(|last| match (end(last), begin(&one)) {
            (Some(a), Some(b)) => apart((a, a), (b, b)) <= pause,
            (None, None) => true,
            _ => false,
        });
        match all.last_mut() {
            Some(open) if goes_on => open.push(one),
            _ => all.push(vec![one]),
        }
    }
    all
}
