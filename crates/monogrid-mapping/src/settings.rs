//! The public settings of maps.

use crate::MappingConfig;
use monogrid_slam::settings;
use monogrid_slam::settings::Settings;

/// The settings of the section `[mapping]`.
pub const MAPPING: Settings<MappingConfig> = settings! { mapping: MappingConfig, OLD,
    mapping.quality => "", [],
        "How much work final maps get. `raw` takes the depth of the filter as it is, `fast` \
         refines it. `default` adds depth of all pixels. `best` does so with finer steps and \
         more keyframes.",
        "`default` costs four times the work of `fast`, `best` eight times.";
    mapping.resolution => "map units", [(1e-6, 1e6)],
        "Edge length of a cell.",
        "Smaller cells show more detail. They cost memory and time.";
    mapping.auto_resolution => "", [],
        "Whether final maps of unknown scale choose their cell from the scene. The cell is a \
         fiftieth of the median depth, or larger where the depth is less precise or the map would \
         be too large. Naming a resolution turns it off.",
        "Turn it off to get the given resolution whatever the scale is.";
    mapping.sensor_model => "", [],
        "Inverse sensor model: `thrun`, `andert`, `ideal`, or `none` for end points without free \
         space.",
        "Change it to compare sensor models, as the thesis does.";
    mapping.buffer => "map units", [(1e-6, 1e6)],
        "Thickness L of the occupied band of `thrun` and `ideal`. `\"auto\"` takes the larger of \
         the cell's extent along the ray and `buffer_sigmas` standard deviations.",
        "Fix it to repeat the thesis' tables, or to make walls thicker.";
    mapping.buffer_sigmas => "standard deviations", [(0.862, 100.0)],
        "Thickness of the band where `buffer` is `\"auto\"`. Below 0.861 a hit would be evidence \
         against the obstacle. docs/sensor-parameters.md derives the default.",
        "Raise it where the stated depth noise is too small.";
    mapping.thrun_form => "", [],
        "Form of the model `thrun`: `exact`, the closed form of the `thesis`, or `inverse-depth`.",
        "Change it to compare the forms.";
    mapping.significance => "map units", [(1e-6, 1e6)],
        "Significance k of the model `andert`. `\"auto\"` takes one cell.",
        "Fix it to repeat the thesis' tables.";
    mapping.andert_p_min => "probability", [(0.001, 0.499)],
        "Probability of free space in the model `andert`. The default is the thesis' value.",
        "Lower it to clear free space with fewer rays.";
    mapping.andert_form => "", [],
        "Depth noise of the model `andert`: of a `monocular` or of a `stereo` camera.",
        "Use `stereo` for depth whose noise grows with the square of the range.";
    mapping.integration => "", [],
        "How measurements update cells. `fused` makes one update per cell and keyframe, `rays` one \
         per ray and cell.",
        "`rays` is the thesis' rule. `fused` is faster and does not count one keyframe many times.";
    mapping.update_limits => "log-odds", [(-100.0, -1e-6), (1e-6, 100.0)],
        "Smallest and largest update of a cell by one keyframe. docs/sensor-parameters.md explains \
         the default.",
        "Widen them for sensors whose single measurements can be trusted.";
    mapping.updates_to_belief => "updates", [(0.0, 255.0), (0.0, 255.0)],
        "Equal updates that bring a cell to the model's probability, for free and for occupied \
         cells. More do not go farther, because keyframes share errors. 0 lets updates add up \
         without end.",
        "Lower them where cells must change after few keyframes. Use 0 for independent \
         measurements.";
    mapping.tail_log_odds => "log-odds", [(0.0, 1.0)],
        "A ray ends behind the obstacle where the model states less than this.",
        "Lower it to thicken walls, raise it to thin them.";
    mapping.clamp => "log-odds", [(-7.99, -0.001), (0.001, 7.99)],
        "Lowest and highest stored value of a cell. OctoMap's are -2 and 3.5.",
        "Narrow them where the scene changes, so that cells can change quickly.";
    mapping.occupancy_threshold => "probability", [(0.001, 0.999)],
        "Cells at least this likely are occupied.",
        "Lower it to plan more carefully, raise it to drop uncertain cells.";
    mapping.max_range => "map units", [(1e-6, f64::INFINITY)],
        "Measurements farther away are ignored.",
        "Raise it outdoors, lower it to save memory.";
    mapping.local_radius => "map units", [(1e-6, 1e6)],
        "Radius of the local map around the camera.",
        "Match it to the distance over which a robot plans.";
    mapping.follow_threshold => "cells", [(0.0, 1e6)],
        "The live global map redraws a keyframe when a correction moves a measurement by this \
         much. Final maps have all poses exactly.",
        "Raise it to save time while a run goes on.";
    mapping.sigma_mode => "", [],
        "Meaning of a measurement's standard deviation: of the `range`, or `raw-inverse-depth` \
         taken as a range.",
        "`raw-inverse-depth` repeats a possible reading of the thesis.";
    mapping.pose_sigma => "map units", [(0.0, 1e6)],
        "Standard deviation of a keyframe's position relative to its neighbours.",
        "Raise it where the same wall appears twice. 0 trusts all poses.";
    mapping.pose_sigma_deg => "degrees", [(0.0, 180.0)],
        "Standard deviation of a keyframe's rotation relative to its neighbours.",
        "Raise it where distant walls appear twice. 0 trusts all poses.";
    mapping.body_radius => "map units", [(0.0, 1e6)],
        "Cells this close to the camera's path are free in final maps. `\"auto\"` takes one cell, \
         0 switches it off.",
        "Set it to the radius of the robot that carried the camera.";
    mapping.depth_image_sigma => "share of the depth", [(1e-6, 10.0)],
        "Standard deviation of depth in given depth images.",
        "Set it to the noise of the depth camera.";
    mapping.max_memory_gb => "GB (10^9 bytes)", [(0.01, 1024.0)],
        "Memory that a map and its preparation may take.",
        "Raise it for large maps, lower it on small computers.";
    mapping.filter.max_relative_sigma => "share of the inverse depth", [(1e-6, f64::INFINITY)],
        "Measurements with a larger standard deviation are not mapped. `inf` keeps all. Where \
         keyframes agree so badly that most would go, half of them stay.",
        "Raise it to observe more of the surfaces, lower it for thinner walls.";
    mapping.filter.skip_keyframes => "keyframes", [(0.0, 1e6)],
        "This many first keyframes are not mapped.",
        "Use it after a random start, whose first keyframes have no depth yet.";
    mapping.dense.live => "", [],
        "Whether maps that grow during a run get depth of all pixels too, a few keyframes later.",
        "Turn it off to save time while a run goes on.";
    mapping.fill.enabled => "", [],
        "Whether plain regions get the depth of a plane through their outline.",
        "Turn it off to map measured depth only.";
    mapping.planes.max_count => "planes", [(0.0, 1000.0)],
        "Most large planes around a keyframe on which final maps average and continue depth. 0 \
         switches this off.",
        "Turn it off outdoors, or where walls are not flat.";
    mapping.mesh.enabled => "", [],
        "Whether a run writes the surface as a mesh.",
        "Turn it off to save time and space.";
    mapping.mesh.min_faces => "faces of cells", [(0.0, 1e9)],
        "Smaller pieces of the surface are left out of the mesh.",
        "Lower it to keep small objects, raise it against false measurements.";
};

/// Names that earlier versions had.
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
    ("mapping.filter", "max_agreed_sigma min_support"),
    ("mapping.planes", "max_extent relative_sigma"),
    (
        "mapping.refine",
        "enabled max_keyframes max_separation stereo",
    ),
];

#[cfg(test)]
mod tests;
