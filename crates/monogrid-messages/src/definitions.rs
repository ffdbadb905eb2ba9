//! Interface definitions, as files of messages carry them so that whoever reads them needs nothing
//! else.

use crate::RosMessage;

/// Fields of a type, in order: a line each, the type before the name.
fn fields_of(name: &str) -> Option<&'static str> {
    Some(match name {
        "builtin_interfaces/Time" => "int32 sec\nuint32 nanosec\n",
        "std_msgs/Header" => "builtin_interfaces/Time stamp\nstring frame_id\n",
        "geometry_msgs/Point" | "geometry_msgs/Vector3" => "float64 x\nfloat64 y\nfloat64 z\n",
        "geometry_msgs/Quaternion" => "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
        "geometry_msgs/Pose" => {
            "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
        }
        "geometry_msgs/PoseStamped" => "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
        "geometry_msgs/Transform" => {
            "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n"
        }
        "geometry_msgs/TransformStamped" => {
            "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform\n"
        }
        "tf2_msgs/TFMessage" => "geometry_msgs/TransformStamped[] transforms\n",
        "nav_msgs/Path" => "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n",
        "nav_msgs/MapMetaData" => {
            "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 \
             height\ngeometry_msgs/Pose origin\n"
        }
        "nav_msgs/OccupancyGrid" => {
            "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n"
        }
        "sensor_msgs/CompressedImage" => "std_msgs/Header header\nstring format\nuint8[] data\n",
        "sensor_msgs/RegionOfInterest" => {
            "uint32 x_offset\nuint32 y_offset\nuint32 height\nuint32 width\nbool do_rectify\n"
        }
        "sensor_msgs/CameraInfo" => {
            "std_msgs/Header header\nuint32 height\nuint32 width\nstring distortion_model\n\
             float64[] d\nfloat64[9] k\nfloat64[9] r\nfloat64[12] p\nuint32 binning_x\nuint32 \
             binning_y\nsensor_msgs/RegionOfInterest roi\n"
        }
        "sensor_msgs/PointField" => "string name\nuint32 offset\nuint8 datatype\nuint32 count\n",
        "sensor_msgs/PointCloud2" => {
            "std_msgs/Header header\nuint32 height\nuint32 width\nsensor_msgs/PointField[] fields\n\
             bool is_bigendian\nuint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n"
        }
        _ => return None,
    })
}

/// Between the definition of a message and those of the types that it uses.
const SEPARATOR: &str =
    "================================================================================\n";

/// The definition of a message followed by those of all types that it uses, as MCAP files have it
/// (`ros2msg`); `None` of messages that this project writes into no file.
#[must_use]
pub fn definition<M: RosMessage>() -> Option<String> {
    let mut text = String::new();
    // each type once, in the order in which they are met
    let mut names = vec![format!("{}/{}", M::PACKAGE, M::NAME)];
    let mut next = 0;
    while let Some(name) = names.get(next) {
        let fields = fields_of(name)?;
        if next > 0 {
            text += &format!("{SEPARATOR}MSG: {name}\n");
        }
        text += fields;
        for field in fields.lines() {
            let used = field.split([' ', '[']).next().unwrap_or_default();
            if used.contains('/') && !names.iter().any(|known| known == used) {
                names.push(used.to_owned());
            }
        }
        next += 1;
    }
    Some(text)
}
