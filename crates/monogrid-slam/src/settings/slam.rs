//! The public settings of tracking and depth.

use super::Settings;
use crate::{ConfigError, SlamConfig, settings};

/// The settings of the section `[slam]`.
pub const SLAM: Settings<SlamConfig> = settings! { slam: SlamConfig, OLD,
    slam.initialization.mode => "", [],
        "How a run without given depth starts: from `two-view` geometry, or from `random` depth as \
         LSD-SLAM.",
        "`random` repeats LSD-SLAM.";
    slam.initialization.num_features => "features", [(10.0, 20_000.0)],
        "Features that are followed from the first frame.",
        "Raise it where little of the image has texture, lower it for speed.";
    slam.initialization.min_features => "features", [(8.0, 20_000.0)],
        "A two-view start needs this many.",
        "Lower it where few features can be followed. Wrong starts become more likely.";
    slam.initialization.max_buffered_frames => "frames", [(2.0, 3000.0)],
        "Most frames that are kept while the start waits for parallax. Older ones stay without a \
         pose.",
        "Raise it where the camera stands still at first. Frames cost memory.";
    slam.initialization.max_relative_sigma => "share of the inverse depth", [(0.001, 10.0)],
        "A two-view start is accepted when the median standard deviation of its depth is at most \
         this.",
        "Raise it where the parallax is small for long.";
    slam.tracking.alignment.brightness => "", [],
        "Whether frames may differ in gain and offset (`affine`) or not (`constant`).",
        "Use `constant` for cameras with fixed exposure.";
    slam.tracking.alignment.max_points => "points", [(0.0, 10_000_000.0)],
        "Most points per pyramid level. 0 takes all.",
        "Lower it for speed.";
    slam.tracking.points.enabled => "", [],
        "Whether points of the sparse layer confirm and correct tracked poses. It needs \
         `slam.sparse.enabled`.",
        "Turn it off for purely direct tracking.";
    slam.keyframes.distance_weight => "", [(0.01, 1000.0)],
        "Weight of the distance, in mean depths, in the choice of keyframes.",
        "Raise it for more keyframes, lower it for fewer.";
    slam.keyframes.usage_weight => "", [(0.01, 1000.0)],
        "Weight of the lost overlap in the choice of keyframes.",
        "Raise it for more keyframes when the camera turns.";
    slam.keyframes.reactivation.enabled => "", [],
        "Whether a known view is tracked on an old keyframe in place of a new one.",
        "Turn it off to get a keyframe for every visit of a place.";
    slam.keyframes.refinement.max_passed => "frames", [(0.0, 1000.0)],
        "Most frames in a row that do not refine the depth because they were taken from almost one \
         place. 0 uses all frames.",
        "Raise it for speed at high frame rates.";
    slam.depth.min_gradient => "grey levels per pixel", [(1.0, 100.0)],
        "Pixels with a smaller gradient get no depth from the filter.",
        "Lower it for faint texture, raise it for speed.";
    slam.depth.sensor_sigma => "grey levels", [(0.1, 50.0)],
        "Image noise of the depth filter. Where the noise is estimated, this is the first value.",
        "Set it to the noise of the camera.";
    slam.depth_camera.sigma => "metres at 1 metre", [(0.00001, 1.0)],
        "Standard deviation of the depth that a depth camera measured. It grows with the square of \
         the depth.",
        "Set it to the noise of the depth camera.";
    slam.publication.min_validity => "", [(0.0, 255.0)],
        "Depth needs this much confirmation by later frames to be published. Each confirmation \
         adds 5.",
        "Lower it for more points, raise it for surer ones.";
    slam.sparse.enabled => "", [],
        "Whether points that several keyframes see adjust their poses (bundle adjustment).",
        "Turn it off to repeat LSD-SLAM.";
    slam.sparse.points_per_keyframe => "points", [(0.0, 20_000.0)],
        "Points that each keyframe should see.",
        "Lower it for speed, raise it for precise poses.";
    slam.sparse.window_newest => "keyframes", [(2.0, 1000.0)],
        "Newest keyframes whose poses are adjusted together.",
        "Lower it for speed.";
    slam.sparse.final_rounds => "rounds", [(0.0, 10.0)],
        "Adjustments of all keyframes together after the last frame. 0 leaves the poses to the \
         graph.",
        "Lower it to finish sooner.";
    slam.sparse.final_max_keyframes => "keyframes", [(0.0, 5000.0)],
        "Larger maps are not adjusted as a whole. The time grows with the third power.",
        "Raise it where the end may take minutes.";
    slam.sparse.images.enabled => "", [],
        "Whether the last adjustment is followed by one to the images themselves.",
        "Turn it off to finish sooner, or where the calibration is poor.";
    slam.graph.enabled => "", [],
        "Whether a pose graph of keyframes is optimised. Loop closing needs it.",
        "Turn it off for odometry alone.";
    slam.graph.lag_frames => "frames", [(0.0, 1000.0)],
        "The result of an optimisation is taken over after this many frames.",
        "Raise it where frames wait for the optimisation, as `--realtime` does.";
    slam.graph.window => "keyframes", [(12.0, 1e6)],
        "Keyframes that an optimisation moves during a run. A closed loop and the end move all.",
        "Lower it for speed in large maps.";
    slam.graph.final_search => "", [],
        "Whether all keyframes look for constraints once more at the end.",
        "Turn it off to finish sooner.";
    slam.graph.places.enabled => "", [],
        "Whether keyframes are recognised by their appearance. Loops after drift and \
         relocalisation need it.",
        "Turn it off where different places look alike.";
    slam.graph.places.method => "", [],
        "How places are recognised: by `corners`, or by `fab-map` as the thesis does.",
        "`fab-map` repeats the thesis.";
    slam.graph.places.vocabulary => "file", [],
        "Words of FAB-MAP, made by `monogrid thesis vocabulary`. Empty takes those that come with \
         the program.",
        "Train one for scenes unlike indoor rooms.";
    slam.fragments.enabled => "", [],
        "Whether a lost camera starts a new fragment of the map. It needs `slam.graph.enabled` and \
         `slam.graph.places.enabled`.",
        "Turn it off to wait for a known place.";
    slam.fragments.min_lost_secs => "s of video", [(0.01, 1e6)],
        "The camera must be lost this long before a fragment starts. A known place is recognised \
         sooner.",
        "Lower it for fast cameras, raise it to get fewer fragments.";
    slam.fragments.max_apart => "fragments", [(0.0, 1000.0)],
        "Most fragments that are not joined. With as many, a lost camera waits.",
        "Raise it for long recordings with many losses.";
    slam.fragments.min_times_larger => "", [(1.0, f64::INFINITY)],
        "A fragment becomes the map at the end when it has this many times as many frames. A map \
         in metres or of an earlier session stays.",
        "`inf` keeps the first map in any case.";
    slam.merge.min_agreeing => "keyframes", [(1.0, 1000.0)],
        "Two maps are joined when this many keyframes of each are recognised in the other and \
         agree.",
        "Raise it where different places look alike.";
    slam.inertial.gyroscope_bias_sigma => "rad/s", [(0.00001, 1.0)],
        "Standard deviation of the gyroscope's bias before it is estimated.",
        "Set it from the data sheet of the sensor.";
    slam.inertial.accelerometer_bias_sigma => "m/s²", [(0.0001, 10.0)],
        "Standard deviation of the accelerometer's bias before it is estimated.",
        "Set it from the data sheet of the sensor.";
    slam.inertial.max_scale_sigma => "share of the scale", [(0.0, 1.0)],
        "Results become metric when the inertial scale is at least this precise.",
        "Raise it to accept a rough scale.";
    slam.inertial.max_gravity_sigma_deg => "degrees", [(0.0, 90.0)],
        "Results become level when the direction of gravity is at least this precise.",
        "Raise it to accept a rough direction.";
    slam.memory.keyframes_mb => "MB", [(0.0, 1e6)],
        "Images and depth of keyframes, and poses of old frames, in memory. The rest lies in a \
         temporary file. No result depends on it.",
        "Raise it where the disk is slow, lower it on small computers.";
    slam.memory.prepared_mb => "MB", [(0.0, 1e6)],
        "Image pyramids of keyframes in memory. Others are made again. No result depends on it.",
        "Raise it for speed, lower it on small computers.";
};

/// Names that earlier versions had.
const OLD: &[(&str, &str)] = &[
    (
        "slam.depth",
        "ambiguity_ratio backoff crop_to_far_end failure_inflation fill_relative_var floor_px \
         frame_choice line_sigma_px mature_validity max_create_search_px \
         max_disagreement_sigma max_gain_ratio max_idepth max_residual_sigmas \
         max_scale_change max_smoothing_gain max_update_search_px max_var min_line_cosine \
         min_line_gradient min_support_fill min_support_keep min_support_share \
         near_search_factor occlusion_support photometric_factor propagate_subpixel \
         propagation_inflation propagation_relative_sigma remove_mean residual_gradient_share \
         search_sigmas selection slope_per_px smoothing_per_px success_inflation \
         validity_created validity_gain validity_loss validity_max validity_per_gradient \
         variance verify_interval",
    ),
    (
        "slam.fragments",
        "bridge_frames max_bridge_scale_sigma max_bridge_turn_deg max_disagreement \
         min_agreeing min_bridge_frames",
    ),
    (
        "slam.graph",
        "direct_edges max_distance_ratio max_iterations max_nearest_distance max_overlapping \
         max_view_angle_deg min_nearest_overlap min_overlap nearest odometry_scale_sigma \
         similarity sparse_edges switch_chi_sq",
    ),
    (
        "slam.graph.places",
        "drift max_loops min_keyframes_between min_lost_frames",
    ),
    (
        "slam.inertial",
        "join_position_sigma_m max_frames max_join_position_share max_join_scale_sigma \
         min_secs",
    ),
    (
        "slam.initialization",
        "min_displacement patient_frames reference_displacement seed_relative_sigma sigma_px",
    ),
    (
        "slam.keyframes",
        "min_good_of_visible min_holding_points min_mapped_frames min_relative_baseline \
         old_keyframes_observed ramp_keyframes urgent_good_of_visible urgent_usage",
    ),
    (
        "slam.keyframes.reactivation",
        "crowd crowded_max_disagreement crowded_max_score first_keyframe max_candidates \
         max_disagreement max_predicted_score max_score min_good_usage min_keyframes_between",
    ),
    (
        "slam.keyframes.refinement",
        "first_frames max_passed_distance",
    ),
    ("slam.merge", "min_aligned min_majority"),
    ("slam.publication", "relative_sigma sigma_factor smoothed"),
    (
        "slam.sparse",
        "back_search_keyframes cell_px drop_after_keyframes final_iterations final_radius_px \
         kernel_px max_chi_sq max_distance_ratio max_iterations max_searched_points \
         max_view_angle_deg min_pose_points min_shared_points min_spacing pose_sigma_px \
         search_radius_px sigma_px window_covisible",
    ),
    (
        "slam.sparse.images",
        "independent_pixels kernel max_iterations min_correlation min_keyframes noise",
    ),
    (
        "slam.tracking",
        "accept_good_of_visible accept_visible_share degraded_good_of_visible doubtful_frames \
         doubtful_residual doubtful_sigma max_relative_sigma min_correlation \
         min_good_of_visible min_good_share min_holding_points min_points \
         min_reference_points min_validity min_visible_share motion_hypotheses \
         retry_correlation return_correlation return_good_of_visible return_max_log_gain \
         return_near_frames return_usage smoothed_depth surprising_log_gain surprising_motion",
    ),
    (
        "slam.tracking.alignment",
        "coarsest_level contrast_weight finest_level max_iterations max_residual \
         max_residual_per_gradient min_cost_decrease min_step_sq pixels_per_measurement \
         robust sigma_intensity",
    ),
    (
        "slam.tracking.points",
        "alignment_sigma_factor max_error_px max_jump max_points min_correlation \
         min_inlier_share min_inliers near_radius_px probe_error_px probe_points \
         search_radius_px",
    ),
];

impl SlamConfig {
    /// Checks the ranges.
    ///
    /// # Errors
    /// The first setting outside its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        SLAM.check(self)
    }
}
