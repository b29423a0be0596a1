//! `wingd simulate` renders frames of a wing with known truth.

mod gusts;

use std::path::PathBuf;

use nalgebra::Vector2;

use crate::render::Light;
use crate::render::SceneOptions;
use crate::render::SceneSide;
use crate::render::SeededRandom;
use crate::render::{Scene, SceneShot};
use crate::set::{
    FlightMoment, SetFrame, choose_hidden, sample_aircraft, with_default_priors,
    write_board_images, write_set,
};
use wingd_base::failure::{Completion, Failure, TaskResult};
use wingd_base::output::{print_line, progress_bar};
use wingd_evaluation::inputs::stopping::{is_stopped, watch_signals};
use wingd_evaluation::installation;
use wingd_evaluation::installation::Installation;
use wingd_evaluation::number::count_text;
use wingd_measure::plan;
use wingd_measure::plan::PlanOptions;

/// Render frames of a wing, or images of a board, with known truth
#[derive(clap::Args)]
pub struct SimulateArgs {
    /// Folder for installation/, frames/ and truth.json
    #[arg(long, value_name = "DIR")]
    output: PathBuf,
    /// Use the camera, survey and orientation of this installation instead of a random wing
    #[arg(long, value_name = "DIR")]
    installation: Option<PathBuf>,
    /// Seed of all random numbers
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Tip deflection of each flight frame, m
    #[arg(
        long,
        value_delimiter = ',',
        allow_hyphen_values = true,
        default_value = "2.6,2.3,2.0,1.7,1.4",
        value_name = "M,M"
    )]
    tip_deflections: Vec<f64>,
    /// Light of the flight frames in turn: plain, gradient, shadow, glare, dusk, backlight, haze
    #[arg(long, value_delimiter = ',', default_value = "plain", value_name = "LIGHT,LIGHT", value_parser = parse_light)]
    lights: Vec<Light>,
    /// Number of markers missing in each flight frame
    #[arg(long, default_value_t = 0, value_name = "N")]
    hide: usize,
    /// Change of the load distribution over the flight, for example 0.05
    #[arg(
        long,
        default_value_t = 0.0,
        allow_hyphen_values = true,
        value_name = "SHARE"
    )]
    shape_change: f64,
    /// Remount the camera before this flight frame, counted from 1
    #[arg(long, value_name = "N")]
    remount: Option<usize>,
    /// Sample errors of the installation's values and in-flight effects from the installation's priors; the installation
    /// that is written has these errors and the priors they were sampled from
    #[arg(long, requires = "installation")]
    drawn: bool,
    #[command(flatten)]
    gusts: gusts::GustArgs,
    #[command(flatten)]
    wing: WingArgs,
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    board: BoardArgs,
}

/// Images of a board by the same camera
#[derive(clap::Args)]
#[command(next_help_heading = "Board")]
struct BoardArgs {
    /// Also render images of this checkerboard, in board/
    #[arg(long, value_name = "BOARD.toml")]
    board: Option<PathBuf>,
    /// Number of board images
    #[arg(long, default_value_t = 20, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=200))]
    board_pictures: u16,
}

/// The random wing and its camera
#[derive(clap::Args)]
#[command(next_help_heading = "Random wing (not with --installation)")]
struct WingArgs {
    /// Side of the wing [default: by seed]
    #[arg(long, value_name = "left|right", value_parser = parse_side)]
    side: Option<SceneSide>,
    /// Length of the wing, m
    #[arg(long, value_name = "M")]
    length: Option<f64>,
    /// Number of markers, including the pair at the tip
    #[arg(long, value_name = "N")]
    markers: Option<usize>,
    /// Number of markers that are quadrants
    #[arg(long, value_name = "N")]
    quadrants: Option<usize>,
    /// Diameter of the markers, m
    #[arg(long, value_name = "M")]
    diameter: Option<f64>,
    /// Camera above the skin at the root, m
    #[arg(long, value_name = "M")]
    camera_height: Option<f64>,
    /// Fixed targets, rigid to the cabin, 0 to 4, in the corners of the image
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=4))]
    fixed_targets: Option<u8>,
    /// Points: salient structures without a decal, 0 to 40; frames/marks.csv has their places in the ground frame
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=40))]
    points: Option<u8>,
    /// Standard deviation of the survey, m
    #[arg(long, value_name = "M")]
    survey_sigma: Option<f64>,
    /// Clutter on the skin: 1 typical, 0 none
    #[arg(long, value_name = "FACTOR")]
    clutter: Option<f64>,
    /// Size of the frames, px
    #[arg(long, num_args = 2, value_names = ["WIDTH", "HEIGHT"])]
    size: Option<Vec<u32>>,
    /// Focal length, px
    #[arg(long, value_name = "PX")]
    focal: Option<f64>,
    /// Distortion coefficients
    #[arg(long, value_delimiter = ',', num_args = 5, value_names = ["K1", "K2", "K3", "P1", "P2"], allow_hyphen_values = true)]
    distortion: Option<Vec<f64>>,
}

/// Sensor and file
#[derive(clap::Args)]
#[command(next_help_heading = "Image")]
struct PictureArgs {
    /// Standard deviation of the point spread function, px
    #[arg(long, default_value_t = 0.8, value_name = "PX")]
    blur: f64,
    /// Movement during the exposure, px
    #[arg(long, num_args = 2, value_names = ["U", "V"], allow_hyphen_values = true)]
    motion: Option<Vec<f64>>,
    /// Noise at white, grey levels
    #[arg(long, default_value_t = 1.5, value_name = "LEVELS")]
    noise: f64,
    /// Exponent of the tone curve
    #[arg(long, default_value_t = 2.2)]
    gamma: f64,
    /// JPEG quality
    #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u8).range(1..=100))]
    quality: u8,
}

fn parse_light(name: &str) -> Result<Light, String> {
    Light::from_name(name)
        .ok_or_else(|| format!("one of {}", Light::ALL.map(Light::name).join(", ")))
}

fn parse_side(name: &str) -> Result<SceneSide, String> {
    match name {
        "left" => Ok(SceneSide::Left),
        "right" => Ok(SceneSide::Right),
        _ => Err("left or right".into()),
    }
}

/// Renders frames or images of a board, as the arguments say.
pub fn run(args: &SimulateArgs) -> TaskResult<Completion> {
    args.gusts.check_options()?;
    let scene = create_scene(args)?;
    let mut frames = match args.gusts.seconds {
        Some(seconds) => gusts::gust_frames(args, &scene, seconds),
        None => list_flight_frames(args, &scene),
    };
    let mut specified = with_default_priors(&scene.setup);
    if args.drawn {
        (specified, frames) = sample_aircraft(args.seed, &scene, frames);
    }
    let name = args
        .output
        .file_name()
        .map_or("set".into(), |name| name.to_string_lossy());
    let bar = progress_bar(frames.len(), "rendering");
    watch_signals();
    let go_on = || {
        bar.inc(1);
        !is_stopped()
    };
    let rendered = write_set(&args.output, &name, (&scene, &specified), &frames, go_on)
        .map_err(|e| Failure::Failed(format!("{e:#}")))?;
    bar.finish_and_clear();
    if rendered < frames.len() {
        let (n, folder) = (frames.len(), args.output.display());
        let text = format!("stopped: {rendered} of {n} frames with their truth are in {folder}");
        return Err(Failure::Failed(text));
    }
    print_line(&format!(
        "{} with truth in {}",
        count_text(frames.len(), "frame"),
        args.output.display()
    ))?;
    if let Some(file) = &args.board.board {
        let (folder, count) = (
            args.output.join("board"),
            usize::from(args.board.board_pictures),
        );
        let bar = progress_bar(count, "rendering the board");
        write_board_images(&folder, file, &scene.setup.lens, count, args.seed, || {
            bar.inc(1)
        })?;
        bar.finish_and_clear();
        print_line(&format!(
            "{} of the board in {}",
            count_text(count, "image"),
            folder.display()
        ))?;
    }
    Ok(Completion::All)
}

fn create_scene(args: &SimulateArgs) -> TaskResult<Scene> {
    let highest = args.tip_deflections.iter().copied().fold(0.5, f64::max)
        + args.gusts.max_added_deflection_m();
    let Some(directory) = &args.installation else {
        let options = args.wing.render_options(args.seed, highest);
        check_scene_options(&options)?;
        return Ok(Scene::random(args.seed, &options));
    };
    let Installation {
        setup,
        mut orientation,
        ..
    } = installation::load(directory)?;
    if args.drawn && orientation.is_none() {
        // Planned attitude: only there are targets in the corners of the image visible.
        let options = PlanOptions {
            tip_deflection_m: highest,
            ..PlanOptions::default()
        };
        let planned = plan::assumed_attitude(&setup, None, &options);
        orientation = Some(planned.map_err(|e| Failure::from_path_error(directory, e))?);
    }
    let attitude = orientation.map(|orientation| orientation.camera_from_survey);
    Scene::from_setup(&setup, attitude, args.seed, highest)
        .map_err(|e| Failure::from_path_error(directory, e))
}

fn check_scene_options(options: &SceneOptions) -> TaskResult<()> {
    let wrong = |what: &str| Err(Failure::Usage(what.into()));
    let positive = |x: f64| x.is_finite() && x > 0.0;
    if options.lens.width < 64
        || options.lens.height < 64
        || options.lens.width.max(options.lens.height) > 65_000
    {
        return wrong("--size: give sides between 64 and 65000 px");
    }
    if !positive(options.lens.fx)
        || !positive(options.diameter_m)
        || !positive(options.camera_height_m)
    {
        return wrong("--focal, --diameter and --camera-height must be above 0");
    }
    if !(5.0..=80.0).contains(&options.length_m) {
        return wrong("--length: give 5 to 80 m");
    }
    if !(4..=200).contains(&(options.markers + options.points)) {
        return wrong("--markers: give 4 to 200, points included");
    }
    if !(options.survey_sigma_m >= 0.0 && options.clutter >= 0.0 && options.clutter <= 20.0) {
        return wrong("--survey-sigma must not be negative, --clutter is 0 to 20");
    }
    Ok(())
}

impl WingArgs {
    fn render_options(&self, seed: u64, highest_deflection_m: f64) -> SceneOptions {
        let by_seed = if seed.is_multiple_of(2) {
            SceneSide::Right
        } else {
            SceneSide::Left
        };
        let mut options = SceneOptions::random(seed, self.side.unwrap_or(by_seed));
        options.tip_deflection_m = 1.03 * highest_deflection_m;
        options.length_m = self.length.unwrap_or(options.length_m);
        options.markers = self.markers.unwrap_or(options.markers);
        options.quadrants = self.quadrants.unwrap_or(options.quadrants);
        options.diameter_m = self.diameter.unwrap_or(options.diameter_m);
        options.camera_height_m = self.camera_height.unwrap_or(options.camera_height_m);
        options.survey_sigma_m = self.survey_sigma.unwrap_or(options.survey_sigma_m);
        options.fixed_targets = self.fixed_targets.map_or(0, usize::from);
        options.points = self.points.map_or(0, usize::from);
        options.clutter = self.clutter.unwrap_or(options.clutter);
        let lens = &mut options.lens;
        if let Some([width, height]) = self.size.as_deref() {
            let scale = f64::from(*width) / f64::from(lens.width);
            (lens.fx, lens.fy) = (lens.fx * scale, lens.fy * scale);
            (lens.cx, lens.cy) = (0.5 * f64::from(*width), 0.5 * f64::from(*height));
            (lens.width, lens.height) = (*width, *height);
        }
        if let Some(focal) = self.focal {
            (lens.fx, lens.fy) = (focal, focal * lens.fy / lens.fx);
        }
        if let Some([k1, k2, k3, p1, p2]) = self.distortion.as_deref() {
            (lens.k1, lens.k2, lens.k3, lens.p1, lens.p2) = (*k1, *k2, *k3, *p1, *p2);
        }
        options
    }
}

fn list_flight_frames(args: &SimulateArgs, scene: &Scene) -> Vec<SetFrame> {
    let mut random = SeededRandom::new(args.seed, 20);
    let mount = scene.remount(&mut random);
    let count = args.tip_deflections.len();
    let seed = |i: usize| args.seed.wrapping_mul(1000).wrapping_add(i as u64);
    let mut frames = vec![args.picture.ground_frame(scene, seed(0))];
    for (i, &deflection) in args.tip_deflections.iter().enumerate() {
        let light = args
            .lights
            .get(i % args.lights.len().max(1))
            .copied()
            .unwrap_or(Light::Plain);
        let mut shot = args
            .picture
            .apply_to(scene.flight_shot(deflection, light, seed(i + 1)));
        // Burning fuel changes the load slowly and steadily.
        let progress = i as f64 / count.max(2) as f64 - 0.5;
        shot.state.load.relief += args.shape_change * progress;
        shot.state.load.triangular -= args.shape_change * progress;
        if args.remount.is_some_and(|first| i + 1 >= first) {
            shot.mount = mount;
        }
        shot.hidden = choose_hidden(&mut random, args.hide, scene.markers.len());
        frames.push(args.picture.flight_frame(i + 1, count, shot, None));
    }
    frames
}

impl PictureArgs {
    fn ground_frame(&self, scene: &Scene, seed: u64) -> SetFrame {
        let shot = self.apply_to(scene.ground_shot(seed));
        SetFrame {
            image: "ground.jpg".into(),
            shot,
            quality: self.quality,
            moment: None,
        }
    }

    fn flight_frame(
        &self,
        number: usize,
        count: usize,
        shot: SceneShot,
        moment: Option<FlightMoment>,
    ) -> SetFrame {
        let digits = count.to_string().len();
        SetFrame {
            image: format!("flight-{number:0digits$}.jpg"),
            shot,
            quality: self.quality,
            moment,
        }
    }

    fn apply_to(&self, mut shot: SceneShot) -> SceneShot {
        shot.sensor.blur_px = self.blur.clamp(0.0, 20.0);
        shot.sensor.noise = self.noise.max(0.0);
        // Less light, more gain.
        if shot.light == Light::Dusk {
            shot.sensor.noise *= 2.5;
        }
        shot.sensor.gamma = self.gamma.clamp(0.5, 5.0);
        if let Some([u, v]) = self.motion.as_deref() {
            shot.sensor.motion_px = Vector2::new(u.clamp(-50.0, 50.0), v.clamp(-50.0, 50.0));
        }
        shot
    }
}
