//! Promise: whatever happens at whichever single step of the store's work, nothing acknowledged is lost,
//! nothing half is taken for whole, nothing is solved twice. The table in docs/store/durability.md comes from here.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use wingd::store::fake::{UnsyncedBytes, FakeDisk, DiskFault, Survival, read_all_files};
use wingd::store::manifest::SeriesCause;
use wingd::store::{Disk, StoreError, upgrade_store};

use crate::common::store_work::{ROOT, Work, installation};

type Act = fn(&mut Work) -> Result<(), StoreError>;

/// A piece of work that is disturbed at each of its steps, and what was there before.
struct Scenario {
    name: &'static str,
    before: Act,
    act: Act,
}

/// One line each; an operation that writes to a store belongs here.
const SCENARIOS: &[Scenario] = &[
    Scenario { name: "create", before: |_| Ok(()), act: |work| work.open().map(drop) },
    Scenario { name: "commit", before: a_day, act: |work| work.take_series(&work.open()?) },
    Scenario { name: "first flight", before: nothing_yet, act: |work| work.take_series(&work.open()?) },
    Scenario { name: "next flight", before: a_day, act: next_flight },
    Scenario { name: "installation", before: a_series, act: keep },
    Scenario { name: "result", before: a_series, act: |work| work.solve(&work.open()?) },
    Scenario { name: "recover", before: broken_off, act: |work| work.open().map(drop) },
    Scenario { name: "upgrade", before: old_store, act: up },
    Scenario { name: "aircraft data", before: a_series, act: listen },
    Scenario { name: "live results", before: a_series, act: live },
    Scenario { name: "live alone", before: nothing_yet, act: live_alone },
    Scenario { name: "two at a time", before: a_series, act: two_at_a_time },
];

fn nothing_yet(work: &mut Work) -> Result<(), StoreError> {
    work.open().map(drop)
}

fn a_day(work: &mut Work) -> Result<(), StoreError> {
    work.days(&work.open()?, 1)
}

fn a_series(work: &mut Work) -> Result<(), StoreError> {
    work.take_series(&work.open()?)
}

fn next_flight(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    store.request_new_flight();
    work.take_series(&store)
}

fn keep(work: &mut Work) -> Result<(), StoreError> {
    work.open()?.keep_installation(&installation())
}

/// Lines of two feeds, the first feed's in two writes.
fn listen(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    for (feed, line) in [("one", 1), ("one", 2), ("two", 3)] {
        work.hear(&store, feed, line)?;
    }
    store.close_aircraft_file()
}

/// Two blocks of one table, one of another.
fn live(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    for (program, rows) in [("one", 3), ("one", 1), ("two", 2)] {
        work.go_live(&store, program, rows)?;
    }
    store.close_live_file()
}

/// Live results begin the flight, and nobody closes them.
fn live_alone(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    work.go_live(&store, "one", 2)?;
    work.go_live(&store, "one", 2)
}

/// A series of an event begins and ends while another one is taken.
fn two_at_a_time(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    let mut hourly = work.begin(&store, SeriesCause::Scheduled, 2)?;
    work.shoot(&mut hourly, 1)?;
    let mut event = work.begin(&store, SeriesCause::Event, 0)?;
    event.add_remark("a gust")?;
    work.shoot(&mut event, 1)?;
    work.shoot(&mut hourly, 2)?;
    work.finish(&store, event)?;
    work.finish(&store, hourly)
}

/// A series whose second frame has no name yet.
fn broken_off(work: &mut Work) -> Result<(), StoreError> {
    a_day(work)?;
    let store = work.open()?;
    work.take_series(&store)?;
    work.solve_some(&store, 1)?;
    drop(store);
    let whole = Survival { names: u64::MAX, bytes: Some(UnsyncedBytes::Whole), seed: 0 };
    let part = Path::new(ROOT).join("incoming/s000003/0002.jpg.part");
    let commit = Scenario { name: "", before: a_day, act: |work| work.take_series(&work.open()?) };
    let cut = |step| disturbed(work, &commit, DiskFault::PowerCut(step)).0;
    let cuts = (1..).map(cut).map(|work| work.moved_to(work.disk.power_up(whole)));
    let mut begun = cuts.skip_while(|work| !work.disk.exists(&part));
    // With its first step the part is whole in memory, with the second on the disk.
    *work = begun.nth(1).unwrap_or_else(|| work.clone());
    Ok(())
}

/// As format 1 has it: without id, chains, sums, installations.
fn old_store(work: &mut Work) -> Result<(), StoreError> {
    let root = PathBuf::from(ROOT);
    work.open()?;
    work.disk.write(&root.join("store.toml"), b"format = 1\ncreated_by = \"wingd 0.1.0\"\n").unwrap();
    a_day(work)
}

fn up(work: &mut Work) -> Result<(), StoreError> {
    upgrade_store(work.disk(), Path::new(ROOT), Some(&installation()))
}

/// Every order in which names can reach the medium, with each thing that can become of bytes.
fn survivals(disk: &FakeDisk) -> Vec<Survival> {
    let names = disk.unsynced_names();
    assert!(names <= 8, "{names} names unsynced at a time: is there a sync missing?");
    let bytes = [UnsyncedBytes::Lost, UnsyncedBytes::Whole, UnsyncedBytes::Half, UnsyncedBytes::Zeros];
    let spoilt = (0..4).flat_map(|seed| [UnsyncedBytes::Garbage(seed), UnsyncedBytes::Sectors(seed)]);
    let bytes: Vec<_> = bytes.into_iter().chain(spoilt).map(Some).chain([None]).collect();
    let of = |names: u64| bytes.iter().map(move |bytes| Survival { names, bytes: *bytes, seed: names });
    (0..1_u64 << names).flat_map(of).collect()
}

/// What a person finds on the disk, directories too.
fn found(disk: &FakeDisk) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all: Vec<_> = read_all_files(disk, Path::new("")).into_iter().collect();
    let mut open = vec![PathBuf::new()];
    while let Some(directory) = open.pop() {
        for entry in disk.list(&directory).unwrap_or_default().into_iter().filter(|entry| entry.is_dir) {
            open.push(directory.join(entry.name));
        }
        all.push((directory, Vec::new()));
    }
    all
}

/// The next boot: recovers, has everything, works on, has everything still.
fn next_boot(work: &mut Work) -> Result<(), String> {
    let text = |error: StoreError| error.to_string();
    let store = work.open().map_err(text)?;
    work.check().map_err(|why| format!("recovered: {why}"))?;
    let incoming = Path::new(ROOT).join("incoming");
    let left: Vec<_> = work.disk.list(&incoming).unwrap().into_iter().map(|entry| entry.name).collect();
    if !left.is_empty() {
        return Err(format!("left in incoming: {left:?}"));
    }
    work.take_series(&store).map_err(text)?;
    work.solve_some(&store, 1).map_err(text)?;
    work.check().map_err(|why| format!("a series later: {why}"))?;
    work.solve(&store).map_err(text)?;
    work.check().map_err(|why| format!("all solved: {why}"))
}

/// Each different thing that the next boot may find, once.
fn boots(work: &Work) -> Vec<(Survival, Work)> {
    let mut seen = BTreeSet::new();
    let all = survivals(&work.disk).into_iter().map(|left| (left, work.disk.power_up(left)));
    let new = all.filter(|(_, disk)| seen.insert(found(disk)));
    new.map(|(left, disk)| (left, work.moved_to(disk))).collect()
}

/// The scenario's beginning, and how many steps it has.
fn begin(scenario: &Scenario) -> (Work, u64) {
    let mut work = Work::on(FakeDisk::default());
    (scenario.before)(&mut work).unwrap_or_else(|error| panic!("{}: {error}", scenario.name));
    work = work.moved_to(work.disk.fork());
    let mut trial = work.moved_to(work.disk.fork());
    (scenario.act)(&mut trial).unwrap_or_else(|error| panic!("{}: {error}", scenario.name));
    trial.check().unwrap_or_else(|why| panic!("{} undisturbed: {why}", scenario.name));
    (work, trial.disk.steps())
}

/// The scenario with a fault; whether it went through all the same.
fn disturbed(before: &Work, scenario: &Scenario, fault: DiskFault) -> (Work, bool) {
    let mut work = before.moved_to(before.disk.fork());
    work.disk.set_faults(vec![fault]);
    let went_through = (scenario.act)(&mut work).is_ok();
    (work, went_through)
}

/// Power cuts at every step of every scenario, and at every step of the recovery from each of them.
#[test]
fn a_power_cut_at_any_step_loses_nothing_acknowledged() {
    for scenario in SCENARIOS {
        let (before, steps) = begin(scenario);
        let mut cases = 0;
        for cut in 1..=steps {
            let (work, _) = disturbed(&before, scenario, DiskFault::PowerCut(cut));
            assert!(work.disk.steps() >= cut, "{}: step {cut} of {steps} was not reached", scenario.name);
            for (left, mut boot) in boots(&work) {
                cases += 1;
                let when = format!("{}: cut at step {cut} of {steps}, {left:?}", scenario.name);
                goes_on(&mut boot, scenario).unwrap_or_else(|why| panic!("{when}: {why}"));
            }
        }
        println!("power cut  {:13} {steps:3} steps, {cases:5} states of the disk", scenario.name);
    }
}

/// The power goes again while the store recovers from the last time.
#[test]
fn a_power_cut_in_the_recovery_from_a_power_cut_loses_nothing_acknowledged() {
    let mut seen = BTreeSet::new();
    let recover = Scenario { name: "recovery", before: nothing_yet, act: |work| work.open().map(drop) };
    let mut cases = 0;
    for scenario in SCENARIOS.iter().filter(|scenario| ["commit", "result"].contains(&scenario.name)) {
        let (before, steps) = begin(scenario);
        for cut in 1..=steps {
            let (work, _) = disturbed(&before, scenario, DiskFault::PowerCut(cut));
            for (_, boot) in boots(&work).into_iter().filter(|(_, boot)| seen.insert(found(&boot.disk))) {
                let trial = boot.moved_to(boot.disk.fork());
                trial.open().unwrap();
                for again in 1..=trial.disk.steps() {
                    let (work, _) = disturbed(&boot, &recover, DiskFault::PowerCut(again));
                    for (left, mut boot) in boots(&work).into_iter().step_by(3) {
                        cases += 1;
                        let when = format!("{}: cut at {cut}, again at {again}, {left:?}", scenario.name);
                        next_boot(&mut boot).unwrap_or_else(|why| panic!("{when}: {why}"));
                    }
                }
            }
        }
    }
    println!("power cut  in the recovery from a power cut: {cases} states of the disk");
}

/// One step fails and the program goes on; later the power goes.
#[test]
fn a_failing_step_loses_nothing_acknowledged() {
    type Kind = (&'static str, fn(u64) -> DiskFault);
    let kinds: [Kind; 3] = [("failure", DiskFault::Error), ("late", DiskFault::FailedAfterwards), ("disk full", DiskFault::Full)];
    for (kind, fault) in kinds {
        for scenario in SCENARIOS {
            let (before, steps) = begin(scenario);
            for step in 1..=steps {
                let when = format!("{}: {kind} at step {step} of {steps}", scenario.name);
                let (mut work, _) = disturbed(&before, scenario, fault(step));
                work.disk.set_faults(Vec::new());
                goes_on(&mut work, scenario).unwrap_or_else(|why| panic!("{when}: {why}"));
                for (left, mut boot) in boots(&work) {
                    next_boot(&mut boot).unwrap_or_else(|why| panic!("{when}, then {left:?}: {why}"));
                }
            }
            println!("{kind:10} {:13} {steps:3} steps", scenario.name);
        }
    }
}

/// The daemon after a failure: does it again where that is its way, and goes on.
fn goes_on(work: &mut Work, scenario: &Scenario) -> Result<(), String> {
    if scenario.name == "upgrade" {
        up(work).map_err(|error| error.to_string())?;
    }
    next_boot(work)
}

/// The same on a medium whose syncs are lies: the test must notice, or it would notice nothing.
#[test]
fn on_a_medium_that_lies_about_syncs_frames_are_lost_and_that_is_noticed() {
    let commit = SCENARIOS.iter().find(|scenario| scenario.name == "commit").unwrap();
    let (before, steps) = begin(commit);
    let (mut work, went_through) = disturbed(&before, commit, DiskFault::IgnoredSyncs(1));
    assert!(went_through && work.disk.steps() == steps);
    let store = work.open().unwrap();
    work.take_series(&store).unwrap();
    let lost = Survival { names: 0, bytes: Some(UnsyncedBytes::Lost), seed: 0 };
    let mut boot = work.moved_to(work.disk.power_up(lost));
    let why = next_boot(&mut boot).unwrap_err();
    assert!(why.contains("missing"), "{why}");
}

/// A store whose process goes on after a failed step, without being opened anew.
#[test]
fn a_failing_step_costs_one_series_at_most() {
    let mut trial = Work::on(FakeDisk::default());
    let store = trial.open().unwrap();
    let begin = trial.disk.steps();
    trial.days(&store, 2).unwrap();
    for kind in [DiskFault::Error, DiskFault::FailedAfterwards] {
        for step in begin + 1..=trial.disk.steps() {
            let mut work = Work::on(FakeDisk::default());
            let store = work.open().unwrap();
            work.disk.set_faults(vec![kind(step)]);
            let mut failed = 0;
            for _ in 0..3 {
                failed += u32::from(work.take_series(&store).is_err());
                failed += u32::from(work.solve(&store).is_err());
            }
            assert!(failed <= 1, "step {step}: {failed} failures");
            work.solve(&store).unwrap();
            for (left, mut boot) in boots(&work) {
                next_boot(&mut boot).unwrap_or_else(|why| panic!("{:?}, then {left:?}: {why}", kind(step)));
            }
        }
    }
}
