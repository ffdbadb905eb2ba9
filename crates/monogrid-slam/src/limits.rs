//! The ranges of all settings, one row per number, as they stand in the documentation of the fields.

use crate::mapping::{AutoLength, MappingConfig};
use crate::{ConfigError, SlamConfig};
use monogrid_alignment::Robust;
use monogrid_depth::ConfigError as DepthConfigError;

/// A setting, and the smallest and the largest value that it may have.
struct Limit<C> {
    /// Dotted, as in a configuration file.
    name: &'static str,
    value: fn(&C) -> f64,
    low: f64,
    high: f64,
}

/// A number as it was written: 0.1 in single precision is 0.1.
fn decimal(number: impl ToString) -> f64 {
    number.to_string().parse().unwrap_or(f64::NAN)
}

/// Rows `field: smallest, largest;` of sections: the name of a row is that of the field, so that none can be
/// confused.
macro_rules! limits {
    ($config:ident: $type:ty, $($section:expr => { $($field:ident: $low:expr, $high:expr;)* })*) => {
        &[$($(Limit {
            name: concat!(stringify!($section), ".", stringify!($field)),
            value: |$config: &$type| decimal($section.$field),
            low: $low,
            high: $high,
        }),*),*]
    };
}

/// Fails where a value is not in its range; NaN is in none.
fn within(name: &str, value: impl ToString, low: f64, high: f64) -> Result<(), ConfigError> {
    let value = decimal(value);
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ConfigError {
        name: name.to_owned(),
        value,
        allowed: format!("{low} to {high}"),
    })
}

fn all_within<C>(config: &C, limits: &[Limit<C>]) -> Result<(), ConfigError> {
    let mut limits = limits.iter();
    limits.try_for_each(|l| within(l.name, (l.value)(config), l.low, l.high))
}

/// What the depth filter says of its own settings, which stand in this section.
fn of_depth(section: &str, checked: Result<(), DepthConfigError>) -> Result<(), ConfigError> {
    checked.map_err(|error| ConfigError {
        name: format!("{section}.{}", error.name),
        value: error.value,
        allowed: format!("{} to {}", error.min, error.max),
    })
}

/// Checks the ranges of all settings of tracking and depth.
pub(crate) fn check_slam(slam: &SlamConfig) -> Result<(), ConfigError> {
    all_within(slam, SLAM)?;
    let (t, s) = (&slam.tracking.alignment, &slam.graph.similarity);
    let levels = "slam.tracking.alignment.max_iterations";
    within(levels, t.max_iterations.len(), 1.0, 9.0)?;
    for iterations in &t.max_iterations {
        within(levels, iterations, 0.0, 1000.0)?;
    }
    of_robust("slam.tracking.alignment.robust", &t.robust)?;
    of_robust("slam.graph.similarity.robust", &s.robust)?;
    of_depth("slam.depth", slam.depth.validate())?;
    for (section, finest, coarsest) in [
        ("slam.tracking.alignment", t.finest_level, t.coarsest_level),
        ("slam.graph.similarity", s.finest_level, s.coarsest_level),
    ] {
        if finest > coarsest {
            return Err(ConfigError {
                name: format!("{section}.coarsest_level"),
                value: coarsest as f64,
                allowed: format!("at least finest_level ({finest})"),
            });
        }
    }
    Ok(())
}

fn of_robust(name: &str, robust: &Robust) -> Result<(), ConfigError> {
    match robust {
        Robust::Huber { k } => within(&format!("{name}.huber.k"), k, 0.01, 1000.0),
        Robust::StudentT { nu } => within(&format!("{name}.student-t.nu"), nu, 0.1, 1e6),
    }
}

/// Checks the ranges of all settings of maps.
pub(crate) fn check_mapping(mapping: &MappingConfig) -> Result<(), ConfigError> {
    all_within(mapping, MAPPING)?;
    // lengths that follow from the cell where they are not given
    for (name, length, low) in [
        ("mapping.buffer", &mapping.buffer, 1e-6),
        ("mapping.significance", &mapping.significance, 1e-6),
        ("mapping.body_radius", &mapping.body_radius, 0.0),
    ] {
        if let AutoLength::Fixed(length) = length {
            within(name, length, low, 1e6)?;
        }
    }
    let ([update_low, update_high], [clamp_low, clamp_high]) =
        (mapping.update_limits, mapping.clamp);
    within("mapping.update_limits", update_low, -100.0, -1e-6)?;
    within("mapping.update_limits", update_high, 1e-6, 100.0)?;
    within("mapping.clamp", clamp_low, -7.99, -0.001)?;
    within("mapping.clamp", clamp_high, 0.001, 7.99)?;
    of_depth("mapping.refine.stereo", mapping.refine.stereo.validate())?;
    of_depth("mapping.dense.stereo", mapping.dense.stereo.validate())
}

const SLAM: &[Limit<SlamConfig>] = limits! { slam: SlamConfig,
    slam.initialization => {
        num_features: 10.0, 20_000.0;
        min_features: 8.0, 20_000.0;
        min_displacement: 0.001, 1.0;
        reference_displacement: 0.001, 10.0;
        max_buffered_frames: 2.0, 3000.0;
        patient_frames: 0.0, 1_000_000.0;
        sigma_px: 0.01, 20.0;
        max_relative_sigma: 0.001, 10.0;
        seed_relative_sigma: 0.0001, 1.0;
    }
    slam.tracking => {
        max_relative_sigma: 0.0001, 1000.0;
        min_validity: 0.0, 255.0;
        min_reference_points: 0.0, 1_000_000.0;
        accept_good_of_visible: 0.0, 1.0;
        accept_visible_share: 0.0, 1.0;
        retry_correlation: -1.0, 1.0;
        min_points: 6.0, 1_000_000.0;
        min_holding_points: 0.0, 1_000_000.0;
        min_visible_share: 0.0, 1.0;
        min_good_share: 0.0, 1.0;
        min_good_of_visible: 0.0, 1.0;
        min_correlation: -1.0, 1.0;
        degraded_good_of_visible: 0.0, 1.0;
        doubtful_residual: 1.0, 1000.0;
        doubtful_sigma: 1.0, 1000.0;
        doubtful_frames: 0.0, 1000.0;
        surprising_motion: 0.0, 1000.0;
        surprising_log_gain: 0.0, 1000.0;
        return_correlation: -1.0, 1.0;
        return_good_of_visible: 0.0, 1.0;
        return_usage: 0.0, 1.0;
        return_max_log_gain: 0.0, 1000.0;
        return_near_frames: 0.0, 1000.0;
    }
    slam.tracking.points => {
        probe_points: 0.0, 100_000.0;
        probe_error_px: 0.01, 100.0;
        max_points: 0.0, 100_000.0;
        near_radius_px: 1.0, 100.0;
        search_radius_px: 1.0, 200.0;
        min_correlation: 0.0, 1.0;
        max_error_px: 0.1, 100.0;
        min_inliers: 4.0, 1_000_000.0;
        min_inlier_share: 0.0, 1.0;
        max_jump: 0.0, 1000.0;
        alignment_sigma_factor: 0.01, 1000.0;
    }
    slam.tracking.alignment => {
        coarsest_level: 0.0, 8.0;
        finest_level: 0.0, 8.0;
        sigma_intensity: 0.1, 100.0;
        contrast_weight: 0.0, 1_000_000.0;
        min_cost_decrease: 0.0, 1.0;
        min_step_sq: 0.0, 1.0;
        max_residual: 1.0, 1000.0;
        max_residual_per_gradient: 0.0, 100.0;
        pixels_per_measurement: 1.0, 1_000_000.0;
        max_points: 0.0, 10_000_000.0;
    }
    slam.keyframes => {
        distance_weight: 0.01, 1000.0;
        usage_weight: 0.01, 1000.0;
        min_mapped_frames: 0.0, 1000.0;
        urgent_usage: 0.0, 1.0;
        min_good_of_visible: 0.0, 1.0;
        urgent_good_of_visible: 0.0, 1.0;
        min_holding_points: 0.0, 100_000.0;
        ramp_keyframes: 0.0, 1000.0;
        old_keyframes_observed: 0.0, 100.0;
        min_relative_baseline: 0.0, 100.0;
    }
    slam.keyframes.reactivation => {
        min_keyframes_between: 0.0, 1_000_000.0;
        first_keyframe: 0.0, 1_000_000.0;
        max_candidates: 0.0, 100.0;
        max_predicted_score: 0.0, 1000.0;
        max_score: 0.0, 1000.0;
        min_good_usage: 0.0, 1.0;
        max_disagreement: 0.0, 1000.0;
        crowd: 0.0, 1_000_000.0;
        crowded_max_score: 0.0, 1000.0;
        crowded_max_disagreement: 0.0, 1000.0;
    }
    slam.keyframes.refinement => {
        first_frames: 0.0, 1000.0;
        max_passed: 0.0, 1000.0;
        max_passed_distance: 0.0, 1000.0;
    }
    slam.publication => {
        min_validity: 0.0, 255.0;
        sigma_factor: 0.01, 100.0;
        relative_sigma: 0.0, 1.0;
    }
    slam.sparse => {
        points_per_keyframe: 0.0, 20_000.0;
        min_spacing: 1e-4, 1.0;
        max_searched_points: 0.0, 100_000.0;
        cell_px: 4.0, 1000.0;
        search_radius_px: 1.0, 100.0;
        max_view_angle_deg: 0.0, 180.0;
        max_distance_ratio: 1.0, 1000.0;
        back_search_keyframes: 0.0, 1000.0;
        sigma_px: 0.01, 20.0;
        kernel_px: 0.001, 100.0;
        pose_sigma_px: 0.01, 100.0;
        window_newest: 2.0, 1000.0;
        window_covisible: 0.0, 1000.0;
        min_shared_points: 1.0, 1_000_000.0;
        max_iterations: 1.0, 1000.0;
        max_chi_sq: 0.1, 1_000_000.0;
        min_pose_points: 4.0, 1_000_000.0;
        drop_after_keyframes: 0.0, 1_000_000.0;
        final_rounds: 0.0, 10.0;
        final_iterations: 1.0, 1000.0;
        final_radius_px: 1.0, 100.0;
        final_max_keyframes: 0.0, 5000.0;
    }
    slam.sparse.images => {
        min_keyframes: 0.0, 1_000_000.0;
        max_iterations: 1.0, 1000.0;
        min_correlation: -1.0, 1.0;
        noise: 0.01, 100.0;
        kernel: 0.01, 255.0;
        independent_pixels: 0.0, 64.0;
    }
    slam.fragments => {
        min_lost_secs: 0.01, 1_000_000.0;
        max_apart: 0.0, 1000.0;
        min_agreeing: 1.0, 1000.0;
        max_disagreement: 0.000001, 1000.0;
        bridge_frames: 0.0, 100.0;
        min_bridge_frames: 3.0, 100.0;
        max_bridge_scale_sigma: 0.0, 10.0;
        max_bridge_turn_deg: 0.0, 180.0;
        min_times_larger: 1.0, f64::INFINITY;
    }
    slam.merge => {
        min_agreeing: 1.0, 1000.0;
        min_aligned: 0.0, 1000.0;
        min_majority: 1.0, 1000.0;
    }
    slam.memory => {
        keyframes_mb: 0.0, 1_000_000.0;
        prepared_mb: 0.0, 1_000_000.0;
    }
    slam.inertial => {
        max_frames: 30.0, 100_000.0;
        gyroscope_bias_sigma: 0.00001, 1.0;
        accelerometer_bias_sigma: 0.0001, 10.0;
        min_secs: 0.5, 100_000.0;
        max_scale_sigma: 0.0, 1.0;
        max_gravity_sigma_deg: 0.0, 90.0;
        max_join_scale_sigma: 0.0, 1.0;
        max_join_position_share: 0.0, 1.0;
        join_position_sigma_m: 0.0, 10.0;
    }
    slam.graph => {
        nearest: 0.0, 1000.0;
        min_nearest_overlap: 0.0, 1.0;
        max_nearest_distance: 0.0, 1000.0;
        min_overlap: 0.0, 1.0;
        max_overlapping: 0.0, 1000.0;
        max_view_angle_deg: 0.0, 180.0;
        max_distance_ratio: 1.0, 1000.0;
        odometry_scale_sigma: 0.000001, 10.0;
        switch_chi_sq: 0.01, 1_000_000_000.0;
        lag_frames: 0.0, 1000.0;
        window: 12.0, 1e6;
        max_iterations: 1.0, 1000.0;
    }
    slam.graph.places => {
        min_keyframes_between: 0.0, 1_000_000.0;
        max_loops: 0.0, 100.0;
        min_lost_frames: 0.0, 1_000_000.0;
    }
    slam.graph.places.drift => {
        translation_start: 0.000001, 1000.0;
        translation_share: 0.0, 1000.0;
        rotation_start: 0.000001, 1000.0;
        rotation_step: 0.0, 1000.0;
        scale_start: 0.000001, 1000.0;
        scale_step: 0.0, 1000.0;
    }
    slam.graph.direct_edges => {
        translation_share: 0.0, 10.0;
        translation_sigma: 0.000001, 10.0;
        rotation_sigma: 0.000001, 10.0;
        scale_sigma: 0.000001, 10.0;
    }
    slam.graph.sparse_edges => {
        min_shared_points: 1.0, 1_000_000.0;
        max_edges: 0.0, 1000.0;
        max_gap: 0.0, 1_000_000.0;
        reference_points: 1.0, 1_000_000.0;
        translation_sigma: 0.000001, 10.0;
        rotation_sigma: 0.000001, 10.0;
        scale_sigma: 0.000001, 10.0;
    }
    slam.graph.similarity => {
        coarsest_level: 0.0, 8.0;
        finest_level: 0.0, 8.0;
        max_iterations: 1.0, 1000.0;
        max_points: 0.0, 10_000_000.0;
        sigma_intensity: 0.1, 100.0;
        shared_depth_sigma: 0.0, 1.0;
        min_cost_decrease: 0.0, 1.0;
        pixels_per_measurement: 1.0, 1_000_000.0;
        min_visible_share: 0.0, 1.0;
        min_good_of_visible: 0.0, 1.0;
        min_depth_share: 0.0, 1.0;
        min_correlation: -1.0, 1.0;
        max_scale_change: 1.0, 1000.0;
        max_reciprocal_chi_sq: 0.0, 1_000_000_000.0;
    }
};

const MAPPING: &[Limit<MappingConfig>] = limits! { mapping: MappingConfig,
    mapping => {
        resolution: 0.000001, 1_000_000.0;
        buffer_sigmas: 0.862, 100.0;
        significance_gain: 0.000001, 1_000_000.0;
        andert_p_min: 0.001, 0.499;
        tail_log_odds: 0.0, 1.0;
        occupancy_threshold: 0.001, 0.999;
        max_range: 0.000001, f64::INFINITY;
        local_radius: 0.000001, 1_000_000.0;
        follow_threshold: 0.0, 1_000_000.0;
        pose_sigma: 0.0, 1_000_000.0;
        pose_sigma_deg: 0.0, 180.0;
        depth_image_sigma: 0.000001, 10.0;
        max_memory_gb: 0.01, 1024.0;
    }
    mapping.filter => {
        max_relative_sigma: 0.000001, f64::INFINITY;
        max_agreed_sigma: 0.000001, f64::INFINITY;
        min_support: 0.0, 9.0;
        skip_keyframes: 0.0, 1_000_000.0;
    }
    mapping.refine => {
        max_keyframes: 1.0, 1000.0;
        max_separation: 0.000001, 1_000_000.0;
    }
    mapping.dense => {
        max_sources: 1.0, 32.0;
        best_angle_deg: 0.1, 45.0;
        max_witnesses: 1.0, 100.0;
    }
    mapping.fusion => {
        max_witnesses: 0.0, 1000.0;
        sigmas: 0.01, 100.0;
        min_tolerance: 0.0, 1.0;
        min_support: 1.0, 1000.0;
    }
    mapping.completion => {
        max_witnesses: 0.0, 1000.0;
        min_support: 1.0, 1000.0;
        tolerance: 0.0001, 1.0;
        max_against: 0.0, 1000.0;
        max_difference: 0.0, 1000.0;
    }
    mapping.planes => {
        max_count: 0.0, 1000.0;
        relative_sigma: 0.0, 1.0;
        max_extent: 0.0, 100.0;
    }
    mapping.fill => {
        max_gradient: 0.01, 255.0;
        min_area_px: 1.0, 1_000_000_000.0;
        samples: 1.0, 5000.0;
        min_inliers: 3.0, 1_000_000.0;
        min_inliers_offered: 3.0, 1_000_000.0;
        max_offered: 0.0, 1000.0;
        min_inlier_share: 0.001, 1.0;
        min_offered_share: 0.001, 1.0;
        max_behind_share: 0.0, 0.999;
        relative_sigma: 0.000001, 10.0;
        front_weight: 0.001, 1.0;
        correlated_points: 1.0, 1_000_000.0;
        max_stated_sigma: 0.000001, f64::INFINITY;
    }
    mapping.upright => {
        roll_sigma_deg: 1.0, 180.0;
        pitch_deg: -90.0, 90.0;
        pitch_sigma_deg: 1.0, 180.0;
        min_edge: 0.01, 1.0;
        min_confidence: 0.0, 1.0;
        min_floor_share: 0.001, 1.0;
    }
    mapping.mesh => {
        min_faces: 0.0, 1_000_000_000.0;
    }
};
