//! Promise: floods, slow readers, long series, weak secrets, damaged counters and hostile names take neither memory, threads
//! nor the terminal.

use std::io::Write;
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use wingd::clock::{Clock, SystemClock};
use wingd::daemon::query_daemon;

use super::recorder_survives::{
    FIRST_SERIES, Recorder, TOKEN, assert_sound, configure, free_address, page, recorded_flight,
    series,
};
use crate::common::report_store::{failed, jpeg, solved, store_with};

/// A flood of datagrams takes neither memory nor disk; the lines of the feed are recorded.
#[test]
fn a_flood_of_datagrams_costs_only_lines() {
    let dir = tempfile::tempdir().unwrap();
    let port = std::net::UdpSocket::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port();
    configure(
        dir.path(),
        &format!("[live]\n[live.aircraft_data]\nudp = \"127.0.0.1:{port}\"\n"),
    );
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
    let junk = "x\n".repeat(700);
    let begun = Instant::now();
    let mut sent = 0;
    while begun.elapsed() < Duration::from_secs(6) {
        for _ in 0..20 {
            let _ = socket.send_to(junk.as_bytes(), ("127.0.0.1", port));
        }
        if sent < 10 * begun.elapsed().as_secs() {
            let line = format!(
                "IWG1,{},1,2\r\n",
                SystemClock::new()
                    .stamp()
                    .utc
                    .to_string()
                    .trim_end_matches('Z')
            );
            let _ = socket.send_to(line.as_bytes(), ("127.0.0.1", port));
            sent += 1;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    let status = recorder.wait("lost lines", FIRST_SERIES, |status| {
        status["aircraft"]["lost"].as_u64() > Some(100_000)
    });
    assert!(
        status["aircraft"]["read"].as_u64() > Some(5),
        "{}",
        status["aircraft"]
    );
    let peak_kb = process_number(&recorder, "VmHWM:");
    assert!(peak_kb < 150_000, "{peak_kb} kB");
    recorder.end();
    let store = dir.path().join("store");
    let written: u64 = std::fs::read_dir(store.join("flights/f0001"))
        .unwrap()
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with("aircraft-"))
        .map(|entry| entry.metadata().unwrap().len())
        .sum();
    assert!(written < 3_000_000, "{written} bytes of a flood of 8 MB");
    assert_sound(&store);
}

/// Page of a store with a series of 120 frames, 48 MB of results and a frame of 9 MB.
fn serve_long_series() -> (tempfile::TempDir, Recorder, std::net::SocketAddr) {
    let results: Vec<Value> = (0..120).map(|_| solved(2.9, 0.006)).collect();
    let store = store_with(&[&results]);
    let folder = store.path().join("flights/f0001/s000001");
    // 48 MB of results, as of an event of a thousand frames.
    let padding = format!("\"record\":{{\"padding\":[{}1],", "1.5,".repeat(100_000));
    let text = std::fs::read_to_string(folder.join("results.jsonl")).unwrap();
    std::fs::write(
        folder.join("results.jsonl"),
        text.replace("\"record\":{", &padding),
    )
    .unwrap();
    let frame = folder.join("0001.jpg");
    std::fs::OpenOptions::new()
        .write(true)
        .open(&frame)
        .unwrap()
        .set_len(9 << 20)
        .unwrap();
    let manifest = std::fs::read_to_string(folder.join("series.json")).unwrap();
    let length = format!("\"bytes\": {}", jpeg().len());
    std::fs::write(
        folder.join("series.json"),
        manifest.replace(&length, &format!("\"bytes\": {}", 9 << 20)),
    )
    .unwrap();
    let address = free_address();
    let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
    let command = command
        .arg("serve")
        .arg(store.path())
        .args(["--listen", &address.to_string()]);
    let child = command.stderr(Stdio::null()).spawn().unwrap();
    let server = Recorder {
        child,
        folder: store.path().to_owned(),
    };
    let begun = Instant::now();
    while page(address, "/live").is_none() && begun.elapsed() < FIRST_SERIES {
        std::thread::sleep(Duration::from_millis(50));
    }
    (store, server, address)
}

/// A number of the server's process, as in /proc/…/status.
fn process_number(server: &Recorder, key: &str) -> u64 {
    let text = std::fs::read_to_string(format!("/proc/{}/status", server.child.id())).unwrap();
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix(key))
        .unwrap();
    line.trim().trim_end_matches(" kB").parse().unwrap()
}

/// Pages of a long event are made from parts of its results.
#[test]
fn pages_of_a_long_series_need_little_memory() {
    let (_store, server, address) = serve_long_series();
    let series = "/flights/f0001/s000001";
    let first = page(address, series).unwrap().1;
    assert!(
        first.contains("Page 1 of 3") && first.contains("0050.jpg") && !first.contains("0051.jpg"),
        "{first}"
    );
    assert!(first.contains("tip deflection 2.9"), "{first}");
    let last = page(address, &format!("{series}?page=3")).unwrap().1;
    assert!(
        last.contains("0120.jpg") && !last.contains("0100.jpg"),
        "{last}"
    );
    for path in [
        "/",
        "/status.json",
        "/flights/f0001",
        "/frames/f0001/s000001/0002.jpg",
        "/thumb/f0001/s000001/0002.jpg.svg",
    ] {
        assert_eq!(page(address, path).unwrap().0, 200, "{path}");
    }
    assert!(process_number(&server, "VmHWM:") < 200_000);
}

#[test]
fn slow_readers_hold_few_threads_and_little_memory() {
    let (_store, server, address) = serve_long_series();
    let slow: Vec<TcpStream> = (0..100)
        .map(|_| {
            let mut stream = TcpStream::connect(address).unwrap();
            write!(
                stream,
                "GET /files/f0001/s000001/0001.jpg HTTP/1.1\r\nHost: localhost\r\n\r\n"
            )
            .unwrap();
            stream
        })
        .collect();
    std::thread::sleep(Duration::from_secs(2));
    let (threads, memory_kb) = (
        process_number(&server, "Threads:"),
        process_number(&server, "VmHWM:"),
    );
    assert!(
        threads < 20 && memory_kb < 200_000,
        "{threads} threads, {memory_kb} kB"
    );
    drop(slow);
}

fn check_configuration(folder: &Path) -> (Option<i32>, String) {
    crate::program::outcome(&[
        "check",
        "--config",
        folder.join("wingd.toml").to_str().unwrap(),
    ])
}

/// A file in the place of the socket is named, and stays.
#[test]
fn a_file_in_the_place_of_the_socket_is_not_removed() {
    let dir = tempfile::tempdir().unwrap();
    configure(dir.path(), "");
    let socket = dir.path().join("wingd.sock");
    std::fs::write(&socket, "notes").unwrap();
    let (code, printed) = check_configuration(dir.path());
    assert!(
        code == Some(78) && printed.contains("not a socket"),
        "{printed}"
    );
    let mut recorder = Recorder::start(dir.path());
    recorder.records();
    recorder.end();
    assert_eq!(std::fs::read_to_string(&socket).unwrap(), "notes");
}

/// In a control group with less memory the ring for events must fit; as root, who can make such a group.
#[test]
fn a_ring_beyond_the_groups_memory_is_refused() {
    let (all, one) = (
        Path::new("/sys/fs/cgroup/cgroup.controllers"),
        format!("wingd-test-{}", std::process::id()),
    );
    let (group, limit) = match all.exists() {
        true => (Path::new("/sys/fs/cgroup").join(one), "memory.max"),
        false => (
            Path::new("/sys/fs/cgroup/memory").join(one),
            "memory.limit_in_bytes",
        ),
    };
    if std::fs::create_dir(&group).is_err() {
        return;
    }
    let limited = std::fs::write(group.join(limit), "536870912").is_ok();
    let dir = tempfile::tempdir().unwrap();
    configure(
        dir.path(),
        "[live]\nrate_hz = 10\n[live.keep]\nring_mb = 4000\n",
    );
    let script = format!(
        "echo $$ > {}/cgroup.procs && exec \"$0\" check --config wingd.toml",
        group.display()
    );
    let mut command = Command::new("sh");
    command
        .args(["-c", &script, env!("CARGO_BIN_EXE_wingd")])
        .current_dir(dir.path());
    let output = command.output().unwrap();
    let _ = std::fs::remove_dir(&group);
    let printed = crate::program::all_output(&output);
    assert!(
        !limited || output.status.code() == Some(78) && printed.contains("ring_mb"),
        "{printed}"
    );
}

/// Requests that come all the time do not prolong an event for ever.
#[test]
fn an_event_that_is_prolonged_ends() {
    let dir = tempfile::tempdir().unwrap();
    let keep = "[live]\nrate_hz = 5\nseries = false\n[live.keep]\nbefore = \"1s\"\nafter = \"1s\"\nring_mb = 16\n";
    configure(dir.path(), keep);
    let mut recorder = Recorder::start(dir.path());
    recorder.wait("frames", FIRST_SERIES, |status| {
        status["live"]["frames"].as_u64() > Some(5)
    });
    for _ in 0..16 {
        query_daemon(&dir.path().join("wingd.sock"), "trigger").unwrap();
        std::thread::sleep(Duration::from_millis(500));
    }
    // Of three seconds each.
    recorder.wait("events", Duration::from_secs(1), |status| {
        status["live"]["events"].as_u64() >= Some(2)
    });
    recorder.end();
}

/// A camera that repeats its last frame takes no more of the disk.
#[test]
fn a_repeated_frame_is_not_kept_again() {
    let dir = tempfile::tempdir().unwrap();
    let stale = |shot| format!("[[camera.fault]]\nshot = {shot}\nkind = \"stale\"\n");
    configure(dir.path(), &(2..=4).map(stale).collect::<String>());
    let mut recorder = Recorder::start(dir.path());
    recorder.wait("the next series", FIRST_SERIES, |status| {
        status["counts"]["stale_frames"].as_u64() > Some(1)
    });
    recorder.end();
    let kept = std::fs::read_dir(dir.path().join("store/partial")).map_or(0, Iterator::count);
    assert_eq!(kept, 0);
}

/// A server that sends line ends without lines counts as silent.
#[test]
fn a_feed_without_lines_is_a_fault() {
    let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let dir = tempfile::tempdir().unwrap();
    let address = server.local_addr().unwrap();
    configure(
        dir.path(),
        &format!("[live]\n[live.aircraft_data]\ntcp = \"{address}\"\nidle = \"500ms\"\n"),
    );
    std::thread::spawn(move || {
        for mut stream in server.incoming().map_while(Result::ok) {
            std::thread::spawn(move || {
                while stream.write_all(b"\r\n").is_ok() {
                    std::thread::sleep(Duration::from_millis(50));
                }
            });
        }
    });
    let mut recorder = Recorder::start(dir.path());
    let silent = |status: &Value| {
        status["aircraft"]["fault"]
            .as_str()
            .is_some_and(|why| why.contains("no line for 0.5 s"))
    };
    recorder.wait("a fault", FIRST_SERIES, silent);
    recorder.end();
}

/// Free text of a store is no formula for a spreadsheet.
#[test]
fn cells_of_an_export_are_no_formulas() {
    let store = store_with(&[&[failed("=HYPERLINK(1)")]]);
    let table =
        crate::program::stdout(&["export", "--format", "csv", store.path().to_str().unwrap()]);
    assert!(
        table.contains("'=HYPERLINK(1)") && !table.contains(",=HYPERLINK"),
        "{table}"
    );
}

#[test]
fn a_weak_token_is_refused_and_a_readable_one_is_named() {
    let dir = tempfile::tempdir().unwrap();
    let token = dir.path().join("token");
    configure(
        dir.path(),
        "[serve]\nlisten = \"127.0.0.1:0\"\ntoken_file = \"token\"\n",
    );
    let check = || check_configuration(dir.path());
    std::fs::write(&token, "aaaaaaaaaaaaaaaa").unwrap();
    let (code, printed) = check();
    assert!(
        code == Some(78) && printed.contains("different characters"),
        "{printed}"
    );
    std::fs::write(&token, TOKEN).unwrap();
    std::fs::set_permissions(&token, std::fs::Permissions::from_mode(0o644)).unwrap();
    let (code, printed) = check();
    assert!(
        code == Some(0) && printed.contains("chmod 600"),
        "{printed}"
    );
    std::fs::set_permissions(&token, std::fs::Permissions::from_mode(0o600)).unwrap();
    assert!(!check().1.contains("chmod 600"));
}

/// A counter or a folder with the largest number ends nothing.
#[test]
fn a_counter_at_its_end_does_not_end_recording() {
    let dir = recorded_flight();
    let store = dir.path().join("store");
    let largest = u64::MAX;
    std::fs::write(
        store.join("counter.json"),
        format!("{{\"next_flight\":{largest},\"next_series\":{largest}}}\n"),
    )
    .unwrap();
    std::fs::create_dir(store.join(format!("flights/f{largest}"))).unwrap();
    let before = series(&store);
    let mut recorder = Recorder::start(dir.path());
    recorder.wait("a series", FIRST_SERIES, |_| series(&store) > before);
    recorder.end();
}

/// Names in a store and in answers do not control the terminal.
#[test]
fn names_with_control_characters_are_escaped() {
    let store = store_with(&[&[solved(2.9, 0.006)]]);
    std::fs::write(
        store
            .path()
            .join("flights/f0001/s000001/\u{1b}[2J\nall invariants hold"),
        "x",
    )
    .unwrap();
    let (code, printed) = crate::program::outcome(&["verify", store.path().to_str().unwrap()]);
    assert_eq!(code, Some(1), "{printed}");
    assert!(
        !printed.contains('\u{1b}')
            && !printed
                .lines()
                .any(|line| line.starts_with("all invariants")),
        "{printed}"
    );
    assert!(printed.contains("\\u{1b}[2J\\nall"), "{printed}");
}

/// A pipe in the place of a picture, or in a store, is not waited for.
#[test]
fn a_pipe_is_not_waited_for() {
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("picture.jpg");
    assert!(
        Command::new("mkfifo")
            .arg(&pipe)
            .status()
            .unwrap()
            .success()
    );
    let begun = Instant::now();
    let (code, printed) = crate::program::outcome(&["detect", pipe.to_str().unwrap()]);
    assert!(
        code == Some(1) && printed.contains("not a regular file"),
        "{printed}"
    );
    assert!(begun.elapsed() < FIRST_SERIES);
}

/// Files of the service: no chip of GPIO lines for other groups, no store for other users.
#[test]
fn the_service_keeps_its_devices_and_files_to_itself() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let rules = std::fs::read_to_string(root.join("config/99-wingd.rules")).unwrap();
    let gpio = rules
        .lines()
        .find(|line| line.starts_with("SUBSYSTEM==\"gpio\""))
        .unwrap();
    assert!(
        gpio.contains("GROUP=\"wingd\"") && gpio.contains("MODE=\"0660\""),
        "{gpio}"
    );
    let unit = std::fs::read_to_string(root.join("systemd/wingd.service")).unwrap();
    assert!(
        unit.contains("\nUMask=0027\n") && unit.contains("\nStateDirectoryMode=0750\n"),
        "{unit}"
    );
}
