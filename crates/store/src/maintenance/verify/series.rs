//! Verification of a finished series: invariants 4 to 12.

use std::collections::BTreeSet;
use std::path::Path;

use super::StoreChecker;
use crate::format::manifest::{ResultLine, SeriesManifest, SeriesState, Shot};
use crate::format::{Inputs, jsonl, layout, sha256_hex};
use crate::read::catalogue::SeriesRef;

impl StoreChecker<'_> {
    pub(super) fn check_series(&mut self, series: &SeriesRef) {
        self.report.series += 1;
        if let Some(other) = self.seen.insert(series.id.clone(), series.folder.clone()) {
            self.report.add_fault(
                4,
                &series.folder,
                format!("has the same id as {}", other.display()),
            );
        }
        let path = series.folder.join(layout::SERIES_FILE);
        let Some(manifest) = self.parse_or_report::<SeriesManifest>(&path, 4) else {
            return;
        };
        let digest = self
            .disk
            .read(&path)
            .map(|bytes| sha256_hex(&bytes))
            .unwrap_or_default();
        self.manifests
            .insert(series.id.clone(), (digest, manifest.clone()));
        if manifest.format != layout::SERIES_FORMAT {
            let problem = format!(
                "has format {}, expected {}",
                manifest.format,
                layout::SERIES_FORMAT
            );
            self.report.add_fault(4, &path, problem);
        }
        let foreign = !series.flight.is_empty() && manifest.flight != series.flight;
        if manifest.series != series.id || foreign {
            let problem = format!(
                "names {}/{}, but the folder is {}/{}",
                manifest.flight, manifest.series, series.flight, series.id
            );
            self.report.add_fault(4, &path, problem);
        }
        if manifest.state == SeriesState::Interrupted {
            self.report.notes.push(format!(
                "{}: interrupted; its complete frames are kept",
                series.id
            ));
        }
        self.check_frame_files(series, &manifest);
        self.check_extra_files(series, &manifest);
        self.check_shot_list(&path, &manifest);
        self.check_times(&path, &manifest);
        self.check_results(series, &manifest);
    }

    fn check_frame_files(&mut self, series: &SeriesRef, manifest: &SeriesManifest) {
        for entry in manifest.frames() {
            let path = series.folder.join(&entry.file);
            if !layout::is_frame_name(&entry.file) {
                self.report.add_fault(
                    5,
                    &series.folder,
                    format!("{:?} is not a frame's name", entry.file),
                );
                continue;
            }
            let Some(bytes) = self.read_or_report(&path, 5) else {
                continue;
            };
            self.report.frames += 1;
            self.report.bytes += bytes.len() as u64;
            if bytes.len() as u64 != entry.bytes {
                let problem = format!(
                    "has {} bytes, but {} in series.json",
                    bytes.len(),
                    entry.bytes
                );
                self.report.add_fault(5, &path, problem);
            } else if sha256_hex(&bytes) != entry.sha256 {
                self.report
                    .add_fault(5, &path, "does not have the SHA-256 of series.json");
            }
        }
    }

    fn check_extra_files(&mut self, series: &SeriesRef, manifest: &SeriesManifest) {
        let mut names: BTreeSet<&str> = manifest.frames().map(|f| f.file.as_str()).collect();
        names.extend([layout::SERIES_FILE, layout::RESULTS_FILE]);
        for entry in self.list_or_report(&series.folder, 6) {
            if entry.is_dir || !names.contains(entry.name.as_str()) {
                let path = series.folder.join(&entry.name);
                self.report
                    .add_fault(6, &path, "is not named in series.json");
            }
        }
    }

    fn check_shot_list(&mut self, path: &Path, manifest: &SeriesManifest) {
        let numbers: Vec<u32> = manifest.shots.iter().map(|shot| shot.shot).collect();
        if numbers.first().is_some_and(|first| *first == 0) || !numbers.is_sorted_by(|a, b| a < b) {
            self.report
                .add_fault(7, path, "its shots are not numbered in order from 1");
        }
        if manifest.state == SeriesState::Complete
            && !numbers.iter().copied().eq(1..=manifest.planned_shots)
        {
            let problem = format!(
                "is complete, but some of its {} shots are missing",
                manifest.planned_shots
            );
            self.report.add_fault(7, path, problem);
        }
        let empty = |shot: &&Shot| shot.frame.is_none() && shot.failures.is_empty();
        if let Some(shot) = manifest.shots.iter().find(empty) {
            self.report.add_fault(
                7,
                path,
                format!("shot {} has neither a frame nor a reason", shot.shot),
            );
        }
    }

    /// Checks that time since boot does not decrease within a boot, nor from one series to the next. Concurrent series are
    /// checked separately; they may contain shots from before their beginning.
    fn check_times(&mut self, path: &Path, manifest: &SeriesManifest) {
        let beside = manifest.cause.is_concurrent();
        let mut last = if beside { None } else { self.last.take() };
        let began = manifest.started.iter().filter(|_| !beside);
        let shots = manifest.shots.iter().map(|shot| &shot.stamp);
        for stamp in began.chain(shots).chain(manifest.ended.iter()) {
            let earlier = last.as_ref().filter(|last| last.boot_id == stamp.boot_id);
            if earlier.is_some_and(|last| stamp.since_boot_s < last.since_boot_s) {
                let problem = format!("time since boot goes back to {:.3} s", stamp.since_boot_s);
                self.report.add_fault(8, path, problem);
            }
            last = Some(stamp.clone());
        }
        if !beside {
            self.last = last;
        }
    }

    fn check_results(&mut self, series: &SeriesRef, manifest: &SeriesManifest) {
        let path = series.folder.join(layout::RESULTS_FILE);
        if !self.disk.exists(&path) {
            return;
        }
        let Some(bytes) = self.read_or_report(&path, 9) else {
            return;
        };
        let lines = jsonl::parse_lines::<ResultLine>(&bytes);
        for number in &lines.damaged {
            self.report
                .add_fault(9, &path, format!("line {number} is damaged"));
        }
        if lines.good_length < bytes.len() {
            let count = bytes.len() - lines.good_length;
            self.report.notes.push(format!(
                "{}: its last {count} bytes are torn; they are set aside when the frame is solved again",
                path.display()
            ));
        }
        let mut seen = BTreeSet::new();
        for (number, line) in lines.good {
            self.report.results += 1;
            self.check_result_line(&path, number, &line, manifest);
            if !seen.insert((line.frame.clone(), line.inputs.clone())) {
                let problem = format!(
                    "line {number}: {} has a result for these inputs already",
                    line.frame
                );
                self.report.add_fault(11, &path, problem);
            }
        }
    }

    fn check_result_line(
        &mut self,
        path: &Path,
        number: usize,
        line: &ResultLine,
        manifest: &SeriesManifest,
    ) {
        let mut frames = manifest.frames();
        let frame = frames.find(|frame| frame.file == line.frame);
        if frame.is_none_or(|frame| frame.sha256 != line.frame_sha256) {
            let problem = format!(
                "line {number}: {} with this hash is not in the series",
                line.frame
            );
            self.report.add_fault(10, path, problem);
        }
        if Inputs::new(line.provenance.clone()).key(&line.frame_sha256) != line.inputs {
            let problem = format!("line {number}: inputs is not the hash of frame and provenance");
            self.report.add_fault(12, path, problem);
        }
    }
}
