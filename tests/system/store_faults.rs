//! Promise: a fault at any single step of the store's work loses nothing acknowledged, leaves nothing
//! partial that is taken for complete, and solves nothing twice. Source of the table in docs/store/durability.md.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::common::fake_disk::{DiskFault, FakeDisk, Survival, UnsyncedBytes, read_all_files};
use wingd::store::manifest::SeriesCause;
use wingd::store::{Disk, StoreError};

use crate::common::store_work::{ROOT, Work, installation};

type StoreAction = fn(&mut Work) -> Result<(), StoreError>;

/// An operation that is disturbed at each of its steps, and the preceding state.
struct Scenario {
    name: &'static str,
    before: StoreAction,
    act: StoreAction,
}

/// One line each; every operation that writes to a store belongs here.
const SCENARIOS: &[Scenario] = &[
    Scenario {
        name: "create",
        before: |_| Ok(()),
        act: |work| work.open().map(drop),
    },
    Scenario {
        name: "commit",
        before: record_day,
        act: |work| work.take_series(&work.open()?),
    },
    Scenario {
        name: "first flight",
        before: leave_empty,
        act: |work| work.take_series(&work.open()?),
    },
    Scenario {
        name: "next flight",
        before: record_day,
        act: next_flight,
    },
    Scenario {
        name: "installation",
        before: record_series,
        act: keep,
    },
    Scenario {
        name: "result",
        before: record_series,
        act: |work| work.solve(&work.open()?),
    },
    Scenario {
        name: "recover",
        before: interrupt_series,
        act: |work| work.open().map(drop),
    },
    Scenario {
        name: "format 1",
        before: old_store,
        act: record_series,
    },
    Scenario {
        name: "aircraft data",
        before: record_series,
        act: record_feeds,
    },
    Scenario {
        name: "live results",
        before: record_series,
        act: record_live,
    },
    Scenario {
        name: "live alone",
        before: leave_empty,
        act: record_live_alone,
    },
    Scenario {
        name: "two at a time",
        before: record_series,
        act: record_two_series,
    },
];

fn leave_empty(work: &mut Work) -> Result<(), StoreError> {
    work.open().map(drop)
}

fn record_day(work: &mut Work) -> Result<(), StoreError> {
    work.take_days(&work.open()?, 1)
}

fn record_series(work: &mut Work) -> Result<(), StoreError> {
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
fn record_feeds(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    for (feed, line) in [("one", 1), ("one", 2), ("two", 3)] {
        work.record_line(&store, feed, line)?;
    }
    store.close_aircraft_file()
}

/// Two blocks of one table, one of another.
fn record_live(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    for (program, rows) in [("one", 3), ("one", 1), ("two", 2)] {
        work.record_live(&store, program, rows)?;
    }
    store.close_live_file()
}

/// Live results begin the flight, and are not closed.
fn record_live_alone(work: &mut Work) -> Result<(), StoreError> {
    let store = work.open()?;
    work.record_live(&store, "one", 2)?;
    work.record_live(&store, "one", 2)
}

/// A series of an event begins and ends while another one is taken.
fn record_two_series(work: &mut Work) -> Result<(), StoreError> {
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
fn interrupt_series(work: &mut Work) -> Result<(), StoreError> {
    record_day(work)?;
    let store = work.open()?;
    work.take_series(&store)?;
    work.solve_some(&store, 1)?;
    drop(store);
    let whole = Survival {
        names: u64::MAX,
        bytes: Some(UnsyncedBytes::Whole),
        seed: 0,
    };
    let part = Path::new(ROOT).join("incoming/s000003/0002.jpg.part");
    let commit = Scenario {
        name: "",
        before: record_day,
        act: |work| work.take_series(&work.open()?),
    };
    let cut = |step| run_disturbed(work, &commit, DiskFault::PowerCut(step)).0;
    let cuts = (1..)
        .map(cut)
        .map(|work| work.moved_to(work.disk.power_up(whole)));
    let mut begun = cuts.skip_while(|work| !work.disk.exists(&part));
    // With its first step the part is complete in memory, with the second on the disk.
    *work = begun.nth(1).unwrap_or_else(|| work.clone());
    Ok(())
}

/// A store of format 1: without id, chains, sums, installations.
fn old_store(work: &mut Work) -> Result<(), StoreError> {
    let root = PathBuf::from(ROOT);
    work.open()?;
    work.disk
        .write(
            &root.join("store.toml"),
            b"format = 1\ncreated_by = \"wingd 0.1.0\"\n",
        )
        .unwrap();
    record_day(work)
}

/// Every order in which names can reach the medium, with each possible state of the bytes.
fn survivals(disk: &FakeDisk) -> Vec<Survival> {
    let names = disk.unsynced_names();
    assert!(
        names <= 8,
        "{names} names unsynced at a time: is there a sync missing?"
    );
    let bytes = [
        UnsyncedBytes::Lost,
        UnsyncedBytes::Whole,
        UnsyncedBytes::Half,
        UnsyncedBytes::Zeros,
    ];
    let spoilt =
        (0..4).flat_map(|seed| [UnsyncedBytes::Garbage(seed), UnsyncedBytes::Sectors(seed)]);
    let bytes: Vec<_> = bytes
        .into_iter()
        .chain(spoilt)
        .map(Some)
        .chain([None])
        .collect();
    let of = |names: u64| {
        bytes.iter().map(move |bytes| Survival {
            names,
            bytes: *bytes,
            seed: names,
        })
    };
    (0..1_u64 << names).flat_map(of).collect()
}

/// Contents of the disk, directories too.
fn found(disk: &FakeDisk) -> Vec<(PathBuf, Vec<u8>)> {
    let mut all: Vec<_> = read_all_files(disk, Path::new("")).into_iter().collect();
    let mut open = vec![PathBuf::new()];
    while let Some(directory) = open.pop() {
        for entry in disk
            .list(&directory)
            .unwrap_or_default()
            .into_iter()
            .filter(|entry| entry.is_dir)
        {
            open.push(directory.join(entry.name));
        }
        all.push((directory, Vec::new()));
    }
    all
}

/// The next boot: recovers, has everything, continues, still has everything.
fn next_boot(work: &mut Work) -> Result<(), String> {
    let text = |error: StoreError| error.to_string();
    let store = work.open().map_err(text)?;
    work.check().map_err(|why| format!("recovered: {why}"))?;
    let incoming = Path::new(ROOT).join("incoming");
    let left: Vec<_> = work
        .disk
        .list(&incoming)
        .unwrap()
        .into_iter()
        .map(|entry| entry.name)
        .collect();
    if !left.is_empty() {
        return Err(format!("left in incoming: {left:?}"));
    }
    work.take_series(&store).map_err(text)?;
    work.solve_some(&store, 1).map_err(text)?;
    work.check()
        .map_err(|why| format!("a series later: {why}"))?;
    work.solve(&store).map_err(text)?;
    work.check().map_err(|why| format!("all solved: {why}"))
}

/// Each different state that the next boot may find, once.
fn boots(work: &Work) -> Vec<(Survival, Work)> {
    let mut seen = BTreeSet::new();
    let all = survivals(&work.disk)
        .into_iter()
        .map(|left| (left, work.disk.power_up(left)));
    let new = all.filter(|(_, disk)| seen.insert(found(disk)));
    new.map(|(left, disk)| (left, work.moved_to(disk)))
        .collect()
}

/// Beginning of the scenario, and its number of steps.
fn begin(scenario: &Scenario) -> (Work, u64) {
    let mut work = Work::new(FakeDisk::default());
    (scenario.before)(&mut work).unwrap_or_else(|error| panic!("{}: {error}", scenario.name));
    work = work.moved_to(work.disk.fork());
    let mut trial = work.moved_to(work.disk.fork());
    (scenario.act)(&mut trial).unwrap_or_else(|error| panic!("{}: {error}", scenario.name));
    trial
        .check()
        .unwrap_or_else(|why| panic!("{} undisturbed: {why}", scenario.name));
    (work, trial.disk.steps())
}

/// The scenario with a fault; whether it completed nevertheless.
fn run_disturbed(before: &Work, scenario: &Scenario, fault: DiskFault) -> (Work, bool) {
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
            let (work, _) = run_disturbed(&before, scenario, DiskFault::PowerCut(cut));
            assert!(
                work.disk.steps() >= cut,
                "{}: step {cut} of {steps} was not reached",
                scenario.name
            );
            for (left, mut boot) in boots(&work) {
                cases += 1;
                let when = format!("{}: cut at step {cut} of {steps}, {left:?}", scenario.name);
                next_boot(&mut boot).unwrap_or_else(|why| panic!("{when}: {why}"));
            }
        }
        println!(
            "power cut  {:13} {steps:3} steps, {cases:5} states of the disk",
            scenario.name
        );
    }
}

/// The power fails again while the store recovers from the last time.
#[test]
fn a_power_cut_in_the_recovery_from_a_power_cut_loses_nothing_acknowledged() {
    let mut seen = BTreeSet::new();
    let recover = Scenario {
        name: "recovery",
        before: leave_empty,
        act: |work| work.open().map(drop),
    };
    let mut cases = 0;
    for scenario in SCENARIOS
        .iter()
        .filter(|scenario| ["commit", "result"].contains(&scenario.name))
    {
        let (before, steps) = begin(scenario);
        for cut in 1..=steps {
            let (work, _) = run_disturbed(&before, scenario, DiskFault::PowerCut(cut));
            for (_, boot) in boots(&work)
                .into_iter()
                .filter(|(_, boot)| seen.insert(found(&boot.disk)))
            {
                let trial = boot.moved_to(boot.disk.fork());
                trial.open().unwrap();
                for again in 1..=trial.disk.steps() {
                    let (work, _) = run_disturbed(&boot, &recover, DiskFault::PowerCut(again));
                    for (left, mut boot) in boots(&work).into_iter().step_by(3) {
                        cases += 1;
                        let when = format!(
                            "{}: cut at {cut}, again at {again}, {left:?}",
                            scenario.name
                        );
                        next_boot(&mut boot).unwrap_or_else(|why| panic!("{when}: {why}"));
                    }
                }
            }
        }
    }
    println!("power cut  in the recovery from a power cut: {cases} states of the disk");
}

/// One step fails and the program continues; later the power fails.
#[test]
fn a_failing_step_loses_nothing_acknowledged() {
    type Kind = (&'static str, fn(u64) -> DiskFault);
    let kinds: [Kind; 3] = [
        ("failure", DiskFault::Error),
        ("late", DiskFault::FailedAfterwards),
        ("disk full", DiskFault::Full),
    ];
    for (kind, fault) in kinds {
        for scenario in SCENARIOS {
            let (before, steps) = begin(scenario);
            for step in 1..=steps {
                let when = format!("{}: {kind} at step {step} of {steps}", scenario.name);
                let (mut work, _) = run_disturbed(&before, scenario, fault(step));
                work.disk.set_faults(Vec::new());
                next_boot(&mut work).unwrap_or_else(|why| panic!("{when}: {why}"));
                for (left, mut boot) in boots(&work) {
                    next_boot(&mut boot)
                        .unwrap_or_else(|why| panic!("{when}, then {left:?}: {why}"));
                }
            }
            println!("{kind:10} {:13} {steps:3} steps", scenario.name);
        }
    }
}

/// Faults on a medium whose syncs are ineffective: the test must notice, otherwise it would notice nothing.
#[test]
fn on_a_medium_that_lies_about_syncs_frames_are_lost_and_that_is_noticed() {
    let commit = SCENARIOS
        .iter()
        .find(|scenario| scenario.name == "commit")
        .unwrap();
    let (before, steps) = begin(commit);
    let (mut work, went_through) = run_disturbed(&before, commit, DiskFault::IgnoredSyncs(1));
    assert!(went_through && work.disk.steps() == steps);
    let store = work.open().unwrap();
    work.take_series(&store).unwrap();
    let lost = Survival {
        names: 0,
        bytes: Some(UnsyncedBytes::Lost),
        seed: 0,
    };
    let mut boot = work.moved_to(work.disk.power_up(lost));
    let why = next_boot(&mut boot).unwrap_err();
    assert!(why.contains("missing"), "{why}");
}

/// A store whose process continues after a failed step, without reopening.
#[test]
fn a_failing_step_costs_one_series_at_most() {
    let mut trial = Work::new(FakeDisk::default());
    let store = trial.open().unwrap();
    let begin = trial.disk.steps();
    trial.take_days(&store, 2).unwrap();
    for kind in [DiskFault::Error, DiskFault::FailedAfterwards] {
        for step in begin + 1..=trial.disk.steps() {
            let mut work = Work::new(FakeDisk::default());
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
                next_boot(&mut boot)
                    .unwrap_or_else(|why| panic!("{:?}, then {left:?}: {why}", kind(step)));
            }
        }
    }
}
