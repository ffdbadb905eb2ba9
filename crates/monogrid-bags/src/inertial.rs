//! The inertial sensor beside the camera: its readings in a recording, and where the camera sits on
//! it.

use crate::bag::Bag;
use crate::convert::{imu_sample_of, pose_of_transform};
use crate::error::BagError;
use crate::message::Raw;
use crate::topic::{Family, Topic, TopicKind};
use monogrid_geometry::Se3;
use monogrid_inertial::ImuSample;
use monogrid_messages::sensor_msgs::Imu;
use monogrid_messages::std_msgs::Header;
use monogrid_messages::tf2_msgs::TFMessage;
use std::collections::{BTreeMap, VecDeque};

/// Readings of a topic.
#[derive(Clone, Debug)]
pub struct Readings {
    /// Its name.
    pub topic: String,
    /// In the order of the recording, on the clock of the headers.
    pub samples: Vec<ImuSample>,
    /// Where the camera sits on the sensor, by the transforms that do not change (`/tf_static`),
    /// where these say it.
    pub imu_from_camera: Option<Se3>,
    /// What the frames of the sensor and of the camera are called.
    pub frames: [String; 2],
}

/// Poses of frames in other ones: parent, child, parent_from_child.
#[derive(Debug, Default)]
struct Tree(BTreeMap<(String, String), Se3>);

impl Tree {
    fn add(&mut self, message: TFMessage) {
        for stamped in message.transforms {
            if let Some(pose) = pose_of_transform(&stamped.transform) {
                let frames = (
                    named(&stamped.header.frame_id),
                    named(&stamped.child_frame_id),
                );
                self.0.insert(frames, pose);
            }
        }
    }

    /// from_to along the fewest transforms, whichever way they go.
    fn between(&self, from: &str, to: &str) -> Option<Se3> {
        let mut known = BTreeMap::from([(from.to_owned(), Se3::identity())]);
        let mut waiting = VecDeque::from([from.to_owned()]);
        while let Some(frame) = waiting.pop_front() {
            let from_frame = *known.get(&frame)?;
            if frame == to {
                return Some(from_frame);
            }
            for ((parent, child), parent_from_child) in &self.0 {
                let (next, frame_from_next) = match (&frame == parent, &frame == child) {
                    (true, _) => (child, *parent_from_child),
                    (_, true) => (parent, parent_from_child.inverse()),
                    _ => continue,
                };
                if !known.contains_key(next) {
                    known.insert(next.clone(), from_frame * frame_from_next);
                    waiting.push_back(next.clone());
                }
            }
        }
        None
    }
}

/// The name of a frame; ROS 1 let it begin with a slash.
fn named(frame: &str) -> String {
    frame.trim_start_matches('/').to_owned()
}

/// How many parts the names of two topics have in common at their beginning.
fn kinship(a: &str, b: &str) -> usize {
    let pairs = a.split('/').zip(b.split('/'));
    pairs.take_while(|(a, b)| a == b).count()
}

impl Bag {
    /// The readings that belong to a topic of images: those of the topic that is named, else of the
    /// one whose name has most in common with it and that has both angular velocities and forces.
    /// Damage ends them.
    ///
    /// # Errors
    /// A topic that is named and not there; says which there are.
    pub fn readings(
        &self,
        images: &Topic,
        name: Option<&str>,
    ) -> Result<Option<Readings>, BagError> {
        let sensors = self.topics().iter().filter(|t| t.kind == TopicKind::Imu);
        let names: Vec<&str> = sensors.map(|topic| topic.name.as_str()).collect();
        if let Some(name) = name.filter(|name| !names.contains(name)) {
            let there = names.join(", ");
            let reason = format!("no inertial readings of {name}: there are {there:?}");
            return Err(BagError::damaged(self.path(), reason));
        }
        if names.is_empty() {
            return Ok(None);
        }
        let mut gathered = Gathered::default();
        for message in self.messages().map_while(Result::ok) {
            gathered.take(&message, images);
        }
        let wanted = |sensor: &&Sensor| name.is_none_or(|name| sensor.topic == name);
        let usable = gathered.sensors.values().filter(|s| s.has_both());
        let sensor = usable.filter(wanted).max_by(|a, b| {
            // of equals the first by name
            let kinships = [a, b].map(|sensor| kinship(&sensor.topic, &images.name));
            kinships[0].cmp(&kinships[1]).then(b.topic.cmp(&a.topic))
        });
        let Some(sensor) = sensor else {
            return Ok(None);
        };
        let camera = gathered.camera_frame.unwrap_or_default();
        let imu_from_camera = match sensor.frame.is_empty() || camera.is_empty() {
            true => None,
            false => gathered.tree.between(&sensor.frame, &camera),
        };
        Ok(Some(Readings {
            topic: sensor.topic.clone(),
            samples: sensor.stamped(),
            imu_from_camera,
            frames: [sensor.frame.clone(), camera],
        }))
    }
}

/// What is known of a sensor.
#[derive(Debug)]
struct Sensor {
    topic: String,
    frame: String,
    /// Readings, and when they were recorded, ns.
    samples: Vec<(ImuSample, i64)>,
}

impl Sensor {
    /// Whether it has a gyroscope and an accelerometer: some drivers have a topic for each, with
    /// zeros for the other.
    fn has_both(&self) -> bool {
        let has = |value: fn(&ImuSample) -> f64| self.samples.iter().any(|(s, _)| value(s) != 0.0);
        has(|s| s.angular_velocity.amax()) && has(|s| s.specific_force.amax())
    }

    /// Readings with the times of recording where the driver sets none, as for images.
    fn stamped(&self) -> Vec<ImuSample> {
        let has_stamps = self
            .samples
            .iter()
            .take(2)
            .any(|(s, _)| s.timestamp_ns != 0);
        let stamped = self.samples.iter().map(|(sample, log_ns)| ImuSample {
            timestamp_ns: if has_stamps {
                sample.timestamp_ns
            } else {
                *log_ns
            },
            ..*sample
        });
        stamped.collect()
    }
}

/// What one reading of all messages gives.
#[derive(Debug, Default)]
struct Gathered {
    sensors: BTreeMap<String, Sensor>,
    tree: Tree,
    camera_frame: Option<String>,
}

impl Gathered {
    fn take(&mut self, message: &Raw, images: &Topic) {
        let topic = &message.topic;
        match topic.kind {
            TopicKind::Imu => {
                let Ok(imu) = message.content::<Imu>() else {
                    return;
                };
                let sensor = self.sensors.entry(topic.name.clone());
                let sensor = sensor.or_insert_with(|| Sensor {
                    topic: topic.name.clone(),
                    frame: named(&imu.header.frame_id),
                    samples: Vec::new(),
                });
                let sample = imu_sample_of(&imu);
                sensor
                    .samples
                    .extend(sample.map(|sample| (sample, message.log_ns)));
            }
            TopicKind::Transforms if topic.name.ends_with("tf_static") => {
                if let Ok(transforms) = message.content() {
                    self.tree.add(transforms);
                }
            }
            _ if self.camera_frame.is_none()
                && topic.name == images.name
                && topic.family == Family::Ros =>
            {
                // every message of ROS with a time begins with its header
                let header = message.content::<Header>();
                self.camera_frame = header.ok().map(|header| named(&header.frame_id));
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monogrid_geometry::{Vec3, rotation_exp};

    #[test]
    fn frames_are_found_over_others_and_against_the_arrows() {
        let mut tree = Tree::default();
        let turned = Se3::new(
            rotation_exp(&Vec3::new(0.0, 0.0, 1.0)),
            Vec3::new(1.0, 0.0, 0.0),
        );
        let moved = Se3::new(Default::default(), Vec3::new(0.0, 2.0, 0.0));
        let mut add = |parent: &str, child: &str, pose: Se3| {
            tree.0.insert((parent.to_owned(), child.to_owned()), pose);
        };
        add("base", "imu", turned);
        add("base", "camera", moved);
        add("camera", "optical", turned);
        add("map", "base", moved);
        let expected = turned.inverse() * moved * turned;
        let found = tree.between("imu", "optical").unwrap();
        assert!((found.translation - expected.translation).norm() < 1e-12);
        assert!(found.rotation.angle_to(&expected.rotation) < 1e-12);
        assert!(tree.between("imu", "elsewhere").is_none());
        let itself = tree.between("imu", "imu").unwrap();
        assert!(itself.translation.norm() == 0.0);
    }

    #[test]
    fn names_are_kin_by_what_they_begin_with() {
        assert!(kinship("/left/imu", "/left/image") > kinship("/right/imu", "/left/image"));
        assert_eq!(kinship("/imu0", "/cam0/image_raw"), 1);
        assert_eq!(named("/imu"), "imu");
    }
}
