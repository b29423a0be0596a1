//! Classification of libgphoto2's errors by the caller's action, with the most common cause.

use gphoto2::error::ErrorKind;

use crate::camera::CameraError;

/// Classifies an error that occurred during `what`.
pub fn classify_error(error: &gphoto2::Error, what: &str) -> CameraError {
    let text = format!("{what}: {error}");
    match error.kind() {
        ErrorKind::IoUsbClaim | ErrorKind::IoLock => CameraError::Busy(format!(
            "{text}; another program holds the camera, typically the desktop's automounter: systemctl --user \
             mask --now gvfs-gphoto2-volume-monitor gvfs-daemon"
        )),
        ErrorKind::CameraBusy => CameraError::Busy(format!(
            "{text}; leave menu, playback and live view, switch off mirror lock-up and self-timer"
        )),
        ErrorKind::Timeout => CameraError::Timeout {
            after_s: 0.0,
            what: text,
        },
        ErrorKind::NoSpace | ErrorKind::FixedLimitExceeded => {
            CameraError::Refused(card_full_message(&text))
        }
        ErrorKind::NotSupported => CameraError::Refused(format!(
            "{text}; this camera does not support that over USB"
        )),
        // Other errors are mostly a camera that no longer answers; the caller reopens it.
        _ => CameraError::Gone(format!(
            "{text}; unplugged, switched off, asleep or out of power: check cable and battery, and switch \
             off the camera's power saving"
        )),
    }
}

/// Builds the message for a full card.
pub fn card_full_message(what: &str) -> String {
    format!(
        "{what}; the card is full: remove images from it, or set capturetarget to the internal memory"
    )
}
