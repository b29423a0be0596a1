//! Commands of the desk. The on-board build has stand-ins that name the package with them.

#[cfg(feature = "boards")]
use super::calibrate;
#[cfg(not(feature = "boards"))]
use super::unavailable::calibrate;
#[cfg(not(feature = "upload"))]
use super::unavailable::upload;
#[cfg(feature = "upload")]
use super::upload;
use super::{
    Completion, Failure, aircraft_data, compare, convert, deform, demo, difference, export, fetch,
    import, learn, mark, mean, plan, report, simulate, stress, time_check,
};

commands! {
    DeskCommand()
    /// Run a bundled flight through the real recorder
    Demo(demo::DemoArgs) => demo::run,
    /// Estimate the interior orientation from images of a board
    Calibrate(calibrate::CalibrateArgs) => calibrate::run,
    /// Convert a camera from or to OpenCV, ROS, Kalibr and mrcal
    Convert(convert::ConvertArgs) => convert::run,
    /// Check times of exposure with images of a clock on a screen
    TimeCheck(time_check::TimeCheckArgs) => time_check::run,
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
    /// Download flights from a recorder or `wingd serve`
    Fetch(fetch::FetchArgs) => fetch::run,
    /// Upload flights to an object store (not in the on-board build)
    Upload(upload::UploadArgs) => upload::run,
    /// Average measured shapes, also by conditions of the flight
    Mean(mean::MeanArgs) => mean::run,
    /// Compare measured shapes with each other or with a computation
    Difference(difference::DifferenceArgs) => difference::run,
    /// Export results as tables, VTK, JSON lines, NetCDF or NumPy
    Export(export::ExportArgs) => export::run,
    /// Move the nodes of a surface by the measured shape
    Deform(deform::DeformArgs) => deform::run,
    /// Add a table of the aircraft's own data to a flight
    AircraftData(aircraft_data::AircraftDataArgs) => aircraft_data::run,
    /// Compute bending moments: extremes, load cycles, damage
    Stress(stress::StressArgs) => stress::run,
    /// Render frames of a wing, or images of a board
    Simulate(simulate::SimulateArgs) => simulate::run,
}
