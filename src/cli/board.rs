//! Commands of the recorder and of its operator: the on-board build has no others.

#[cfg(feature = "gphoto")]
use super::camera_child;
use super::{
    check, copy, detect, diagnose, init, mount_check, orient, prune, run, serve, solve, status,
    verify,
};
use wingd_evaluation::results::ReportBuilder;

commands! {
    BoardCommand(reports: Option<ReportBuilder>)
    /// Run the camera process of a recorder
    #[cfg(feature = "gphoto")]
    #[command(hide = true)]
    CameraChild(camera_child::CameraChildArgs) => camera_child::run, Hidden [];
    /// Run the recorder: take series of frames and solve them
    Run(run::RunArgs) => run::run, Record [
        "wingd run --config wingd.toml",
    ];
    /// Write a configuration, an installation and a board to fill in
    Init(init::InitArgs) => init::run, Prepare [
        "wingd init aircraft",
    ];
    /// Check configuration, installation, store and camera
    Check(check::CheckArgs) => check::run, Prepare [
        "wingd check --config wingd.toml",
        "wingd check --installation installation",
        "wingd check --config wingd.toml --camera 2 --output look",
    ];
    /// Measure how far the camera moved between ground frames
    MountCheck(mount_check::MountCheckArgs) => mount_check::run, Prepare [
        "wingd mount-check --installation installation frames/ground.jpg frames/ground.jpg",
    ];
    /// Detect markers in images
    Detect(detect::DetectArgs) => detect::run, Evaluate [
        "wingd detect --installation installation --overlay drawn frames/ground.jpg",
    ];
    /// Estimate the camera's attitude from ground frames
    Orient(orient::OrientArgs) => orient::run, Prepare [
        "wingd orient --installation installation frames/ground.jpg",
    ];
    /// Find the error that explains images which do not fit
    Diagnose(diagnose::DiagnoseArgs) => diagnose::run, Prepare [
        "wingd diagnose --installation installation frames/ground.jpg",
    ];
    /// Estimate bending, torsion and positions for each image
    Solve(solve::SolveArgs) => solve::run [reports], Evaluate [
        "wingd solve --installation installation --report report.html frames/flight-1.jpg frames/flight-2.jpg",
        "wingd solve --installation installation frames/flight-1.jpg",
        "wingd solve --installation installation --joint --json frames/flight-*.jpg",
        "wingd solve store",
        "wingd solve store --single --sigma prior",
    ];
    /// Verify every checksum and every invariant of a store
    Verify(verify::VerifyArgs) => verify::run, Transfer [
        "wingd verify store",
    ];
    /// Copy flights to another disk and verify the copy
    Copy(copy::CopyArgs) => copy::run, Transfer [
        "wingd copy store copy",
        "wingd copy http://127.0.0.1:8080 copy",
    ];
    /// Delete flights of which a copy holds every byte
    Prune(prune::PruneArgs) => prune::run, Transfer [
        "wingd prune store --verified-copy copy --dry-run",
    ];
    /// Show the state of the running recorder
    Status(status::StatusArgs) => status::print_status, Record [
        "wingd status --config wingd.toml --json",
    ];
    /// Ask the running recorder for an extra series
    Trigger(status::TriggerArgs) => status::trigger_series, Record [
        "wingd trigger --config wingd.toml",
    ];
    /// Serve the page of a store: flights, frames, downloads
    Serve(serve::ServeArgs) => serve::run, Transfer [
        "wingd serve store",
    ];
}
