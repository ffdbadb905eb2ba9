//! Videos as others write them: fragments, unknown boxes, mirrored and anamorphic pictures, fields,
//! holes. Each test makes its own.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "tests")]

use monogrid_image::Image;
use monogrid_video::{Patience, Video, VideoError, VideoFrame, is_video_file, read_telemetry};
use std::path::{Path, PathBuf};
use std::process::Command;

fn data(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    folder.join("tests/data").join(name)
}

/// 30 frames of 64x48 pixels; its index lies behind its samples.
fn original() -> Vec<u8> {
    std::fs::read(data("reordered.mp4")).unwrap()
}

fn frames(video: &mut Video) -> Vec<VideoFrame> {
    video.by_ref().map(Result::unwrap).collect()
}

fn images(path: &Path) -> Vec<Image<u8>> {
    let mut video = Video::open(path).unwrap();
    frames(&mut video).into_iter().map(|f| f.image).collect()
}

/// Where a box of this kind begins, the last one in the file.
fn at(bytes: &[u8], kind: &[u8; 4]) -> usize {
    let windows = bytes.windows(4).collect::<Vec<_>>();
    windows.iter().rposition(|window| window == kind).unwrap() - 4
}

/// Makes boxes that begin there larger.
fn grow(bytes: &mut [u8], by: usize, boxes: &[usize]) {
    for &at in boxes {
        let size = u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
        bytes[at..at + 4].copy_from_slice(&(size + by as u32).to_be_bytes());
    }
}

fn boxed(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let size = (8 + content.len()) as u32;
    [&size.to_be_bytes(), kind.as_slice(), content].concat()
}

fn ffmpeg(arguments: &[&str]) -> bool {
    let done = Command::new("ffmpeg")
        .args(["-v", "error", "-y"])
        .args(arguments)
        .status();
    let is_done = done.is_ok_and(|status| status.success());
    if !is_done {
        eprintln!("SKIPPED: ffmpeg is not installed, or cannot do this: {arguments:?}");
    }
    is_done
}

#[test]
fn unknown_boxes_may_lie_anywhere() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("video.mp4");
    let expected = images(&data("reordered.mp4"));
    let uuid = boxed(b"uuid", &[7; 40]);
    let other = boxed(b"c2pa", &[1, 2, 3]);
    let moov = at(&original(), b"moov");
    let trak = at(&original(), b"trak");
    for unknown in [uuid, other] {
        let mut before = original();
        before.splice(moov..moov, unknown.clone());
        let mut in_index = original();
        in_index.splice(moov + 8..moov + 8, unknown.clone());
        grow(&mut in_index, unknown.len(), &[moov]);
        let mut in_track = original();
        in_track.splice(trak + 8..trak + 8, unknown.clone());
        grow(&mut in_track, unknown.len(), &[moov, trak]);
        for bytes in [before, in_index, in_track] {
            std::fs::write(&path, bytes).unwrap();
            let mut video = Video::open(&path).unwrap();
            assert_eq!(video.description(), "MP4, H.264");
            let found = frames(&mut video).into_iter().map(|frame| frame.image);
            assert!(found.eq(expected.iter().cloned()));
            assert!(video.faults().is_empty() && video.notes().is_empty());
        }
    }
    // one that goes on for longer than 32 bits can say, behind everything
    let long = [
        &1_u32.to_be_bytes(),
        b"free".as_slice(),
        &(1_u64 << 40).to_be_bytes(),
    ]
    .concat();
    std::fs::write(&path, [original(), long].concat()).unwrap();
    assert_eq!(images(&path).len(), 30);
}

#[test]
fn fragments_are_never_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fragments.mp4");
    let moov = at(&original(), b"moov");
    // announced behind the tracks, or not at all
    let mut announced = original();
    announced.extend(boxed(b"mvex", &[]));
    grow(&mut announced, 8, &[moov]);
    let mut only_there = original();
    only_there.extend(boxed(b"moof", &[]));
    for bytes in [announced, only_there] {
        std::fs::write(&path, bytes).unwrap();
        match Video::open(&path) {
            Ok(video) => assert_eq!(video.description(), "MP4 in fragments, decoded by ffmpeg"),
            Err(VideoError::NeedsFfmpeg { found, .. }) => assert_eq!(found, "MP4 in fragments"),
            Err(VideoError::Ffmpeg { .. }) => {}
            Err(error) => panic!("{error}"),
        }
    }
    let source = data("reordered.mp4");
    let (source, target) = (source.to_str().unwrap(), path.to_str().unwrap());
    let expected = images(&data("reordered.mp4"));
    for flags in [
        "frag_keyframe",
        "frag_keyframe+empty_moov",
        "dash",
        "frag_every_frame+empty_moov+default_base_moof",
    ] {
        if !ffmpeg(&["-i", source, "-c", "copy", "-movflags", flags, target]) {
            return;
        }
        assert!(images(&path) == expected, "{flags}");
    }
}

#[test]
fn a_mirrored_picture_is_used_as_it_is_stored() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mirrored.mp4");
    let expected = images(&data("reordered.mp4"));
    let one = 0x10000_i32;
    // 40 bytes behind the header of the box and its version
    let matrix = at(&original(), b"tkhd") + 8 + 4 + 36;
    for entries in [
        [-one, 0, 0, one],
        [one, 0, 0, -one],
        [0, one, one, 0],
        [0, -one, -one, 0],
    ] {
        let mut bytes = original();
        for (k, entry) in [0, 1, 3, 4].into_iter().zip(entries) {
            let at = matrix + 4 * k;
            bytes[at..at + 4].copy_from_slice(&entry.to_be_bytes());
        }
        std::fs::write(&path, bytes).unwrap();
        let mut video = Video::open(&path).unwrap();
        assert!(video.notes()[0].contains("mirrors"), "{:?}", video.notes());
        let found = frames(&mut video).into_iter().map(|frame| frame.image);
        assert!(found.eq(expected.iter().cloned()), "{entries:?}");
    }
    // another codec, through ffmpeg
    let mut bytes = std::fs::read(data("h265.mp4")).unwrap();
    let matrix = at(&bytes, b"tkhd") + 8 + 4 + 36;
    bytes[matrix..matrix + 4].copy_from_slice(&(-one).to_be_bytes());
    std::fs::write(&path, bytes).unwrap();
    match Video::open(&path) {
        Ok(mut video) => {
            assert!(video.notes()[0].contains("mirrors"), "{:?}", video.notes());
            let found = frames(&mut video).into_iter().map(|frame| frame.image);
            assert!(found.eq(images(&data("h265.mp4"))));
        }
        Err(error) => assert!(matches!(error, VideoError::NeedsFfmpeg { .. }), "{error}"),
    }
}

#[test]
fn pixels_that_are_not_square_are_made_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("anamorphic.mp4");
    let shaped = |width: u32, height: u32, turned: bool| {
        let mut bytes = std::fs::read(data(if turned {
            "upright.mp4"
        } else {
            "reordered.mp4"
        }))
        .unwrap();
        let pasp = at(&bytes, b"pasp");
        bytes[pasp + 8..pasp + 12].copy_from_slice(&width.to_be_bytes());
        bytes[pasp + 12..pasp + 16].copy_from_slice(&height.to_be_bytes());
        std::fs::write(&path, bytes).unwrap();
        Video::open(&path).unwrap()
    };
    for (shape, size) in [
        ((4, 3), (85, 48)),
        ((3, 4), (64, 64)),
        ((1, 1), (64, 48)),
        ((336, 337), (64, 48)),
    ] {
        let mut video = shaped(shape.0, shape.1, false);
        assert_eq!((video.size(), video.stored_size()), (size, (64, 48)));
        let is_said = video.notes().iter().any(|note| note.contains("not square"));
        assert_eq!(is_said, size != (64, 48), "{:?}", video.notes());
        let sizes = frames(&mut video)
            .into_iter()
            .map(|f| (f.image.width(), f.image.height()));
        assert!(sizes.into_iter().all(|found| found == size));
    }
    // a pixel of the sensor is turned with the picture
    let video = shaped(4, 3, true);
    assert_eq!((video.size(), video.stored_size()), ((48, 85), (48, 64)));
    let stream = b"YUV4MPEG2 W4 H4 F30:1 A2:1 Cmono\nFRAME\nabcdefghijklmnop";
    let path = folder.path().join("video.y4m");
    std::fs::write(&path, stream).unwrap();
    assert_eq!(Video::open(&path).unwrap().size(), (8, 4));
}

/// How much rows differ from those around them: much where two fields do not fit together.
fn combing(image: &Image<u8>) -> f64 {
    let mut sum = 0.0;
    for y in 1..image.height() - 1 {
        for x in 0..image.width() {
            let around = f64::from(image.at(x, y - 1)) + f64::from(image.at(x, y + 1));
            sum += (f64::from(image.at(x, y)) - 0.5 * around).abs();
        }
    }
    sum / image.as_slice().len() as f64
}

#[test]
fn fields_are_made_whole_frames() {
    let folder = tempfile::tempdir().unwrap();
    let pattern = "testsrc2=size=96x96:rate=50:duration=1,scroll=horizontal=0.03,\
                   tinterlace=mode=interleave_top,setfield=tff";
    let mpeg2 = ["-c:v", "mpeg2video", "-q:v", "2", "-flags", "+ilme+ildct"].as_slice();
    let h264 = ["-c:v", "libx264", "-qp", "10", "-x264opts", "tff=1"].as_slice();
    for (name, codec) in [("video.mpg", mpeg2), ("video.mp4", h264)] {
        let path = folder.path().join(name);
        let target = path.to_str().unwrap();
        let arguments = [
            &["-f", "lavfi", "-i", pattern, "-pix_fmt", "yuv420p"],
            codec,
            &[target],
        ];
        if !ffmpeg(&arguments.concat()) {
            continue;
        }
        let raw = folder.path().join("raw.y4m");
        let decoded = [
            "-i",
            target,
            "-vsync",
            "passthrough",
            "-pix_fmt",
            "yuv420p",
            raw.to_str().unwrap(),
        ];
        assert!(ffmpeg(&decoded));
        // neither says that it is interlaced any more
        let text = std::fs::read(&raw).unwrap();
        let line = text.iter().position(|byte| *byte == b'\n').unwrap();
        let header = String::from_utf8_lossy(&text[..line])
            .replace(" It", " Ip")
            .replace(" Ib", " Ip");
        std::fs::write(&raw, [header.as_bytes(), &text[line..]].concat()).unwrap();
        let combed: Vec<f64> = images(&raw).iter().map(combing).collect();
        let mut video = Video::open(&path).unwrap();
        assert!(
            video.notes().iter().any(|note| note.contains("interlaced")),
            "{name}"
        );
        let whole = frames(&mut video);
        assert_eq!(whole.len(), combed.len(), "{name}");
        assert!(whole.is_sorted_by(|a, b| a.timestamp_ns < b.timestamp_ns));
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let smooth: Vec<f64> = whole.iter().map(|frame| combing(&frame.image)).collect();
        let (smooth, combed) = (mean(&smooth[2..]), mean(&combed[2..]));
        assert!(smooth < 0.5 * combed, "{name}: {smooth} {combed}");
        assert_eq!(video.faults(), Vec::<String>::new());
    }
    // whole frames stay as they are
    let path = data("h265.mp4");
    if let Ok(video) = Video::open(&path) {
        assert!(video.notes().is_empty(), "{:?}", video.notes());
    }
}

#[test]
fn frames_in_a_hole_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("hole.mp4");
    let mut bytes = original();
    let (mdat, moov) = (at(&bytes, b"mdat"), at(&bytes, b"moov"));
    let middle = mdat + (moov - mdat) / 3;
    bytes[middle..middle + (moov - mdat) / 4].fill(0);
    std::fs::write(&path, bytes).unwrap();
    let mut video = Video::open(&path).unwrap();
    let shown: Vec<i64> = video
        .by_ref()
        .filter_map(|frame| Some(frame.ok()?.timestamp_ns))
        .collect();
    // pictures whose order nobody knows are left out, not put right behind the ones before
    assert!(
        shown.windows(2).all(|pair| pair[1] > pair[0] + 1_000_000),
        "{shown:?}"
    );
    assert_eq!(video.repaired_times(), 0);
    let shown = shown.len();
    let errors = 30 - shown;
    let faults = video.faults().join(" ");
    let missing = faults
        .split(' ')
        .next()
        .and_then(|count| count.parse::<usize>().ok());
    // what is no error is counted, and nothing twice
    assert!(shown < 30, "the hole does no harm");
    let missing = missing.unwrap_or(0);
    assert!(missing > 0 && missing <= errors, "{shown} {faults}");
    let mut whole = Video::open(data("reordered.mp4")).unwrap();
    assert_eq!(frames(&mut whole).len(), 30);
    assert!(whole.faults().is_empty());
}

#[test]
fn videos_are_known_by_their_content() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["recording", "video.txt", "video.zip", "video.jpg"] {
        let path = folder.path().join(name);
        std::fs::write(&path, original()).unwrap();
        assert!(is_video_file(&path), "{name}");
        assert_eq!(images(&path).len(), 30);
    }
    let text = folder.path().join("text");
    std::fs::write(&text, "0.0 image.png\n").unwrap();
    assert!(!is_video_file(&text) && !is_video_file(folder.path()));
}

/// A field of Protocol Buffers with bytes.
fn field(number: u8, bytes: &[u8]) -> Vec<u8> {
    let mut length = bytes.len();
    let mut out = vec![number << 3 | 2];
    while length >= 0x80 {
        out.push(length as u8 | 0x80);
        length >>= 7;
    }
    out.push(length as u8);
    [out, bytes.to_vec()].concat()
}

/// An MCAP file with a topic of packets of 10 ms each (<https://mcap.dev/spec>), and one of words.
fn recording_of(packets: &[&[u8]], format: &str) -> Vec<u8> {
    let text = |text: &str| [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat();
    let record = |opcode: u8, body: &[u8]| {
        [
            &[opcode],
            (body.len() as u64).to_le_bytes().as_slice(),
            body,
        ]
        .concat()
    };
    let magic = b"\x89MCAP0\r\n";
    let mut file = magic.to_vec();
    let types = ["foxglove.CompressedVideo", "std_msgs/msg/String"];
    for (id, (name, type_name)) in (1..).zip(["/video", "/words"].into_iter().zip(types)) {
        let schema = [&[id, 0], &*text(type_name), &text(""), &text("")].concat();
        let channel = [&[id, 0, id, 0], &*text(name), &text("protobuf"), &text("")].concat();
        file.extend([record(3, &schema), record(4, &channel)].concat());
        let head = [&[id, 0, 0, 0, 0, 0], [0_u8; 16].as_slice()].concat();
        file.extend((id == 2).then(|| record(5, &head)).into_iter().flatten());
    }
    for (k, packet) in packets.iter().enumerate() {
        let nanoseconds = [vec![2 << 3, 0x80 | (k as u8 & 0x7f), 0x80, 0x01]].concat();
        let time = field(1, &[vec![1 << 3, 1], nanoseconds].concat());
        // fields that are empty are not written
        let fields = [(4, format.as_bytes()), (3, packet)];
        let fields = fields.into_iter().filter(|(_, bytes)| !bytes.is_empty());
        let fields: Vec<u8> = fields.flat_map(|(id, bytes)| field(id, bytes)).collect();
        let message = [time, fields].concat();
        let head = [&[1, 0, 0, 0, 0, 0], [0_u8; 16].as_slice()].concat();
        file.extend(record(5, &[head, message].concat()));
    }
    [file, record(2, &[0; 20]), magic.to_vec()].concat()
}

#[test]
fn a_recording_whose_video_cannot_be_read_says_why_and_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("video.mcap");
    let junk: &[u8] = &[0, 0, 0, 1, 0x67, 1, 2, 3];
    let kinds: [(&str, &[u8], &str); 4] = [
        ("", junk, "do not name their codec"),
        ("h265", junk, "coded as \"h265\""),
        ("h264", &[], "no frames"),
        ("h264", junk, "/video"),
    ];
    for (format, packet, reason) in kinds {
        std::fs::write(&path, recording_of(&[packet; 12], format)).unwrap();
        let opened = Video::open_recording(&path, None, Patience::default());
        let said = opened.err().unwrap().to_string();
        let there = "/video (foxglove.CompressedVideo), /words (std_msgs/msg/String)";
        assert!(said.contains(reason) && said.contains(there), "{said}");
    }
}

#[test]
fn coded_video_in_a_recording_is_decoded() {
    let folder = tempfile::tempdir().unwrap();
    let stream = folder.path().join("video.h264");
    let source = data("reordered.mp4");
    let filter = "h264_mp4toannexb,h264_metadata=aud=insert";
    let arguments = [
        "-i",
        source.to_str().unwrap(),
        "-c",
        "copy",
        "-bsf:v",
        filter,
        stream.to_str().unwrap(),
    ];
    if !ffmpeg(&arguments) {
        return;
    }
    let bytes = std::fs::read(&stream).unwrap();
    let delimiter: &[u8] = &[0, 0, 0, 1, 9];
    let starts: Vec<usize> = (0..bytes.len())
        .filter(|at| bytes[*at..].starts_with(delimiter))
        .collect();
    let ends = starts.iter().skip(1).copied().chain([bytes.len()]);
    let packets: Vec<&[u8]> = starts
        .iter()
        .zip(ends)
        .map(|(from, to)| &bytes[*from..to])
        .collect();
    assert_eq!(packets.len(), 30);
    let path = folder.path().join("video.mcap");
    std::fs::write(&path, recording_of(&packets, "h264")).unwrap();
    let (mut video, _) = Video::open_recording(&path, None, Patience::default()).unwrap();
    let found = frames(&mut video).into_iter().map(|frame| frame.image);
    assert!(found.eq(images(&data("reordered.mp4"))));
    // damaged packets: errors of frames, and no panic
    for at in 0..packets[0].len().min(200) {
        let mut damaged = packets[0].to_vec();
        damaged[at] ^= 0x55;
        std::fs::write(&path, recording_of(&[&damaged, packets[1]], "h264")).unwrap();
        if let Ok((video, _)) = Video::open_recording(&path, None, Patience::default()) {
            assert!(video.count() <= 4);
        }
    }
}

/// The video with a track of packets beside it, as cameras of GoPro write it: 0.5 s each.
fn with_telemetry(packets: &[Vec<u8>]) -> Vec<u8> {
    let list = |numbers: &[u32]| -> Vec<u8> {
        numbers
            .iter()
            .flat_map(|number| number.to_be_bytes())
            .collect()
    };
    let mut bytes = original();
    let moov = at(&bytes, b"moov");
    let size = u32::from_be_bytes(bytes[moov..moov + 4].try_into().unwrap());
    assert_eq!(moov + size as usize, bytes.len(), "the index is the last");
    let mut index = bytes.split_off(moov);
    let (mut offsets, mut sizes) = (vec![0, packets.len() as u32], vec![0, 0]);
    sizes.push(packets.len() as u32);
    for packet in packets {
        offsets.push(bytes.len() as u32 + 8);
        sizes.push(packet.len() as u32);
        bytes.extend(boxed(b"mdat", packet));
    }
    let kind = [list(&[0, 1]), boxed(b"gpmd", &[0; 8])].concat();
    let table = [
        boxed(b"stsd", &kind),
        boxed(b"stts", &list(&[0, 1, packets.len() as u32, 500])),
        boxed(b"stsc", &list(&[0, 1, 1, 1, 1])),
        boxed(b"stsz", &list(&sizes)),
        boxed(b"stco", &list(&offsets)),
    ];
    let media = [
        boxed(b"mdhd", &list(&[0, 0, 0, 1000, 500, 0])),
        boxed(b"hdlr", &[&[0; 8], b"meta".as_slice(), &[0; 13]].concat()),
        boxed(b"minf", &boxed(b"stbl", &table.concat())),
    ];
    index.extend(boxed(b"trak", &boxed(b"mdia", &media.concat())));
    let size = index.len() as u32;
    index[..4].copy_from_slice(&size.to_be_bytes());
    [bytes, index].concat()
}

#[test]
fn what_a_camera_writes_beside_the_picture_has_the_times_of_its_packets() {
    let item = |key: &[u8; 4], kind: u8, size: u8, repeat: u16, data: &[u8]| {
        [&key[..], &[kind, size], &repeat.to_be_bytes(), data].concat()
    };
    let packet = |latitude: i32| {
        let place = [latitude, 85_000_000, 400_000, 0, 0]
            .map(i32::to_be_bytes)
            .concat();
        let scales = [10_000_000_i32, 10_000_000, 1000, 1000, 100].map(i32::to_be_bytes);
        let stream = [
            item(b"SCAL", b'l', 4, 5, &scales.concat()),
            item(b"GPS5", b'l', 20, 1, &place),
        ];
        let stream = stream.concat();
        let stream = item(b"STRM", 0, 1, stream.len() as u16, &stream);
        item(b"DEVC", 0, 1, stream.len() as u16, &stream)
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("GX010001.MP4");
    let whole = with_telemetry(&[
        packet(470_000_000),
        packet(470_000_100),
        packet(470_000_200),
    ]);
    std::fs::write(&path, &whole).unwrap();
    let places = read_telemetry(&path).unwrap().unwrap().places;
    let times: Vec<i64> = places.iter().map(|(time_ns, _)| *time_ns).collect();
    assert_eq!(times, [0, 500_000_000, 1_000_000_000]);
    assert!((places[2].1.latitude - 47.000_02).abs() < 1e-9);
    assert_eq!(places[2].1.altitude, Some(400.0));
    // and it is a video as before
    assert_eq!(frames(&mut Video::open(&path).unwrap()).len(), 30);
    for cut in (0..whole.len()).step_by(97) {
        std::fs::write(&path, &whole[..cut]).unwrap();
        let _ = read_telemetry(&path).unwrap();
    }
    std::fs::write(&path, original()).unwrap();
    assert_eq!(read_telemetry(&path).unwrap(), None);
}
