//! Commands of the recorder and of its operator: the on-board build has no others.

#[cfg(feature = "gphoto")]
use super::camera_child;
use super::{
    camera_test, check, copy, detect, diagnose, init, mount_check, orient, prune, run, serve,
    solve, status, verify,
};
use wingd_evaluation::results::ReportBuilder;

commands! {
    BoardCommand(reports: Option<ReportBuilder>)
    /// Run the camera process of a recorder
    #[cfg(feature = "gphoto")]
    #[command(hide = true)]
    CameraChild(camera_child::CameraChildArgs) => camera_child::run,
    /// Take shots with the configured camera, without the recorder
    CameraTest(camera_test::CameraTestArgs) => camera_test::run,
    /// Run the recorder: take series of frames and solve them
    Run(run::RunArgs) => run::run [reports],
    /// Write a configuration, an installation and a board to fill in
    Init(init::InitArgs) => init::run,
    /// Check configuration, installation, store and camera
    Check(check::CheckArgs) => check::run,
    /// Measure how far the camera moved between ground frames
    MountCheck(mount_check::MountCheckArgs) => mount_check::run,
    /// Detect markers in images
    Detect(detect::DetectArgs) => detect::run,
    /// Estimate the camera's attitude from ground frames
    Orient(orient::OrientArgs) => orient::run,
    /// Find the error that explains images which do not fit
    Diagnose(diagnose::DiagnoseArgs) => diagnose::run,
    /// Estimate bending, torsion and positions for each image
    Solve(solve::SolveArgs) => solve::run [reports],
    /// Verify every checksum and every invariant of a store
    Verify(verify::VerifyArgs) => verify::run,
    /// Copy flights to another disk and verify the copy
    Copy(copy::CopyArgs) => copy::run,
    /// Delete flights of which a copy holds every byte
    Prune(prune::PruneArgs) => prune::run,
    /// Show the state of the running recorder
    Status(status::StatusArgs) => status::print_status,
    /// Ask the running recorder for an extra series
    Trigger(status::TriggerArgs) => status::trigger_series,
    /// Serve the page of a store: flights, frames, downloads
    Serve(serve::ServeArgs) => serve::run [reports],
}
