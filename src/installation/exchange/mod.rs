//! Cameras as other programs write them: OpenCV, ROS, Kalibr, mrcal. All count pixels from the centre of the
//! top-left one and use Brown's distortion in OpenCV's order k1 k2 p1 p2 k3, for a rational lens with k4 k5 k6 behind it.
//!
//! | file | from | to |
//! |---|---|---|
//! | `format` | a file's name and keys | whose format it is |
//! | `declared` | the keys of a camera | refusal of a model that is not ours, keys that nobody knows |
//! | `matrix`, `listed` | the keys of a camera | numbers as they stand: [`interior`] |
//! | `interior` | numbers | a lens that can be, with remarks on what is unusual |
//! | `read` | a file | the camera, what was left of it and what is to be known |
//! | `write` | a lens | a file |

mod declared;
mod format;
mod interior;
mod listed;
mod matrix;
mod read;
mod write;

pub use format::{CameraFormat, format_of_name};
pub use read::{ReadCamera, read_exchange};
pub use write::{WriteError, write_exchange};
