//! Commands of the workstation.

mod aircraft_data;
#[cfg(feature = "boards")]
mod calibrate;
mod compare;
mod export;
mod import;
mod learn;
mod mark;
mod plan;
mod report;
#[cfg(feature = "upload")]
mod upload;

use wingd_simulate::command as simulate;

use crate::board_camera::OpenCamera;

commands! {
    DeskCommand(cameras: OpenCamera)
    /// Estimate the interior orientation from images of a board
    #[cfg(feature = "boards")]
    Calibrate(calibrate::CalibrateArgs) => calibrate::run [cameras],
    /// Predict resolution and standard deviations
    Plan(plan::PlanArgs) => plan::run,
    /// Import the images of a camera's card into a store
    Import(import::ImportArgs) => import::run,
    /// Mark undetected markers manually in a browser
    Mark(mark::MarkArgs) => mark::run,
    /// Estimate flight-invariant parameters from several flights
    Learn(learn::LearnArgs) => learn::run,
    /// Write a flight's figures and tables as one HTML file
    Report(report::ReportArgs) => report::run,
    /// Compare two solves of a store, or two stores
    Compare(compare::CompareArgs) => compare::run,
    /// Upload flights to an object store (not in the on-board build)
    #[cfg(feature = "upload")]
    Upload(upload::UploadArgs) => upload::run,
    /// Export results as tables, VTK, JSON lines or NetCDF
    Export(export::ExportArgs) => export::run,
    /// Add a table of the aircraft's own data to a flight
    AircraftData(aircraft_data::AircraftDataArgs) => aircraft_data::run,
    /// Render frames of a wing, or images of a board
    Simulate(simulate::SimulateArgs) => simulate::run,
}
