//! The node in a process of its own, real messages between: images at 30 Hz, and all that comes
//! back.
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test may panic and talk"
)]

mod robot;

use monogrid_datasets::{
    Dataset, ReadOptions, Recording, SourceOptions, read_gray, read_trajectory,
};
use monogrid_geometry::{Camera, Se3, Vec3, align_similarity};
use monogrid_image::{GrayImage, Image};
use monogrid_inertial::ImuSample;
use monogrid_messages::builtin_interfaces::Time;
use monogrid_messages::geometry_msgs::{Pose, Transform};
use monogrid_messages::map_msgs::OccupancyGridUpdate;
use monogrid_messages::nav_msgs::OccupancyGrid;
use monogrid_messages::rcl_interfaces::{DEBUG, ERROR, INFO, WARN};
use monogrid_messages::std_srvs::{TriggerRequest, TriggerResponse};
use monogrid_messages::tf2_msgs::TFMessage;
use monogrid_ros2::convert::{MAX_MESSAGE_BYTES, pose_of_transform};
use monogrid_ros2::frames::mount;
use monogrid_ros2::node::connect_to;
use monogrid_worlds::{
    CameraPath, Carrier, ImuConfig, LightingConfig, SynthConfig, SynthSequence, Waypoint, World,
    imu_samples,
};
use robot::wheels::{Wheels, alternating, two_wheels};
use robot::{Heard, Listening, Node, Robot, first_arrivals, latencies, now};
use ros2_client::ParameterValue;
use ros2_client::dds::rustdds::{QosPolicyBuilder, TopicDescription, TopicKind, policy};
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU16, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// A domain that other tests of this computer hardly use at the same time.
fn domain() -> u16 {
    static USED: AtomicU16 = AtomicU16::new(0);
    100 + (std::process::id() % 50) as u16 * 2 + USED.fetch_add(1, Ordering::Relaxed)
}

/// A camera and what it sees.
struct Film {
    camera: Camera,
    images: Vec<Image<u8>>,
}

impl Film {
    /// The beginning of a built-in world.
    fn rendered(sequence: &SynthSequence, count: usize) -> Self {
        let frames = (0..count).map_while(|k| sequence.frame(k));
        Self {
            camera: *sequence.camera(),
            images: frames.map(|frame| bytes(&frame.image)).collect(),
        }
    }

    /// A sequence on disk with its calibration.
    fn read(folder: &Path) -> Self {
        let dataset = Dataset::open(folder, SourceOptions::default()).unwrap();
        let calibration = dataset.calibration(None).unwrap().unwrap();
        let images = dataset.frames.iter();
        Self {
            camera: calibration.camera,
            images: images
                .map(|frame| bytes(&read_gray(&frame.path).unwrap()))
                .collect(),
        }
    }

    /// The images forth and back and so on.
    fn forth_and_back(&self) -> impl Iterator<Item = &Image<u8>> {
        let last = self.images.len() - 1;
        let back = (1..last).rev();
        (0..=last).chain(back).cycle().map(|k| &self.images[k])
    }
}

fn bytes(image: &GrayImage) -> Image<u8> {
    image.map(|grey| grey.round() as u8)
}

/// What happened while images were sent.
struct Sent {
    stamps: Vec<Time>,
    cpu_seconds: f64,
}

/// Sends images at 30 Hz, and the calibration before and in between.
fn send(robot: &Robot, node: &Node, film: &Film, count: usize) -> Sent {
    let interval = Duration::from_nanos(1_000_000_000 / 30);
    for _ in 0..5 {
        robot.send_info(&film.camera);
        thread::sleep(Duration::from_millis(100));
    }
    let (begin, cpu) = (Instant::now(), node.cpu_seconds());
    let mut stamps = Vec::with_capacity(count);
    for (index, image) in film.forth_and_back().take(count).enumerate() {
        let due = interval * index as u32;
        thread::sleep(due.saturating_sub(begin.elapsed()));
        if index % 30 == 0 {
            robot.send_info(&film.camera);
        }
        stamps.push(robot.send_image(image));
    }
    Sent {
        stamps,
        cpu_seconds: node.cpu_seconds() - cpu,
    }
}

/// CPU time of the node without images, in cores.
fn idle_load(node: &Node, seconds: u64) -> f64 {
    let before = node.cpu_seconds();
    thread::sleep(Duration::from_secs(seconds));
    (node.cpu_seconds() - before) / seconds as f64
}

/// A run of the node over some images.
struct Loopback {
    heard: Listening,
    robot: Robot,
    node: Node,
    folder: tempfile::TempDir,
}

impl Loopback {
    fn start(more: &[&str]) -> Self {
        let domain = domain();
        let folder = tempfile::tempdir().unwrap();
        let parent = folder.path().display().to_string();
        let arguments = [
            "--save-dir",
            &parent,
            "--map-period",
            "0.2",
            "--threads",
            "2",
        ];
        let node = Node::start(domain, &[&arguments, more].concat());
        let (heard, robot) = (Listening::start(domain), Robot::start(domain));
        heard.wait_until("the node says that it waits", |heard| {
            let array = heard.diagnostics.as_ref();
            array.is_some_and(|array| array.status[0].message.contains("no image"))
        });
        // the other topics find each other at the same time
        thread::sleep(Duration::from_secs(2));
        Self {
            heard,
            robot,
            node,
            folder,
        }
    }

    /// Sends all images, waits until it is known what became of each, and checks all that came
    /// back.
    fn run(&mut self, film: &Film, count: usize) -> Sent {
        let sent = send(&self.robot, &self.node, film, count);
        self.heard
            .wait_until("all images are accounted for", |heard| {
                heard.accounted() == count as u64
            });
        assert!(self.node.is_running());
        // the mapper gives way to everybody else on a busy computer
        self.heard.wait_until("maps arrive", |heard| {
            let trees = [&heard.binary, &heard.full, &heard.large, &heard.local_tree];
            let is_there = trees.iter().all(|tree| tree.is_some()) && heard.cells.is_some();
            is_there && heard.grid.is_some() && heard.path.is_some() && heard.points > 0
        });
        self.heard.heard(|heard| {
            poses_are_those_of_a_robot(heard);
            what_is_around_is_said_often(heard);
            messages_are_small(heard);
            assert_eq!(
                heard.wrong,
                [] as [String; 0],
                "nav2 takes all grids and changes"
            );
            assert!(heard.has_said(INFO, "calibration: "), "{:?}", heard.log);
            assert!(
                heard.has_said(WARN, "good; scale unknown"),
                "{:?}",
                heard.log
            );
            // a grid that comes often is sent as changes in between
            assert!(heard.updates > 0 || heard.grid_times.len() < 10);
        });
        sent
    }

    /// The files of the service are what was published.
    fn save(&self) {
        let folder = self.robot.save().unwrap();
        assert!(Path::new(&folder).starts_with(self.folder.path().canonicalize().unwrap()));
        self.heard
            .wait_until("the map is that of the files", |heard| {
                is_saved(heard, Path::new(&folder))
            });
        self.heard.heard(|heard| {
            let trajectory = fs::read_to_string(Path::new(&folder).join("trajectory.txt")).unwrap();
            let saved = trajectory
                .lines()
                .filter(|line| !line.starts_with('#'))
                .count();
            assert!(saved >= heard.odometry.len() / 2, "{saved} poses");
        });
    }
}

/// Five or six maps of what is around come in a second, in the frame of odometry.
fn what_is_around_is_said_often(heard: &Heard) {
    let maps = &heard.local_maps;
    let stamps = || {
        heard
            .odometry
            .iter()
            .map(|(odometry, _)| odometry.header.stamp)
    };
    let [first, last] = [stamps().min(), stamps().max()].map(|stamp| stamp.unwrap().nanoseconds());
    let rate = maps.len() as f64 / ((last - first) as f64 * 1e-9);
    println!("{rate:.1} local maps in a second");
    // on a busy computer some are passed over
    assert!(rate > 2.0 && rate < 7.0, "{rate} local maps in a second");
    let is_later = |pair: &[OccupancyGrid]| pair[0].header.stamp < pair[1].header.stamp;
    assert!(maps.windows(2).all(is_later));
    for map in maps {
        assert_eq!(map.header.frame_id, "odom");
    }
    let last = maps.last().unwrap();
    assert!(last.data.contains(&100), "no obstacle is around");
    // within three units of the camera, in multiples of 64 cells
    let side = |cells: u32| f64::from(cells) * f64::from(last.info.resolution);
    let most = 6.0 + 2.0 * 64.0 * f64::from(last.info.resolution);
    assert!(side(last.info.width) < most && side(last.info.height) < most);
    assert_eq!(heard.local_tree.as_ref().unwrap().header.frame_id, "odom");
    assert_eq!(heard.large.as_ref().unwrap().header.frame_id, "map");
}

/// Odometry never jumps; the transforms of an image are those of one tree.
fn poses_are_those_of_a_robot(heard: &Heard) {
    let position = |pose: &Pose| [pose.position.x, pose.position.y, pose.position.z];
    let odometry = &heard.odometry;
    // on a busy computer images are dropped
    assert!(
        odometry.len() > 30,
        "{} poses: {:?}",
        odometry.len(),
        heard.diagnostics
    );
    let length: f64 = odometry
        .windows(2)
        .map(|pair| {
            let [a, b] = [0, 1].map(|k| position(&pair[k].0.pose.pose));
            let step = (0..3)
                .map(|axis| (b[axis] - a[axis]).powi(2))
                .sum::<f64>()
                .sqrt();
            let gap = pair[1].0.header.stamp.nanoseconds() - pair[0].0.header.stamp.nanoseconds();
            assert!(gap > 0);
            // a hand moves at most by a part of the depth of the scene, which is about 1, in a
            // thirtieth of a second
            assert!(
                step < 0.15 * (gap as f64 / 33e6).max(1.0),
                "a step of {step}"
            );
            step
        })
        .sum();
    assert!(length > 0.3, "the camera moved by {length}");
    assert_eq!(odometry[0].0.header.frame_id, "odom");
    // nobody knows how long a unit is
    assert_eq!(odometry[0].0.pose.covariance[0][0], 1e6);
    assert_eq!(odometry[0].0.twist.covariance[0][0], 1e6);
    assert_eq!(odometry[0].0.child_frame_id, "base_link");
    assert_eq!(heard.tf.len(), odometry.len());
    for (tf, (odometry, _)) in heard.tf.iter().zip(odometry) {
        let [map, odom] = &tf.transforms[..] else {
            panic!("two transforms");
        };
        assert_eq!(
            (map.header.frame_id.as_str(), map.child_frame_id.as_str()),
            ("map", "odom")
        );
        assert_eq!(
            (odom.header.frame_id.as_str(), odom.child_frame_id.as_str()),
            ("odom", "base_link")
        );
        assert_eq!(odom.header.stamp, odometry.header.stamp);
        assert!(is_same(&odom.transform, &odometry.pose.pose));
    }
    let mount = &heard.tf_static[0].transforms[0];
    assert_eq!(
        (
            mount.header.frame_id.as_str(),
            mount.child_frame_id.as_str()
        ),
        ("base_link", "camera_optical")
    );
}

fn is_same(transform: &Transform, pose: &Pose) -> bool {
    let (t, p) = (&transform.translation, &pose.position);
    [t.x, t.y, t.z] == [p.x, p.y, p.z] && transform.rotation == pose.orientation
}

fn messages_are_small(heard: &Heard) {
    let sizes = [
        heard.grid.as_ref().map_or(0, |grid| grid.data.len()),
        heard.binary.as_ref().map_or(0, |tree| tree.data.len()),
        heard.full.as_ref().map_or(0, |tree| tree.data.len()),
        heard.cells.as_ref().map_or(0, |cloud| cloud.data.len()),
    ];
    assert!(
        sizes
            .iter()
            .all(|size| (1..MAX_MESSAGE_BYTES).contains(size)),
        "{sizes:?}"
    );
    let path = heard.path.as_ref().unwrap();
    assert!(path.poses.len() > 1 && path.header.frame_id == "map");
}

/// Whether what was heard last is what stands in the files.
fn is_saved(heard: &Heard, folder: &Path) -> bool {
    let file = |name: &str| fs::read(folder.join(name)).unwrap();
    let Some((grid, _)) = &heard.whole_grid else {
        return false;
    };
    let trees = [(&heard.binary, "global.bt"), (&heard.full, "global.ot")];
    pgm_of(grid) == file("map.pgm")
        && trees.into_iter().all(|(tree, name)| {
            let file = file(name);
            tree.as_ref()
                .is_some_and(|tree| file.ends_with(&tree.data) && has_body(&file, tree.data.len()))
        })
}

/// Whether the header of the file ends where a body of this length begins.
fn has_body(file: &[u8], length: usize) -> bool {
    file[..file.len() - length].ends_with(b"\ndata\n")
}

/// A grid as the map server's file.
fn pgm_of(grid: &OccupancyGrid) -> Vec<u8> {
    let mut pgm = format!("P5\n{} {}\n255\n", grid.info.width, grid.info.height).into_bytes();
    for row in grid.data.chunks(grid.info.width as usize).rev() {
        pgm.extend(row.iter().map(|cell| match cell {
            0 => 254,
            100 => 0,
            -1 => 205,
            other => panic!("a cell of {other}"),
        }));
    }
    pgm
}

#[test]
fn ten_seconds_of_a_small_camera() {
    let film = Film::rendered(&SynthSequence::small_demo().unwrap(), 150);
    let mut loopback = Loopback::start(&[]);
    loopback.run(&film, 300);
    let changed = loopback.heard.heard(|heard| heard.grid.clone()).unwrap();
    loopback.save();
    // the grid that came by changes is the one that came as a whole
    loopback.heard.heard(|heard| {
        let (whole, before) = heard.whole_grid.as_ref().unwrap();
        let before = before.as_ref().unwrap_or(&changed);
        if before.info == whole.info && before.header.stamp == whole.header.stamp {
            assert_eq!(before.data, whole.data);
        }
    });
    let is_saved = |heard: &Heard| heard.has_said(INFO, "map saved: ");
    loopback.heard.wait_until("saving is said", is_saved);
    let no_level = |heard: &Heard| !heard.log.iter().any(|log| log.level == DEBUG);
    assert!(loopback.heard.heard(no_level));
    a_scale_makes_everything_longer(&loopback);
    a_reset_begins_a_new_map(&loopback, &film.images[0]);
    assert!(loopback.node.interrupt());
}

/// A robot that is stopped, saves its map, and finds itself in it later: in the same node, and in
/// one that must not change it.
#[test]
fn a_saved_map_is_loaded_and_the_camera_is_found_in_it() {
    let film = Film::rendered(&SynthSequence::small_demo().unwrap(), 150);
    let mut loopback = Loopback::start(&[]);
    let stamps = loopback.run(&film, 300).stamps;
    loopback.robot.set_scale(2.5).unwrap();
    a_stopped_node_keeps_its_map(&loopback, &film.images[0]);
    let folder = loopback.robot.save().unwrap();
    nothing_is_loaded_that_is_no_map(&loopback);
    // what was told of the world before has nothing to do with the map, which says it itself
    loopback.robot.set_scale(0.0).unwrap();
    let path = ParameterValue::String(folder.clone());
    loopback.robot.set("load_path", path).unwrap();
    let said = loopback.robot.call("load").unwrap();
    assert!(said.contains("keyframes in"), "{said}");
    the_camera_is_found(&loopback, &film, Path::new(&folder), &stamps);
    // it is a run like any other
    let again = loopback.robot.save().unwrap();
    let keyframes = |folder: &str| {
        let file = Path::new(folder).join("recording.mgk");
        let recording = Recording::read(&file, ReadOptions::default()).unwrap();
        let sessions = recording.continuation.unwrap().sessions.len();
        (recording.keyframes.len(), sessions)
    };
    let ((before, one), (after, two)) = (keyframes(&folder), keyframes(&again));
    assert!(before > 0 && after >= before && (one, two) == (1, 2));
    assert!(loopback.node.interrupt());
    let frozen = Loopback::start(&["--load-path", &folder, "--localise-only"]);
    the_camera_is_found(&frozen, &film, Path::new(&folder), &stamps);
    let made = frozen.heard.heard(|heard| heard.count("keyframes"));
    assert_eq!(made, before as u64, "the map stays as it is");
}

fn a_stopped_node_keeps_its_map(loopback: &Loopback, image: &Image<u8>) {
    let (robot, heard) = (&loopback.robot, &loopback.heard);
    let counts = |heard: &Heard| ["images received", "images processed"].map(|k| heard.count(k));
    let says = |text: &'static str| {
        move |heard: &Heard| {
            let array = heard.diagnostics.as_ref();
            array.is_some_and(|array| array.status[0].message.starts_with(text))
        }
    };
    robot.call("stop").unwrap();
    heard.wait_until("it says so", says("stopped"));
    let [received, processed] = heard.heard(counts);
    robot.send_image(image);
    let came = |heard: &Heard| counts(heard)[0] > received;
    heard.wait_until("the image comes", came);
    thread::sleep(Duration::from_secs(1));
    assert_eq!(heard.heard(counts)[1], processed, "it is not taken");
    assert!(heard.heard(|heard| says("stopped")(heard) && heard.count("keyframes") > 0));
    robot.call("start").unwrap();
    heard.wait_until("it says so", says("started"));
    robot.send_image(image);
    heard.wait_until("the next one is taken", |heard| {
        counts(heard)[1] == processed + 1
    });
}

fn nothing_is_loaded_that_is_no_map(loopback: &Loopback) {
    let refused = loopback.robot.call("load").unwrap_err();
    assert!(refused.contains("load_path"), "{refused}");
    let number = loopback.robot.set("load_path", ParameterValue::Integer(1));
    assert!(number.is_err(), "a number is no folder");
    let nowhere = ParameterValue::String("/nowhere".into());
    loopback.robot.set("load_path", nowhere).unwrap();
    let refused = loopback.robot.call("load").unwrap_err();
    assert!(refused.contains("/nowhere"), "{refused}");
    assert!(loopback.heard.heard(|heard| heard.count("keyframes") > 0));
}

/// The camera is where it was when the map was made, in the map's frame and metres.
fn the_camera_is_found(loopback: &Loopback, film: &Film, folder: &Path, stamps: &[Time]) {
    let saved = read_trajectory(&folder.join("trajectory.txt")).unwrap();
    let heard = &loopback.heard;
    let (before, grids) = heard.heard(|heard| (heard.tf.len(), heard.grid_times.len()));
    let last = film.images.len() - 1;
    let count = 2 * last;
    let sent = send(&loopback.robot, &loopback.node, film, count);
    heard.wait_until("the camera is found in a map of metres", |heard| {
        let is_metric = heard.fact("metres per unit") == Some("2.5");
        is_metric && heard.tf.len() > before + count / 8
    });
    // the mapper gives way to everybody else on a busy computer
    heard.wait_until("the map arrives", |heard| {
        heard.grid_times.len() > grids && heard.full.is_some()
    });
    let apart = heard.heard(|heard| {
        let poses = heard.tf[before..].iter().filter_map(|tf| {
            let stamp = tf.transforms[0].header.stamp;
            let k = sent.stamps.iter().position(|sent| *sent == stamp)?;
            // forth, and back
            let then = stamps[last - last.abs_diff(k)].nanoseconds();
            let there = saved.iter().find(|pose| pose.timestamp_ns == then)?;
            let [map_from_odom, odom_from_base] =
                [0, 1].map(|k| pose_of_transform(&tf.transforms[k].transform).unwrap());
            let map_from_camera = map_from_odom * odom_from_base * mount([0.0; 3], [0.0; 3]);
            Some((map_from_camera.translation - there.world_from_camera.translation).norm())
        });
        let mut apart: Vec<f64> = poses.collect();
        apart.sort_unstable_by(f64::total_cmp);
        apart
    });
    let [median, most] = [apart[apart.len() / 2], apart[apart.len() - 1]];
    println!(
        "{} poses, apart by {median:.3} m, at most {most:.3} m",
        apart.len()
    );
    assert!(apart.len() > count / 16 && median < 0.05, "{median} m");
}

/// What the tests with a run look at can be wrong.
#[test]
fn grids_and_changes_that_nav2_would_not_take_are_noticed() {
    let mut grid = OccupancyGrid::default();
    grid.header.frame_id = "map".into();
    grid.header.stamp = now();
    grid.info.map_load_time = now();
    grid.info.resolution = 0.05;
    (grid.info.width, grid.info.height) = (3, 2);
    grid.data = vec![0, -1, 100, 0, 0, 0];
    let mut update = OccupancyGridUpdate {
        header: grid.header.clone(),
        x: 1,
        y: 1,
        width: 2,
        height: 1,
        data: vec![0, 100],
    };
    let grid_wrong = |change: fn(&mut OccupancyGrid)| {
        let (mut heard, mut grid) = (Heard::default(), grid.clone());
        change(&mut grid);
        heard.check_grid(&grid);
        heard.wrong.len()
    };
    assert_eq!(grid_wrong(|_| {}), 0);
    for change in [
        |grid: &mut OccupancyGrid| grid.header.frame_id.clear(),
        |grid: &mut OccupancyGrid| grid.header.stamp.sec += 60,
        |grid: &mut OccupancyGrid| grid.info.map_load_time = Time::default(),
        |grid: &mut OccupancyGrid| grid.info.resolution = 0.0,
        |grid: &mut OccupancyGrid| grid.info.width += 1,
        |grid: &mut OccupancyGrid| grid.data[0] = 101,
        |grid: &mut OccupancyGrid| grid.info.origin.position.z = 0.1,
        |grid: &mut OccupancyGrid| grid.info.origin.orientation.x = 0.1,
    ] {
        assert_eq!(grid_wrong(change), 1);
    }
    let mut heard = Heard::default();
    heard.check_update(&update);
    assert_eq!(heard.wrong.len(), 1, "there is no grid");
    heard = Heard {
        grid: Some(grid),
        ..Heard::default()
    };
    heard.check_update(&update);
    assert_eq!(heard.wrong.len(), 0);
    update.x = 2;
    heard.check_update(&update);
    assert_eq!(heard.wrong.len(), 1, "it ends beside the grid");
}

/// Without a listener no map is kept for one: the middleware kept all of them, and sent them all.
#[test]
fn who_comes_late_gets_one_map() {
    let film = Film::rendered(&SynthSequence::small_demo().unwrap(), 150);
    let domain = domain();
    // what is heard as `map` has another name in the node
    let renamed = ["--ros-args", "-r", "__ns:=/robot", "-r", "map:=/map"];
    let others = [
        "path",
        "octomap_full",
        "octomap_binary",
        "octomap_point_cloud_centers",
    ];
    let others = others.map(|topic| ["-r".to_owned(), format!("{topic}:=/{topic}")]);
    let others: Vec<&str> = others.iter().flatten().map(String::as_str).collect();
    // time is that of a simulation, and names of keyframes are said
    let simulated = [
        "-p",
        "use_sim_time:=true",
        "--log-level",
        "robot.monogrid:=debug",
    ];
    let options = ["--map-period", "0.2", "--threads", "2"];
    let mut node = Node::start(
        domain,
        &[&options[..], &renamed, &others, &simulated].concat(),
    );
    let robot = Robot::start(domain);
    thread::sleep(Duration::from_secs(2));
    send(&robot, &node, &film, 150);
    let heard = Listening::start(domain);
    heard.wait_until("maps arrive", |heard| {
        heard.full.is_some() && heard.cells.is_some() && heard.grid.is_some()
    });
    // the next ones would come later
    thread::sleep(Duration::from_secs(2));
    heard.heard(|heard| {
        let grids = heard.grid_times.len() - heard.updates;
        assert_eq!((heard.trees, grids), (1, 1));
    });
    a_clock_that_jumps_back_begins_a_new_map(&heard, &robot, &film);
    assert!(node.interrupt());
}

#[test]
fn an_answer_waits_for_whoever_asked() {
    let domain = domain();
    let mut node = Node::start(domain, &[]);
    let participant = connect_to(domain, true).unwrap().domain_participant();
    let qos = QosPolicyBuilder::new()
        .reliability(policy::Reliability::Reliable {
            max_blocking_time: Duration::from_secs(1).into(),
        })
        .history(policy::History::KeepLast { depth: 10 })
        .build();
    let topic = |name: &str, kind: &str| {
        let (name, kind) = (name.to_owned(), format!("std_srvs::srv::dds_::{kind}"));
        let made = participant.create_topic(name, kind, &qos, TopicKind::NoKey);
        made.unwrap()
    };
    let requests = topic("rq/monogrid/saveRequest", "Trigger_Request_");
    let publisher = participant.create_publisher(&qos).unwrap();
    let writer = publisher
        .create_datawriter_no_key_cdr::<TriggerRequest>(&requests, None)
        .unwrap();
    let is_offered = || {
        let readers = participant.discovered_readers();
        let mut topics = readers
            .iter()
            .map(|r| r.subscription_topic_data.topic_name());
        topics.any(|topic| *topic == requests.name())
    };
    let begin = Instant::now();
    while !is_offered() {
        assert!(begin.elapsed() < Duration::from_secs(20));
        thread::sleep(Duration::from_millis(10));
    }
    // until the writer has taken it up
    thread::sleep(Duration::from_millis(500));
    writer.write(TriggerRequest::default(), None).unwrap();
    // the request comes, and who reads the answer is not known yet
    thread::sleep(Duration::from_millis(200));
    let replies = topic("rr/monogrid/saveReply", "Trigger_Response_");
    let subscriber = participant.create_subscriber(&qos).unwrap();
    let mut reader = subscriber
        .create_datareader_no_key_cdr::<TriggerResponse>(&replies, None)
        .unwrap();
    let begin = Instant::now();
    let answer = loop {
        if let Ok(Some(answer)) = reader.take_next_sample() {
            break answer.into_value();
        }
        assert!(begin.elapsed() < Duration::from_secs(10), "no answer");
        thread::sleep(Duration::from_millis(10));
    };
    assert!(!answer.success && answer.message.contains("no map yet"));
    assert!(node.interrupt());
}

fn a_clock_that_jumps_back_begins_a_new_map(heard: &Listening, robot: &Robot, film: &Film) {
    let is_at = |sec| {
        move |heard: &Heard| {
            let array = heard.diagnostics.as_ref();
            array.is_some_and(|array| array.header.stamp.sec == sec)
        }
    };
    heard.wait_until("time waits for the clock", is_at(0));
    robot.send_clock(100);
    heard.wait_until("time is that of the clock", is_at(100));
    for image in film.images.iter().skip(1).rev() {
        robot.send_image(image);
        thread::sleep(Duration::from_millis(33));
    }
    let says = |heard: &Heard, level, text: &str| {
        let mut log = heard.log.iter();
        log.any(|log| log.level == level && log.name == "robot.monogrid" && log.msg.contains(text))
    };
    heard.wait_until("keyframes are said", |heard| {
        says(heard, DEBUG, "keyframe ")
    });
    assert!(heard.heard(|heard| heard.count("keyframes")) > 0);
    robot.send_clock(50);
    heard.wait_until("a new map begins", |heard| {
        heard.count("keyframes") == 0 && says(heard, WARN, "/clock has jumped back")
    });
}

/// A camera and an inertial sensor of which neither sits straight: the map is in metres, and its z
/// is up.
#[test]
fn an_inertial_sensor_makes_the_map_metric_and_level() {
    let sequence = SynthSequence::small_demo().unwrap();
    let film = Film::rendered(&sequence, 240);
    let sensor = ImuConfig::default();
    let readings = imu_samples(sequence.path(), &sensor, 0, 8.2);
    let folder = tempfile::tempdir().unwrap();
    let mount = folder.path().join("mount.txt");
    fs::write(&mount, written(&sensor.camera_from_imu.inverse())).unwrap();
    let mut loopback = Loopback::start(&[
        "--imu",
        "/imu/data",
        "--imu-from-camera",
        mount.to_str().unwrap(),
        // the base is tilted against the camera, and knows nothing of gravity
        "--base-from-camera",
        "0,0,0,0.1,0.2,0",
    ]);
    let begin_ns = send_with_readings(&loopback.robot, &film, &readings);
    let heard = &loopback.heard;
    heard.wait_until("all images are accounted for", |heard| {
        heard.accounted() == film.images.len() as u64
    });
    heard.wait_until("the map is metric", |heard| {
        let scale = heard.fact("metres per unit");
        scale.is_some_and(|scale| scale.parse::<f64>().is_ok())
    });
    assert!(heard.heard(|heard| heard.count("inertial readings")) > 1000);
    let folder = loopback.robot.save().unwrap();
    let yaml = fs::read_to_string(Path::new(&folder).join("map.yaml")).unwrap();
    assert!(!yaml.contains("WARNING"), "{yaml}");
    let path = sequence.path();
    let truth = |ns: i64| path.world_from_camera((ns - begin_ns) as f64 * 1e-9);
    let saved = read_trajectory(&Path::new(&folder).join("trajectory.txt")).unwrap();
    let places = saved.iter().map(|pose| {
        let truth = truth(pose.timestamp_ns);
        (pose.world_from_camera.translation, truth.translation)
    });
    let (found, truth): (Vec<Vec3>, Vec<Vec3>) = places.unzip();
    let truth_from_map = align_similarity(&found, &truth, true)
        .unwrap()
        .target_from_source;
    let up = truth_from_map.rotation * Vec3::z();
    let (scale, tilt) = (truth_from_map.scale, up.angle(&Vec3::z()).to_degrees());
    assert!(scale.ln().abs() < 0.05 && tilt < 2.0, "{scale} {tilt}");
    assert!(loopback.node.interrupt());
}

/// A hand carries the camera, beside wheels that are wrong by 2 % now and then, and spin once.
#[test]
fn beside_an_odometry_the_map_is_metric_and_nothing_else_is_said() {
    let sequence = SynthSequence::small_demo().unwrap();
    let film = Film::rendered(&sequence, 240);
    let drive = Drive {
        film: &film,
        path: sequence.path(),
        mount: [[0.0; 3]; 2],
        wheels: alternating,
    };
    let said = drive.map_is_in_metres();
    let apart = said[said.len() - 1];
    assert!(apart < 0.05, "{apart} m");
}

/// A robot on two wheels that slip drives along a corridor; its camera looks ahead and to the left.
#[test]
#[ignore = "takes minutes: scripts/ros2_loopback.sh"]
fn a_robot_on_two_wheels_that_slip_has_a_map_in_metres() {
    const FRAMES: usize = 900;
    let mount = [[0.2, 0.0, 0.5], [0.0, 0.0, 0.5]];
    // 15 m in half a minute, weaving
    let place = |x: f64| Vec3::new(x, 1.0 + 0.25 * (0.9 * x).sin(), 0.5);
    let waypoints = (0..=30).map(|k| {
        let x = 2.5 + 0.5 * f64::from(k);
        let heading = (0.25 * 0.9 * (0.9 * x).cos()).atan() + mount[1][2];
        let looked_at = place(x) + 3.0 * Vec3::new(heading.cos(), heading.sin(), 0.0);
        (place(x).into(), looked_at.into())
    });
    let waypoints: Vec<Waypoint> = waypoints.collect();
    let path = CameraPath::scripted(&waypoints, Carrier::Rails, FRAMES as f64 / 30.0, 0).unwrap();
    let world = World::by_name_with("corridor-loop", &LightingConfig::quick()).unwrap();
    let config = SynthConfig {
        frames: FRAMES,
        ..SynthConfig::small()
    };
    let sequence = SynthSequence::new(Arc::new(world), path.clone(), config).unwrap();
    let film = Film::rendered(&sequence, FRAMES);
    let drive = Drive {
        film: &film,
        path: &path,
        mount,
        wheels: two_wheels,
    };
    let mut said = drive.map_is_in_metres();
    said.sort_unstable_by(f64::total_cmp);
    let (median, most) = (said[said.len() / 2], said[said.len() - 1]);
    println!("the robot is where it is in the map to {median:.3} m, at most {most:.3} m");
    assert!(median < 0.1 && most < 0.5, "{median} m, {most} m");
}

/// A robot with wheels and a camera.
struct Drive<'a> {
    film: &'a Film,
    path: &'a CameraPath,
    /// Where the camera sits on the base: place and angles.
    mount: [[f64; 3]; 2],
    wheels: Wheels,
}

impl Drive<'_> {
    fn base_from_camera(&self) -> Se3 {
        mount(self.mount[0], self.mount[1])
    }

    /// Drives, and checks that the map is in metres, that nothing is said of odometry but where it
    /// begins, and that nav2 takes the grids. How far the robot was said to be from where it is, in
    /// the map, for each time that it was said.
    fn map_is_in_metres(&self) -> Vec<f64> {
        let numbers = self.mount.as_flattened().iter().map(f64::to_string);
        let mount = numbers.collect::<Vec<_>>().join(",");
        let loopback = Loopback::start(&["--odometry", "odom", "--base-from-camera", &mount]);
        let (robot, heard) = (&loopback.robot, &loopback.heard);
        let wheels = self.send(robot);
        let begin_ns = wheels[0].0.nanoseconds();
        heard.wait_until("all images are accounted for", |heard| {
            heard.accounted() == self.film.images.len() as u64
        });
        heard.wait_until("the map is metric", |heard| {
            let scale = heard.fact("metres per unit");
            scale.is_some_and(|scale| scale.parse::<f64>().is_ok()) && heard.full.is_some()
        });
        let folder = robot.save().unwrap();
        let saved = read_trajectory(&Path::new(&folder).join("trajectory.txt")).unwrap();
        let true_pose = |ns: i64| {
            let secs = (ns - begin_ns) as f64 * 1e-9;
            self.path.world_from_camera(secs)
        };
        let places = saved.iter().map(|pose| {
            let truth = true_pose(pose.timestamp_ns).translation;
            (pose.world_from_camera.translation, truth)
        });
        let (found, truth): (Vec<Vec3>, Vec<Vec3>) = places.unzip();
        let aligned = align_similarity(&found, &truth, true).unwrap();
        let scale = aligned.target_from_source.scale;
        println!(
            "a metre of the map is {scale:.4} m, of {} poses",
            saved.len()
        );
        assert!(scale.ln().abs() < 0.02, "{scale}");
        let said = heard.heard(|heard| {
            is_of_metres(heard);
            let said = corrections(heard, &wheels);
            let there = said.iter().map(|(ns, map_from_base)| {
                let found = (*map_from_base * self.base_from_camera()).translation;
                let found = aligned.target_from_source * found;
                (found - true_pose(*ns).translation).norm()
            });
            there.collect()
        });
        let mut node = loopback.node;
        assert!(node.interrupt());
        said
    }

    /// Sends images at 30 Hz with the odometry of wheels, which is returned.
    fn send(&self, robot: &Robot) -> Vec<(Time, Se3)> {
        let camera_from_base = self.base_from_camera().inverse();
        let true_base = |k: usize| self.path.world_from_camera(k as f64 / 30.0) * camera_from_base;
        let mut wheels: Vec<(Time, Se3)> = Vec::new();
        for _ in 0..5 {
            robot.send_info(&self.film.camera);
            thread::sleep(Duration::from_millis(100));
        }
        let (clock, begin_ns) = (Instant::now(), now().nanoseconds());
        for (k, image) in self.film.images.iter().enumerate() {
            let ns = k as i64 * 1_000_000_000 / 30;
            let due = Duration::from_nanos(ns as u64);
            thread::sleep(due.saturating_sub(clock.elapsed()));
            let stamp = Time::from_nanoseconds(begin_ns + ns);
            let odom_from_base = wheels.last().map_or(Se3::identity(), |(_, last)| {
                let step = true_base(k - 1).inverse() * true_base(k);
                *last * (self.wheels)(k, &step)
            });
            wheels.push((stamp, odom_from_base));
            robot.send_odometry(stamp, &odom_from_base);
            robot.send_image_of(stamp, image);
        }
        wheels
    }
}

/// Whether the node says of its lengths how sure they are, and its grids are those of nav2.
fn is_of_metres(heard: &Heard) {
    let deviation = heard.fact("its standard error by wheels, %").unwrap();
    let deviation: f64 = deviation.parse().unwrap();
    println!("and should be right to {deviation} %");
    assert!(deviation > 0.0 && deviation < 2.0, "{deviation} %");
    assert!(heard.odometry.is_empty(), "another odometry");
    assert_eq!(heard.wrong, [] as [String; 0], "nav2 takes all grids");
    let grid = heard.grid.as_ref().unwrap();
    assert!(grid.data.contains(&100) && grid.data.contains(&0));
}

/// Where the robot was said to be in the map, map_from_base, and when (ns): by where its odometry
/// was said to begin, and that odometry, which nobody else says anything of.
fn corrections(heard: &Heard, wheels: &[(Time, Se3)]) -> Vec<(i64, Se3)> {
    let is_of_map = |tf: &&TFMessage| tf.transforms[0].header.frame_id == "map";
    let said: Vec<&TFMessage> = heard.tf.iter().filter(is_of_map).collect();
    assert!(said.iter().all(|tf| tf.transforms.len() == 1));
    assert!(
        heard.tf.len() - said.len() <= wheels.len(),
        "odom -> base_link of two"
    );
    let poses = said.iter().map(|tf| {
        let transform = &tf.transforms[0];
        assert_eq!(transform.child_frame_id, "odom");
        let stamp = transform.header.stamp;
        let by_wheels = wheels.iter().find(|(time, _)| *time == stamp).unwrap();
        let map_from_odom = pose_of_transform(&transform.transform).unwrap();
        (stamp.nanoseconds(), map_from_odom * by_wheels.1)
    });
    let poses: Vec<(i64, Se3)> = poses.collect();
    assert!(poses.len() > wheels.len() / 4, "said {} times", poses.len());
    poses
}

/// A transform as a line of a file.
fn written(transform: &Se3) -> String {
    let (t, q) = (transform.translation, transform.rotation);
    let numbers = [t.x, t.y, t.z, q.i, q.j, q.k, q.w];
    numbers.map(|number| number.to_string()).join(" ")
}

/// Sends images at 30 Hz, and the readings of their times after them; the time of the first one,
/// ns.
fn send_with_readings(robot: &Robot, film: &Film, readings: &[ImuSample]) -> i64 {
    for _ in 0..5 {
        robot.send_info(&film.camera);
        thread::sleep(Duration::from_millis(100));
    }
    let (clock, begin_ns) = (Instant::now(), now().nanoseconds());
    let at = |ns: i64| Time::from_nanoseconds(begin_ns + ns);
    let mut readings = readings.iter().peekable();
    for (k, image) in film.images.iter().enumerate() {
        let image_ns = k as i64 * 1_000_000_000 / 30;
        let due = Duration::from_nanos(image_ns as u64);
        thread::sleep(due.saturating_sub(clock.elapsed()));
        robot.send_image_of(at(image_ns), image);
        while let Some(reading) = readings.next_if(|r| r.timestamp_ns <= image_ns + 5_000_000) {
            robot.send_reading(at(reading.timestamp_ns), reading);
        }
    }
    begin_ns
}

fn a_scale_makes_everything_longer(loopback: &Loopback) {
    let refused = loopback.robot.set_scale(-1.0).unwrap_err();
    assert!(refused.contains("metres_per_unit"), "{refused}");
    let before = loopback
        .heard
        .heard(|heard| heard.grid.as_ref().unwrap().info.resolution);
    // nobody has told it until now
    let unknown = loopback
        .heard
        .heard(|heard| heard.fact("metres per unit").map(str::to_owned));
    assert!(unknown.unwrap().contains("unknown"));
    loopback.robot.set_scale(2.5).unwrap();
    loopback
        .heard
        .wait_until("the grid has longer cells", |heard| {
            (heard.grid.as_ref().unwrap().info.resolution - 2.5 * before).abs() < 1e-6
        });
    loopback.save();
}

fn a_reset_begins_a_new_map(loopback: &Loopback, image: &Image<u8>) {
    loopback.robot.call("reset").unwrap();
    loopback.heard.wait_until("the node begins again", |heard| {
        heard.count("keyframes") == 0
    });
    let refused = loopback.robot.save().unwrap_err();
    assert!(refused.contains("no map yet"), "{refused}");
    let is_refused = |heard: &Heard| heard.has_said(ERROR, "no map saved: ");
    loopback.heard.wait_until("that is said", is_refused);
    // time may begin again too
    loopback.robot.send_image(image);
    loopback.heard.wait_until("it initialises", |heard| {
        let array = heard.diagnostics.as_ref().unwrap();
        array.status[0].message.starts_with("initialising")
    });
    // a recording that begins again needs no reset
    let counts = |heard: &Heard| {
        (
            heard.count("images processed"),
            heard.count("images of no use"),
        )
    };
    let (processed, useless) = loopback.heard.heard(counts);
    let earlier = Time::from_nanoseconds(now().nanoseconds() - 10_000_000_000);
    loopback.robot.send_image_of(earlier, image);
    let so_far = (processed + 1, useless);
    let is_taken = |heard: &Heard| counts(heard) == so_far;
    loopback
        .heard
        .wait_until("the earlier image is taken", is_taken);
    let is_said = |heard: &Heard| heard.has_said(WARN, "the times of images have jumped back");
    loopback.heard.wait_until("that is said", is_said);
}

/// The bar of a robot: 60 s of the sequence in the folder that `LOOPBACK_SEQUENCE` names. Prints
/// what `BENCHMARKS.md` says.
#[test]
#[ignore = "takes minutes: scripts/ros2_loopback.sh"]
fn a_minute_of_a_camera() {
    let film = match std::env::var("LOOPBACK_SEQUENCE") {
        Ok(folder) => Film::read(Path::new(&folder)),
        Err(_) => Film::rendered(&SynthSequence::demo().unwrap(), 600),
    };
    let mut loopback = Loopback::start(&[]);
    let idle = idle_load(&loopback.node, 10);
    let sent = loopback.run(&film, 1800);
    loopback.save();
    loopback.heard.heard(|heard| {
        println!("images sent {}", sent.stamps.len());
        for status in &heard.diagnostics.as_ref().unwrap().status {
            status
                .values
                .iter()
                .for_each(|fact| println!("{} {}", fact.key, fact.value));
        }
        let odometry = heard
            .odometry
            .iter()
            .map(|(o, arrived)| (o.header.stamp, *arrived));
        print_latency("image to pose", &latencies(odometry));
        let grids = first_arrivals(&heard.grid_times);
        print_latency("image to grid", &latencies(grids.into_iter()));
    });
    println!("idle, share of a core {idle:.4}");
    println!("busy, share of a core {:.2}", sent.cpu_seconds / 60.0);
    assert!(idle < 0.02, "the node idles at {idle} of a core");
}

fn print_latency(what: &str, latencies: &[f64]) {
    let at = |share: f64| latencies[((latencies.len() - 1) as f64 * share).round() as usize];
    println!(
        "{what}, ms: p50 {:.1}, p99 {:.1}, of {}",
        at(0.5),
        at(0.99),
        latencies.len()
    );
}
