//! The quantities, in the order of the tables' columns. To add one, see `docs/recipes.md`.

use super::LiveForm::{Derived, Identity};
use super::ResultTable::{Markers, Moments, Parameters, Shots, Span};
use super::named::{
    CLOCK_SIGMA, EXPOSURE_SIGMA, NUMBER, REASON, SINCE_BOOT, STATUS, UTC, count, flag, number,
    sigma, text, time, tip, words,
};
use super::{QuantitySection, SCHEMA_VERSION, Subject};
use crate::record::variant_name;
use wingd_base::clock::exposure::ExposureSource;
use wingd_measure::adjust::DeflectionReference;
use wingd_measure::estimation::quality::{GlobalTest, SigmaKind};
use wingd_measure::view::SearchMode;
use wingd_store::columns::ValueKind::{F32, F64, U8, U32, U64};

/// All quantities.
pub static SECTIONS: [QuantitySection; 14] = [
    QuantitySection {
        subject: Subject::Row,
        tables: &[Shots, Markers, Span, Moments, Parameters],
        quantities: &[
            text("recorder_id", "random id of the store", |r| {
                r.recorder_id.map(str::to_owned)
            })
            .in_live(Identity),
            text("flight", "flight", |r| r.flight.map(str::to_owned)).in_live(Identity),
            text("result_id", "key of the result", |r| r.result_id()).in_live(Identity),
            text("series", "series of the frame", |r| {
                r.series.map(str::to_owned)
            }),
            count("shot", "number of the shot in the series, from 1", |r| {
                r.shot.map(|shot| shot as usize)
            }),
            text("image", "file name of the frame", |r| {
                r.frame.map(str::to_owned)
            }),
            text("image_sha256", "SHA-256 of the frame", |r| {
                r.frame_sha256.map(str::to_owned)
            }),
            UTC,
            flag(
                "utc_synchronised",
                "whether a service disciplined the clock",
                |r| Some(r.stamp?.utc_synchronised),
            )
            .stored(U8),
            text("boot_id", "boot of the machine", |r| {
                Some(r.stamp?.boot_id.clone())
            })
            .in_live(Identity),
            SINCE_BOOT,
            time("exposure_time", "middle of the [exposure](time.md)", |r| {
                Some(r.exposure?.exposure_time)
            })
            .in_live(Derived),
            EXPOSURE_SIGMA,
            text("exposure_source", "event that determines it", |r| {
                Some(variant_name(r.exposure?.exposure_source))
            })
            .stored_words(|| words(ExposureSource::ALL)),
            CLOCK_SIGMA,
            STATUS,
            REASON,
        ],
    },
    QuantitySection {
        subject: Subject::Row,
        tables: &[],
        quantities: &[
            NUMBER,
            count("skipped", "frames skipped since the start", |r| {
                Some(r.live?.skipped as usize)
            })
            .stored(U64),
            count(
                "full_search",
                "1 if the full frame was searched, 0 if guided",
                |r| Some(usize::from(r.live?.tracked.search == SearchMode::Full)),
            )
            .stored(U8),
            count("mounting", "number of the camera's mounting, from 1", |r| {
                Some(r.live?.tracked.mounting)
            })
            .stored(U32),
            count(
                "mount_disturbed",
                "1 with a [mount disturbance](live.md#results), else 0",
                |r| Some(usize::from(r.live?.tracked.mount_disturbed)),
            )
            .stored(U8),
            number("latency", "ms", "from exposure to result", |r| {
                Some(r.live?.latency_ms)
            })
            .stored(F32),
        ],
    },
    QuantitySection {
        subject: Subject::Row,
        tables: &[Shots, Markers, Span, Moments],
        quantities: &[
            text("method", "`profile`, `spatial`, `live`", |r| {
                r.method
                    .map(str::to_owned)
                    .or_else(|| Some(variant_name(r.image?.method)))
            })
            .in_live(Derived),
            flag(
                "flight_adjustment",
                "whether the flight was adjusted jointly",
                |r| Some(r.image?.flight),
            )
            .in_live(Derived),
            number("variance_factor", "", "a-posteriori variance factor", |r| {
                r.image?.variance_factor
            })
            .stored(F32),
            count("redundancy", "conditions minus parameters", |r| {
                r.image?.redundancy
            })
            .stored(U32),
            text("global_test", "`passed` or `rejected`", |r| {
                r.image?.global_test.map(variant_name)
            })
            .stored_as("global_test_passed", U8, || {
                words([GlobalTest::Rejected, GlobalTest::Passed])
            }),
            text(
                "sigma_kind",
                "standard deviations `prior` or `posterior`",
                |r| r.image?.sigma_kind.map(variant_name),
            )
            .stored_words(|| words([SigmaKind::Prior, SigmaKind::Posterior])),
        ],
    },
    QuantitySection {
        subject: Subject::Row,
        tables: &[Shots, Markers],
        quantities: &[
            text("cad_global_test", "test of the CAD tie points", |r| {
                r.image?.quality.cad.as_ref()?.global_test.map(variant_name)
            }),
            text("tip_marker", "outermost marker", |r| {
                Some(tip(r)?.marker.clone())
            })
            .in_live(Derived),
            flag(
                "tip_predicted",
                "whether the adjusted shape predicts it",
                |r| Some(tip(r)?.predicted),
            ),
            number(
                "tip_deflection",
                "m",
                "its deflection against the survey",
                |r| Some(tip(r)?.deflection_m),
            )
            .stored(F32),
            sigma("tip_sigma_deflection", "m", |r| tip(r)?.sigma_deflection_m).stored_as(
                "sigma_tip_deflection",
                F32,
                Vec::new,
            ),
            number(
                "tip_deflection_ground",
                "m",
                "against the ground frame",
                |r| tip(r)?.deflection_ground_m,
            )
            .stored(F32),
            sigma("tip_sigma_deflection_ground", "m", |r| {
                tip(r)?.sigma_deflection_ground_m
            })
            .stored_as("sigma_tip_deflection_ground", F32, Vec::new),
            number("tip_deflection_root", "m", "from the root's tangent", |r| {
                tip(r)?.deflection_root_m
            })
            .stored(F32),
            sigma("tip_sigma_deflection_root", "m", |r| {
                tip(r)?.sigma_deflection_root_m
            })
            .stored_as("sigma_tip_deflection_root", F32, Vec::new),
            text(
                "tip_reference",
                "reference with the smallest standard deviation",
                |r| tip(r)?.reference.map(variant_name),
            )
            .stored_words(|| words(DeflectionReference::ALL)),
        ],
    },
    QuantitySection {
        subject: Subject::Pair,
        tables: &[Markers],
        quantities: &[
            number("angle", "deg", "change of the angle of attack", |r| {
                r.pair()?.angle_deg
            })
            .stored(F32),
            sigma("sigma_angle", "deg", |r| r.pair()?.sigma_deg).stored(F32),
            number(
                "twist",
                "deg",
                "twist of the section, without bending",
                |r| r.pair()?.twist_deg,
            )
            .stored(F32),
            sigma("sigma_twist", "deg", |r| r.pair()?.sigma_twist_deg).stored(F32),
            number(
                "slope",
                "deg",
                "change of the slope along the span, tip up",
                |r| r.pair()?.incidence.slope_deg,
            )
            .stored(F32),
            sigma("sigma_slope", "deg", |r| {
                r.pair()?.incidence.sigma_slope_deg
            })
            .stored(F32),
            number(
                "streamwise_twist",
                "deg",
                "change of the incidence along the flow, nose up",
                |r| r.pair()?.incidence.streamwise_twist_deg,
            )
            .stored(F32),
            sigma("sigma_streamwise_twist", "deg", |r| {
                r.pair()?.incidence.sigma_streamwise_twist_deg
            })
            .stored(F32),
        ],
    },
    QuantitySection {
        subject: Subject::Marker,
        tables: &[Markers],
        quantities: &[
            text("marker", "id of the marker", |r| {
                Some(r.marker()?.id.clone())
            }),
            text("shape", "kind of marker", |r| {
                Some(r.marker()?.shape.name().to_owned())
            }),
            flag("used", "whether it took part in the adjustment", |r| {
                Some(r.marker()?.used)
            }),
            count("used", "1 if it took part in the adjustment, else 0", |r| {
                Some(usize::from(r.marker()?.used))
            })
            .stored(U8)
            .only_live(),
            text("marker_reason", "why it did not, a sentence", |r| {
                r.marker()?.reason.clone()
            }),
            number("u", "px", "image of the centre", |r| r.marker()?.u_px).stored(F32),
            number("v", "px", "", |r| r.marker()?.v_px).stored(F32),
            sigma("sigma_u", "px", |r| r.marker()?.sigma_u_px).stored(F32),
            sigma("sigma_v", "px", |r| r.marker()?.sigma_v_px).stored(F32),
            number("residual_u", "px", "adjusted minus observed", |r| {
                r.marker()?.residual_u_px
            })
            .stored(F32),
            number("residual_v", "px", "", |r| r.marker()?.residual_v_px).stored(F32),
            number("redundancy_u", "", "redundancy numbers, 0 to 1", |r| {
                r.marker()?.redundancy_u
            }),
            number("redundancy_v", "", "", |r| r.marker()?.redundancy_v),
            number("w_test", "", "statistic of the w-test", |r| {
                r.marker()?.w_test
            }),
            number("mdb_u", "px", "minimal detectable biases", |r| {
                r.marker()?.mdb_u_px
            }),
            number("mdb_v", "px", "", |r| r.marker()?.mdb_v_px),
            number(
                "distance",
                "m",
                "distance from the projection centre",
                |r| r.marker()?.distance_m,
            ),
            sigma("sigma_distance", "m", |r| r.marker()?.sigma_distance_m),
            number("deflection", "m", "against the survey", |r| {
                r.marker()?.deflection_m
            })
            .stored(F32),
            sigma("sigma_deflection", "m", |r| r.marker()?.sigma_deflection_m).stored(F32),
            number("deflection_ground", "m", "against the ground frame", |r| {
                r.marker()?.deflection_ground_m
            })
            .stored(F32),
            sigma("sigma_deflection_ground", "m", |r| {
                r.marker()?.sigma_deflection_ground_m
            })
            .stored(F32),
            number("deflection_root", "m", "from the root's tangent", |r| {
                r.marker()?.deflection_root_m
            })
            .stored(F32),
            sigma("sigma_deflection_root", "m", |r| {
                r.marker()?.sigma_deflection_root_m
            })
            .stored(F32),
            number("position_x", "m", "position in flight, survey frame", |r| {
                Some(r.marker()?.position_m?[0])
            }),
            number("position_y", "m", "", |r| Some(r.marker()?.position_m?[1])),
            number("position_z", "m", "", |r| Some(r.marker()?.position_m?[2])),
            sigma("sigma_position_x", "m", |r| {
                Some(r.marker()?.sigma_position_m?[0])
            }),
            sigma("sigma_position_y", "m", |r| {
                Some(r.marker()?.sigma_position_m?[1])
            }),
            sigma("sigma_position_z", "m", |r| {
                Some(r.marker()?.sigma_position_m?[2])
            }),
            number("position_cad_x", "m", "CAD frame, with `[cad]`", |r| {
                Some(r.marker()?.position_cad_m?[0])
            }),
            number("position_cad_y", "m", "", |r| {
                Some(r.marker()?.position_cad_m?[1])
            }),
            number("position_cad_z", "m", "", |r| {
                Some(r.marker()?.position_cad_m?[2])
            }),
            sigma("sigma_position_cad_x", "m", |r| {
                Some(r.marker()?.sigma_position_cad_m?[0])
            }),
            sigma("sigma_position_cad_y", "m", |r| {
                Some(r.marker()?.sigma_position_cad_m?[1])
            }),
            sigma("sigma_position_cad_z", "m", |r| {
                Some(r.marker()?.sigma_position_cad_m?[2])
            }),
        ],
    },
    QuantitySection {
        subject: Subject::Station,
        tables: &[Span],
        quantities: &[
            number("arc_length", "m", "arc length from the bending root", |r| {
                Some(r.station()?.arc_length_m)
            }),
            number("span", "m", "coordinate of the wing frame in flight", |r| {
                Some(r.station()?.span_m)
            })
            .stored(F32),
            number("deflection", "m", "deflection of the bending axis", |r| {
                Some(r.station()?.deflection_m)
            })
            .stored(F32),
            sigma("sigma_deflection", "m", |r| r.station()?.sigma_deflection_m).stored(F32),
            number("twist", "deg", "twist of the section", |r| {
                r.station()?.twist_deg
            })
            .stored(F32),
            sigma("sigma_twist", "deg", |r| r.station()?.sigma_twist_deg).stored(F32),
            number("slope", "deg", "change of the slope, tip up", |r| {
                r.station()?.incidence.slope_deg
            }),
            sigma("sigma_slope", "deg", |r| {
                r.station()?.incidence.sigma_slope_deg
            }),
            number(
                "streamwise_twist",
                "deg",
                "change of the incidence along the flow",
                |r| r.station()?.incidence.streamwise_twist_deg,
            ),
            sigma("sigma_streamwise_twist", "deg", |r| {
                r.station()?.incidence.sigma_streamwise_twist_deg
            }),
        ],
    },
    QuantitySection {
        subject: Subject::Section,
        tables: &[Moments],
        quantities: &[
            number("arc_length", "m", "arc length from the bending root", |r| {
                Some(r.section()?.arc_length_m)
            }),
            number(
                "bending_moment",
                "nm",
                "N m, change relative to the ground, tip up",
                |r| r.section()?.bending_moment_nm,
            )
            .stored(F32),
            sigma("sigma_bending_moment", "nm", |r| {
                r.section()?.sigma_bending_moment_nm
            })
            .stored(F32),
            number(
                "sigma_stiffness",
                "nm",
                "part of the stiffness, common to all frames",
                |r| r.section()?.sigma_stiffness_nm,
            )
            .stored(F32),
        ],
    },
    QuantitySection {
        subject: Subject::Row,
        tables: &[Parameters],
        quantities: &[
            text("parameter", "name of the parameter", |r| {
                Some(r.parameter?.name.clone())
            }),
            count("index", "place in a list, from 1", |r| {
                Some(r.parameter?.index? + 1)
            }),
            number("value", "", "value in the unit of the name", |r| {
                Some(r.parameter?.estimate?.value)
            }),
            sigma("sigma", "", |r| r.parameter?.estimate?.sigma),
        ],
    },
    QuantitySection {
        subject: Subject::CurvatureTerm,
        tables: &[],
        quantities: &[
            number("curvature", "1/m", "coefficients of the curvature", |r| {
                r.curvature?.per_m.get(r.index?).copied()
            })
            .stored(F64),
        ],
    },
    QuantitySection {
        subject: Subject::CurvatureTermPair,
        tables: &[],
        quantities: &[number(
            "curvature_covariance",
            "1/m2",
            "upper triangle of their covariance, row by row",
            |r| r.curvature?.covariance.get(r.index?).copied(),
        )
        .stored(F64)],
    },
    QuantitySection {
        subject: Subject::Aircraft,
        tables: &[Shots, Markers, Span, Moments],
        quantities: &[
            number(
                "",
                "",
                "[aircraft data](aircraft-data.md) at the exposure",
                |r| Some(r.joined()?.value),
            )
            .in_live(Derived),
            sigma("sigma_", "", |r| Some(r.joined()?.sigma)).in_live(Derived),
        ],
    },
    QuantitySection {
        subject: Subject::Row,
        tables: &[Shots],
        quantities: &[
            count("failed_attempts", "failed attempts of the camera", |r| {
                r.shot.map(|_| r.failures.len())
            }),
            text("camera_failures", "their reasons", |r| {
                Some(r.failures.join("; ")).filter(|text| !text.is_empty())
            }),
        ],
    },
    QuantitySection {
        subject: Subject::Row,
        tables: &[Shots, Markers, Span, Moments, Parameters],
        quantities: &[
            text("program", "name and version of the program", |r| {
                r.inputs?.program.clone()
            })
            .in_live(Derived),
            text(
                "installation_sha256",
                "folder below `installations/` of the store",
                |r| r.inputs?.installation_sha256.clone(),
            )
            .in_live(Derived),
            text("parameters", "options of the adjustment as JSON", |r| {
                r.inputs?.parameters.clone()
            })
            .in_live(Derived),
            text("inputs", "SHA-256 over all inputs", |r| {
                r.inputs?.key.clone()
            })
            .in_live(Derived),
            count("schema_version", "version of this schema", |_| {
                Some(SCHEMA_VERSION)
            })
            .in_live(Derived),
        ],
    },
];
