//! The camera of the recorder, for live calibration.

use wingd_base::failure::TaskResult;

/// Camera of a configuration, as live calibration uses it.
pub trait BoardCamera {
    /// Returns the name that the camera reports.
    fn name(&self) -> &str;

    /// Takes one image and returns its bytes, or the reason why there are no more.
    fn shoot(&mut self) -> Result<Vec<u8>, String>;
}

/// Opens the camera of a configuration (`wingd.toml`).
pub type OpenCamera = fn(&std::path::Path) -> TaskResult<Box<dyn BoardCamera>>;
