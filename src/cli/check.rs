//! `wingd check` reports all errors in configuration, installation, store and camera at once.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;

use super::camera_shots::{ShotArgs, take_shots};
use super::workstation;
use crate::camera::section::CameraSection;
use crate::config::{self, Config};
use crate::daemon::{self, memory, radios};
use wingd_base::clock::SystemClock;
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::fault::Fault;
use wingd_base::output::{print_json, print_line, show_busy};
use wingd_evaluation::inputs::default_paths;
use wingd_evaluation::installation;
use wingd_evaluation::number::count_text;
use wingd_evaluation::pipeline::recording::cad_record;
use wingd_measure::setup::{Setup, WingSide};
use wingd_store as store;
use wingd_store::signing::exposure;
use wingd_store::{RealDisk, catalogue, is_vacant, unwritable_reason, verify};

/// Check configuration, installation and store, and open the camera if there is one.
#[derive(clap::Args)]
pub struct CheckArgs {
    /// Configuration [default: wingd.toml in this directory, else the installation in this directory]
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
    /// Check only this installation
    #[arg(long, value_name = "DIR", conflicts_with = "config")]
    installation: Option<PathBuf>,
    /// Do not open the camera
    #[arg(long)]
    no_camera: bool,
    /// Check the store's format only: verifying takes as long as reading all its files
    #[arg(long)]
    no_verify: bool,
    #[command(flatten)]
    camera: ShotArgs,
    /// Print one JSON object: ok, found, faults
    #[arg(long)]
    json: bool,
}

/// Name of a checked item and its state.
type Finding = (&'static str, String);

/// Checks a configuration, the installation and the store, and prints faults and remarks.
pub(super) fn run(args: &CheckArgs) -> TaskResult<Completion> {
    if let Some(shots) = args.camera.shots {
        return take_shots(&args.camera, shots, args.config.as_deref());
    }
    let mut findings = Findings::default();
    let (file, directory) = select_subjects(args)?;
    if let Some(directory) = &directory {
        findings.check_installation(directory, false);
    }
    if let Some(file) = &file {
        match config::load_configuration(file) {
            Ok(config) => findings.check_configuration(args, file, &config),
            Err(found) => findings.faults.extend(found),
        }
    }
    let Findings { reported, faults } = findings;
    if args.json {
        return print_findings(&reported, &faults);
    }
    if !reported.is_empty() {
        let lines: Vec<String> = reported
            .iter()
            .map(|(what, how)| format!("{what:<15}{how}"))
            .collect();
        print_line(&lines.join("\n"))?;
    }
    if faults.is_empty() {
        Ok(Completion::All)
    } else {
        Err(Failure::Faults(faults))
    }
}

/// Selects the configuration and the installation to check: those given, else those in the working directory.
fn select_subjects(args: &CheckArgs) -> TaskResult<(Option<PathBuf>, Option<PathBuf>)> {
    if args.config.is_some() || args.installation.is_some() {
        return Ok((args.config.clone(), args.installation.clone()));
    }
    match (
        default_paths::local_configuration(),
        default_paths::local_installation(),
    ) {
        (Some(file), _) => Ok((Some(file), None)),
        (None, Some(directory)) => Ok((None, Some(directory))),
        (None, None) => default_paths::resolve_configuration(None).map(|file| (Some(file), None)),
    }
}

/// Prints the findings by name, and the errors, as one JSON object.
fn print_findings(reported: &[Finding], faults: &[Fault]) -> TaskResult<Completion> {
    let found: serde_json::Map<_, _> = reported
        .iter()
        .map(|(what, how)| ((*what).to_owned(), how.as_str().into()))
        .collect();
    let fault = |f: &Fault| json!({"file": f.file, "place": f.place, "problem": f.problem, "remedy": f.remedy});
    let faults: Vec<_> = faults.iter().map(fault).collect();
    let ok = faults.is_empty();
    print_json(&json!({"ok": ok, "found": found, "faults": faults}))?;
    Ok(if ok {
        Completion::All
    } else {
        Completion::Faulty
    })
}

/// Findings on cabin rules: radio transmitters, time to stop. None is an error: the operator decides.
fn cabin_findings(config: &Config, sys: &Path) -> Vec<Finding> {
    let radios = radios::list_radios(sys);
    let open: Vec<String> = radios
        .iter()
        .filter(|r| !r.blocked)
        .map(|r| format!("{} ({})", r.name, r.kind))
        .collect();
    let radios = match (radios.len(), open.is_empty()) {
        (0, _) => "none known to the kernel".to_owned(),
        (n, true) => format!("{n}, all blocked"),
        (_, false) => format!(
            "NOT BLOCKED: {}; block them: rfkill block all",
            open.join(", ")
        ),
    };
    let power = &config.power;
    let hold_up = match power.is_configured() {
        false => "; no line or file to report a power failure is configured".to_owned(),
        true => format!(
            "; after a power failure all data are durable within {:?}",
            power.hold_up
        ),
    };
    vec![
        ("radios", radios),
        (
            "a stop takes",
            format!("at most {:?}{hold_up}", power.stop_within),
        ),
    ]
}

/// Describes the direction of the nose, which decides the sign of the twist.
fn nose_text(setup: &Setup) -> String {
    let Some((side, span)) = setup.side().zip(setup.span_direction.try_normalize(0.0)) else {
        return String::new();
    };
    // Seen from above, the nose is to the left of a right wing's span.
    let (turn, hand) = match side {
        WingSide::Right => (1.0, "left"),
        WingSide::Left => (-1.0, "right"),
    };
    let [x, y] = [-turn * span.y, turn * span.x];
    format!(", nose towards [{x:.2}, {y:.2}] in the survey, {hand} in the image")
}

/// Findings that are valid but possibly not intended.
fn advisory_findings(setup: &Setup) -> Vec<Finding> {
    let mut all = Vec::new();
    if setup.thermal.is_none() {
        let how = "no [thermal]: the wing's length in flight is known only to 1.6 mm per metre";
        all.push(("temperature", how.to_owned()));
    }
    if setup.markers.iter().all(|m| !m.fixed) {
        let how = "none: camera rotation and shift since the ground frame can only be estimated from the wing itself; \
                   `wingd plan` shows the gain from far fixed targets";
        all.push(("fixed targets", how.to_owned()));
    }
    let small_priors = workstation::describe_small_priors(setup);
    all.extend(small_priors.into_iter().map(|how| ("prior sigma", how)));
    let span = setup.span_direction.try_normalize(0.0);
    let normal = setup.window.as_ref().and_then(|w| w.normal);
    if let (Some(span), Some(normal)) = (span, normal) {
        let turn_deg = normal.xy().dot(&span).clamp(-1.0, 1.0).acos().to_degrees();
        if turn_deg > MAX_NORMAL_TO_SPAN_DEG {
            let how = format!(
                "[window] normal is at {turn_deg:.0} degrees to the span, but should point outboard like the wing; check that it is in \
                 the survey frame and points along the view"
            );
            all.push(("window", how));
        }
    }
    all
}

/// Maximum angle between window normal and span, degrees. Neither sweep nor a tapering fuselage explains a larger one.
const MAX_NORMAL_TO_SPAN_DEG: f64 = 60.0;

/// Findings and errors collected by the checks.
#[derive(Default)]
struct Findings {
    reported: Vec<Finding>,
    faults: Vec<Fault>,
}

impl Findings {
    fn check_configuration(&mut self, args: &CheckArgs, file: &Path, config: &Config) {
        self.reported
            .push(("configuration", file.display().to_string()));
        match &config.installation {
            Some(directory) => self.check_installation(directory, true),
            None => self.reported.push((
                "installation",
                "none configured: frames are recorded but not solved".into(),
            )),
        }
        self.check_store(args, config, file);
        self.check_page(config, file);
        self.check_memory(config, file);
        self.check_sockets(config, file);
        if !args.no_camera {
            self.check_camera(config, file);
        }
        self.reported
            .extend(cabin_findings(config, Path::new(radios::SYSFS)));
    }

    /// Checks an installation; with `flies` it must have an orientation, because it will solve frames.
    fn check_installation(&mut self, directory: &Path, flies: bool) {
        match installation::load(directory) {
            Err(found) => self.faults.extend(found),
            Ok(installation) => {
                let markers = installation.setup.markers.len();
                let pairs = installation.setup.torsion.len();
                let fixed = installation
                    .setup
                    .markers
                    .iter()
                    .filter(|m| m.fixed)
                    .count();
                let how = format!(
                    "{}: {markers} markers ({fixed} of them fixed to the cabin), {}{}",
                    directory.display(),
                    count_text(pairs, "torsion pair"),
                    nose_text(&installation.setup)
                );
                self.reported.push(("installation", how));
                self.reported.extend(advisory_findings(&installation.setup));
                self.reported
                    .extend(cad_record(&installation).map(|cad| ("CAD frame", cad.describe())));
                default_paths::print_warnings(&installation);
                let prior = installation.flight_prior.as_ref();
                self.reported.extend(prior.map(|prior| {
                    (
                        "flight_prior",
                        format!("from {}", prior.flight_count_text()),
                    )
                }));
                match installation.require_orientation() {
                    Ok(_) => self.reported.push(("orientation", "present".into())),
                    Err(fault) if flies => self.faults.push(fault),
                    Err(_) => self.reported.push((
                        "orientation",
                        "none yet; run `wingd orient` to create it".into(),
                    )),
                }
            }
        }
    }

    fn check_store(&mut self, args: &CheckArgs, config: &Config, file: &Path) {
        let path = &config.store.path;
        let exposed = config.store.signing_key.as_deref().and_then(exposure);
        self.reported
            .extend(exposed.map(|how| ("signing key", how)));
        self.faults
            .extend(unwritable_reason(&RealDisk, path).map(|problem| {
                let remedy = "give the recorder's user write access, or choose another directory";
                Fault::new(file, "store.path", problem, remedy)
            }));
        if is_vacant(&RealDisk, path) {
            self.reported
                .push(("store", format!("{} will be created", path.display())));
            let parent = path.parent().filter(|p| !p.as_os_str().is_empty());
            if parent.is_some_and(|p| !p.is_dir()) {
                let problem = format!("the folder above {} does not exist", path.display());
                self.faults.push(Fault::new(
                    file,
                    "store.path",
                    problem,
                    "create it, or choose another directory",
                ));
            }
            return;
        }
        if args.no_verify {
            let format = catalogue::check_format(&RealDisk, path).err();
            self.faults.extend(format.map(|error| {
                Fault::new(file, "store.path", error.to_string(), "see docs/store.md")
            }));
            return;
        }
        let report = show_busy("verifying the store", || {
            verify::verify_path(&RealDisk, path)
        });
        let found: Vec<Fault> = report
            .faults
            .iter()
            .map(|f| {
                Fault::new(
                    &f.path,
                    format!("invariant {}", f.invariant),
                    &f.what,
                    "see docs/store.md",
                )
            })
            .collect();
        if found.is_empty() {
            self.reported
                .push(("store", format!("{}: sound", path.display())));
        }
        self.faults.extend(found);
    }

    /// Checks the address and the secrets of the page; the recorder itself runs without it.
    fn check_page(&mut self, config: &Config, file: &Path) {
        let Some(serve) = &config.serve else { return };
        let place = |key: &str| (file.to_owned(), format!("serve.{key}"));
        self.faults
            .extend(serve.resolve(place).err().unwrap_or_default());
        let owner = store::service_owner(&config.store.path);
        for path in [&serve.token_file, &serve.key, &serve.certificate]
            .into_iter()
            .flatten()
        {
            if owner.is_some_and(|owner| !owner.can_read(path)) {
                let problem = "cannot be read by the owner of the store, who runs the recorder";
                let remedy = "give it to that user: install -o wingd -m 600";
                self.faults
                    .push(Fault::new(path, "permissions", problem, remedy));
            }
        }
        self.reported.extend(
            serve
                .warnings()
                .into_iter()
                .map(|warning| ("web page", warning)),
        );
    }

    /// Checks that the frames in memory fit into the memory of the service.
    fn check_memory(&mut self, config: &Config, file: &Path) {
        let (ring_mb, limit_mb) = (
            config.live.keep.ring_mb,
            memory::service_limit_mb(Path::new("/")),
        );
        let Some(limit_mb) = limit_mb.filter(|_| config.live.is_enabled()) else {
            return;
        };
        let largest_mb = memory::largest_ring_mb(limit_mb);
        if ring_mb > largest_mb {
            let problem = format!("is {ring_mb}, but the service may use {limit_mb} MB in all");
            let remedy =
                format!("lower it to {largest_mb}, or raise MemoryMax (systemctl edit wingd)");
            self.faults
                .push(Fault::new(file, "live.keep.ring_mb", problem, remedy));
        }
    }

    fn check_sockets(&mut self, config: &Config, file: &Path) {
        let sockets = [
            ("status.socket", Some(&config.status.socket)),
            ("live.socket", config.live.socket.as_ref()),
        ];
        for (key, path) in sockets {
            let Some(path) = path else { continue };
            if let Some(problem) = daemon::occupied_socket_reason(path) {
                let problem = format!("{} {problem}", path.display());
                self.faults.push(Fault::new(
                    file,
                    key,
                    problem,
                    "the recorder removes sockets only",
                ));
            }
        }
    }

    fn check_camera(&mut self, config: &Config, file: &Path) {
        let make = config
            .camera
            .factory(Arc::new(SystemClock::new()), Duration::ZERO);
        let mut camera = make();
        match camera.open() {
            Ok(info) => {
                let again = match &config.camera {
                    CameraSection::Replay(replay) if replay.repeat => {
                        ": repeats after the last image; set loop = false to stop there"
                    }
                    _ => "",
                };
                self.reported
                    .push(("camera", format!("{}{again}", info.name)));
                for warning in &info.warnings {
                    let remedy = "set it manually on the camera, or correct the configuration";
                    self.faults
                        .push(Fault::new(file, "camera", warning.clone(), remedy));
                }
            }
            Err(error) => {
                let remedy = if matches!(config.camera, CameraSection::Replay(_)) {
                    "name a folder or a list with images"
                } else {
                    "see docs/operations/camera.md, or skip the camera with --no-camera"
                };
                self.faults
                    .push(Fault::new(file, "camera", error.to_string(), remedy));
            }
        }
        camera.close();
    }
}
