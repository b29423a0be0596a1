//! What is said of a live frame's adjustment.

/// Of a frame that the state explains: which it is of its mounting, and whether the camera mount was disturbed.
pub fn remarks(frames: usize, mounting: usize, mount_disturbed: bool) -> Vec<String> {
    let mut list =
        vec![format!("adjusted with what the frames before it told, frame {frames} of mounting {mounting}")];
    if mount_disturbed {
        list.push("the camera mount was disturbed: its rotation and shift are estimated again".into());
    }
    list
}

/// Of one that contradicts it.
pub fn contradiction(given_up: bool, mounting: usize) -> String {
    let what = "adjusted by itself: what the frames before it told contradicts it, whether the camera mount was disturbed or not";
    match given_up {
        true => format!("{what}; all is learnt anew from here, in mounting {mounting}"),
        false => format!("{what}; nothing is learnt from it"),
    }
}
