//! Settings of mapping, as they stand in the section `[mapping]` of a configuration file.

use monogrid_depth::DenseConfig;
use monogrid_occupancy::{
    AndertForm, Buffer, IntegrationRule, MapConfig, SensorModel, SigmaMode, Significance, ThrunForm,
};
use monogrid_slam::ConfigError;
use monogrid_slam::settings::{SettingValue, other};
use serde::{Deserialize, Serialize};
use toml::Value;

/// Significance k of the model `andert` where it is automatic, cells.
const AUTO_SIGNIFICANCE_CELLS: f64 = 1.0;

/// Inverse sensor models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SensorModelKind {
    /// The ideal model convolved with the Gaussian of the range.
    Thrun,
    /// Andert's model.
    Andert,
    /// Free before the band, occupied inside it.
    Ideal,
    /// End points only, no free space: the thesis' "unprocessed map".
    None,
}

/// How much is done for the depth of final maps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapQuality {
    /// The depth of the filter as it is.
    Raw,
    /// The depth of the filter, refined at the final poses, each depth fused with those of other
    /// keyframes that agree.
    Fast,
    /// Dense depth in place of the refinement, and large planes beyond what was measured: more of
    /// the surfaces and of the free space, for four times the work.
    #[serde(alias = "dense")]
    Default,
    /// The same with finer planes and more keyframes beside each: still more of the surfaces, for
    /// twice the work of `default`.
    Best,
}

/// How many others the depth of a keyframe is compared with, and how finely.
#[derive(Clone, Debug)]
pub(crate) struct Effort {
    /// Keyframes that its image is matched with.
    pub max_sources: usize,
    /// Keyframes whose dense depth must confirm its own.
    pub max_confirming: usize,
    /// Keyframes that its depth is fused with.
    pub max_covisible: usize,
    pub stereo: DenseConfig,
}

impl MapQuality {
    /// Whether keyframes get dense depth.
    #[must_use]
    pub fn has_dense_depth(self) -> bool {
        matches!(self, Self::Default | Self::Best)
    }

    /// In five recordings more of the surfaces was found by all of `best` together
    /// (docs/decisions/015-dense-depth.md); single parts took some away.
    pub(crate) fn effort(self) -> Effort {
        let mut stereo = DenseConfig::default();
        if self == Self::Best {
            (stereo.max_planes, stereo.step_px) = (160, 0.5);
        }
        let [max_sources, max_confirming, max_covisible] = match self {
            Self::Best => [6, 16, 32],
            _ => [4, 8, 16],
        };
        Effort {
            max_sources,
            max_confirming,
            max_covisible,
            stereo,
        }
    }
}

/// A length, or chosen from the data. In files: a number or `"auto"`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AutoLength {
    /// From the resolution and the uncertainty of each measurement.
    Auto,
    /// Map units.
    Fixed(f64),
}

impl SettingValue for AutoLength {
    fn to_value(&self) -> Value {
        match self {
            Self::Auto => Value::String("auto".to_owned()),
            Self::Fixed(length) => length.to_value(),
        }
    }

    fn of_value(value: &Value) -> Result<Self, String> {
        if value.as_str() == Some("auto") {
            return Ok(Self::Auto);
        }
        let length = f64::of_value(value).map(Self::Fixed);
        length.map_err(|_| other(value, "a number or \"auto\""))
    }
}

/// Which measurements of a keyframe are mapped.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthFilterConfig {
    /// Largest relative standard deviation of the inverse depth; `inf` keeps all. Where keyframes
    /// tell how certain depth is, and less than half of it is as certain, that of half of it.
    /// Measured: a measurement beyond it smears its surface along the ray (in the demo world 3.6
    /// times the true number of occupied cells at 0.1, 1.4 times at 0.035).
    pub max_relative_sigma: f64,
    /// First keyframes that are not mapped (a random start needs some to converge).
    pub skip_keyframes: usize,
}

impl Default for DepthFilterConfig {
    fn default() -> Self {
        Self {
            max_relative_sigma: 0.035,
            skip_keyframes: 0,
        }
    }
}

/// Dense depth (quality `default`).
#[derive(Clone, Debug, PartialEq)]
pub struct DenseMappingConfig {
    /// Whether maps that are read while they grow get it too, a few keyframes later.
    pub live: bool,
}

impl Default for DenseMappingConfig {
    fn default() -> Self {
        Self { live: true }
    }
}

/// How plain surfaces get depth from the depth around them.
#[derive(Clone, Debug, PartialEq)]
pub struct FillConfig {
    /// Whether plain regions are filled.
    pub enabled: bool,
}

impl Default for FillConfig {
    fn default() -> Self {
        Self { enabled: true }
    }
}

/// Depth on large planes, and these planes beyond what was measured of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanesConfig {
    /// Large planes around each keyframe in final maps, at most; 0: none.
    pub max_count: usize,
}

impl Default for PlanesConfig {
    fn default() -> Self {
        Self { max_count: 12 }
    }
}

/// Settings of [`crate::mapping`].
///
/// Lengths are in map units: metres where the scale is known.
#[derive(Clone, Debug, PartialEq)]
pub struct MappingConfig {
    /// How much is done for the depth of final maps.
    pub quality: MapQuality,
    /// Edge of a cell.
    pub resolution: f64,
    /// Whether the final maps of a run of arbitrary scale have cells that follow from the scene: a
    /// fiftieth of the median depth, or as fine as the depth is precise, or as many as can be paid
    /// for. Default true, and false where `resolution` is given.
    pub auto_resolution: bool,
    /// Inverse sensor model.
    pub sensor_model: SensorModelKind,
    /// Thickness L of the occupied band of `ideal` and `thrun`, or `"auto"`: the larger of the way
    /// through the cells of the surface (by rule `fused` as many as the slope of the surface needs,
    /// else a cell's diagonal) and `buffer_sigmas` standard deviations.
    pub buffer: AutoLength,
    /// Thickness in standard deviations where `buffer` is automatic (below 0.861, a hit is evidence
    /// against the obstacle). Default 1.7; docs/sensor-parameters.md derives it.
    pub buffer_sigmas: f64,
    /// Form of the model `thrun`.
    pub thrun_form: ThrunForm,
    /// Significance k of the model `andert`, or `"auto"`: one cell.
    pub significance: AutoLength,
    /// Probability of free space in the model `andert`. Default 0.3, the thesis'.
    pub andert_p_min: f64,
    /// Form of the model `andert`.
    pub andert_form: AndertForm,
    /// How measurements are combined.
    pub integration: IntegrationRule,
    /// Limits of one update, log-odds, [-100, -0.000001] and [0.000001, 100]: a single ray must not
    /// decide. Default -0.4 and 1.2: a cell is occupied if a surface touches any part of it, so
    /// what passes through the rest says little (docs/sensor-parameters.md).
    pub update_limits: [f64; 2],
    /// How many equal updates bring a cell to what the sensor model says of it, for free and for
    /// occupied; none brings it farther, since keyframes share their errors. 0: the first one does,
    /// and they add up without end, as if all were independent, and so they do with `andert`.
    /// Default 15 and 3 (docs/sensor-parameters.md).
    pub updates_to_belief: [u8; 2],
    /// Where the model states less than these log-odds behind the obstacle, the ray ends. The
    /// models stay above 1/2 far behind it: 0.02 makes walls 4.8 sigma thick, 0.4 makes them 3.3.
    /// Default 0.8: against 0.6, a quarter fewer cells are occupied behind walls, where no ray ever
    /// clears them, and 1 % less of the surfaces is observed.
    pub tail_log_odds: f64,
    /// Lowest and highest stored log-odds, [-7.99, -0.001] and [0.001, 7.99]. Default -4 and 3.5;
    /// OctoMap's are -2 and 3.5, but what many keyframes see through is free in 99 of 100 cells.
    pub clamp: [f32; 2],
    /// Cells at least this likely are occupied.
    pub occupancy_threshold: f64,
    /// Measurements farther away are ignored.
    pub max_range: f64,
    /// Radius of the local map around the camera.
    pub local_radius: f64,
    /// While a run goes on, the global map follows keyframes of which some measurement moved by at
    /// least this many cells. The final maps have all poses exactly.
    pub follow_threshold: f64,
    /// What is taken as the standard deviation of a range.
    pub sigma_mode: SigmaMode,
    /// Standard deviation of a keyframe's position relative to its neighbours.
    pub pose_sigma: f64,
    /// Standard deviation of a keyframe's rotation relative to its neighbours, degrees.
    pub pose_sigma_deg: f64,
    /// What lies within this distance of the path of the camera is free in the final maps: it was
    /// there itself. 0: nothing is; `"auto"`: one cell.
    pub body_radius: AutoLength,
    /// Standard deviation of the depth in given depth images over the depth.
    pub depth_image_sigma: f64,
    /// Memory that a map and what prepares it may take, GB (10^9 bytes).
    pub max_memory_gb: f64,
    /// Which measurements are mapped.
    pub filter: DepthFilterConfig,
    /// Dense depth.
    pub dense: DenseMappingConfig,
    /// Depth of plain surfaces.
    pub fill: FillConfig,
    /// Depth on large planes, and these planes beyond what was measured of them.
    pub planes: PlanesConfig,
    /// The surface as triangles.
    pub mesh: MeshConfig,
}

/// The surface between occupied and free cells as a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MeshConfig {
    /// Whether a run writes it.
    pub enabled: bool,
    /// Pieces of the surface with fewer faces of cells are left out: most are false measurements.
    pub min_faces: usize,
}

impl Default for MeshConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_faces: 60,
        }
    }
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            quality: MapQuality::Default,
            resolution: 0.05,
            auto_resolution: true,
            sensor_model: SensorModelKind::Thrun,
            buffer: AutoLength::Auto,
            buffer_sigmas: 1.7,
            thrun_form: ThrunForm::Exact,
            significance: AutoLength::Auto,
            andert_p_min: 0.3,
            andert_form: AndertForm::Monocular,
            integration: IntegrationRule::Fused,
            update_limits: [-0.4, 1.2],
            updates_to_belief: [15, 3],
            tail_log_odds: 0.8,
            clamp: [-4.0, 3.5],
            occupancy_threshold: 0.5,
            max_range: 10.0,
            local_radius: 3.0,
            follow_threshold: 1.0,
            sigma_mode: SigmaMode::Range,
            pose_sigma: 0.01,
            pose_sigma_deg: 0.1,
            body_radius: AutoLength::Auto,
            depth_image_sigma: 0.01,
            max_memory_gb: 1.5,
            filter: DepthFilterConfig::default(),
            dense: DenseMappingConfig::default(),
            fill: FillConfig::default(),
            planes: PlanesConfig::default(),
            mesh: MeshConfig::default(),
        }
    }
}

impl MappingConfig {
    /// The thesis' rules: fixed L and k (the values it found best), its closed form, updates
    /// limited only to P in [1e-6, 1 - 1e-6], every measurement mapped, no uncertainty of the pose.
    #[must_use]
    pub fn thesis() -> Self {
        let certain = (1e-6f64 / (1.0 - 1e-6)).ln();
        Self {
            quality: MapQuality::Raw,
            auto_resolution: false,
            buffer: AutoLength::Fixed(0.5),
            thrun_form: ThrunForm::Thesis,
            significance: AutoLength::Fixed(0.02),
            integration: IntegrationRule::Rays,
            update_limits: [certain, -certain],
            updates_to_belief: [0, 0],
            clamp: [-2.0, 3.5],
            tail_log_odds: 0.02,
            // The thesis names no limit; but points of a random start lie at any distance, and
            // their free rays would fill the memory. The median depth is 1 there.
            max_range: 20.0,
            pose_sigma: 0.0,
            pose_sigma_deg: 0.0,
            body_radius: AutoLength::Fixed(0.0),
            filter: DepthFilterConfig {
                max_relative_sigma: f64::INFINITY,
                skip_keyframes: 0,
            },
            fill: FillConfig { enabled: false },
            planes: PlanesConfig { max_count: 0 },
            ..Self::default()
        }
    }

    /// Checks the ranges documented on the fields.
    ///
    /// # Errors
    /// The first setting outside its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        crate::settings::MAPPING.check(self)
    }

    /// The settings of the map itself.
    #[must_use]
    pub fn map_config(&self) -> MapConfig {
        MapConfig {
            resolution: self.resolution,
            clamp_min: self.clamp[0],
            clamp_max: self.clamp[1],
            occupancy_threshold: self.occupancy_threshold,
            memory_budget_bytes: (self.max_memory_gb * 1e9) as usize,
        }
    }

    /// The inverse sensor model at this resolution.
    #[must_use]
    pub fn sensor(&self) -> SensorModel {
        let buffer = match self.buffer {
            AutoLength::Fixed(length) => Buffer::Fixed(length),
            AutoLength::Auto => Buffer::Auto {
                sigmas: self.buffer_sigmas,
                min: 0.0,
            },
        };
        let model = match self.sensor_model {
            SensorModelKind::None => SensorModel::None,
            SensorModelKind::Ideal => SensorModel::Ideal { buffer },
            SensorModelKind::Thrun => SensorModel::Thrun {
                buffer,
                form: self.thrun_form,
            },
            SensorModelKind::Andert => SensorModel::Andert {
                significance: match self.significance {
                    AutoLength::Fixed(value) => Significance::Fixed(value),
                    AutoLength::Auto => Significance::Auto {
                        gain: AUTO_SIGNIFICANCE_CELLS,
                        cell: self.resolution,
                    },
                },
                p_min: self.andert_p_min,
                form: self.andert_form,
            },
        };
        model.at_resolution(self.resolution)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_profiles_are_valid_and_differ_in_every_rule_of_the_thesis() {
        let (default, thesis) = (MappingConfig::default(), MappingConfig::thesis());
        default.validate().unwrap();
        thesis.validate().unwrap();
        assert_ne!(default.buffer, thesis.buffer);
        assert_ne!(default.thrun_form, thesis.thrun_form);
        assert_ne!(default.update_limits, thesis.update_limits);
        assert_ne!(default.filter, thesis.filter);
        assert_ne!(default.integration, thesis.integration);
        assert_ne!(default.quality, thesis.quality);
        assert!(thesis.pose_sigma <= 0.0 && thesis.pose_sigma_deg <= 0.0);
    }

    #[test]
    fn best_compares_with_more_and_more_finely() {
        let [fast, default, best] =
            [MapQuality::Fast, MapQuality::Default, MapQuality::Best].map(MapQuality::effort);
        assert_eq!(fast.max_covisible, default.max_covisible);
        assert!(best.max_sources > default.max_sources);
        assert!(best.max_confirming > default.max_confirming);
        assert!(best.max_covisible > default.max_covisible);
        assert!(best.stereo.max_planes > default.stereo.max_planes);
        assert!(best.stereo.step_px < default.stereo.step_px);
    }

    #[test]
    fn values_outside_their_range_are_named() {
        let mut config = MappingConfig {
            resolution: f64::NAN,
            ..MappingConfig::default()
        };
        assert_eq!(config.validate().unwrap_err().name, "mapping.resolution");
        config.resolution = 0.1;
        config.buffer = AutoLength::Fixed(-1.0);
        assert_eq!(config.validate().unwrap_err().name, "mapping.buffer");
        config.buffer = AutoLength::Auto;
        config.filter.max_relative_sigma = 0.0;
        let name = config.validate().unwrap_err().name;
        assert_eq!(name, "mapping.filter.max_relative_sigma");
        config.filter.max_relative_sigma = 0.1;
        config.update_limits = [0.1, 1.0];
        assert_eq!(config.validate().unwrap_err().name, "mapping.update_limits");
    }
}
