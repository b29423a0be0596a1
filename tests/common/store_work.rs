//! A day of work on a store, what the store acknowledged, and a check that all of it is present.

use crate::common::store_reading::{read_live, read_results};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;

use crate::common::fake_disk::FakeDisk;
use serde_json::{Map, Value, json};
use wingd::clock::Stamp;
use wingd::store::aircraft::{self, AircraftLine};
use wingd::store::columns::UTC;
use wingd::store::installations::InstallationFile;
use wingd::store::manifest::{SeriesCause, SeriesState, Shot, ShotFailure};
use wingd::store::verify::verify_path;
use wingd::store::{
    Disk, Inputs, LiveColumn, LiveRow, LiveTable, NewFrame, OpenSeries, SeriesPlan, Store,
    StoreConfig, StoreError, ValueKind, catalogue, live, sha256_hex,
};

pub const ROOT: &str = "store";

pub fn moment(since_boot_s: f64) -> Stamp {
    let utc = jiff::Timestamp::from_millisecond((since_boot_s * 1e3) as i64).unwrap();
    Stamp {
        utc,
        utc_synchronised: false,
        boot_id: "boot".to_owned(),
        since_boot_s,
    }
}

/// Installation of the results.
pub fn installation() -> Vec<InstallationFile> {
    vec![
        ("camera.toml".into(), b"fx = 1\n".to_vec()),
        ("survey.csv".into(), b"id\n".to_vec()),
    ]
}

pub fn inputs() -> Inputs {
    let named =
        |(name, bytes): (String, Vec<u8>)| (format!("{name}.sha256"), sha256_hex(&bytes).into());
    Inputs::new(installation().into_iter().map(named).collect())
}

/// Live results of three markers.
pub fn live_table(program: &str) -> LiveTable {
    let column = |name: &str, unit: &str, kind, width| {
        let (name, unit) = (name.to_owned(), unit.to_owned());
        LiveColumn {
            name,
            unit,
            kind,
            width,
        }
    };
    let columns = vec![
        column("utc", UTC, ValueKind::U64, 1),
        column("number", "", ValueKind::U32, 1),
        column("markers.deflection", "m", ValueKind::F32, 3),
        column("latency", "ms", ValueKind::F64, 1),
    ];
    LiveTable {
        source: json!({"program": program, "markers": ["M1", "M2", "M3"]}),
        columns,
    }
}

/// A live result, identified by its number.
pub fn live_row(number: u32) -> LiveRow {
    let x = f64::from(number);
    vec![
        1e15 + 1e5 * x,
        x,
        0.5 + 0.001 * (x % 7.0),
        f64::NAN,
        1.5,
        80.25 + x % 3.0,
    ]
}

/// Items that the store acknowledged.
#[derive(Default, Clone)]
pub struct Acknowledged {
    pub frames: BTreeSet<String>,
    pub results: BTreeSet<String>,
    pub complete: BTreeSet<String>,
    pub lines: BTreeSet<String>,
    /// Numbers of live results.
    pub live: BTreeSet<u32>,
}

/// A store on a faulty disk, and a program that works with it.
#[derive(Clone)]
pub struct Work {
    pub disk: Arc<FakeDisk>,
    pub acknowledged: Acknowledged,
    pub time_s: f64,
    /// Number of series begun; each has different frames.
    pub begun: u32,
    /// Number of live results.
    pub seen: u32,
}

impl Work {
    pub fn new(disk: FakeDisk) -> Self {
        Self {
            disk: Arc::new(disk),
            acknowledged: Acknowledged::default(),
            time_s: 0.0,
            begun: 0,
            seen: 0,
        }
    }

    /// The same state on another disk.
    pub fn moved_to(&self, disk: FakeDisk) -> Self {
        Self {
            disk: Arc::new(disk),
            ..self.clone()
        }
    }

    pub fn disk(&self) -> Arc<dyn Disk> {
        self.disk.clone()
    }

    pub fn open(&self) -> Result<Store, StoreError> {
        let config = StoreConfig {
            reserve_mb: 0,
            ..StoreConfig::new(ROOT)
        };
        Store::open(self.disk(), config).map(|(store, _)| store)
    }

    /// Takes series with frames and failures, with results after each.
    pub fn take_days(&mut self, store: &Store, series: u32) -> Result<(), StoreError> {
        for _ in 0..series {
            self.take_series(store)?;
            self.solve(store)?;
        }
        Ok(())
    }

    /// Takes three shots; every fifth has no frame.
    pub fn take_series(&mut self, store: &Store) -> Result<(), StoreError> {
        let mut series = self.begin(store, SeriesCause::Scheduled, 3)?;
        for shot in 1..=3 {
            self.shoot(&mut series, shot)?;
        }
        self.finish(store, series)
    }

    pub fn begin(
        &mut self,
        store: &Store,
        cause: SeriesCause,
        shots: u32,
    ) -> Result<OpenSeries, StoreError> {
        self.begun += 1;
        self.time_s += 60.0;
        let (mut series, _) =
            store.begin_series(SeriesPlan { cause, shots }, &moment(self.time_s))?;
        series.note_camera(json!({"name": "fake"}).as_object().cloned().unwrap())?;
        Ok(series)
    }

    pub fn shoot(&mut self, series: &mut OpenSeries, shot: u32) -> Result<(), StoreError> {
        self.time_s += 1.0;
        let n = self.begun - 1;
        let failed = (n + shot).is_multiple_of(5);
        let why = ShotFailure {
            kind: "busy".to_owned(),
            reason: "busy".to_owned(),
            kept_as: None,
        };
        let failures = if failed { vec![why] } else { Vec::new() };
        let bytes = format!("frame {n} {shot} {} ", self.time_s)
            .repeat(10)
            .into_bytes();
        let stamp = moment(self.time_s);
        let shot = Shot {
            shot,
            stamp,
            duration_s: Some(0.1),
            exposure: None,
            frame: None,
            failures,
        };
        let frame = NewFrame {
            bytes: &bytes,
            extension: "jpg",
            format: Value::Null,
            settings: Map::new(),
        };
        series.add_shot(shot, (!failed).then_some(frame))?;
        if !failed {
            self.acknowledged.frames.insert(sha256_hex(&bytes));
        }
        Ok(())
    }

    pub fn finish(&mut self, store: &Store, series: OpenSeries) -> Result<(), StoreError> {
        let id = series.id().to_owned();
        store.close_series(
            series,
            SeriesState::Complete,
            &moment(self.time_s),
            Vec::new(),
        )?;
        self.acknowledged.complete.insert(id);
        Ok(())
    }

    /// Records `rows` live results in a block.
    pub fn record_live(
        &mut self,
        store: &Store,
        program: &str,
        rows: u32,
    ) -> Result<(), StoreError> {
        let numbers = self.seen..self.seen + rows;
        self.seen += rows;
        self.time_s += 2.0;
        let rows: Vec<LiveRow> = numbers.clone().map(live_row).collect();
        store.append_live_rows(&live_table(program), &rows, &moment(self.time_s))?;
        self.acknowledged.live.extend(numbers);
        Ok(())
    }

    /// Records a line of a feed.
    pub fn record_line(
        &mut self,
        store: &Store,
        feed: &str,
        number: u32,
    ) -> Result<(), StoreError> {
        let line = format!("IWG1,{number},{}", self.time_s);
        let acknowledged = AircraftLine {
            at: Some(moment(self.time_s)),
            line: line.clone(),
        };
        if store.add_aircraft_lines(&json!({"feed": feed}), &[acknowledged])? {
            self.acknowledged.lines.insert(line);
        }
        Ok(())
    }

    /// Solves all unsolved frames.
    pub fn solve(&mut self, store: &Store) -> Result<(), StoreError> {
        store.keep_installation(&installation())?;
        while self.solve_some(store, usize::MAX)? > 0 {}
        store.seal();
        Ok(())
    }

    /// Solves at most `most` frames of the first series; returns how many.
    pub fn solve_some(&mut self, store: &Store, most: usize) -> Result<usize, StoreError> {
        let frames: Vec<_> = store
            .unsolved_frames(&inputs())?
            .into_iter()
            .take(most)
            .collect();
        for frame in &frames {
            store.begin_solving(frame, &inputs())?;
            store.read_frame(frame)?;
            assert!(
                store.add_result(frame, &inputs(), json!({"deflection_m": 1.25}))?,
                "solved twice"
            );
            self.acknowledged.results.insert(frame.entry.sha256.clone());
        }
        Ok(frames.len())
    }

    /// Checks that the store is sound and contains everything acknowledged, once.
    pub fn check(&self) -> Result<(), String> {
        let report = verify_path(self.disk.as_ref(), Path::new(ROOT));
        if !report.is_sound() {
            return Err(format!("{:#?}", report.faults));
        }
        let (frames, results, states) = holdings(self.disk.as_ref())?;
        let missing: Vec<_> = self.acknowledged.frames.difference(&frames).collect();
        if !missing.is_empty() {
            return Err(format!("acknowledged frames are missing: {missing:?}"));
        }
        if let Some(result) = self
            .acknowledged
            .results
            .iter()
            .find(|result| !results.contains_key(*result))
        {
            return Err(format!("an acknowledged result is missing: {result}"));
        }
        if results.values().any(|count| *count != 1) {
            return Err("solved twice".to_owned());
        }
        let heard = lines(self.disk.as_ref())?;
        if let Some(line) = self
            .acknowledged
            .lines
            .iter()
            .find(|line| !heard.contains(*line))
        {
            return Err(format!(
                "an acknowledged line of the aircraft's data is missing: {line}"
            ));
        }
        let (seen, twice) = live_numbers(self.disk.as_ref())?;
        if let Some(number) = self
            .acknowledged
            .live
            .iter()
            .find(|number| !seen.contains(*number))
        {
            return Err(format!("an acknowledged live result is missing: {number}"));
        }
        if twice {
            return Err("a live result is there twice".to_owned());
        }
        let incomplete = self
            .acknowledged
            .complete
            .iter()
            .find(|id| states.get(*id) != Some(&SeriesState::Complete));
        incomplete.map_or(Ok(()), |id| {
            Err(format!("{id} is not there as a complete series"))
        })
    }
}

/// Lines of the aircraft data.
fn lines(disk: &dyn Disk) -> Result<BTreeSet<String>, String> {
    let text = |error: StoreError| error.to_string();
    let mut all = BTreeSet::new();
    for flight in catalogue::list_flights(disk, Path::new(ROOT)).map_err(text)? {
        let (read, notes) =
            aircraft::read_aircraft(disk, Path::new(ROOT), &flight).map_err(text)?;
        if let Some(note) = notes.first() {
            return Err(note.clone());
        }
        all.extend(
            read.into_iter()
                .flat_map(|(_, lines)| lines)
                .map(|line| line.line),
        );
    }
    Ok(all)
}

/// Numbers of the live results, and whether one occurs twice.
fn live_numbers(disk: &dyn Disk) -> Result<(BTreeSet<u32>, bool), String> {
    let text = |error: StoreError| error.to_string();
    let (mut all, mut twice) = (BTreeSet::new(), false);
    for flight in catalogue::list_flights(disk, Path::new(ROOT)).map_err(text)? {
        let (files, notes) = read_live(disk, Path::new(ROOT), &flight).map_err(text)?;
        if let Some(note) = notes.first() {
            return Err(note.clone());
        }
        for row in files.iter().flat_map(|(_, rows)| rows) {
            let number = row[1] as u32;
            let bits = |row: &[f64]| {
                row.iter()
                    .map(|v| (*v as f32).to_bits())
                    .collect::<Vec<_>>()
            };
            if bits(row) != bits(&live_row(number)) {
                return Err(format!("live result {number} has other values"));
            }
            twice |= !all.insert(number);
        }
    }
    Ok((all, twice))
}

/// Frames, results of each, state of each series.
type Holdings = (
    BTreeSet<String>,
    BTreeMap<String, usize>,
    BTreeMap<String, SeriesState>,
);

fn holdings(disk: &dyn Disk) -> Result<Holdings, String> {
    let (mut frames, mut results, mut states) = Holdings::default();
    let text = |error: StoreError| error.to_string();
    for flight in catalogue::list_flights(disk, Path::new(ROOT)).map_err(text)? {
        for series in catalogue::list_series(disk, &flight).map_err(text)? {
            let manifest = catalogue::read_series_manifest(disk, &series).map_err(text)?;
            states.insert(series.id.clone(), manifest.state);
            for frame in wingd::store::series_frames(&series, manifest) {
                wingd::store::read_frame(disk, &frame).map_err(text)?;
                if !frames.insert(frame.entry.sha256) {
                    return Err("a frame is there twice".to_owned());
                }
            }
            for line in read_results(disk, &series).map_err(text)? {
                *results.entry(line.frame_sha256).or_insert(0) += 1;
            }
        }
    }
    Ok((frames, results, states))
}
