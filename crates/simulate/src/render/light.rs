//! Light on the wing, and the sky behind it. Radiance 1 saturates the sensor.

use nalgebra::Vector3;

use super::random::{SeededRandom, value_noise};
use super::trace::Hit;
use super::wing::DeformedWing;

/// Kind of illumination in flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Light {
    /// Even light.
    Plain,
    /// Falls off along and across the wing.
    Gradient,
    /// Edges of shadows across the wing.
    Shadow,
    /// Saturating reflection of the sun in the skin.
    Glare,
    /// Low light.
    Dusk,
    /// Sun behind the wing: dark skin, bright sky, stray light.
    Backlight,
    /// Contrast lost with distance.
    Haze,
}

impl Light {
    /// List of the kinds.
    pub const ALL: [Self; 7] = [
        Self::Plain,
        Self::Gradient,
        Self::Shadow,
        Self::Glare,
        Self::Dusk,
        Self::Backlight,
        Self::Haze,
    ];

    /// Returns the word used in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Gradient => "gradient",
            Self::Shadow => "shadow",
            Self::Glare => "glare",
            Self::Dusk => "dusk",
            Self::Backlight => "backlight",
            Self::Haze => "haze",
        }
    }

    /// Returns the kind of that name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|light| light.name() == name)
    }
}

/// Soft bands of shadow.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ShadowBands {
    depth: f64,
    softness: f64,
    along: f64,
    across: f64,
    phase: f64,
    seed: u64,
}

/// Reflection of the sun, stretched along the span as by brushed metal.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Specular {
    gain: f64,
    spread_along: f64,
    spread_across: f64,
}

/// Illumination of one frame.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Illumination {
    exposure: f64,
    ambient: f64,
    sun: Vector3<f64>,
    gradient_s: f64,
    gradient_z: f64,
    bands: Option<ShadowBands>,
    specular: Option<Specular>,
    haze_per_m: f64,
    air_light: f64,
    stray: f64,
    sky: f64,
    cloud_seed: u64,
}

/// Light at one point of the skin.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SkinLight {
    /// Radiance of a reflectance of 1.
    pub diffuse: f64,
    /// Radiance added by reflection, air and stray light.
    pub added: f64,
}

impl Illumination {
    /// Samples the details of a kind of light.
    pub fn random(light: Light, random: &mut SeededRandom, pose: &DeformedWing) -> Self {
        let side = if random.unit() < 0.5 { -1.0 } else { 1.0 };
        let high = Vector3::new(
            random.uniform(-0.4, 0.4),
            1.0,
            side * random.uniform(0.1, 0.5),
        );
        let mut lit = Self {
            exposure: random.uniform(0.80, 1.05),
            ambient: 0.45,
            sun: high.normalize(),
            haze_per_m: 0.0008,
            air_light: 0.5,
            sky: random.uniform(0.40, 0.60),
            cloud_seed: random.bits(),
            ..Self::default()
        };
        match light {
            Light::Plain => {}
            Light::Gradient => {
                lit.gradient_s = side * random.uniform(0.3, 0.55);
                lit.gradient_z = random.uniform(-0.45, 0.45);
            }
            Light::Shadow => lit.bands = Some(ShadowBands::random(random)),
            Light::Glare => lit.mirror_sun(random, pose),
            Light::Dusk => {
                lit.exposure *= random.uniform(0.12, 0.22);
                lit.sky *= 0.22;
                lit.air_light *= 0.2;
                lit.ambient = 0.9;
            }
            Light::Backlight => {
                lit.exposure *= random.uniform(0.30, 0.42);
                lit.ambient = 0.8;
                lit.sky = random.uniform(0.9, 1.3);
                lit.stray = random.uniform(0.04, 0.10);
                lit.specular = Some(Specular {
                    gain: random.uniform(0.08, 0.2),
                    spread_along: 0.5,
                    spread_across: 0.25,
                });
                lit.sun = Vector3::new(1.0, 0.35, side * 0.2).normalize();
            }
            Light::Haze => {
                lit.haze_per_m = random.uniform(0.015, 0.03);
                lit.air_light = random.uniform(0.45, 0.6);
            }
        }
        lit
    }

    /// Puts the sun at a direction that some point of the wing reflects to the camera.
    fn mirror_sun(&mut self, random: &mut SeededRandom, pose: &DeformedWing) {
        let s = random.uniform(0.4, 0.8) * pose.wing.beam.length_m;
        let (low, high) = pose.wing.edges(s);
        let z = random.uniform(0.5 * low, 0.5 * high);
        let view = pose.skin_point(s, z).normalize();
        let (_, _, normal) = pose.tangents(s, z);
        self.sun = view - normal * (2.0 * view.dot(&normal));
        self.ambient = 0.8;
        self.specular = Some(Specular {
            gain: random.uniform(1.0, 2.5),
            spread_along: random.uniform(0.05, 0.3),
            spread_across: random.uniform(0.010, 0.025),
        });
    }

    /// Returns the light at a point of the skin.
    pub fn light_at(&self, pose: &DeformedWing, hit: &Hit) -> SkinLight {
        let point = pose.skin_point(hit.s, hit.z);
        let (along, across, normal) = pose.tangents(hit.s, hit.z);
        let distance = point.norm();
        let shadow = self.bands.map_or(1.0, |bands| bands.light_factor_at(hit));
        let slope =
            self.gradient_s * (2.0 * pose.wing.eta(hit.s) - 1.0) + self.gradient_z * hit.z / 4.0;
        let direct = normal.dot(&self.sun).max(0.0) * shadow;
        // Shadowed points receive less sky light too, as the cloud covers part of the sky.
        let ambient = self.ambient * (0.6 + 0.4 * shadow);
        let diffuse =
            self.exposure * (ambient + (1.0 - self.ambient) * direct) * (1.0 + slope).max(0.15);
        let mirrored = self.specular.map_or(0.0, |specular| {
            let half = (self.sun - point / distance).normalize();
            specular.radiance_at(
                half.dot(&along) / along.norm(),
                half.dot(&across) / across.norm(),
            )
        });
        let clear = (-self.haze_per_m * distance).exp();
        SkinLight {
            diffuse: diffuse * clear,
            added: mirrored * self.exposure * clear + self.air_light * (1.0 - clear) + self.stray,
        }
    }

    /// Returns the radiance of the sky in a direction of the wing frame.
    pub fn sky(&self, direction: &Vector3<f64>) -> f64 {
        let (azimuth, elevation) = (direction.z / direction.x, direction.y / direction.x);
        let coarse = value_noise(azimuth * 9.0, elevation * 16.0, self.cloud_seed);
        let fine = value_noise(azimuth * 23.0, elevation * 41.0, self.cloud_seed ^ 0xAA);
        let cloud = (coarse + 0.4 * fine).max(0.0);
        self.sky * (1.0 - 0.8 * elevation + 0.5 * cloud) + self.stray
    }
}

impl ShadowBands {
    fn random(random: &mut SeededRandom) -> Self {
        let length = random.uniform(3.0, 9.0);
        let angle = random.uniform(0.3, 1.2);
        Self {
            depth: random.uniform(0.45, 0.75),
            softness: random.uniform(0.02, 0.15),
            along: std::f64::consts::TAU * angle.cos() / length,
            across: std::f64::consts::TAU * angle.sin() / length,
            phase: random.uniform(0.0, std::f64::consts::TAU),
            seed: random.bits(),
        }
    }

    fn light_factor_at(&self, hit: &Hit) -> f64 {
        let warp = 1.5 * value_noise(hit.s / 2.0, hit.z / 1.5, self.seed);
        let wave = (self.along * hit.s + self.across * hit.z + self.phase + warp).sin();
        let t = ((wave / self.softness + 1.0) * 0.5).clamp(0.0, 1.0);
        1.0 - self.depth * t * t * (3.0 - 2.0 * t)
    }
}

impl Specular {
    fn radiance_at(&self, along: f64, across: f64) -> f64 {
        let q = (along / self.spread_along).powi(2) + (across / self.spread_across).powi(2);
        self.gain * (-0.5 * q).exp()
    }
}
