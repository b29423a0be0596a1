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

use wingd_simulate::command as simulate;

commands! {
    DeskCommand()
    /// Estimate the interior orientation from images of a board
    #[cfg(feature = "boards")]
    Calibrate(calibrate::CalibrateArgs) => calibrate::run, Prepare [
        "wingd calibrate --board board.toml --output camera.toml --report calibration.html board/*.jpg",
    ];
    /// Predict resolution and standard deviations
    Plan(plan::PlanArgs) => plan::run, Prepare [
        "wingd plan --reach 33 --height 2.5 --chord 4 --focal 12 --sensor 4000x3000x1.54 --markers 20 --fixed 2 --frames 10 --want 5mm",
        "wingd plan --installation installation --tip-deflection 2.5",
    ];
    /// Import the images of a camera's card into a store
    Import(import::ImportArgs) => import::run, Evaluate [
        "wingd import frames --store card --installation installation",
    ];
    /// Mark undetected markers manually in a browser
    Mark(mark::MarkArgs) => mark::run, Evaluate [
        "wingd mark store",
        "wingd mark --installation installation frames/flight-1.jpg",
    ];
    /// Estimate flight-invariant parameters from several flights
    Learn(learn::LearnArgs) => learn::run, Evaluate [
        "wingd learn store --installation installation",
    ];
    /// Write a flight's figures and tables as one HTML file
    Report(report::ReportArgs) => report::run, Evaluate [
        "wingd report store --output report.html",
    ];
    /// Compare two solves of a store
    Compare(compare::CompareArgs) => compare::run, Evaluate [
        "wingd compare store",
    ];
    /// Export results as tables, JSON lines or NetCDF
    Export(export::ExportArgs) => export::run, Evaluate [
        "wingd export store --format csv --table span --output span.csv",
        "wingd export store --format parquet --output markers.parquet",
        "wingd export store --format netcdf --output shape.nc",
    ];
    /// Add a table of the aircraft's own data to a flight
    AircraftData(aircraft_data::AircraftDataArgs) => aircraft_data::run, Evaluate [
        "wingd aircraft-data demo-flight/store aircraft.csv --flight f0001",
        "wingd aircraft-data store --flight f0001 --list",
    ];
    /// Render frames of a wing, or images of a board
    Simulate(simulate::SimulateArgs) => simulate::run, Utility [
        "wingd simulate --output practice --seed 4 --size 1600 1200 --focal 1400 --tip-deflections 2.4,1.8 --board board.toml",
    ];
}
