//! Main loop of the camera process: reads requests, drives the camera and answers.

use std::io::{self, Write};
use std::sync::mpsc;
use std::time::Duration;

use serde_json::{Value, json};

use crate::camera::CameraError;
use crate::camera::gphoto::driver::GphotoDriver;
use crate::camera::gphoto::protocol::{self, CameraAnswer, Request};

/// Serves until the recorder closes the pipe; then the process ends, even from within a hung call.
pub fn serve_requests() -> io::Result<()> {
    let (sender, requests) = mpsc::channel();
    std::thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Ok((request, _)) = protocol::read_message::<Request>(&mut input) {
            if sender.send(request).is_err() {
                break;
            }
        }
        std::process::exit(0);
    });
    let mut driver = None;
    let mut output = io::BufWriter::new(io::stdout().lock());
    for request in requests {
        let (answer, body) = match handle_request(&mut driver, request) {
            Ok((answer, body)) => (Ok(answer), body),
            Err(error) => (Err(error), Vec::new()),
        };
        protocol::write_message(&mut output, &answer, &body)?;
        output.flush()?;
    }
    Ok(())
}

fn handle_request(
    driver: &mut Option<GphotoDriver>,
    request: Request,
) -> CameraAnswer<(Value, Vec<u8>)> {
    if let Request::Open { section } = &request {
        *driver = None;
        let (opened, info) = GphotoDriver::open(section)?;
        *driver = Some(opened);
        return Ok((json!(info), Vec::new()));
    }
    let driver = driver.as_mut().ok_or_else(CameraError::closed)?;
    match request {
        Request::Recover => driver.recover().map(|(image, body)| (json!(image), body)),
        Request::Shoot {
            deadline_s,
            trigger,
        } => {
            let deadline = Duration::try_from_secs_f64(deadline_s).unwrap_or_default();
            driver
                .shoot(deadline, trigger)
                .map(|(image, body)| (json!(image), body))
        }
        Request::Drain => Ok((json!(driver.unexpected_images()), Vec::new())),
        Request::Release | Request::Open { .. } => {
            driver.delete_last().map(|()| (Value::Null, Vec::new()))
        }
    }
}
