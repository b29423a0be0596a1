//! What is said of a live frame's adjustment.

/// Of a frame that the state explains: which it is of its mounting, and whether the camera was jolted.
pub fn remarks(frames: usize, mounting: usize, jolt: bool) -> Vec<String> {
    let mut list =
        vec![format!("adjusted with what the frames before it told, frame {frames} of mounting {mounting}")];
    if jolt {
        list.push("the camera was jolted: its rotation and shift are learnt anew".into());
    }
    list
}

/// Of one that contradicts it.
pub fn contradiction(given_up: bool, mounting: usize) -> String {
    let what = "adjusted by itself: what the frames before it told contradicts it, whether the camera was jolted or not";
    match given_up {
        true => format!("{what}; all is learnt anew from here, in mounting {mounting}"),
        false => format!("{what}; nothing is learnt from it"),
    }
}
