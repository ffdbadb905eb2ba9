//! Settings of the integration, and what it reports.

use crate::error::MapError;
use crate::scan::SigmaMode;
use crate::sensor::SensorModel;
use crate::sensor::table::UpdateLimits;
use serde::{Deserialize, Serialize};

/// How measurements become updates of cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntegrationRule {
    /// One update per cell and scan. For scans that cover surfaces: a point with no others in the
    /// directions around it may fall between the samples of a footprint.
    #[default]
    Fused,
    /// Every measurement updates every cell that its ray crosses.
    Rays,
}

/// Settings of the integration.
#[derive(Clone, Debug, PartialEq)]
pub struct IntegrationConfig {
    /// The rule. Default fused.
    pub rule: IntegrationRule,
    /// The inverse sensor model. Default Thrun's with automatic thickness.
    pub model: SensorModel,
    /// Rays end here, in world units; farther measurements clear the space up to it and mark
    /// nothing. Default 100.
    pub max_range: f64,
    /// Lowest log-odds of one update, negative. Default -0.4, as OctoMap's miss: in the room of
    /// the benchmark better than -0.6 at every resolution. The thesis' P >= 1e-6 is -13.8.
    pub update_min: f32,
    /// Highest log-odds of one update, positive. Default 1.2.
    pub update_max: f32,
    /// Behind the obstacle, evidence smaller than this (log-odds, not negative) is not written.
    /// Default 0.02.
    pub cutoff_log_odds: f32,
    /// How many equal updates bring a cell to the log-odds that the model states, for free and for
    /// occupied; none brings it farther, as measurements share errors. 0: the first one does, and
    /// they add up without end, as if all were independent. Default 0 for both, for range sensors.
    pub updates_to_belief: [u8; 2],
    /// Rule `fused`: how often, beyond once, a measurement of an obstacle counts among those in the
    /// footprint of a coarse cell, 0 to 3. A coarse cell is occupied if anything in it is, and free
    /// only if all of it is; but false measurements gain as well, and noise where cells are not
    /// larger than it. Default 1, for range sensors.
    pub obstacle_weight: u8,
    /// Rule `fused`, automatic thickness: whether the band is as long along each line of sight as
    /// the cells that the surface passes through there, by its slope in the image, instead of a
    /// cell's diagonal. Default false.
    pub band_by_slope: bool,
    /// What the uncertainty of an inverse depth is taken for. Default: propagated to the range.
    pub sigma_mode: SigmaMode,
}

impl Default for IntegrationConfig {
    fn default() -> Self {
        Self {
            rule: IntegrationRule::default(),
            model: SensorModel::default(),
            max_range: 100.0,
            update_min: -0.4,
            update_max: 1.2,
            cutoff_log_odds: 0.02,
            updates_to_belief: [0, 0],
            obstacle_weight: 1,
            band_by_slope: false,
            sigma_mode: SigmaMode::default(),
        }
    }
}

impl IntegrationConfig {
    /// Checks every range documented on the fields.
    ///
    /// # Errors
    /// The first field found outside its range.
    pub fn validate(&self) -> Result<(), MapError> {
        self.model.validate()?;
        // Written so that NaN fails.
        let (max_range, cutoff) = (self.max_range, self.cutoff_log_odds);
        MapError::unless(max_range > 0.0, "max_range", max_range, "positive")?;
        let (min, max) = (self.update_min, self.update_max);
        MapError::unless(min < 0.0, "update_min", min, "negative")?;
        MapError::unless(max > 0.0, "update_max", max, "positive")?;
        let is_allowed = (0.0..=1.0).contains(&cutoff);
        MapError::unless(is_allowed, "cutoff_log_odds", cutoff, "0 to 1")?;
        let weight = self.obstacle_weight;
        MapError::unless(weight <= 3, "obstacle_weight", weight, "0 to 3")
    }

    pub(crate) fn update_limits(&self) -> UpdateLimits {
        UpdateLimits {
            min: f64::from(self.update_min),
            max: f64::from(self.update_max),
            cutoff: f64::from(self.cutoff_log_odds),
            to_belief: self.updates_to_belief,
        }
    }
}

/// What an integration did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IntegrationReport {
    /// Measurements used, those that their neighbours in a depth image stand for included.
    pub points: usize,
    /// Measurements dropped because they were not finite, or had no length or uncertainty.
    pub skipped: usize,
    /// Bricks visited: for `rays`, once per ray that crosses them.
    pub brick_visits: usize,
}

impl IntegrationReport {
    pub(super) fn add(&mut self, other: &Self) {
        self.points += other.points;
        self.skipped += other.skipped;
        self.brick_visits += other.brick_visits;
    }
}
