//! Poses and depth images of another SLAM:
//! `cargo run --example depth_and_poses -- FOLDER calibration.txt poses.txt map.ot`
use monogrid::datasets::{Calibration, Dataset, SourceOptions, read_depth, read_trajectory};
use monogrid::mapping::{KeyframeScan, Mapper, MappingConfig};
use monogrid::occupancy::{save_atomically, write_ot};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [_, folder, calibration, poses, out] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("expected FOLDER CALIBRATION POSES OUT.ot".into());
    };
    let camera = Calibration::read(calibration.as_ref(), None)?.camera; // without distortion
    let dataset = Dataset::open(folder.as_ref(), SourceOptions::default())?; // depth.txt, depth/
    let mapper = Mapper::new(MappingConfig::default(), 2);
    let mut map = mapper.empty_map()?;
    for (id, pose) in (0..).zip(read_trajectory(poses.as_ref())?) {
        if let Some(entry) = dataset.depth_of_frame(pose.timestamp_ns) {
            let depth = read_depth(&entry.path, 5000.0)?; // units per metre
            let scan = KeyframeScan::from_depth_image(id, &depth, camera.pinhole, mapper.config());
            mapper.integrate(&mut map, &scan, &pose.world_from_camera.with_scale(1.0))?;
        }
    }
    Ok(save_atomically(out.as_ref(), |file| write_ot(&map, file))?)
}
