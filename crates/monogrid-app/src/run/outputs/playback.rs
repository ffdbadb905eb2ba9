//! A run as messages of ROS 2 in an MCAP file, to be played in other programs.

use super::Ground;
use super::maps::seen_from_above;
use crate::run::summary::unit_name;
use monogrid_bags::McapWriter;
use monogrid_bags::convert::{
    cloud_of, grid_of, info_of, packed, path_of, points_of_cells, transform_of,
};
use monogrid_datasets::{TimedPose, encode_png};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::sensor_msgs::CompressedImage;
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_occupancy::OccupancyMap;
use monogrid_report::colours::Colours;
use monogrid_report::explorer::ShownKeyframe;
use std::collections::BTreeMap;
use std::io::{self, Write};

/// The frame of the results, z up.
const MAP: &str = "map";
/// x right, y down, z ahead.
const CAMERA: &str = "camera";

/// What there is to see of a run, in the frame of the results.
#[derive(Debug)]
pub struct Playback<'a> {
    /// All poses that are known at the end.
    pub poses: &'a [TimedPose],
    /// What was measured.
    pub keyframes: &'a [ShownKeyframe<'a>],
    /// Images in colour.
    pub colours: &'a Colours,
    /// The map.
    pub map: Option<&'a OccupancyMap>,
    /// What is known of the floor and of the unit.
    pub ground: Ground,
}

impl Playback<'_> {
    /// Writes everything that happened at its time, as it is known at the end; path and map at the
    /// first time, so that they are seen from there on.
    pub fn write(&self, out: impl Write) -> io::Result<()> {
        let program = concat!("monogrid ", env!("CARGO_PKG_VERSION"));
        let mut writer = McapWriter::new(out, program)?;
        let unit = unit_name(self.ground.is_metric).to_owned();
        let note = BTreeMap::from([("unit of length".to_owned(), unit)]);
        writer.note("monogrid", note)?;
        let posed = self.poses.iter().map(|pose| pose.timestamp_ns);
        let times = posed.chain(self.keyframes.iter().map(|k| k.timestamp_ns));
        if let Some(first_ns) = times.min() {
            self.write_results(&mut writer, first_ns)?;
        }
        // keyframes are in the order in which they were made: those of frames before the start come
        // later
        let mut keyframes: Vec<_> = self.keyframes.iter().collect();
        keyframes.sort_by_key(|keyframe| keyframe.timestamp_ns);
        let mut keyframes = keyframes.into_iter().peekable();
        for pose in self.poses {
            write_pose(&mut writer, pose)?;
            while let Some(keyframe) = keyframes.next_if(|k| k.timestamp_ns <= pose.timestamp_ns) {
                self.write_keyframe(&mut writer, keyframe)?;
            }
        }
        // those of other sessions
        for keyframe in keyframes {
            self.write_keyframe(&mut writer, keyframe)?;
        }
        writer.finish()
    }

    /// Path and map.
    fn write_results(&self, writer: &mut McapWriter<impl Write>, time_ns: i64) -> io::Result<()> {
        let header = header(time_ns, MAP);
        let poses = self.poses.iter();
        let times = poses
            .clone()
            .map(|pose| Time::from_nanoseconds(pose.timestamp_ns));
        let stamped = times.zip(poses.map(|pose| pose.world_from_camera));
        let path = path_of(header.clone(), stamped);
        writer.write("/path", time_ns, &path)?;
        let Some(map) = self.map else {
            return Ok(());
        };
        let cells = cloud_of(header.clone(), "intensity", points_of_cells(map));
        writer.write("/map/cells", time_ns, &cells)?;
        let heights = points_of_cells(map).map(|[_, _, z, _]| f64::from(z));
        if let Some((grid, _)) = seen_from_above(map, heights, self.ground) {
            let grid = grid_of(header.clone(), header.stamp, &grid);
            writer.write("/map/grid", time_ns, &grid)?;
        }
        Ok(())
    }

    /// Calibration, image and points.
    fn write_keyframe(
        &self,
        writer: &mut McapWriter<impl Write>,
        keyframe: &ShownKeyframe,
    ) -> io::Result<()> {
        let time_ns = keyframe.timestamp_ns;
        if let Some(image) = keyframe.image {
            let (header, size) = (header(time_ns, CAMERA), image.size());
            let info = info_of(header.clone(), &keyframe.pinhole, size);
            writer.write("/camera/camera_info", time_ns, &info)?;
            let jpeg = self.colours.jpeg(keyframe.semi_dense.id());
            let jpeg = jpeg.map(|jpeg| ("jpeg", jpeg.to_vec()));
            let png = || Some(("png", encode_png(&*image.get()?)));
            if let Some((format, data)) = jpeg.or_else(png) {
                let image = CompressedImage {
                    header,
                    format: format.to_owned(),
                    data,
                };
                writer.write("/camera/image/compressed", time_ns, &image)?;
            }
        }
        let points = keyframe.points(self.colours).map(|point| {
            let [x, y, z] = point.point;
            [x, y, z, packed(point.colour)]
        });
        let cloud = cloud_of(header(time_ns, MAP), "rgb", points);
        writer.write("/points", time_ns, &cloud)
    }
}

fn write_pose(writer: &mut McapWriter<impl Write>, pose: &TimedPose) -> io::Result<()> {
    let header = header(pose.timestamp_ns, MAP);
    let transforms = vec![transform_of(header, CAMERA, &pose.world_from_camera)];
    writer.write("/tf", pose.timestamp_ns, &TFMessage { transforms })
}

fn header(time_ns: i64, frame: &str) -> Header {
    Header {
        stamp: Time::from_nanoseconds(time_ns),
        frame_id: frame.to_owned(),
    }
}
