//! libgphoto2's errors are sorted by what the caller does about them, with the usual culprit named.

use gphoto2::error::ErrorKind;

use crate::camera::CameraError;

/// `what` was being done.
pub fn sort(error: &gphoto2::Error, what: &str) -> CameraError {
    let text = format!("{what}: {error}");
    match error.kind() {
        ErrorKind::IoUsbClaim | ErrorKind::IoLock => CameraError::Busy(format!(
            "{text}; another program holds the camera, mostly the desktop's mounter: \
             systemctl --user mask --now gvfs-gphoto2-volume-monitor gvfs-daemon"
        )),
        ErrorKind::CameraBusy => CameraError::Busy(format!(
            "{text}; leave menu, playback and live view, switch off mirror lock-up and self-timer"
        )),
        ErrorKind::Timeout => CameraError::Timeout { after_s: 0.0, what: text },
        ErrorKind::NoSpace | ErrorKind::FixedLimitExceeded => CameraError::Refused(card_full(&text)),
        ErrorKind::NotSupported => {
            CameraError::Refused(format!("{text}; this camera cannot do that over USB"))
        }
        // What is left is mostly a camera that no longer answers; the caller reopens it.
        _ => CameraError::Gone(format!(
            "{text}; unplugged, switched off, asleep or out of power: check cable and battery, switch off the \
             camera's power saving"
        )),
    }
}

/// The sentence for a full card.
pub fn card_full(what: &str) -> String {
    format!("{what}; the card is full: take pictures off it, or set capturetarget to the internal memory")
}
