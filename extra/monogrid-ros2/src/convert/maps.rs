//! Maps as messages, and how much of them fits into one.

use super::{MAX_MESSAGE_BYTES, OVERHEAD_BYTES};
use monogrid_bags::convert::{BYTES_PER_NUMBER, cloud_of, path_of, points_of_cells};
use monogrid_geometry::{Pinhole, Se3, Sim3, Vec2};
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::{OccupancyGrid, Path};
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::sensor_msgs::PointCloud2;
use monogrid_messages::std_msgs::Header;
use monogrid_occupancy::{MapError, OccupancyMap, write_bt, write_ot};
use monogrid_slam::Keyframe;

/// Bytes of a grid (one for a cell) or tree that fit into one message.
pub const MAX_BYTES: usize = MAX_MESSAGE_BYTES - OVERHEAD_BYTES;

/// A part is smaller than the one before by this much.
const SHRINK: f64 = 0.8;

/// What `make` makes of a map, or, where that does not fit, of the largest part around `center`
/// that does, with its radius. Lengths are those of the map.
///
/// # Errors
/// What `make` cannot do.
pub fn part_that_fits<M>(
    map: &OccupancyMap,
    center: [f64; 3],
    make: impl Fn(&OccupancyMap) -> Result<M, MapError>,
    fits: impl Fn(&M) -> bool,
) -> Result<(M, Option<f64>), MapError> {
    let whole = make(map)?;
    if fits(&whole) {
        return Ok((whole, None));
    }
    let mut radius = map.bounds().map_or(0.0, |(low, high)| {
        let sides = (0..3).map(|axis| (high[axis] - low[axis]).powi(2));
        sides.sum::<f64>().sqrt()
    });
    // a part without a cell fits always
    while radius > map.resolution() {
        radius *= SHRINK;
        let part = make(&map.within(center, radius)?)?;
        if fits(&part) {
            return Ok((part, Some(radius)));
        }
    }
    let nothing = OccupancyMap::new(map.config().clone())?;
    Ok((make(&nothing)?, Some(0.0)))
}

/// Bytes of a part of what is sent in parts: a listener with the usual buffers has room for it.
const PART_BYTES: usize = 96_000;

const BYTES_PER_POINT: usize = 4 * BYTES_PER_NUMBER;
/// Points that fit into one message.
pub const MAX_POINTS: usize = MAX_BYTES / BYTES_PER_POINT;

/// Depths that are less certain are not sent.
const MAX_RELATIVE_SIGMA: f32 = 0.05;

/// The centres of the occupied cells of a map whose lengths are metres; the intensity is their
/// probability.
#[must_use]
pub fn cloud_of_cells(header: Header, map: &OccupancyMap) -> PointCloud2 {
    cloud_of(header, "intensity", points_of_cells(map).take(MAX_POINTS))
}

/// The points of a keyframe, of which depth is known well enough, in the frame given by
/// `frame_from_keyframe` (m), in parts; the intensity is the grey value, 0 to 255.
#[must_use]
pub fn clouds_of_keyframe(
    header: &Header,
    keyframe: &Keyframe,
    pinhole: &Pinhole,
    frame_from_keyframe: &Sim3,
) -> Vec<PointCloud2> {
    let pixels = keyframe.pixels.iter();
    let certain =
        pixels.filter(|p| p.idepth > 0.0 && p.idepth_var.sqrt() <= MAX_RELATIVE_SIGMA * p.idepth);
    let points = certain.map(|pixel| {
        let at = Vec2::new(f64::from(pixel.x), f64::from(pixel.y));
        let in_keyframe = pinhole.unproject(&at) / f64::from(pixel.idepth);
        let point = *frame_from_keyframe * in_keyframe;
        let grey = keyframe.image.at(pixel.x.into(), pixel.y.into());
        [point.x as f32, point.y as f32, point.z as f32, grey.into()]
    });
    let points: Vec<[f32; 4]> = points.collect();
    let parts = points.chunks(PART_BYTES / BYTES_PER_POINT);
    let part = |part: &[[f32; 4]]| cloud_of(header.clone(), "intensity", part.iter().copied());
    parts.map(part).collect()
}

/// The smallest rectangle of `now` that holds all cells that differ from `before`, in parts; none
/// where none does. The two are of one size and place, else all of `now` must be sent.
#[must_use]
pub fn changed_parts(before: &OccupancyGrid, now: &OccupancyGrid) -> Vec<OccupancyGridUpdate> {
    let width = now.info.width as usize;
    let changed = before.data.iter().zip(&now.data).enumerate();
    let changed = changed.filter(|(_, (before, now))| before != now);
    let cells = changed.map(|(index, _)| (index % width, index / width));
    let bounds = cells.fold(None, |bounds: Option<[usize; 4]>, (x, y)| {
        let [left, low, right, high] = bounds.unwrap_or([x, y, x, y]);
        Some([left.min(x), low.min(y), right.max(x), high.max(y)])
    });
    let Some([left, low, right, high]) = bounds else {
        return Vec::new();
    };
    let rows = (PART_BYTES / (right - left + 1)).max(1);
    let part = |first: usize| {
        let height = rows.min(high + 1 - first);
        let rows = now.data.chunks(width).skip(first).take(height);
        OccupancyGridUpdate {
            header: now.header.clone(),
            x: left as i32,
            y: first as i32,
            width: (right - left + 1) as u32,
            height: height as u32,
            data: rows.flat_map(|row| &row[left..=right]).copied().collect(),
        }
    };
    (low..=high).step_by(rows).map(part).collect()
}

/// The last line of the header of OctoMap's files.
const END_OF_HEADER: &[u8] = b"\ndata\n";

/// A map whose lengths are metres as a tree: with free and occupied cells only (`binary`), or with
/// log-odds.
///
/// # Errors
/// Cells beyond what OctoMap can address.
pub fn octomap_of(header: Header, map: &OccupancyMap, binary: bool) -> Result<Octomap, MapError> {
    let mut file = Vec::new();
    if binary {
        write_bt(map, &mut file)?;
    } else {
        write_ot(map, &mut file)?;
    }
    let mut windows = file.windows(END_OF_HEADER.len());
    let end = windows.position(|window| window == END_OF_HEADER);
    let end = end.map_or(0, |at| at + END_OF_HEADER.len());
    Ok(Octomap {
        header,
        binary,
        id: "OcTree".to_owned(),
        resolution: map.resolution(),
        data: file.split_off(end),
    })
}

/// Bytes of a pose but for the name of its frame: time, length of the name, padding, seven numbers.
const BYTES_PER_POSE: usize = 8 + 4 + 8 + 7 * 8;
/// Longest name of a frame that is counted with.
const MAX_NAME_BYTES: usize = 100;

/// Bytes of a pose at most.
pub const MAX_BYTES_PER_POSE: usize = BYTES_PER_POSE + MAX_NAME_BYTES;
/// Poses that fit into one message.
pub const MAX_PATH_POSES: usize = MAX_BYTES / MAX_BYTES_PER_POSE;

/// Poses in the frame of the header, m, with their times; at most [`MAX_PATH_POSES`], the last
/// ones.
#[must_use]
pub fn last_path_of(header: Header, poses: &[(Time, Se3)]) -> Path {
    let first = poses.len().saturating_sub(MAX_PATH_POSES);
    path_of(header, poses[first..].iter().copied())
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Rotation, Vec3};
    use monogrid_image::Image;
    use monogrid_messages::nav_msgs::MapMetaData;
    use monogrid_occupancy::{MapConfig, VoxelKey};
    use monogrid_slam::DepthPixel;

    #[test]
    fn the_largest_part_that_fits_is_taken() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(1.0)).unwrap();
        for x in 0..1000 {
            map.set_log_odds(VoxelKey::new(x, 0, 0), Some(1.0)).unwrap();
        }
        let cells = |map: &OccupancyMap| Ok(map.cells().map(|cell| cell.key.x).collect::<Vec<_>>());
        let (all, radius) = part_that_fits(&map, [0.0; 3], cells, |c| c.len() <= 1000).unwrap();
        assert_eq!((all.len(), radius), (1000, None));
        let (part, radius) =
            part_that_fits(&map, [500.5, 0.5, 0.5], cells, |c| c.len() <= 100).unwrap();
        assert!((80..=100).contains(&part.len()), "{}", part.len());
        assert!(part.contains(&500) && radius.unwrap() > 40.0);
        let none = part_that_fits(&map, [500.5, 0.5, 0.5], cells, Vec::is_empty).unwrap();
        assert!(none.0.is_empty());
    }

    fn numbers(cloud: &PointCloud2) -> Vec<f32> {
        let (numbers, rest) = cloud.data.as_chunks::<4>();
        assert!(rest.is_empty());
        numbers.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }

    #[test]
    fn centres_of_occupied_cells() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.5)).unwrap();
        map.set_log_odds(VoxelKey::new(1, -1, 0), Some(0.0 + 1.0))
            .unwrap();
        map.set_log_odds(VoxelKey::new(5, 5, 5), Some(-1.0))
            .unwrap();
        let cloud = cloud_of_cells(Header::default(), &map);
        let names: Vec<&str> = cloud.fields.iter().map(|f| f.name.as_str()).collect();
        assert_eq!(names, ["x", "y", "z", "intensity"]);
        assert_eq!((cloud.height, cloud.width, cloud.row_step), (1, 1, 16));
        let [x, y, z, probability] = numbers(&cloud)[..] else {
            panic!("one point of four numbers");
        };
        assert_eq!([x, y, z], [0.75, -0.25, 0.25]);
        assert!((probability - 0.731).abs() < 1e-3);
    }

    #[test]
    fn certain_points_of_a_keyframe() {
        let pixel = |x, idepth, idepth_var| DepthPixel {
            x,
            y: 0,
            idepth,
            idepth_var,
        };
        let keyframe = Keyframe {
            id: 0,
            frame_index: 0,
            timestamp_ns: 0,
            revision: 0,
            image: Image::filled(4, 2, 77),
            pixels: vec![
                pixel(3, 0.5, 1e-6),
                pixel(1, 0.5, 1.0),
                pixel(2, -1.0, 1e-6),
            ],
        };
        let pinhole = Pinhole::new(2.0, 2.0, 1.0, 0.0);
        let moved = Sim3::new(3.0, Rotation::identity(), Vec3::new(0.0, 10.0, 0.0));
        let of = |keyframe: &Keyframe| {
            clouds_of_keyframe(&Header::default(), keyframe, &pinhole, &moved)
        };
        let clouds = of(&keyframe);
        assert_eq!(clouds.len(), 1);
        // the pixel is one focal length to the right: (2, 0, 2) in the keyframe
        assert_eq!(numbers(&clouds[0]), [6.0, 10.0, 6.0, 77.0]);
        // all points of a large one come, in parts
        let many = vec![pixel(3, 0.5, 1e-6); 10_000];
        let clouds = of(&Keyframe {
            pixels: many,
            ..keyframe
        });
        assert!(clouds.iter().all(|cloud| cloud.data.len() <= PART_BYTES));
        let points: u32 = clouds.iter().map(|cloud| cloud.width).sum();
        assert_eq!((clouds.len(), points), (2, 10_000));
    }

    fn grid(width: u32, data: &[i8]) -> OccupancyGrid {
        OccupancyGrid {
            info: MapMetaData {
                width,
                height: data.len() as u32 / width,
                ..MapMetaData::default()
            },
            data: data.to_vec(),
            ..OccupancyGrid::default()
        }
    }

    #[test]
    fn a_change_is_the_rectangle_around_it() {
        let before = grid(4, &[-1; 12]);
        let mut after = before.clone();
        (after.data[5], after.data[10]) = (0, 100);
        assert_eq!(changed_parts(&before, &before), []);
        let [update] = &changed_parts(&before, &after)[..] else {
            panic!("one part");
        };
        let place = (update.x, update.y, update.width, update.height);
        assert_eq!(place, (1, 1, 2, 2));
        assert_eq!(update.data, [0, -1, -1, 100]);
    }

    #[test]
    fn a_large_change_comes_in_parts() {
        let before = grid(400, &[-1; 400 * 600]);
        let mut after = before.clone();
        for (index, cell) in after.data.iter_mut().enumerate().skip(400) {
            *cell = (index % 101) as i8;
        }
        let parts = changed_parts(&before, &after);
        assert_eq!(parts.len(), 3);
        let mut row = 1;
        for part in &parts {
            assert!(part.data.len() <= PART_BYTES);
            assert_eq!((part.x, part.y, part.width), (0, row, 400));
            let first = row as usize * 400;
            assert_eq!(part.data, after.data[first..first + part.data.len()]);
            row += part.height as i32;
        }
        assert_eq!(row, 600);
    }

    #[test]
    fn one_occupied_cell_is_a_branch_of_sixteen_nodes() {
        let mut map = OccupancyMap::new(MapConfig::with_resolution(0.25)).unwrap();
        // the lowest cell of the octant that is positive in all axes: octant 7, then 0 down to the
        // leaf
        map.set_log_odds(VoxelKey::new(0, 0, 0), Some(1.0)).unwrap();
        let binary = octomap_of(Header::default(), &map, true).unwrap();
        assert_eq!((binary.id.as_str(), binary.binary), ("OcTree", true));
        assert_eq!(binary.resolution, 0.25);
        let mut expected = vec![0, 0b1100_0000]; // the eighth child is an inner node
        expected.extend([0b11, 0].repeat(14));
        expected.extend([0b10, 0]); // the first child is an occupied leaf
        assert_eq!(binary.data, expected);
        let full = octomap_of(Header::default(), &map, false).unwrap();
        assert_eq!(full.data.len(), 17 * 5);
        assert_eq!(full.data[..5], [0, 0, 128, 63, 0b1000_0000]);
        assert_eq!(full.data[80..], [0, 0, 128, 63, 0]);
    }

    #[test]
    fn poses_keep_their_times_and_the_last_ones_are_sent() {
        let pose = |k: usize| {
            let at = Se3::new(Rotation::identity(), Vec3::new(k as f64, 0.0, 0.0));
            (Time::from_nanoseconds(k as i64), at)
        };
        let poses: Vec<_> = (0..MAX_PATH_POSES + 3).map(pose).collect();
        let header = Header {
            frame_id: "map".into(),
            ..Header::default()
        };
        let path = last_path_of(header, &poses);
        assert_eq!(path.poses.len(), MAX_PATH_POSES);
        let first = &path.poses[0];
        assert_eq!(
            (first.header.stamp.nanosec, first.pose.position.x),
            (3, 3.0)
        );
        assert_eq!(first.header.frame_id, "map");
    }
}
