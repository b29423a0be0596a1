//! Promise: manual marks are stored durably with author, time and reason, without replacing detections; a kill loses at most the
//! last click, the store verifies and detects a changed mark, and `solve` and `orient` use the marks.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::{Value, json};

use crate::program::{all_output, fixture, run_in as wingd, run_in_folder as done};

/// The fixture's images and installation, optionally oriented.
fn prepared(oriented: bool) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("installation")).unwrap();
    for name in ["camera.toml", "installation.toml", "survey.csv"] {
        std::fs::copy(
            fixture("dev/installation").join(name),
            dir.path().join("installation").join(name),
        )
        .unwrap();
    }
    for name in ["ground.jpg", "flight-1.jpg"] {
        std::fs::copy(fixture("dev/frames").join(name), dir.path().join(name)).unwrap();
    }
    if oriented {
        done(dir.path(), &["orient", "ground.jpg"]);
    }
    dir
}

/// `wingd mark`; killed when dropped.
struct Marking {
    child: Child,
    address: String,
    token: String,
}

impl Marking {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_wingd"));
        command
            .arg("mark")
            .args(arguments)
            .args(["--listen", "127.0.0.1:0", "--who", "ada"]);
        let mut child = command
            .current_dir(folder)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let line = lines
            .find(|line| line.as_ref().unwrap().contains("http://"))
            .unwrap()
            .unwrap();
        std::thread::spawn(move || lines.for_each(drop));
        let (address, rest) = line
            .split_once("http://")
            .unwrap()
            .1
            .split_once('/')
            .unwrap();
        let token = rest
            .strip_prefix("?token=")
            .unwrap()
            .split(' ')
            .next()
            .unwrap();
        Self {
            child,
            address: address.to_owned(),
            token: token.to_owned(),
        }
    }

    fn request(&self, head: &str, body: &str) -> (u16, Value) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        let token = &self.token;
        write!(
            stream,
            "{head}\r\nConnection: close\r\nAuthorization: Bearer {token}\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        )
        .unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        let text = String::from_utf8_lossy(&bytes);
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        (
            head[9..12].parse().unwrap(),
            serde_json::from_str(body).unwrap_or(Value::Null),
        )
    }

    fn state(&self) -> Value {
        let (status, state) = self.request(
            &format!("GET /picture/0.json HTTP/1.1\r\nHost: {}", self.address),
            "",
        );
        assert_eq!(status, 200, "{state}");
        state
    }

    fn send_mark(&self, mut asked: Value) -> (u16, Value) {
        asked
            .as_object_mut()
            .unwrap()
            .entry("who")
            .or_insert("ada".into());
        let head = format!(
            "POST /picture/0 HTTP/1.1\r\nHost: {0}\r\nOrigin: http://{0}\r\nContent-Type: application/json",
            self.address
        );
        self.request(&head, &asked.to_string())
    }

    /// Ends it as Ctrl-C does.
    fn end(mut self) {
        let done = Command::new("kill")
            .args(["-TERM", &self.child.id().to_string()])
            .status()
            .unwrap();
        assert!(done.success() && self.child.wait().unwrap().success());
    }
}

impl Drop for Marking {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn marker<'a>(state: &'a Value, id: &str) -> &'a Value {
    state["markers"]
        .as_array()
        .unwrap()
        .iter()
        .find(|m| m["id"] == id)
        .unwrap()
}

fn place(state: &Value, id: &str) -> [f64; 2] {
    ["u_px", "v_px"].map(|key| marker(state, id)[key].as_f64().unwrap())
}

/// Nothing is replaced without confirmation, nothing is withdrawn without a reason, nothing is stored without a name.
fn refuses(marking: &Marking, near: &Value, with: &dyn Fn(Value) -> Value) {
    assert_eq!(marking.send_mark(near.clone()).0, 409);
    assert_eq!(
        marking.send_mark(json!({"act": "reject", "id": "M05"})).0,
        422
    );
    assert_eq!(
        marking.send_mark(with(json!({"over": true, "who": " "}))).0,
        422
    );
    assert_eq!(
        marking
            .send_mark(with(json!({"over": true, "u_px": 1e9})))
            .0,
        422
    );
    assert_eq!(
        marking
            .send_mark(json!({"act": "place", "id": "M99", "u_px": 1.0, "v_px": 1.0}))
            .0,
        422
    );
    assert_eq!(
        marking.send_mark(json!({"act": "withdraw", "id": "M05"})).0,
        422
    );
    // Nor from another site's page.
    let post = format!("POST /picture/0 HTTP/1.1\r\nHost: {}\r\n", marking.address);
    let body = with(json!({"over": true, "who": "eve"})).to_string();
    for head in [
        "Content-Type: text/plain",
        "Content-Type: application/json\r\nOrigin: http://evil.example",
    ] {
        assert_eq!(
            marking.request(&format!("{post}{head}"), &body).0,
            422,
            "{head}"
        );
    }
    assert_eq!(
        marking
            .request("GET / HTTP/1.1\r\nHost: evil.example", "")
            .0,
        421
    );
    assert_eq!(marking.state()["marks"], 0);
}

fn a_changed_mark_is_seen_in_a_copy(at: &Path) {
    done(at, &["copy", "store", "copy"]);
    let file = at.join("copy/flights/f0001/marks-000001.jsonl");
    let text = std::fs::read_to_string(&file).unwrap();
    let marks = text.split_once('\n').unwrap().1;
    super::json_schemas::assert_valid("mark", marks.as_bytes());
    assert!(
        text.contains("\"who\":\"ada\"") && text.contains("\"frame_sha256\":"),
        "{text}"
    );
    std::fs::write(&file, text.replacen("ada", "bob", 1)).unwrap();
    let spoiled = wingd(at, &["verify", "copy"]);
    assert!(
        spoiled.status.code() == Some(1) && all_output(&spoiled).contains("marks-000001.jsonl"),
        "{}",
        all_output(&spoiled)
    );
}

#[test]
fn manual_marks_survive_a_kill_are_evidence_and_are_used_by_solve() {
    let dir = prepared(true);
    let at = dir.path();
    done(
        at,
        &[
            "import",
            "flight-1.jpg",
            "--store",
            "store",
            "--installation",
            "installation",
        ],
    );
    let bare: Value = serde_json::from_str(&done(at, &["solve", "store", "--json"])).unwrap();
    let marking = Marking::start(at, &["store"]);
    let state = marking.state();
    assert_eq!(
        (&state["image"], &state["marks"]),
        (&"s000001/0001.jpg".into(), &0.into())
    );
    let [u, v] = place(&state, "M19");
    let near = json!({"act": "place", "id": "M19", "u_px": u + 1.5, "v_px": v - 1.0});
    let with = |more: Value| {
        let mut all = near.as_object().unwrap().clone();
        all.extend(more.as_object().unwrap().clone());
        Value::Object(all)
    };
    refuses(&marking, &near, &with);
    // The detector measures at the marked position; a mark can also be used unchanged.
    let (status, state) = marking.send_mark(with(json!({"over": true, "why": "by way of trial"})));
    assert_eq!(
        (status, &marker(&state, "M19")["mark"]["source"]),
        (200, &"fit".into()),
        "{state}"
    );
    let off = place(&state, "M19");
    assert!((off[0] - u).hypot(off[1] - v) < 0.2, "{off:?} for {u} {v}");
    let (_, state) = marking.send_mark(with(json!({"over": true, "exact": true})));
    assert_eq!(
        (
            place(&state, "M19"),
            marker(&state, "M19")["mark"]["source"].as_str()
        ),
        ([u + 1.5, v - 1.0], Some("manual"))
    );
    assert!(
        (marker(&state, "M19")["covariance_px2"][0][0]
            .as_f64()
            .unwrap()
            - 4.0)
            .abs()
            < 1e-12
    );
    let (_, state) =
        marking.send_mark(json!({"act": "reject", "id": "M05", "why": "dirt,\n\"oil\""}));
    assert_eq!(
        (
            &marker(&state, "M05")["state"],
            &marker(&state, "M05")["used"]
        ),
        (&"rejected".into(), &false.into())
    );
    assert_eq!(
        marking
            .send_mark(with(json!({"over": false, "who": "bob"})))
            .0,
        409,
        "ada's mark"
    );
    drop(marking);
    // Killed: all three marks are there, and the store is sound.
    done(at, &["verify", "store"]);
    let marking = Marking::start(at, &["store"]);
    let state = marking.state();
    assert_eq!(
        (&state["marks"], &marker(&state, "M05")["mark"]["why"]),
        (&2.into(), &"dirt, \"oil\"".into())
    );
    let (_, state) = marking.send_mark(
        json!({"act": "rename", "id": "M10", "to": "M08", "why": "trial", "over": true}),
    );
    assert_eq!(
        (place(&state, "M08"), &marker(&state, "M10")["state"]),
        (place(&marking.state(), "M08"), &"rejected".into())
    );
    for id in ["M08", "M10"] {
        assert_eq!(
            marking.send_mark(json!({"act": "withdraw", "id": id})).0,
            200
        );
    }
    marking.end();
    done(at, &["verify", "store"]);
    let flight = at.join("store/flights/f0001");
    let sums = std::fs::read_to_string(flight.join("SHA256SUMS")).unwrap();
    assert!(
        sums.contains("  marks-000001.jsonl") && sums.contains("  marks-000002.jsonl"),
        "{sums}"
    );
    let again: Value = serde_json::from_str(&done(at, &["solve", "store", "--json"])).unwrap();
    let line = |result: &Value, id: &str| marker(result, id).clone();
    assert_eq!(
        (&line(&again, "M19")["manual"], &line(&again, "M19")["u_px"]),
        (&true.into(), &(u + 1.5).into())
    );
    let rejected = line(&again, "M05");
    assert!(
        rejected["reason"]
            .as_str()
            .unwrap()
            .contains("rejected manually (ada): dirt"),
        "{rejected}"
    );
    assert!(
        line(&bare, "M05")["used"].as_bool().unwrap() && line(&bare, "M19").get("manual").is_none()
    );
    assert_eq!(
        done(at, &["solve", "store", "--json", "--no-marks"]),
        "",
        "that is there already"
    );
    done(at, &["verify", "store"]);
    a_changed_mark_is_seen_in_a_copy(at);
}

#[test]
fn manual_marks_of_image_files_are_observations_for_solve_and_orient() {
    let dir = prepared(false);
    let at = dir.path();
    // Without an orientation an image shows the wing on the ground.
    let marking = Marking::start(at, &["ground.jpg"]);
    let state = marking.state();
    assert!(
        state["now"]["remarks"][0]
            .as_str()
            .unwrap()
            .contains("orientation from 21 markers"),
        "{}",
        state["now"]
    );
    let [u, v] = place(&state, "M12");
    let asked = json!({"act": "place", "id": "M12", "u_px": u + 1.0, "v_px": v, "exact": true, "over": true});
    assert_eq!(marking.send_mark(asked).0, 200);
    let (_, state) = marking.send_mark(json!({"act": "reject", "id": "M07", "why": "a bird"}));
    assert!(
        marker(&state, "M07")["reason"]
            .as_str()
            .unwrap()
            .contains("a bird"),
        "{}",
        marker(&state, "M07")
    );
    assert!(
        marker(&state, "M12")["used"].as_bool().unwrap(),
        "{}",
        marker(&state, "M12")
    );
    drop(marking);
    let text = std::fs::read_to_string(at.join("observations.csv")).unwrap();
    assert!(
        text.starts_with("id,u_px,v_px,sigma_px,image,") && text.lines().count() == 3,
        "{text}"
    );
    let fit: Value = serde_json::from_str(&done(
        at,
        &[
            "orient",
            "--observations",
            "observations.csv",
            "--json",
            "ground.jpg",
        ],
    ))
    .unwrap();
    assert_eq!(
        (&fit["markers"], &fit["unused"][0]["id"]),
        (&20.into(), &"M07".into()),
        "{fit}"
    );
    assert!(
        fit["unused"][0]["reason"]
            .as_str()
            .unwrap()
            .contains("rejected manually (ada): a bird"),
        "{fit}"
    );
    // The same file takes the marks of an image in flight.
    let marking = Marking::start(at, &["flight-1.jpg"]);
    let [u, v] = place(&marking.state(), "M19");
    let asked = json!({"act": "place", "id": "M19", "u_px": u - 1.0, "v_px": v, "exact": true, "over": true, "why": "a, b"});
    assert_eq!(marking.send_mark(asked).0, 200);
    marking.end();
    let text = std::fs::read_to_string(at.join("observations.csv")).unwrap();
    assert!(
        text.lines().count() == 4 && text.contains("flight-1.jpg") && text.contains("\"a, b\""),
        "{text}"
    );

    let result: Value = serde_json::from_str(&done(
        at,
        &[
            "solve",
            "flight-1.jpg",
            "--observations",
            "observations.csv",
            "--json",
        ],
    ))
    .unwrap();
    assert_eq!(
        (
            &marker(&result, "M19")["manual"],
            &marker(&result, "M19")["u_px"]
        ),
        (&true.into(), &(u - 1.0).into())
    );
    // An unreadable line is a fault of the file, and the file is not overwritten.
    std::fs::write(
        at.join("observations.csv"),
        "id,u_px,v_px,sigma_px\nM19,1,x,2\n",
    )
    .unwrap();
    let refused = wingd(at, &["mark", "flight-1.jpg", "--listen", "127.0.0.1:0"]);
    assert!(
        refused.status.code() == Some(78) && all_output(&refused).contains("column v_px"),
        "{}",
        all_output(&refused)
    );
}

/// Neither another user of this machine nor a request that never ends gets in.
#[test]
fn marking_needs_its_token_and_requests_end() {
    let dir = prepared(true);
    let marking = Marking::start(dir.path(), &["flight-1.jpg"]);
    let answer = |head: String| {
        let mut stream = TcpStream::connect(&marking.address).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        write!(stream, "{head}\r\n\r\n").unwrap();
        let mut bytes = Vec::new();
        stream.read_to_end(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    };
    let get = |path: &str| {
        answer(format!(
            "GET {path} HTTP/1.1\r\nHost: {}\r\nConnection: close",
            marking.address
        ))
    };
    for path in [
        "/",
        "/mark.js",
        "/pictures.json",
        "/?token=00000000000000000000000000000000",
    ] {
        assert!(get(path).starts_with("HTTP/1.1 401"), "{path}");
    }
    let page = get(&format!("/?token={}", marking.token));
    assert!(
        page.starts_with("HTTP/1.1 200")
            && page.contains(&format!("/mark.js?token={}", marking.token)),
        "{page}"
    );
    let begun = std::time::Instant::now();
    let unsent = answer(format!(
        "POST /picture/0?token={0} HTTP/1.1\r\nHost: {1}\r\nOrigin: http://{1}\r\nContent-Type: application/json\r\nContent-Length: 100",
        marking.token, marking.address
    ));
    assert!(
        unsent.starts_with("HTTP/1.1 422") && begun.elapsed() < Duration::from_secs(15),
        "{unsent}"
    );
}

/// Neither the file nor the store belongs to one server.
#[test]
fn two_servers_lose_no_mark_and_a_page_does_not_lock_the_store() {
    let dir = prepared(true);
    let at = dir.path();
    let servers = [(); 2].map(|()| Marking::start(at, &["flight-1.jpg"]));
    for (server, id) in servers.iter().zip(["M18", "M19"]) {
        let [u, v] = place(&server.state(), id);
        let asked =
            json!({"act": "place", "id": id, "u_px": u, "v_px": v, "exact": true, "over": true});
        assert_eq!(server.send_mark(asked).0, 200);
    }
    let text = std::fs::read_to_string(at.join("observations.csv")).unwrap();
    assert!(text.contains("M18") && text.contains("M19"), "{text}");
    let (status, state) = servers[0].send_mark(json!({"act": "withdraw", "id": "M18"}));
    assert_eq!(
        (status, marker(&state, "M19")["state"].as_str()),
        (200, Some("manual"))
    );
    let text = std::fs::read_to_string(at.join("observations.csv")).unwrap();
    assert!(!text.contains("M18") && text.contains("M19"), "{text}");

    done(at, &["import", "flight-1.jpg", "--store", "store"]);
    let arguments = ["store", "--installation", "installation"];
    let servers = [(); 2].map(|()| Marking::start(at, &arguments));
    done(at, &["solve", "store", "--installation", "installation"]);
    for (server, id) in servers.iter().zip(["M18", "M19"]) {
        let [u, v] = place(&server.state(), id);
        let asked =
            json!({"act": "place", "id": id, "u_px": u, "v_px": v, "exact": true, "over": true});
        let (status, answer) = server.send_mark(asked);
        assert_eq!(status, 200, "{answer}");
    }
    let state = servers[1].state();
    let known = ["M18", "M19"].map(|id| marker(&state, id)["state"].clone());
    assert_eq!(known, ["manual", "manual"]);
    let store = wingd::store::StoreConfig::new(at.join("store"));
    let disk = std::sync::Arc::new(wingd::store::RealDisk);
    let (held, _) = wingd::store::Store::open(disk, store).unwrap();
    let (status, answer) = servers[0].send_mark(json!({"act": "withdraw", "id": "M18"}));
    let reason = answer["reason"].as_str().unwrap();
    let process = format!("(process {})", std::process::id());
    assert!(status == 500 && reason.contains(&process), "{answer}");
    drop(held);
    servers.into_iter().for_each(Marking::end);
    done(at, &["verify", "store"]);
}
