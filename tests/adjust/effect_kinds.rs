//! In-flight effects one by one, and at which sizes they must be covered or detected.

use nalgebra::{Vector2, Vector3};
use rand::Rng;
use rand::rngs::StdRng;

use crate::aircraft::{EffectErrors, combined_effects};
use crate::common::beam_truth::{CameraMotion, Claims, Effects, rms};

/// A kind of effect.
pub struct Kind {
    pub name: &'static str,
    /// Multiple of the named size that the standard deviations must cover; 0: none.
    pub holds: f64,
    /// Multiple of the named size that must be rejected, remarked on, or covered to 2; 0: none.
    pub named: f64,
    /// Sampled with this multiple of the named size.
    pub draw: fn(&mut StdRng, f64) -> Effects,
}

pub const fn kind(name: &'static str, named: f64, draw: fn(&mut StdRng, f64) -> Effects) -> Kind {
    Kind {
        name,
        holds: 1.0,
        named,
        draw,
    }
}

pub fn sign(rng: &mut StdRng) -> f64 {
    if rng.random::<bool>() { 1.0 } else { -1.0 }
}

pub const KINDS: [Kind; 25] = [
    kind("rays bent, 0.1 px rms", 0.0, |r, by| Effects {
        rays: (0.14 * by, r.random::<f64>() * 6.3, r.random::<f64>() * 6.3),
        ..Effects::default()
    }),
    kind("all together", 0.0, |r, _| combined_effects(r)),
    kind("nothing", 0.0, |_, _| Effects::default()),
    kind("bent on ground, 10 mm", 2.0, |r, by| Effects {
        ground_bend_m: 0.010 * by * sign(r),
        ..Effects::default()
    }),
    kind("root turns, 0.2 mrad", 5.0, |r, by| Effects {
        root_rotation_rad: Vector3::z() * (2e-4 * by * sign(r)),
        ..Effects::default()
    }),
    kind("root rises, 1 mm", 3.0, |r, by| Effects {
        root_translation_m: Vector3::y() * (0.001 * by * sign(r)),
        ..Effects::default()
    }),
    kind("root moves out, 1 mm", 3.0, |r, by| Effects {
        root_translation_m: Vector3::x() * (0.001 * by * sign(r)),
        ..Effects::default()
    }),
    kind("skin bulges at the root, 0.5 mm", 6.0, |r, by| Effects {
        bulge_m: 5e-4 * by * sign(r),
        ..Effects::default()
    }),
    kind("skin at each marker, 0.3 mm", 10.0 / 3.0, |_, by| Effects {
        skin_m: 3e-4 * by,
        ..Effects::default()
    }),
    kind("fixed targets rise, 0.5 mm", 4.0, |r, by| Effects {
        fixed_m: Vector3::y() * (5e-4 * by * sign(r)),
        ..Effects::default()
    }),
    kind("fixed targets move each, 0.5 mm", 4.0, |_, by| Effects {
        fixed_each_m: 5e-4 * by,
        ..Effects::default()
    }),
    kind("flight scale, 2e-4", 5.0, |r, by| Effects {
        flight_scale: 2e-4 * by * sign(r),
        ..Effects::default()
    }),
    kind("principal point, 0.3 px", 10.0 / 3.0, |r, by| Effects {
        principal_px: Vector2::new(sign(r), sign(r)) * (0.3 * by),
        ..Effects::default()
    }),
    kind("refraction, 2e-4", 0.0, |_, by| Effects {
        refraction: 2e-4 * by,
        ..Effects::default()
    }),
    kind("bow, 30 m", 3.0, |_, by| Effects {
        bow_per_m: by / 30.0,
        ..Effects::default()
    }),
    kind("in the plane, 20 mm", 0.0, |r, by| Effects {
        in_plane_m: 0.020 * by * sign(r),
        ..Effects::default()
    }),
    Kind {
        holds: 0.0,
        ..kind("aileron, 1 degree", 1.0, |r, by| Effects {
            aileron_rad: 0.0175 * by * sign(r),
            ..Effects::default()
        })
    },
    kind("vibration, 1 cm at 3 Hz, 30 ms", 3.0, |_, by| Effects {
        vibration: (0.01 * by, 3.0),
        readout_s: 0.03,
        ..Effects::default()
    }),
    kind("shake, 0.03 mrad at 15 Hz, 30 ms", 0.0, |_, by| Effects {
        shake: (3e-5 * by, 15.0),
        readout_s: 0.03,
        ..Effects::default()
    }),
    kind("entrance pupil, 10 mm", 2.0, |r, by| Effects {
        pupil_m: 0.010 * by * sign(r),
        ..Effects::default()
    }),
    kind("survey's vertical, 0.1 degree", 5.0, |r, by| Effects {
        tilt_rad: Vector2::new(sign(r), sign(r)) * (0.1f64.to_radians() * by / 2f64.sqrt()),
        ..Effects::default()
    }),
    kind("torque, 1 degree", 2.0, |r, by| Effects {
        torque_rad: 0.0175 * by * sign(r),
        ..Effects::default()
    }),
    kind("step of stiffness, 20 %", 0.0, |r, by| Effects {
        step: 0.2 * by * sign(r),
        ..Effects::default()
    }),
    kind("kink, 1 mrad", 0.0, |r, by| Effects {
        kink_rad: 1e-3 * by * sign(r),
        ..Effects::default()
    }),
    kind("engine, 10 %", 0.0, |_, by| Effects {
        engine: 0.1 * by,
        ..Effects::default()
    }),
];

fn moved(camera: CameraMotion) -> Effects {
    Effects {
        camera,
        ..Effects::default()
    }
}

fn remounted_px(remount_px: f64) -> Effects {
    let claims = Claims {
        repeatability_px: Some(1.0),
        ..Claims::default()
    };
    Effects {
        claims,
        ..moved(CameraMotion {
            remount_px,
            ..CameraMotion::default()
        })
    }
}

/// Cameras that move more than stated, and installations that state too much precision. `stayed`: of a camera that is said to
/// have stayed.
pub const CLAIMS: [Kind; 8] = [
    kind("1 px stated, 1 px", 0.0, |_, by| remounted_px(by)),
    Kind {
        holds: 0.0,
        ..kind("1 px stated, 10 px", 1.0, |_, by| remounted_px(10.0 * by))
    },
    kind("axis stated as exact, 0.1 m off", 2.0, |r, by| {
        let claims = Claims {
            axis_off_m: Some(0.1 * by * sign(r)),
            ..Claims::default()
        };
        Effects {
            claims,
            ..Effects::default()
        }
    }),
    kind("stayed, turned by 0.1 mrad", 2.0, |_, by| {
        moved(CameraMotion {
            turn_rad: 1e-4 * by,
            ..Default::default()
        })
    }),
    Kind {
        holds: 0.0,
        ..kind("stayed, taken down", 1.0, |_, by| {
            moved(CameraMotion {
                remount_px: 10.0 * by,
                remount_m: 0.002 * by,
                ..Default::default()
            })
        })
    },
    kind("remounted 5 mm off", 2.0, |_, by| {
        moved(CameraMotion {
            remount_m: 5e-3 * by,
            ..Default::default()
        })
    }),
    kind("stabilised, 20 px", 2.5, |_, by| {
        moved(CameraMotion {
            stabilised_px: 20.0 * by,
            ..Default::default()
        })
    }),
    kind("mount sags by 0.5 mrad", 2.0, |_, by| {
        moved(CameraMotion {
            sag_rad: 5e-4 * by,
            ..Default::default()
        })
    }),
];

/// Normalised errors of the largest of the three deflections, of twist and of moment.
pub fn figures(shown: &EffectErrors) -> [f64; 3] {
    let deflection = shown
        .deflections
        .iter()
        .map(|deflections| rms(deflections))
        .fold(0.0, f64::max);
    [deflection, rms(&shown.twist), rms(&shown.moments)]
}
