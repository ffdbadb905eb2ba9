//! What sensors beside the camera wrote down: inertial readings, places on the globe in subtitles
//! and in Exif blocks, and packets of both (GPMF).
#![no_main]

use libfuzzer_sys::fuzz_target;
use monogrid_datasets::{
    CameraTelemetry, FrameEntry, ImuFile, exif_focal_px, places_of_photographs,
    read_places_of_subtitles,
};
use std::io::Write;

fuzz_target!(|bytes: &[u8]| {
    let mut file = tempfile::NamedTempFile::new_in("/dev/shm").expect("a file in memory");
    file.write_all(bytes).expect("room in memory");
    let path = file.path();
    let is_finite = |sample: &monogrid_inertial::ImuSample| {
        let values = [sample.angular_velocity, sample.specific_force];
        values.iter().flatten().all(|value| value.is_finite())
    };
    if let Ok(imu) = ImuFile::read(path) {
        assert!(imu.samples.iter().all(is_finite));
    }
    let mut telemetry = CameraTelemetry::default();
    telemetry.add(bytes, [0, 1_000_000_000]);
    telemetry.add(bytes, [i64::MAX - 1, i64::MAX]);
    assert!(telemetry.samples().iter().all(is_finite));
    let _ = exif_focal_px(path, (640, 480));
    let photograph = FrameEntry {
        index: 0,
        timestamp_ns: 0,
        path: path.to_owned(),
    };
    let places = places_of_photographs(&[photograph]);
    let places = places
        .into_iter()
        .chain(telemetry.places)
        .chain(read_places_of_subtitles(path).unwrap_or_default());
    let places: Vec<_> = places.map(|(_, place)| place).collect();
    for place in &places {
        let there = places[0].east_north_up(place);
        assert!(there.iter().all(|metres| metres.is_finite()), "{place:?}");
    }
});
