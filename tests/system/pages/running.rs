//! Environment of the pages' commands: a shell in a folder, and background programs.

use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Output};
use std::time::{Duration, Instant};

/// Time limit of a command, and of a background program until it answers, s.
const COMMAND: &str = "120";
const ANSWER: Duration = Duration::from_secs(60);

fn in_shell(folder: &Path, program: &str, arguments: &[&str]) -> Command {
    let binaries = Path::new(env!("CARGO_BIN_EXE_wingd"))
        .parent()
        .unwrap()
        .to_owned();
    let path = format!("{}:{}", binaries.display(), std::env::var("PATH").unwrap());
    let mut command = Command::new(program);
    command
        .args(arguments)
        .current_dir(folder)
        .env("PATH", path);
    command
}

pub fn shell(folder: &Path, script: &str) -> Output {
    in_shell(
        folder,
        "timeout",
        &[COMMAND, "sh", "-e", "-u", "-c", script],
    )
    .output()
    .unwrap()
}

/// A background program that runs until it is dropped.
pub struct Running(Child);

impl Running {
    pub fn start(folder: &Path, line: &str) -> Self {
        Self(
            in_shell(folder, "sh", &["-c", &format!("exec {line}")])
                .spawn()
                .unwrap(),
        )
    }

    /// Started, and a program listens at the port.
    pub fn serving(folder: &Path, line: &str, port: u16) -> Self {
        let running = Self::start(folder, line);
        wait(line, || TcpStream::connect(("127.0.0.1", port)).is_ok());
        running
    }

    /// As `systemctl stop` does.
    pub fn stop(mut self) {
        let killed = Command::new("kill")
            .arg(self.0.id().to_string())
            .status()
            .unwrap();
        assert!(
            killed.success() && self.0.wait().unwrap().success(),
            "ends with success on a signal"
        );
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub fn wait(what: &str, done: impl Fn() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < ANSWER, "{what}: no answer");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// A port of the loopback interface that was free a moment ago.
pub fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .unwrap()
        .local_addr()
        .unwrap()
        .port()
}

pub fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.file_type().unwrap().is_dir() {
            copied(&entry.path(), &target);
        } else if entry.file_type().unwrap().is_file() {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}
