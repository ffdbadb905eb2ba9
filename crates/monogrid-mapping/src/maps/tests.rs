use super::{LiveMaps, LocalMap, Mapper, Maps};
use crate::{KeyframeCamera, KeyframeScan, MappingConfig, z_up_from_camera_world};
use monogrid_geometry::{Pinhole, Rotation, Sim3, Vec3};
use monogrid_occupancy::{Occupancy, OccupancyMap, write_ot};
use monogrid_slam::{DepthPixel, PoseSnapshot};
use std::sync::Arc;
use std::sync::atomic::AtomicUsize;

const CAMERA: KeyframeCamera = KeyframeCamera {
    pinhole: Pinhole {
        fx: 40.0,
        fy: 40.0,
        cx: 31.5,
        cy: 23.5,
    },
    width: 64,
    height: 48,
};

fn config() -> MappingConfig {
    MappingConfig {
        resolution: 0.1,
        ..MappingConfig::default()
    }
}

/// A wall two units before the camera, in units of half that length.
fn wall(id: u32) -> KeyframeScan {
    let pixels: Vec<DepthPixel> = (0..CAMERA.height as u16)
        .flat_map(|y| (0..CAMERA.width as u16).map(move |x| (x, y)))
        .map(|(x, y)| DepthPixel {
            x,
            y,
            idepth: 1.0,
            idepth_var: 1e-4,
        })
        .collect();
    KeyframeScan::new(id, &pixels, None, &CAMERA, &config())
}

fn pose(x: f64) -> Sim3 {
    Sim3::new(2.0, Rotation::identity(), Vec3::new(x, 0.0, 0.0))
}

fn bytes(map: &OccupancyMap) -> Vec<u8> {
    let mut out = Vec::new();
    write_ot(map, &mut out).unwrap();
    out
}

fn finished(last: &[Sim3], threads: usize) -> Maps {
    let mapper = Mapper::new(config(), threads);
    let z_up = z_up_from_camera_world();
    let mut live = LiveMaps::new(mapper, z_up).unwrap();
    for (id, x) in [(0, 0.0), (1, 0.3)] {
        live.add(wall(id), pose(x)).unwrap();
    }
    let snapshot = PoseSnapshot {
        revision: 1,
        world_from_keyframe: last.to_vec(),
        ..PoseSnapshot::default()
    };
    live.finish(
        &Arc::new(snapshot),
        &z_up,
        Some(Vec3::zeros()),
        threads,
        &AtomicUsize::new(0),
    )
    .unwrap()
}

#[test]
fn a_wall_ahead_of_the_camera_is_ahead_and_upright_in_the_map() {
    let maps = finished(&[pose(0.0), pose(0.3)], 1);
    // x forward, y left, z up
    assert_eq!(maps.global.state([2.05, 0.0, 0.0]), Occupancy::Occupied);
    assert_eq!(maps.global.state([1.0, 0.0, 0.0]), Occupancy::Free);
    assert_eq!(maps.global.state([3.0, 0.0, 0.0]), Occupancy::Unknown);
    // the second keyframe is to the right: y < 0
    let right_edge = 2.0 * 31.0 / 40.0 + 0.2;
    assert_eq!(
        maps.global.state([2.05, -right_edge, 0.0]),
        Occupancy::Occupied
    );
    assert_eq!(
        maps.global.state([2.05, right_edge, 0.0]),
        Occupancy::Unknown
    );
    assert!(maps.stats.points > 4000 && maps.stats.keyframes == 2);
}

#[test]
fn the_global_map_follows_the_poses_and_the_large_one_does_not() {
    let unmoved = finished(&[pose(0.0), pose(0.3)], 1);
    assert_eq!(bytes(&unmoved.global), bytes(&unmoved.large));
    let moved = finished(&[pose(0.0), pose(0.6)], 2);
    assert_eq!(bytes(&moved.large), bytes(&unmoved.large));
    assert_ne!(bytes(&moved.global), bytes(&unmoved.global));
    // always what a build from scratch gives
    let mapper = Mapper::new(config(), 1);
    let (scratch, stats) = mapper
        .build(
            &[wall(0), wall(1)],
            &[Some(pose(0.0)), Some(pose(0.6))],
            &z_up_from_camera_world(),
        )
        .unwrap();
    assert_eq!(bytes(&moved.global), bytes(&scratch));
    assert_eq!(moved.stats, stats);
}

#[test]
fn the_local_map_is_the_part_of_the_global_one_around_the_camera() {
    let mut config = config();
    config.local_radius = 1.5;
    let mapper = Mapper::new(config, 1);
    let z_up = z_up_from_camera_world();
    let mut live = LiveMaps::new(mapper, z_up).unwrap();
    live.add(wall(0), pose(0.0)).unwrap();
    let snapshot = PoseSnapshot {
        revision: 1,
        world_from_keyframe: vec![pose(0.0)],
        ..PoseSnapshot::default()
    };
    let maps = live
        .finish(
            &Arc::new(snapshot),
            &z_up,
            Some(Vec3::zeros()),
            1,
            &AtomicUsize::new(0),
        )
        .unwrap();
    for point in [[1.0, 0.05, 0.05], [0.5, 0.05, 0.05]] {
        assert_eq!(maps.local.log_odds(point), maps.global.log_odds(point));
    }
    assert_eq!(maps.global.state([2.05, 0.05, 0.05]), Occupancy::Occupied);
    assert_eq!(maps.local.state([2.05, 0.05, 0.05]), Occupancy::Unknown);
}

#[test]
fn a_map_around_the_camera_stays_as_odometry_has_it() {
    let config = MappingConfig {
        local_radius: 4.0,
        ..config()
    };
    let mut local = LocalMap::new(Mapper::new(config, 1)).unwrap();
    let take = |local: &mut LocalMap, id, x: f64, unit| {
        let pose = Sim3 {
            scale: unit,
            ..pose(x)
        };
        local.take(wall(id), pose, Vec3::new(x, 0.0, 0.0)).unwrap()
    };
    let at = |x: f64, z: f64| [x, 0.05, z];
    let first = take(&mut local, 0, 0.0, 2.0);
    assert_eq!(first.state(at(0.05, 2.05)), Occupancy::Occupied);
    // the graph has found another unit for the keyframe: what was seen stays where it is
    let corrected = take(&mut local, 0, 0.0, 1.5);
    assert_eq!(bytes(&corrected), bytes(&first));
    // the next keyframe has the new unit
    let next = take(&mut local, 1, 2.5, 1.5);
    assert_eq!(next.state(at(0.05, 2.05)), Occupancy::Occupied);
    assert_eq!(next.state(at(2.55, 1.55)), Occupancy::Occupied);
    // what lies behind the radius is left, and does not come back with the camera
    let far = take(&mut local, 2, 9.0, 1.5);
    assert_eq!(far.state(at(9.05, 1.55)), Occupancy::Occupied);
    assert_eq!(far.state(at(0.05, 2.05)), Occupancy::Unknown);
    let back = take(&mut local, 3, 0.0, 3.0);
    assert_eq!(back.state(at(0.05, 2.05)), Occupancy::Free);
    assert_eq!(back.state(at(2.55, 1.55)), Occupancy::Unknown);
}

/// A generator of numbers in [0, 1).
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, end: usize) -> usize {
        (self.unit() * end as f64) as usize
    }

    /// A pose in a small room.
    fn pose(&mut self) -> Sim3 {
        let mut vector = |size: f64| Vec3::from_fn(|_, _| size * (self.unit() - 0.5));
        let (turn, shift) = (vector(1.0), vector(1.0));
        Sim3::new(1.0 + self.unit(), Rotation::from_scaled_axis(turn), shift)
    }

    /// A surface with bumps and holes.
    fn scan(&mut self, id: u32) -> KeyframeScan {
        let mut pixels = Vec::new();
        for y in (0..CAMERA.height as u16).step_by(2) {
            for x in (0..CAMERA.width as u16).step_by(2) {
                if self.unit() < 0.8 {
                    pixels.push(DepthPixel {
                        x,
                        y,
                        idepth: (0.7 + 0.05 * self.unit() + f64::from(x) * 0.004) as f32,
                        idepth_var: 2e-4,
                    });
                }
            }
        }
        let config = MappingConfig {
            filter: MappingConfig::thesis().filter,
            ..config()
        };
        KeyframeScan::new(id, &pixels, None, &CAMERA, &config)
    }
}

/// What a run tells its maps, and how often they got to work in between.
struct History {
    scans: Vec<KeyframeScan>,
    first: Vec<Sim3>,
    /// Poses after each keyframe, the last of all included.
    snapshots: Vec<Arc<PoseSnapshot>>,
    /// Better depth of an old keyframe, after which keyframe it comes.
    revised: (usize, KeyframeScan),
}

impl History {
    /// Every keyframe moves with every keyframe that comes, as after a loop closure.
    fn new(random: &mut Random) -> Self {
        let scans: Vec<_> = (0..6).map(|id| random.scan(id)).collect();
        let mut snapshots = Vec::new();
        let mut first = Vec::new();
        for newest in 0..=scans.len() {
            let count = (newest + 1).min(scans.len());
            let poses: Vec<Sim3> = (0..count).map(|_| random.pose()).collect();
            first.extend(poses.get(first.len()));
            snapshots.push(Arc::new(PoseSnapshot {
                revision: newest as u64 + 1,
                world_from_keyframe: poses,
                ..PoseSnapshot::default()
            }));
        }
        Self {
            revised: (3, random.scan(1)),
            scans,
            first,
            snapshots,
        }
    }

    fn last(&self) -> &Arc<PoseSnapshot> {
        &self.snapshots[self.scans.len()]
    }

    /// Depths at the end.
    fn final_scans(&self) -> Vec<KeyframeScan> {
        let mut scans = self.scans.clone();
        scans[1] = self.revised.1.clone();
        scans
    }

    /// Plays the history with `steps(i)` steps after keyframe i, which stand for the time there
    /// was.
    fn play(
        &self,
        threads: usize,
        steps: &mut dyn FnMut() -> usize,
        frame: &Sim3,
        mut look: impl FnMut(&mut LiveMaps, usize),
    ) -> Maps {
        let config = MappingConfig {
            follow_threshold: 0.0,
            ..config()
        };
        let mapper = Mapper::new(config, threads);
        let mut live = LiveMaps::new(mapper, z_up_from_camera_world()).unwrap();
        for (i, scan) in self.scans.iter().enumerate() {
            live.add(scan.clone(), self.first[i]).unwrap();
            live.follow(Arc::clone(&self.snapshots[i])).unwrap();
            if i == self.revised.0 {
                live.revise(self.revised.1.clone());
            }
            look(&mut live, i);
            for _ in 0..steps() {
                live.step().unwrap();
                look(&mut live, i);
            }
        }
        live.finish(
            self.last(),
            frame,
            Some(Vec3::zeros()),
            threads,
            &AtomicUsize::new(0),
        )
        .unwrap()
    }
}

fn from_scratch(scans: &[KeyframeScan], poses: &[Sim3], frame: &Sim3) -> OccupancyMap {
    let poses: Vec<Option<Sim3>> = poses.iter().copied().map(Some).collect();
    let mapper = Mapper::new(config(), 1);
    mapper.build(scans, &poses, frame).unwrap().0
}

#[test]
fn after_every_keyframe_has_moved_the_maps_are_those_built_from_scratch_for_any_timing() {
    let z_up = z_up_from_camera_world();
    for seed in 0..12 {
        let mut random = Random(seed);
        let history = History::new(&mut random);
        let final_poses = &history.last().world_from_keyframe;
        let global = from_scratch(&history.final_scans(), final_poses, &z_up);
        let large = from_scratch(&history.final_scans(), &history.first, &z_up);
        assert_ne!(bytes(&global), bytes(&large));
        let mut timings: [Box<dyn FnMut() -> usize>; 3] = [
            Box::new(|| 0),
            Box::new(|| 1000),
            Box::new(|| random.below(9)),
        ];
        for (timing, steps) in timings.iter_mut().enumerate() {
            for threads in [1, 2] {
                // Nobody reads, somebody always does, or only for a while.
                let mut reader = None;
                let maps = history.play(threads, steps, &z_up, |live, newest| {
                    if timing == 1 || timing == 2 && (1..4).contains(&newest) {
                        reader.get_or_insert_with(|| live.reader().unwrap());
                    } else {
                        reader = None;
                    }
                });
                let case = format!("seed {seed}, timing {timing}, {threads} threads");
                assert!(bytes(&maps.global) == bytes(&global), "{case}");
                assert!(bytes(&maps.large) == bytes(&large), "{case}");
                assert_eq!(maps.stats.keyframes, 6, "{case}");
                let num_measured: usize = history.final_scans().iter().map(|s| s.num_pixels).sum();
                assert_eq!(maps.stats.points, num_measured, "{case}");
            }
        }
    }
}

#[test]
fn maps_in_a_frame_found_at_the_end_are_built_there() {
    let mut random = Random(77);
    let history = History::new(&mut random);
    let frame = random.pose();
    let mut reader = None;
    let maps = history.play(1, &mut || 3, &frame, |live, _| {
        reader.get_or_insert_with(|| live.reader().unwrap());
    });
    let scans = history.final_scans();
    let final_poses = &history.last().world_from_keyframe;
    let global = from_scratch(&scans, final_poses, &frame);
    assert!(bytes(&maps.global) == bytes(&global));
    let large = from_scratch(&scans, &history.first, &frame);
    assert!(bytes(&maps.large) == bytes(&large));
}

#[test]
fn maps_that_are_brought_to_another_frame_while_they_grow_are_those_built_there() {
    let frame = Random(5).pose();
    let poses = [pose(0.1), pose(0.4), pose(0.8)];
    let snapshot = |count: usize| {
        Arc::new(PoseSnapshot {
            revision: count as u64,
            world_from_keyframe: poses[..count].to_vec(),
            ..PoseSnapshot::default()
        })
    };
    let scans: Vec<KeyframeScan> = (0..3).map(wall).collect();
    let first = [pose(0.0), pose(0.3), pose(0.7)];
    let mut live = LiveMaps::new(Mapper::new(config(), 1), z_up_from_camera_world()).unwrap();
    let reader = live.reader().unwrap();
    for id in 0..2 {
        live.add(scans[id].clone(), first[id]).unwrap();
    }
    // an update that is under way leads elsewhere
    live.follow(snapshot(2)).unwrap();
    live.step().unwrap();
    live.bring_to(frame).unwrap();
    let view = reader.latest().unwrap();
    assert_eq!(view.map_from_world, frame);
    let built = |poses: &[Sim3]| bytes(&from_scratch(&scans[..poses.len()], poses, &frame));
    assert!(bytes(&view.global) == built(&poses[..2]));
    assert!(bytes(&view.large) == built(&first[..2]));
    live.add(scans[2].clone(), first[2]).unwrap();
    live.follow(snapshot(3)).unwrap();
    while live.step().unwrap() {}
    let view = reader.latest().unwrap();
    assert!(bytes(&view.global) == built(&poses) && bytes(&view.large) == built(&first));
}

#[test]
fn what_is_read_is_always_complete_and_of_one_revision() {
    let z_up = z_up_from_camera_world();
    let mut revisions = std::collections::BTreeSet::new();
    for seed in 100..103 {
        let mut random = Random(seed);
        let history = History::new(&mut random);
        let mut reader = None;
        let mut held = None;
        history.play(1, &mut || random.below(9), &z_up, |live, newest| {
            let reader = reader.get_or_insert_with(|| live.reader().unwrap());
            let view = reader.latest().unwrap();
            assert_eq!(view.stats.keyframes, newest + 1);
            let large = from_scratch(&history.scans[..=newest], &history.first[..=newest], &z_up);
            assert!(bytes(&view.large) == bytes(&large));
            // Keyframes that came after the revision are where they were first.
            let mut poses = history.first[..=newest].to_vec();
            if let Some(known) = history
                .snapshots
                .iter()
                .find(|s| s.revision == view.revision)
            {
                let known = &known.world_from_keyframe;
                poses[..known.len()].copy_from_slice(known);
            }
            let is_old = bytes(&from_scratch(&history.scans[..=newest], &poses, &z_up))
                == bytes(&view.global);
            let is_revised = newest >= history.revised.0
                && bytes(&from_scratch(
                    &history.final_scans()[..=newest],
                    &poses,
                    &z_up,
                )) == bytes(&view.global);
            assert!(is_old || is_revised, "revision {}", view.revision);
            revisions.insert(view.revision);
            // Views never change under those who hold them.
            let (old, old_bytes) = held.get_or_insert_with(|| {
                let bytes = bytes(&view.global);
                (view, bytes)
            });
            assert!(bytes(&old.global) == *old_bytes);
        });
    }
    assert!(revisions.len() > 3, "{revisions:?}");
}

#[test]
fn keyframes_that_hardly_moved_wait_for_the_end() {
    let mapper = Mapper::new(config(), 1);
    let mut live = LiveMaps::new(mapper, z_up_from_camera_world()).unwrap();
    let _reader = live.reader().unwrap();
    live.add(wall(0), pose(0.0)).unwrap();
    // Cells of 0.1, and the default is to follow from one cell on.
    let mut moved_to = |revision, x| {
        live.follow(Arc::new(PoseSnapshot {
            revision,
            world_from_keyframe: vec![pose(x)],
            ..PoseSnapshot::default()
        }))
        .unwrap();
        let mut steps = 0;
        while live.step().unwrap() {
            steps += 1;
        }
        steps
    };
    assert_eq!(moved_to(1, 0.09), 0);
    assert!(moved_to(2, 0.11) > 0);
    assert_eq!(moved_to(3, 0.05), 0);
    let last = Arc::new(PoseSnapshot {
        revision: 4,
        world_from_keyframe: vec![pose(0.05)],
        ..PoseSnapshot::default()
    });
    let maps = live
        .finish(
            &last,
            &z_up_from_camera_world(),
            None,
            1,
            &AtomicUsize::new(0),
        )
        .unwrap();
    let expected = from_scratch(&[wall(0)], &[pose(0.05)], &z_up_from_camera_world());
    assert!(bytes(&maps.global) == bytes(&expected));
}

#[test]
fn keyframes_of_a_fragment_are_mapped_once_it_is_joined() {
    let z_up = z_up_from_camera_world();
    let snapshot = |revision, poses: &[Sim3], fragment: &[u32]| {
        Arc::new(PoseSnapshot {
            revision,
            world_from_keyframe: poses.to_vec(),
            fragment: fragment.to_vec(),
            ..PoseSnapshot::default()
        })
    };
    let elsewhere = Sim3::new(0.3, Rotation::identity(), Vec3::new(7.0, 8.0, 9.0));
    let before = [pose(0.0), elsewhere, pose(0.3)];
    let after = [pose(0.0), pose(0.6), pose(0.3)];
    for (is_read, is_joined) in [(false, false), (false, true), (true, false), (true, true)] {
        let mut live = LiveMaps::new(Mapper::new(config(), 1), z_up).unwrap();
        let reader = is_read.then(|| live.reader().unwrap());
        live.add(wall(0), before[0]).unwrap();
        live.add_apart(wall(7));
        live.add_apart(wall(1));
        live.revise(wall(1));
        live.add(wall(2), before[2]).unwrap();
        live.follow(snapshot(1, &before, &[0, 1, 0])).unwrap();
        while live.step().unwrap() {}
        if let Some(reader) = &reader {
            assert_eq!(reader.latest().unwrap().stats.keyframes, 2);
        }
        let fragments = if is_joined { [0, 0, 0] } else { [0, 1, 0] };
        let last = snapshot(2, &after, &fragments);
        if is_joined {
            live.follow(Arc::clone(&last)).unwrap();
        }
        if let Some(reader) = &reader {
            let keyframes = if is_joined { 3 } else { 2 };
            assert_eq!(reader.latest().unwrap().stats.keyframes, keyframes);
        }
        let maps = live
            .finish(&last, &z_up, None, 1, &AtomicUsize::new(0))
            .unwrap();
        let poses: Vec<Option<Sim3>> = (0..3).map(|i| last.in_main_map(i).copied()).collect();
        let mapper = Mapper::new(config(), 1);
        let scans = [wall(0), wall(1), wall(2)];
        let (expected, stats) = mapper.build(&scans, &poses, &z_up).unwrap();
        assert_eq!(maps.stats, stats, "read {is_read}, joined {is_joined}");
        assert!(bytes(&maps.global) == bytes(&expected));
    }
}
