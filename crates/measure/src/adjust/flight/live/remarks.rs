//! Remarks about the adjustment of a live frame.

/// Remarks for a frame that the state explains: its number within the mounting, and a mount disturbance if there was one.
pub fn accepted_remarks(frames: usize, mounting: usize, mount_disturbed: bool) -> Vec<String> {
    let mut list = vec![format!(
        "adjusted with the previous frames (frame {frames} of mounting {mounting})"
    )];
    if mount_disturbed {
        list.push(
            "the camera mount was disturbed: its rotation and shift were estimated again; check the mount".into(),
        );
    }
    list
}

/// Remark for a frame that contradicts the state.
pub fn rejection_remark(is_restarted: bool, mounting: usize) -> String {
    let cause = "adjusted on its own: inconsistent with the previous frames, with or without a mount disturbance";
    match is_restarted {
        true => format!("{cause}; all is estimated again from here, as mounting {mounting}"),
        false => format!("{cause}; not used for later frames"),
    }
}
