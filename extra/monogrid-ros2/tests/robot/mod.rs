//! The other process: a camera, and somebody who listens to everything that the node publishes.

pub mod wheels;

use monogrid_geometry::{Camera, Distortion, Se3, Vec3};
use monogrid_image::Image as Picture;
use monogrid_inertial::ImuSample;
use monogrid_messages::RosMessage;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::diagnostic_msgs::DiagnosticArray;
use monogrid_messages::geometry_msgs::Vector3;
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::{OccupancyGrid, Odometry, Path};
use monogrid_messages::octomap_msgs::Octomap;
use monogrid_messages::rcl_interfaces::Log;
use monogrid_messages::rosgraph_msgs::Clock;
use monogrid_messages::sensor_msgs::{CameraInfo, Image, Imu, PointCloud2};
use monogrid_messages::std_msgs::Header;
use monogrid_messages::std_srvs::{TriggerRequest, TriggerResponse};
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_ros2::convert::transform_of;
use monogrid_ros2::node::{Outlet, Quality, RosNode, Wire, connect_to};
use ros2_client::rcl_interfaces::{SetParametersRequest, SetParametersResponse};
use ros2_client::{
    Client, Context, Message, Name, NodeOptions, Parameter, ParameterValue, QosProfile,
    ServiceMapping, ServiceTypeName, Subscription,
};
use std::collections::BTreeMap;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// How often the topics are looked at.
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// What has not come within this time does not come: long, for busy computers.
const PATIENCE: Duration = Duration::from_secs(120);

/// The time of the system's clock.
pub fn now() -> Time {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap();
    Time::from_nanoseconds(now.as_nanos() as i64)
}

/// The node in a process of its own, which ends with this.
pub struct Node {
    child: Child,
}

impl Node {
    /// Starts it in a domain of its own on this computer.
    pub fn start(domain: u16, arguments: &[&str]) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_monogrid-ros2"))
            .args(arguments)
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .stdin(Stdio::null())
            .spawn()
            .unwrap();
        Self { child }
    }

    /// CPU time that it has used, s (Linux).
    pub fn cpu_seconds(&self) -> f64 {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let (_, fields) = stat.rsplit_once(')').unwrap();
        let ticks = |field: usize| -> f64 {
            fields
                .split_whitespace()
                .nth(field)
                .unwrap()
                .parse()
                .unwrap()
        };
        // utime and stime, 100 per second
        (ticks(11) + ticks(12)) / 100.0
    }

    /// Ends it as people do; whether it ended well.
    pub fn interrupt(&mut self) -> bool {
        let pid = self.child.id().to_string();
        assert!(
            Command::new("kill")
                .args(["-INT", &pid])
                .status()
                .unwrap()
                .success()
        );
        let begin = Instant::now();
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.success();
            }
            assert!(begin.elapsed() < PATIENCE, "the node does not end");
            thread::sleep(Duration::from_millis(20));
        }
    }

    /// Whether it is still running.
    pub fn is_running(&mut self) -> bool {
        self.child.try_wait().unwrap().is_none()
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Everything that was heard.
#[derive(Default)]
pub struct Heard {
    /// Odometry, and when it arrived.
    pub odometry: Vec<(Odometry, Time)>,
    pub tf: Vec<TFMessage>,
    pub tf_static: Vec<TFMessage>,
    /// Stamp and arrival of grids and their changes.
    pub grid_times: Vec<(Time, Time)>,
    /// The grid with all changes.
    pub grid: Option<OccupancyGrid>,
    /// The last grid that was sent as a whole, and how the one before had become by changes.
    pub whole_grid: Option<(OccupancyGrid, Option<OccupancyGrid>)>,
    pub updates: usize,
    /// What was around, one after the other.
    pub local_maps: Vec<OccupancyGrid>,
    pub local_tree: Option<Octomap>,
    pub large: Option<Octomap>,
    pub binary: Option<Octomap>,
    pub full: Option<Octomap>,
    /// How many came of the last one.
    pub trees: usize,
    pub cells: Option<PointCloud2>,
    pub points: usize,
    pub path: Option<Path>,
    pub diagnostics: Option<DiagnosticArray>,
    /// What the node has said.
    pub log: Vec<Log>,
    /// What nav2 would not take of grids and their changes.
    pub wrong: Vec<String>,
}

impl Heard {
    /// A fact of the last diagnostics.
    pub fn fact(&self, key: &str) -> Option<&str> {
        let facts = &self.diagnostics.as_ref()?.status[0].values;
        let fact = facts.iter().find(|fact| fact.key == key)?;
        Some(&fact.value)
    }

    /// A number among the facts of the last diagnostics; 0 where there is none.
    pub fn count(&self, key: &str) -> u64 {
        self.fact(key).map_or(0, |value| value.parse().unwrap())
    }

    /// Images of which it is known what became of them.
    pub fn accounted(&self) -> u64 {
        let dropped = self.count("images dropped (busy)") + self.count("images lost on the way");
        self.count("images processed") + self.count("images of no use") + dropped
    }

    /// Whether a message of the log begins so.
    pub fn has_said(&self, level: u8, text: &str) -> bool {
        let mut log = self.log.iter();
        log.any(|log| log.level == level && log.name == "monogrid" && log.msg.starts_with(text))
    }

    /// Notes what of a grid nav2 would not take.
    pub fn check_grid(&mut self, grid: &OccupancyGrid) {
        let (info, origin) = (&grid.info, &grid.info.origin);
        let (place, turn) = (origin.position, origin.orientation);
        let is_wrong = [
            ("frame", grid.header.frame_id != "map"),
            ("stamp", !is_of_now(grid.header.stamp)),
            ("map_load_time", !is_of_now(info.map_load_time)),
            (
                "resolution",
                !(info.resolution > 0.0 && info.resolution.is_finite()),
            ),
            ("size", info.width == 0 || info.height == 0),
            (
                "cells",
                grid.data.len() != info.width as usize * info.height as usize,
            ),
            (
                "values",
                !grid.data.iter().all(|cell| (-1..=100).contains(cell)),
            ),
            (
                "place",
                !(place.x.is_finite() && place.y.is_finite() && place.z == 0.0),
            ),
            (
                "turn",
                [turn.x, turn.y, turn.z, turn.w] != [0.0, 0.0, 0.0, 1.0],
            ),
        ];
        let wrong = is_wrong.iter().filter(|(_, is_wrong)| *is_wrong);
        self.wrong
            .extend(wrong.map(|(what, _)| format!("{what} of a grid: {info:?}")));
    }

    /// Notes what of a change nav2 would not take, in the grid that it has.
    pub fn check_update(&mut self, update: &OccupancyGridUpdate) {
        let Some(grid) = &self.grid else {
            return self.wrong.push("a change before its grid".to_owned());
        };
        let (width, height) = (i64::from(update.width), i64::from(update.height));
        let ends = [i64::from(update.x) + width, i64::from(update.y) + height];
        let is_inside = update.x >= 0
            && update.y >= 0
            && ends[0] <= i64::from(grid.info.width)
            && ends[1] <= i64::from(grid.info.height);
        let is_wrong = [
            ("frame", update.header.frame_id != "map"),
            ("stamp", !is_of_now(update.header.stamp)),
            ("order", update.header.stamp < grid.header.stamp),
            ("place", !is_inside),
            (
                "cells",
                update.data.len() as i64 != width * height || update.data.is_empty(),
            ),
            (
                "values",
                !update.data.iter().all(|cell| (-1..=100).contains(cell)),
            ),
        ];
        let wrong = is_wrong.iter().filter(|(_, is_wrong)| *is_wrong);
        let place = (update.x, update.y, width, height);
        self.wrong
            .extend(wrong.map(|(what, _)| format!("{what} of a change: {place:?}")));
    }

    fn take_grid(&mut self, grid: OccupancyGrid) {
        self.check_grid(&grid);
        self.grid_times.push((grid.header.stamp, now()));
        self.whole_grid = Some((grid.clone(), self.grid.replace(grid)));
    }

    fn take_update(&mut self, update: &OccupancyGridUpdate) {
        self.check_update(update);
        self.grid_times.push((update.header.stamp, now()));
        self.updates += 1;
        let grid = self.grid.as_mut().unwrap();
        for (row, cells) in update.data.chunks(update.width as usize).enumerate() {
            let first = (update.y as usize + row) * grid.info.width as usize + update.x as usize;
            grid.data[first..first + cells.len()].copy_from_slice(cells);
        }
    }
}

/// Whether a time is one of the last minutes: neither unset nor of the future.
fn is_of_now(time: Time) -> bool {
    let age_ns = now().nanoseconds() - time.nanoseconds();
    time.nanosec < 1_000_000_000 && (0..600_000_000_000).contains(&age_ns)
}

/// Listens in a thread of its own.
pub struct Listening {
    heard: Arc<std::sync::Mutex<Heard>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Listening {
    /// To all topics of the node.
    pub fn start(domain: u16) -> Self {
        let heard = Arc::new(std::sync::Mutex::new(Heard::default()));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = {
            let (heard, stop) = (Arc::clone(&heard), Arc::clone(&stop));
            thread::spawn(move || listen(domain, &heard, &stop))
        };
        Self {
            heard,
            stop,
            thread: Some(thread),
        }
    }

    /// What was heard until now.
    pub fn heard<R>(&self, look: impl FnOnce(&Heard) -> R) -> R {
        look(&self.heard.lock().unwrap())
    }

    /// Waits until something is so.
    pub fn wait_until(&self, what: &str, mut is_so: impl FnMut(&Heard) -> bool) {
        let begin = Instant::now();
        while !self.heard(&mut is_so) {
            let diagnostics = self.heard(|heard| format!("{:?}", heard.diagnostics));
            assert!(begin.elapsed() < PATIENCE, "{what}: {diagnostics}");
            thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// All messages that have come on a topic.
fn all<M: RosMessage + 'static>(topic: &Subscription<M>) -> Vec<M> {
    std::iter::from_fn(|| topic.take().ok().flatten().map(|(message, _)| message)).collect()
}

fn hear<M: RosMessage + 'static>(
    node: &mut RosNode,
    on: &str,
    quality: Quality,
) -> Subscription<M> {
    node.subscription(on, quality).unwrap()
}

fn listen(domain: u16, heard: &std::sync::Mutex<Heard>, stop: &AtomicBool) {
    let context = connect_to(domain, true).unwrap();
    let mut node = RosNode::new(&context, "/", "listener", NodeOptions::new()).unwrap();
    let odometry = hear::<Odometry>(&mut node, "odom", Quality::Stream);
    let tf = hear::<TFMessage>(&mut node, "/tf", Quality::Stream);
    let tf_static = hear::<TFMessage>(&mut node, "/tf_static", Quality::Latched);
    let grid = hear::<OccupancyGrid>(&mut node, "map", Quality::Latched);
    let updates = hear::<OccupancyGridUpdate>(&mut node, "map_updates", Quality::Stream);
    let local_map = hear::<OccupancyGrid>(&mut node, "local_map", Quality::Stream);
    let local_tree = hear::<Octomap>(&mut node, "local_octomap", Quality::Stream);
    let large = hear::<Octomap>(&mut node, "large_octomap", Quality::Latched);
    let binary = hear::<Octomap>(&mut node, "octomap_binary", Quality::Latched);
    let full = hear::<Octomap>(&mut node, "octomap_full", Quality::Latched);
    let cells = hear::<PointCloud2>(&mut node, "octomap_point_cloud_centers", Quality::Latched);
    let points = hear::<PointCloud2>(&mut node, "points", Quality::Stream);
    let path = hear::<Path>(&mut node, "path", Quality::Latched);
    let diagnostics = hear::<DiagnosticArray>(&mut node, "/diagnostics", Quality::Stream);
    let log = hear::<Log>(&mut node, "/rosout", Quality::Log);
    while !stop.load(Ordering::Relaxed) {
        thread::sleep(LOOK_EVERY);
        let mut heard = heard.lock().unwrap();
        let arrived = now();
        heard
            .odometry
            .extend(all(&odometry).into_iter().map(|o| (o, arrived)));
        heard.log.extend(all(&log));
        heard.tf.extend(all(&tf));
        heard.tf_static.extend(all(&tf_static));
        // grids before their changes, as the node sends them
        all(&grid)
            .into_iter()
            .for_each(|grid| heard.take_grid(grid));
        all(&updates)
            .iter()
            .for_each(|update| heard.take_update(update));
        heard.points += all(&points).len();
        heard.local_maps.extend(all(&local_map));
        heard.local_tree = all(&local_tree).pop().or(heard.local_tree.take());
        heard.large = all(&large).pop().or(heard.large.take());
        heard.binary = all(&binary).pop().or(heard.binary.take());
        let mut trees = all(&full);
        heard.trees += trees.len();
        heard.full = trees.pop().or(heard.full.take());
        heard.cells = all(&cells).pop().or(heard.cells.take());
        heard.path = all(&path).pop().or(heard.path.take());
        heard.diagnostics = all(&diagnostics).pop().or(heard.diagnostics.take());
    }
}

/// A camera that sends images, and asks for services.
pub struct Robot {
    _context: Context,
    images: Outlet<Image>,
    readings: Outlet<Imu>,
    infos: Outlet<CameraInfo>,
    tf: Outlet<TFMessage>,
    clock: Outlet<Clock>,
    services: BTreeMap<&'static str, Client<Wire<TriggerRequest>, Wire<TriggerResponse>>>,
    parameters: Client<SetParametersRequest, SetParametersResponse>,
    _node: RosNode,
}

impl Robot {
    pub fn start(domain: u16) -> Self {
        let context = connect_to(domain, true).unwrap();
        let mut node = RosNode::new(&context, "/", "robot", NodeOptions::new()).unwrap();
        let images = node
            .publisher("/camera/image_raw", Quality::Stream)
            .unwrap();
        let readings = node.publisher("/imu/data", Quality::Stream).unwrap();
        let infos = node
            .publisher("/camera/camera_info", Quality::Latched)
            .unwrap();
        let tf = node.publisher("/tf", Quality::Stream).unwrap();
        let clock = node.publisher("/clock", Quality::Stream).unwrap();
        let services = ["start", "stop", "save", "reset", "load"].map(|name| {
            let full = format!("/monogrid/{name}");
            (name, client(&mut node, &full, ("std_srvs", "Trigger")))
        });
        let set = ("rcl_interfaces", "SetParameters");
        let parameters = client(&mut node, "/monogrid/set_parameters", set);
        Self {
            _context: context,
            images,
            readings,
            infos,
            tf,
            clock,
            services: services.into(),
            parameters,
            _node: node,
        }
    }

    /// Says what the camera is.
    pub fn send_info(&self, camera: &Camera) {
        let pinhole = camera.pinhole;
        let d = match camera.distortion {
            Distortion::None => vec![0.0; 5],
            Distortion::RadialTangential { k1, k2, p1, p2, k3 } => vec![k1, k2, p1, p2, k3],
            other => panic!("{other:?} is no plumb_bob"),
        };
        let [fx, fy, cx, cy] = [pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy];
        let info = CameraInfo {
            width: camera.width as u32,
            height: camera.height as u32,
            distortion_model: "plumb_bob".into(),
            d,
            k: [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
            ..CameraInfo::default()
        };
        assert!(self.infos.publish(info));
    }

    /// Sends a reading of the inertial sensor, at a time.
    pub fn send_reading(&self, stamp: Time, reading: &ImuSample) {
        let vector = |v: &Vec3| Vector3 {
            x: v.x,
            y: v.y,
            z: v.z,
        };
        let header = Header {
            stamp,
            frame_id: "imu".into(),
        };
        let message = Imu {
            header,
            angular_velocity: vector(&reading.angular_velocity),
            linear_acceleration: vector(&reading.specific_force),
            ..Imu::default()
        };
        assert!(self.readings.publish(message));
    }

    /// Says where the base is by the wheels.
    pub fn send_odometry(&self, stamp: Time, odom_from_base: &Se3) {
        let frame_id = "odom".into();
        let transform = transform_of(Header { stamp, frame_id }, "base_link", odom_from_base);
        let transforms = vec![transform];
        assert!(self.tf.publish(TFMessage { transforms }));
    }

    /// Says what time it is in a simulation.
    pub fn send_clock(&self, sec: i32) {
        let clock = Time { sec, nanosec: 0 };
        assert!(self.clock.publish(Clock { clock }));
    }

    /// Sends an image as it is now.
    pub fn send_image(&self, image: &Picture<u8>) -> Time {
        self.send_image_of(now(), image)
    }

    /// Sends an image of a time.
    pub fn send_image_of(&self, stamp: Time, image: &Picture<u8>) -> Time {
        let message = Image {
            header: Header {
                stamp,
                frame_id: "camera_optical".into(),
            },
            height: image.height() as u32,
            width: image.width() as u32,
            encoding: "mono8".into(),
            is_bigendian: 0,
            step: image.width() as u32,
            data: image.as_slice().to_vec(),
        };
        assert!(self.images.publish(message));
        stamp
    }

    /// Asks for the map in files; the folder.
    pub fn save(&self) -> Result<String, String> {
        self.call("save")
    }

    /// Calls a service.
    pub fn call(&self, service: &str) -> Result<String, String> {
        let Wire(response) = ask(&self.services[service], Wire(TriggerRequest::default()));
        if response.success {
            Ok(response.message)
        } else {
            Err(response.message)
        }
    }

    /// Sets the parameter of the scale.
    pub fn set_scale(&self, metres_per_unit: f64) -> Result<(), String> {
        self.set("metres_per_unit", ParameterValue::Double(metres_per_unit))
    }

    /// Sets a parameter, as `ros2 param set` does.
    pub fn set(&self, name: &str, value: ParameterValue) -> Result<(), String> {
        let parameter = Parameter {
            name: name.into(),
            value,
        };
        let request = SetParametersRequest {
            parameter: vec![parameter.into()],
        };
        let response = ask(&self.parameters, request);
        let result = response.results[0].clone();
        if result.successful {
            Ok(())
        } else {
            Err(result.reason)
        }
    }
}

fn client<Request, Response>(
    node: &mut RosNode,
    name: &str,
    (package, kind): (&str, &str),
) -> Client<Request, Response>
where
    Request: Message + Clone + 'static,
    Response: Message + 'static,
{
    let qos = QosProfile::publisher_default();
    node.node
        .create_client(
            ServiceMapping::Enhanced,
            &Name::parse(name).unwrap(),
            &ServiceTypeName::new(package, kind),
            qos.clone(),
            qos,
        )
        .unwrap()
}

fn ask<Request, Response>(client: &Client<Request, Response>, request: Request) -> Response
where
    Request: Message + Clone + 'static,
    Response: Message + 'static,
{
    client.send_request(request).unwrap();
    let begin = Instant::now();
    loop {
        if let Ok(Some((_, response))) = client.receive_response() {
            return response;
        }
        assert!(begin.elapsed() < PATIENCE, "the service does not answer");
        thread::sleep(LOOK_EVERY);
    }
}

/// Latencies by stamp, ms.
pub fn latencies(pairs: impl Iterator<Item = (Time, Time)>) -> Vec<f64> {
    let latency =
        |(sent, arrived): (Time, Time)| (arrived.nanoseconds() - sent.nanoseconds()) as f64 * 1e-6;
    let mut latencies: Vec<f64> = pairs.map(latency).collect();
    latencies.sort_unstable_by(f64::total_cmp);
    latencies
}

/// Distinct stamps only, the first arrival of each.
pub fn first_arrivals(pairs: &[(Time, Time)]) -> BTreeMap<Time, Time> {
    let mut first = BTreeMap::new();
    for (stamp, arrived) in pairs {
        first.entry(*stamp).or_insert(*arrived);
    }
    first
}
