//! Images of your own:
//! `ffmpeg -i a.mp4 -f rawvideo -pix_fmt rgb24 - | cargo run --example own_images --
//! calibration.txt 30 a.bt`
use monogrid::occupancy::{save_atomically, write_bt};
use monogrid::{Calibration, GrayImage, Pipeline, Settings};
use std::io::Read;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let [_, calibration, rate, out] = &std::env::args().collect::<Vec<_>>()[..] else {
        return Err("expected CALIBRATION FRAMES_PER_SECOND OUT.bt".into());
    };
    let camera = Calibration::read(calibration.as_ref(), None)?.camera;
    let interval_ns = (1e9 / rate.parse::<f64>()?) as i64;
    let mut pipeline = Pipeline::new(&camera, Settings::default())?;
    let mut rgb = vec![0; 3 * camera.width * camera.height];
    let mut time_ns = 0;
    while std::io::stdin().read_exact(&mut rgb).is_ok() {
        let image = GrayImage::from_rgb8(camera.width, camera.height, &rgb);
        let _ = pipeline.push(image.ok_or("wrong size")?, time_ns); // losing track is no error
        time_ns += interval_ns;
    }
    let maps = pipeline.finish()?.maps()?.ok_or("it did not move")?;
    save_atomically(out.as_ref(), |file| write_bt(&maps.global, file))?;
    Ok(())
}
