//! A growing map: `cargo run --example camera -- /dev/video0 calibration.txt map.ot`, or a video.
#![allow(clippy::print_stdout, reason = "it talks to its user")]
use monogrid::occupancy::{save_atomically, write_ot};
use monogrid::{Calibration, Pipeline, Settings, video::Video};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [_, source, calibration, out] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("expected SOURCE CALIBRATION OUT.ot".into());
    };
    let video = Video::open(source)?;
    let camera = Calibration::read(calibration.as_ref(), Some(video.size()))?.camera;
    let mut pipeline = Pipeline::new(&camera, Settings::default())?;
    for frame in video {
        let frame = frame?;
        let Ok(report) = pipeline.push(frame.image.map(f32::from), frame.timestamp_ns) else {
            continue; // the same image once more
        };
        let position = report.world_from_camera.map(|pose| pose.translation);
        println!("{} {:?} {position:?}", report.index, report.state);
        if let (Some(_), Some(map)) = (report.finished_keyframe, pipeline.map()?) {
            save_atomically(out.as_ref(), |file| write_ot(&map, file))?;
        }
    }
    Ok(())
}
