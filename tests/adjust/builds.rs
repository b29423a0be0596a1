//! Wings and roots that are built otherwise than a straight, tapered wing clamped at its root, and at which sizes they must be covered
//! or detected.

use crate::common::beam_truth::{Claims, Effects, Structure, normal};
use crate::effect_kinds::{Kind, kind, sign};

fn built(structure: Structure) -> Effects {
    Effects {
        structure,
        ..Effects::default()
    }
}

/// Wings and roots that are built otherwise than a straight, tapered wing clamped at its root.
pub const BUILDS: [Kind; 14] = [
    kind("plain", 0.0, |_, _| Effects::default()),
    kind("gull, 4 degrees at the engine", 2.0, |r, by| {
        built(Structure {
            dihedral_break: (0.33, 0.07 * by * sign(r)),
            ..Structure::default()
        })
    }),
    kind("sweep breaks by 4 degrees", 2.0, |r, by| {
        built(Structure {
            plan_break: (0.35, 0.07 * by * sign(r)),
            ..Structure::default()
        })
    }),
    kind("stated sweep, breaks by 4 degrees", 2.0, |r, by| Effects {
        claims: Claims {
            sweep_off_rad: Some(0.0175 * normal(r)),
            ..Claims::default()
        },
        ..built(Structure {
            plan_break: (0.35, 0.07 * by * sign(r)),
            ..Structure::default()
        })
    }),
    kind("chord and stiffness break by 30 %", 2.0, |_, by| {
        built(Structure {
            chord_break: (0.35, 0.3 * by),
            ..Structure::default()
        })
    }),
    kind("winglet, 60 degrees", 1.4, |_, by| {
        built(Structure {
            winglet_rad: 60f64.to_radians() * by,
            ..Structure::default()
        })
    }),
    kind("12 m, camera ahead", 0.0, |_, _| {
        built(Structure {
            ahead_m: 6.0,
            ..Structure::of_length(12.0)
        })
    }),
    kind("model of 3 m", 0.0, |_, _| built(Structure::of_length(3.0))),
    kind("twisted on ground, 0.2 degrees", 2.5, |r, by| Effects {
        ground_twist_rad: 0.2f64.to_radians() * by * sign(r),
        ..Effects::default()
    }),
    kind("bends inboard of the root, 0.5 m", 2.0, |_, by| Effects {
        inboard_m: 0.5 * by,
        ..Effects::default()
    }),
    kind("root gives by 3 mrad, pivot 3 m out", 2.0, |_, by| {
        Effects {
            root_gives: (0.003 * by, 3.0),
            ..Effects::default()
        }
    }),
    kind("root gives by 3 mrad, pivot 3 m in", 2.0, |_, by| Effects {
        root_gives: (0.003 * by, -3.0),
        ..Effects::default()
    }),
    kind("root stated 0.6 m too far out", 5.0 / 3.0, |_, by| {
        Effects {
            root_error_m: 0.6 * by,
            ..Effects::default()
        }
    }),
    kind("joint at 80 % gives by 5 mrad", 2.0, |_, by| Effects {
        joint_rad: 0.005 * by,
        ..Effects::default()
    }),
];
