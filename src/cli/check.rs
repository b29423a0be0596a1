//! `wingd check` names every fault of configuration, installation, store and camera in one go.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use serde_json::json;

use super::{Done, Failure, default_paths, frames, print};
use crate::camera::section::CameraSection;
use crate::clock::System;
use crate::config::{self, Config};
use crate::daemon::machine;
use crate::installation::{self, Fault};
use crate::measure::setup::Setup;
use crate::store::{RealDisk, is_vacant, unwritable, verify};

/// Validate configuration, installation and store, and open the camera if there is one.
#[derive(clap::Args)]
pub struct Args {
    /// The configuration [default: wingd.toml of this folder, else the installation of this folder]
    #[arg(long, value_name = "wingd.toml")]
    config: Option<PathBuf>,
    /// An installation alone
    #[arg(long, value_name = "DIR", conflicts_with = "config")]
    installation: Option<PathBuf>,
    /// Leave the camera alone
    #[arg(long)]
    no_camera: bool,
    /// One JSON object: ok, found, faults
    #[arg(long)]
    json: bool,
}

/// What was looked at, and how it is.
type Found = (&'static str, String);

pub(super) fn run(args: &Args) -> Result<Done, Failure> {
    let mut findings = Findings::default();
    let (file, directory) = asked(args)?;
    if let Some(directory) = &directory {
        findings.installation(directory, false);
    }
    if let Some(file) = &file {
        match config::load(file) {
            Ok(config) => findings.configuration(args, file, &config),
            Err(found) => findings.faults.extend(found),
        }
    }
    let Findings { said, faults } = findings;
    if args.json {
        return as_json(&said, &faults);
    }
    if !said.is_empty() {
        let lines: Vec<String> = said.iter().map(|(what, how)| format!("{what:<15}{how}")).collect();
        print(&lines.join("\n"))?;
    }
    if faults.is_empty() { Ok(Done::All) } else { Err(Failure::Faults(faults)) }
}

/// What is to be looked at: configuration or installation, as named, or as they lie here.
fn asked(args: &Args) -> Result<(Option<PathBuf>, Option<PathBuf>), Failure> {
    if args.config.is_some() || args.installation.is_some() {
        return Ok((args.config.clone(), args.installation.clone()));
    }
    match (default_paths::configuration_here(), default_paths::installation_here()) {
        (Some(file), _) => Ok((Some(file), None)),
        (None, Some(directory)) => Ok((None, Some(directory))),
        (None, None) => default_paths::configuration(None).map(|file| (Some(file), None)),
    }
}

/// `found`: how what was looked at is, by its name.
fn as_json(said: &[Found], faults: &[Fault]) -> Result<Done, Failure> {
    let found: serde_json::Map<_, _> =
        said.iter().map(|(what, how)| ((*what).to_owned(), how.as_str().into())).collect();
    let fault = |f: &Fault| json!({"file": f.file, "place": f.place, "problem": f.problem, "mend": f.remedy});
    let faults: Vec<_> = faults.iter().map(fault).collect();
    let ok = faults.is_empty();
    print(&json!({"ok": ok, "found": found, "faults": faults}).to_string())?;
    if ok { Ok(Done::All) } else { Err(Failure::AlreadyReported) }
}

/// What the rules of the cabin ask: transmitters, heat, supply, how long a stop takes. No fault: the operator decides.
fn cabin(config: &Config, sys: &Path) -> Vec<Found> {
    let radios = machine::radios(sys);
    let open: Vec<String> =
        radios.iter().filter(|r| !r.blocked).map(|r| format!("{} ({})", r.name, r.kind)).collect();
    let radios = match (radios.len(), open.is_empty()) {
        (0, _) => "the kernel knows none".to_owned(),
        (n, true) => format!("{n}, all blocked"),
        (_, false) => format!("NOT BLOCKED: {}; block them: rfkill block all", open.join(", ")),
    };
    let machine = machine::line(sys).unwrap_or("the kernel does not say".to_owned());
    let power = &config.power;
    let hold_up = match power.watches() {
        false => "; no line or file says that the power fails".to_owned(),
        true => format!("; once the power fails all is durable within {:?}", power.hold_up),
    };
    vec![
        ("radios", radios),
        ("machine", machine),
        ("a stop takes", format!("at most {:?}{hold_up}", power.stop_within)),
    ]
}

/// What is in order, and yet may not be meant.
fn open_points(setup: &Setup) -> Vec<Found> {
    let mut all = Vec::new();
    if setup.thermal.is_none() {
        let how = "no [thermal]: the wing's length in flight is known to 1.6 mm per metre only";
        all.push(("temperature", how.to_owned()));
    }
    if setup.markers.iter().all(|m| !m.fixed) {
        let how = "none: how the camera turned and moved since the ground frame is told by the wing alone; `wingd plan` says what \
                   marks rigid to the cabin bring";
        all.push(("fixed marks", how.to_owned()));
    }
    let span = setup.span_direction.try_normalize(0.0);
    let normal = setup.window.as_ref().and_then(|w| w.normal);
    if let (Some(span), Some(normal)) = (span, normal) {
        let turn_deg = normal.xy().dot(&span).clamp(-1.0, 1.0).acos().to_degrees();
        if turn_deg > ACROSS_DEG {
            let how = format!(
                "[window] normal lies at {turn_deg:.0} degrees to the span, and should point outwards as the wing does: is it in the \
                 survey's frame, and along the view?"
            );
            all.push(("window", how));
        }
    }
    all
}

/// From the window's normal to the span: no sweep and no window in a tapering fuselage explains more, degrees.
const ACROSS_DEG: f64 = 60.0;

/// What was found so far.
#[derive(Default)]
struct Findings {
    said: Vec<Found>,
    faults: Vec<Fault>,
}

impl Findings {
    fn configuration(&mut self, args: &Args, file: &Path, config: &Config) {
        self.said.push(("configuration", file.display().to_string()));
        match &config.installation {
            Some(directory) => self.installation(directory, true),
            None => {
                self.said.push(("installation", "none configured: frames are recorded, not solved".into()))
            }
        }
        self.store(config, file);
        if !args.no_camera {
            self.camera(config, file);
        }
        self.said.extend(cabin(config, Path::new(machine::SYS)));
    }

    /// `flies`: it is to solve frames, and needs its orientation.
    fn installation(&mut self, directory: &Path, flies: bool) {
        match installation::load(directory) {
            Err(found) => self.faults.extend(found),
            Ok(installation) => {
                let markers = installation.setup.markers.len();
                let pairs = installation.setup.torsion.len();
                let fixed = installation.setup.markers.iter().filter(|m| m.fixed).count();
                let how = format!(
                    "{}: {markers} markers ({fixed} of them rigid to the cabin), {pairs} torsion pairs",
                    directory.display()
                );
                self.said.push(("installation", how));
                self.said.extend(open_points(&installation.setup));
                super::say_doubts(&installation);
                let learnt = installation.learnt.as_ref();
                self.said.extend(learnt.map(|learnt| ("flight_prior", format!("from {}", learnt.counted()))));
                match installation.require_orientation() {
                    Ok(_) => self.said.push(("orientation", "there".into())),
                    Err(fault) if flies => self.faults.push(fault),
                    Err(_) => self.said.push(("orientation", "none yet: `wingd orient` writes it".into())),
                }
            }
        }
    }

    fn store(&mut self, config: &Config, file: &Path) {
        let path = &config.store.path;
        self.faults.extend(unwritable(&RealDisk, path).map(|problem| {
            let mend = "give the recorder's user the right to write there, or name another place";
            Fault::new(file, "store.path", problem, mend)
        }));
        if is_vacant(&RealDisk, path) {
            self.said.push(("store", format!("{} will be made", path.display())));
            let parent = path.parent().filter(|p| !p.as_os_str().is_empty());
            if parent.is_some_and(|p| !p.is_dir()) {
                let problem = format!("the folder above {} does not exist", path.display());
                self.faults.push(Fault::new(file, "store.path", problem, "make it, or name another place"));
            }
            return;
        }
        let busy = frames::busy("verifying the store");
        let report = verify::verify(&RealDisk, path);
        drop(busy);
        let found: Vec<Fault> = report
            .faults
            .iter()
            .map(|f| Fault::new(&f.path, format!("invariant {}", f.invariant), &f.what, "see docs/store.md"))
            .collect();
        if found.is_empty() {
            self.said.push(("store", format!("{}: sound", path.display())));
        }
        self.faults.extend(found);
    }

    fn camera(&mut self, config: &Config, file: &Path) {
        let make = config.camera.factory(Arc::new(System::new()), Duration::ZERO);
        let mut camera = make();
        match camera.open() {
            Ok(info) => {
                let again = match &config.camera {
                    CameraSection::Replay(replay) if replay.repeat => {
                        ": begins again after the last picture; loop = false ends there"
                    }
                    _ => "",
                };
                self.said.push(("camera", format!("{}{again}", info.name)));
                for warning in &info.warnings {
                    let mend = "set it by hand, or correct the configuration";
                    self.faults.push(Fault::new(file, "camera", warning.clone(), mend));
                }
            }
            Err(error) => {
                let mend = if matches!(config.camera, CameraSection::Replay(_)) {
                    "name a folder or a list with pictures"
                } else {
                    "see docs/operations/camera.md, or check without it: --no-camera"
                };
                self.faults.push(Fault::new(file, "camera", error.to_string(), mend));
            }
        }
        camera.close();
    }
}
