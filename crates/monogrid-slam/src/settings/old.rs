//! Names of settings and sections that earlier versions had. Files and `--set` may still name them
//! for one version; they have no effect.

/// Sections, and the names that are gone from each; a name stands for all below it.
const OLD: &[(&str, &str)] = &[
    (
        "mapping",
        "band_by_slope completion envelope fusion rims sigma_from_agreement significance_gain \
         straighten unseen upright",
    ),
    (
        "mapping.dense",
        "best_angle_deg max_sources max_witnesses stereo",
    ),
    (
        "mapping.fill",
        "correlated_points front_weight max_against max_behind_share max_gradient max_offered \
         max_stated_sigma max_witnesses min_area_px min_inlier_share min_inliers \
         min_inliers_offered min_offered_share relative_sigma samples tolerance",
    ),
    ("mapping.filter", "max_agreed_sigma"),
    ("mapping.planes", "max_extent relative_sigma"),
    ("mapping.refine", "max_keyframes max_separation stereo"),
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
        "min_displacement patient_frames reference_displacement sigma_px",
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

/// Whether a name was that of a setting or section, or of one below it.
pub(super) fn is_old(name: &str) -> bool {
    OLD.iter().any(|(section, keys)| {
        let rest = name.strip_prefix(section);
        let rest = rest.and_then(|rest| rest.strip_prefix('.'));
        let key = rest.and_then(|rest| rest.split('.').next());
        key.is_some_and(|key| keys.split(' ').any(|old| old == key))
    })
}

/// All names, for tests.
#[cfg(test)]
pub(super) fn names() -> impl Iterator<Item = String> {
    let of = |&(section, keys): &(&str, &'static str)| {
        let section = section.to_owned();
        keys.split(' ').map(move |key| format!("{section}.{key}"))
    };
    OLD.iter().flat_map(of)
}
