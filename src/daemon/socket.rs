//! The status socket takes one command per line and answers each with one line of JSON (`metrics`: Prometheus text).

use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream as BlockingStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader as AsyncBufReader};
use tokio::net::{UnixListener, UnixStream};

use super::command::Command;
use super::endpoint;
use super::status::{StatusBoard, exposition};

/// `[status]` of the configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StatusConfig {
    /// Where `wingd status` and `wingd trigger` reach the daemon.
    #[serde(default = "default_socket")]
    pub socket: PathBuf,
}

fn default_socket() -> PathBuf {
    PathBuf::from("/run/wingd/wingd.sock")
}

impl Default for StatusConfig {
    fn default() -> Self {
        Self { socket: default_socket() }
    }
}

/// A longer line is no command.
const MAX_LINE: u64 = 256;
/// For a client that connects and says nothing.
const PATIENCE: Duration = Duration::from_secs(5);

/// Answers clients for ever, each on its own task.
pub(crate) async fn serve(listener: UnixListener, board: StatusBoard, recorder: Sender<Command>) {
    let client = |stream| {
        let (board, recorder) = (board.clone(), recorder.clone());
        tokio::spawn(async move {
            let _ = tokio::time::timeout(PATIENCE, answer(stream, &board, &recorder)).await;
        });
    };
    endpoint::accept(listener, client).await;
}

async fn answer(mut stream: UnixStream, board: &StatusBoard, recorder: &Sender<Command>) -> io::Result<()> {
    let (read, mut write) = stream.split();
    let mut line = String::new();
    AsyncBufReader::new(tokio::io::AsyncReadExt::take(read, MAX_LINE)).read_line(&mut line).await?;
    let mut reply = reply(line.trim(), board, recorder);
    reply.push('\n');
    write.write_all(reply.as_bytes()).await
}

fn reply(command: &str, board: &StatusBoard, recorder: &Sender<Command>) -> String {
    let asked = match command {
        "status" => return serde_json::to_string(&board.snapshot()).unwrap_or_default(),
        "metrics" => return exposition(&board.snapshot()),
        "trigger" => recorder.send(Command::Trigger).map(|()| "an extra series begins"),
        "new-flight" => recorder.send(Command::NewFlight).map(|()| "an extra series begins a new flight"),
        _ => {
            let error = format!("unknown command {command:?}; known: status, metrics, trigger, new-flight");
            return serde_json::json!({ "error": error }).to_string();
        }
    };
    match asked {
        Ok(answer) => serde_json::json!({ "answer": answer }).to_string(),
        Err(_) => serde_json::json!({ "error": "the daemon is stopping" }).to_string(),
    }
}

/// Why a question has no answer; all that is done about it is to say it.
#[derive(Debug, thiserror::Error)]
pub enum Unanswered {
    /// By the socket.
    #[error("{}: {}; {}", .0.display(), .1, mend(.1))]
    Socket(PathBuf, io::Error),
    /// Something else listens there.
    #[error("{}: answers no JSON: {}", .0.display(), .1)]
    Foreign(PathBuf, serde_json::Error),
    /// The daemon says why.
    #[error("{0}")]
    Refused(String),
}

fn mend(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => {
            "no daemon is running there (systemctl status wingd), or [status] socket names another place"
        }
        io::ErrorKind::PermissionDenied => "run as the user of the daemon or as root",
        _ => "the daemon does not answer (journalctl -u wingd)",
    }
}

/// Asks a running daemon; its line of JSON.
///
/// # Errors
/// Where there is none, or it refuses.
pub fn ask(socket: &Path, command: &str) -> Result<serde_json::Value, Unanswered> {
    let fault = |error: io::Error| Unanswered::Socket(socket.to_owned(), error);
    let mut stream = BlockingStream::connect(socket).map_err(fault)?;
    stream.set_read_timeout(Some(PATIENCE)).map_err(fault)?;
    stream.write_all(format!("{command}\n").as_bytes()).map_err(fault)?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).map_err(fault)?;
    let value: serde_json::Value =
        serde_json::from_str(&line).map_err(|error| Unanswered::Foreign(socket.to_owned(), error))?;
    match value.get("error").and_then(|error| error.as_str()) {
        Some(error) => Err(Unanswered::Refused(error.to_owned())),
        None => Ok(value),
    }
}
