//! Dark regions of the frame: background, levels, connected sets, blobs.

pub mod background;
pub mod bitmask;
pub mod blob;
pub mod components;
pub mod options;
pub mod windows;
