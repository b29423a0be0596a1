//! Camera process, started by the recorder, queried with a deadline, and killed.

use std::ffi::OsStr;
use std::io;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::time::Duration;

use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::camera::CameraError;
use crate::camera::gphoto::protocol::{self, CameraAnswer, Request};

type Message = io::Result<(CameraAnswer<Value>, Vec<u8>)>;

/// Running camera process, killed on drop.
pub struct CameraProcess {
    child: Child,
    requests: ChildStdin,
    answers: Receiver<Message>,
}

impl CameraProcess {
    /// Starts `program` with `arguments`; it speaks [`protocol`] on its standard input and output.
    pub fn start<A: AsRef<OsStr>>(program: &str, arguments: &[A]) -> Result<Self, CameraError> {
        let refused = |error: &dyn std::fmt::Display| {
            CameraError::Refused(format!(
                "the camera process {program} could not be started: {error}"
            ))
        };
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| refused(&error))?;
        let (requests, output) = (child.stdin.take(), child.stdout.take());
        let (requests, mut output) = requests
            .zip(output)
            .ok_or_else(|| refused(&"it has no pipes"))?;
        let (sender, answers) = mpsc::sync_channel(1);
        // The thread ends with the pipe, at the latest when the process is killed.
        std::thread::spawn(move || {
            loop {
                let message = protocol::read_message(&mut output);
                let last = message.is_err();
                if sender.send(message).is_err() || last {
                    return;
                }
            }
        });
        Ok(Self {
            child,
            requests,
            answers,
        })
    }

    /// Sends a request and waits for the answer. After an error other than an answer the process cannot be used.
    pub fn ask<T: DeserializeOwned>(
        &mut self,
        request: &Request,
        limit: Duration,
        what: &str,
    ) -> CameraAnswer<(T, Vec<u8>)> {
        if let Err(error) = protocol::write_message(&mut self.requests, request, &[]) {
            return Err(self.end_error(&error.to_string()));
        }
        match self.answers.recv_timeout(limit) {
            Ok(Ok((answer, body))) => {
                let unexpected = |_| {
                    CameraError::Gone("the camera process gave an unexpected answer".to_owned())
                };
                Ok((serde_json::from_value(answer?).map_err(unexpected)?, body))
            }
            Ok(Err(error)) => Err(self.end_error(&error.to_string())),
            Err(RecvTimeoutError::Disconnected) => Err(self.end_error("the pipe was closed")),
            Err(RecvTimeoutError::Timeout) => {
                self.kill();
                let what = format!("{what}; the camera process was killed");
                Err(CameraError::Timeout {
                    after_s: limit.as_secs_f64(),
                    what,
                })
            }
        }
    }

    /// Returns true if the process accepts another request.
    pub fn is_alive(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    /// Kills the process if it still runs, and builds the error with the reason for its end.
    fn end_error(&mut self, why: &str) -> CameraError {
        self.kill();
        let status = self
            .child
            .wait()
            .map_or_else(|error| error.to_string(), |status| status.to_string());
        CameraError::Gone(format!("the camera process ended: {why}, {status}"))
    }

    fn kill(&mut self) {
        // Both fail only if the process has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for CameraProcess {
    fn drop(&mut self) {
        self.kill();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    fn ask(script: &str) -> (CameraError, bool, Duration) {
        let start = Instant::now();
        let mut process = CameraProcess::start("/bin/sh", &["-c", script]).unwrap();
        let error = process
            .ask::<()>(&Request::Recover, Duration::from_millis(300), "nothing")
            .unwrap_err();
        (error, process.is_alive(), start.elapsed())
    }

    #[test]
    fn a_hung_process_is_killed_at_its_deadline() {
        let (error, alive, took) = ask("exec sleep 100");
        assert!(matches!(error, CameraError::Timeout { .. }), "{error}");
        assert!(!alive && took < Duration::from_secs(5), "{took:?}");
    }

    #[test]
    fn crashes_and_invalid_messages_are_errors() {
        let (error, alive, _) = ask("kill -SEGV $$");
        assert!(
            matches!(&error, CameraError::Gone(why) if why.contains("signal: 11")),
            "{error}"
        );
        assert!(!alive);
        let (error, alive, _) = ask("echo hello, this is not a message; sleep 100");
        assert!(
            matches!(&error, CameraError::Gone(why) if why.contains("not a message")),
            "{error}"
        );
        assert!(!alive);
        assert!(CameraProcess::start::<&str>("/no/such/program", &[]).is_err());
    }
}
