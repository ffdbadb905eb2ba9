//! What small files may show.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use monogrid_video::{Patience, Video, VideoError};

/// Zeros as zstd: four bytes for 128 kB of them.
fn zstd(start: &[u8], zeros: usize) -> Vec<u8> {
    const BLOCK: usize = 1 << 17;
    let block = |kind: u32, length: usize, is_last: bool| {
        let head = (length as u32) << 3 | kind << 1 | u32::from(is_last);
        head.to_le_bytes()[..3].to_vec()
    };
    let mut frame = vec![0x28, 0xb5, 0x2f, 0xfd, 0, 7 << 3];
    frame.extend(block(0, start.len(), false));
    frame.extend(start);
    for done in (0..zeros).step_by(BLOCK) {
        let length = BLOCK.min(zeros - done);
        frame.extend(block(1, length, done + length == zeros));
        frame.push(0);
    }
    frame
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
}

fn record(kind: u8, body: &[&[u8]]) -> Vec<u8> {
    let body = body.concat();
    [&[kind][..], &(body.len() as u64).to_le_bytes(), &body].concat()
}

/// A recording of black images of so many pixels a side, each in a chunk of its own.
fn recording(count: usize, side: usize) -> Vec<u8> {
    let pixels = side * side;
    let number = |n: usize| (n as u32).to_le_bytes();
    // header of the message without a frame, then height, width, encoding, bytes of a row and of
    // all
    let image = [
        &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0][..],
        &[number(side), number(side), number(6)].concat(),
        b"mono8\0\0\0",
        &[number(side), number(pixels)].concat(),
    ]
    .concat();
    let mut out = b"\x89MCAP0\r\n".to_vec();
    let [none, one] = [[0_u8; 4], [1, 0, 1, 0]];
    let image_type = text("sensor_msgs/msg/Image");
    out.extend(record(
        3,
        &[&one[..2], &image_type, &text("ros2msg"), &none],
    ));
    out.extend(record(4, &[&one, &text("/image"), &text("cdr"), &none]));
    for index in 0..count as u64 {
        let time = (index * 33_000_000).to_le_bytes();
        let message = [&one[..2], &none, &time, &time, &image].concat();
        let length = (message.len() + pixels) as u64;
        let start = [&[5][..], &length.to_le_bytes(), &message].concat();
        let packed = zstd(&start, pixels);
        let size = (start.len() + pixels) as u64;
        out.extend(record(
            6,
            &[
                &[0; 16],
                &size.to_le_bytes(),
                &none,
                &text("zstd"),
                &(packed.len() as u64).to_le_bytes(),
                &packed,
            ],
        ));
    }
    out.extend(record(15, &[&none]));
    out.extend(record(2, &[&[0; 20]]));
    out.extend(b"\x89MCAP0\r\n");
    out
}

#[test]
fn a_small_file_shows_no_more_than_it_can_have_stored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("black.mcap");
    let file = recording(11, 4000);
    assert!(file.len() < 10_000, "{}", file.len());
    std::fs::write(&path, file).unwrap();
    let open = || {
        Video::open_recording(&path, None, Patience::default())
            .unwrap()
            .0
    };
    // 134 million pixels and some for its bytes
    assert_eq!(open().by_ref().take_while(Result::is_ok).count(), 8);
    let error = open().find_map(Result::err).unwrap();
    assert!(matches!(error, VideoError::TooManyPixels(_)), "{error}");
    assert!(error.to_string().contains("black.mcap"), "{error}");
    assert_eq!(open().count(), 9, "the error is the last item");
}
