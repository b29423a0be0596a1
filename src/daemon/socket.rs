//! Status socket: takes one command per line and answers each with one line of JSON.

use std::io::{self, BufRead, BufReader, Write};
use std::os::unix::net::UnixStream as BlockingStream;
use std::path::{Path, PathBuf};
use std::sync::mpsc::Sender;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader as AsyncBufReader};
use tokio::net::UnixStream;

use super::command::Command;
use super::endpoint;
use super::status::{STATUS_PART, StatusBoard};

/// `[status]` of the configuration.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StatusConfig {
    /// Path of the socket for `wingd status` and `wingd trigger`.
    pub socket: PathBuf,
}

impl Default for StatusConfig {
    fn default() -> Self {
        Self {
            socket: "/run/wingd/wingd.sock".into(),
        }
    }
}

/// Maximum length of a command, bytes.
const MAX_LINE: u64 = 256;
/// Time after which a client that sends or reads nothing is disconnected.
const CLIENT_TIMEOUT: Duration = Duration::from_secs(5);

/// Maximum number of clients at a time: far below the number of files that a process may open.
const MAX_CLIENTS: usize = 64;

/// Answers clients forever, each in its own task. Recording matters more than reporting: a socket that cannot be bound is
/// a fault in the status.
pub(crate) async fn serve_status(
    config: StatusConfig,
    board: StatusBoard,
    recorder: Sender<Command>,
) {
    let report = |fault| board.set_fault(STATUS_PART, fault);
    let client = |stream, permit| {
        let (board, recorder) = (board.clone(), recorder.clone());
        tokio::spawn(async move {
            let _permit = permit;
            let _ = tokio::time::timeout(CLIENT_TIMEOUT, answer_client(stream, &board, &recorder))
                .await;
        });
    };
    endpoint::serve_socket(&config.socket, MAX_CLIENTS, report, client).await;
}

async fn answer_client(
    mut stream: UnixStream,
    board: &StatusBoard,
    recorder: &Sender<Command>,
) -> io::Result<()> {
    let (read, mut write) = stream.split();
    let mut line = String::new();
    AsyncBufReader::new(tokio::io::AsyncReadExt::take(read, MAX_LINE))
        .read_line(&mut line)
        .await?;
    let mut reply = reply_to_command(line.trim(), board, recorder);
    reply.push('\n');
    write.write_all(reply.as_bytes()).await
}

fn reply_to_command(command: &str, board: &StatusBoard, recorder: &Sender<Command>) -> String {
    let sent = match command {
        "status" => return serde_json::to_string(&board.snapshot()).unwrap_or_default(),
        "trigger" => recorder
            .send(Command::Trigger)
            .map(|()| "an extra series begins"),
        "new-flight" => recorder
            .send(Command::NewFlight)
            .map(|()| "an extra series begins a new flight"),
        _ => {
            let error = format!("unknown command {command:?}; known: status, trigger, new-flight");
            return serde_json::json!({ "error": error }).to_string();
        }
    };
    match sent {
        Ok(answer) => serde_json::json!({ "answer": answer }).to_string(),
        Err(_) => serde_json::json!({ "error": "the daemon is stopping" }).to_string(),
    }
}

/// Error of a query to the daemon. It is only reported.
#[derive(Debug, thiserror::Error)]
pub enum QueryError {
    /// The socket cannot be opened, written or read.
    #[error("{}: {}; {}", .0.display(), .1, suggest_remedy(.1))]
    Socket(PathBuf, io::Error),
    /// Another program answers at the socket.
    #[error("{}: the answer is not JSON: {}; another program may use this socket", .0.display(), .1)]
    Foreign(PathBuf, serde_json::Error),
    /// The daemon refuses, with a reason.
    #[error("{0}")]
    Refused(String),
}

fn suggest_remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::ConnectionRefused => {
            "no daemon is running there (check systemctl status wingd), or [status] socket is another path"
        }
        io::ErrorKind::PermissionDenied => "run this as the user of the daemon or as root",
        _ => "the daemon does not answer (check journalctl -u wingd)",
    }
}

/// Sends a command to a running daemon and returns its answer.
///
/// # Errors
/// Returns an error if no daemon answers at the socket, or if it refuses.
pub fn query_daemon(socket: &Path, command: &str) -> Result<serde_json::Value, QueryError> {
    let fault = |error: io::Error| QueryError::Socket(socket.to_owned(), error);
    let mut stream = BlockingStream::connect(socket).map_err(fault)?;
    stream
        .set_read_timeout(Some(CLIENT_TIMEOUT))
        .map_err(fault)?;
    stream
        .write_all(format!("{command}\n").as_bytes())
        .map_err(fault)?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).map_err(fault)?;
    let value: serde_json::Value = serde_json::from_str(&line)
        .map_err(|error| QueryError::Foreign(socket.to_owned(), error))?;
    match value.get("error").and_then(|error| error.as_str()) {
        Some(error) => Err(QueryError::Refused(error.to_owned())),
        None => Ok(value),
    }
}
