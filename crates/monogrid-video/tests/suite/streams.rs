//! A phone as camera: MJPEG from a server on this machine.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "tests")]

use monogrid_datasets::encode_jpeg;
use monogrid_image::Image;
use monogrid_video::{Patience, Video, VideoError};
use std::io::{Read, Write};
use std::net::TcpListener;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A grey JPEG image of one colour.
fn jpeg(level: u8) -> Vec<u8> {
    encode_jpeg(&Image::filled(16, 8, level), 95)
}

/// Answers one request with these bytes; returns the address, and later the request.
fn serve(answer: Vec<u8>) -> (String, JoinHandle<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/video", listener.local_addr().unwrap());
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut request = vec![0; 4096];
        let length = stream.read(&mut request).unwrap();
        // a client that has seen enough hangs up
        drop(stream.write_all(&answer));
        String::from_utf8_lossy(&request[..length]).into_owned()
    });
    (address, server)
}

fn multipart(parts: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut answer =
        b"HTTP/1.0 200 OK\r\nContent-Type: multipart/x-mixed-replace; boundary=b\r\n\r\n".to_vec();
    for (header, image) in parts {
        answer.extend_from_slice(b"--b\r\nContent-Type: image/jpeg\r\n");
        answer.extend_from_slice(header.as_bytes());
        answer.extend_from_slice(b"\r\n");
        answer.extend_from_slice(image);
        answer.extend_from_slice(b"\r\n");
    }
    answer
}

#[test]
fn images_with_and_without_a_length() {
    let second = jpeg(200);
    let length = format!("Content-Length: {}\r\n", second.len());
    let (address, server) = serve(multipart(&[
        ("", jpeg(40)),
        (&length, second),
        ("X-Timestamp: 3\r\n", jpeg(90)),
    ]));
    let video = Video::open(&address).unwrap();
    assert!(video.is_live());
    assert_eq!((video.size(), video.length()), ((16, 8), None));
    let frames: Vec<_> = video.map(Result::unwrap).collect();
    let levels: Vec<u8> = frames.iter().map(|f| f.image.at(3, 3)).collect();
    assert_eq!(levels, [40, 200, 90]);
    assert!(frames.is_sorted_by(|a, b| a.timestamp_ns < b.timestamp_ns));
    assert!(
        server
            .join()
            .unwrap()
            .starts_with("GET /video HTTP/1.0\r\n")
    );
}

#[test]
fn a_damaged_image_does_not_end_the_stream() {
    let damaged = vec![0xff, 0xd8, 1, 2, 3, 0xff, 0xd9];
    let (address, _server) = serve(multipart(&[("", jpeg(40)), ("", damaged), ("", jpeg(90))]));
    let items: Vec<_> = Video::open(&address).unwrap().collect();
    assert_eq!(items.len(), 3);
    assert!(items[1].as_ref().is_err_and(VideoError::is_single_frame));
    assert!(items[2].is_ok());
}

#[test]
fn answers_that_are_no_stream() {
    let (address, _server) = serve(b"HTTP/1.0 404 Not Found\r\n\r\n".to_vec());
    let error = Video::open(&address).unwrap_err().to_string();
    assert!(error.contains("404 Not Found"), "{error}");
    let (address, _server) = serve(b"HTTP/1.0 200 OK\r\n".repeat(200));
    assert!(matches!(Video::open(&address), Err(VideoError::Io { .. })));
}

/// Frames before a stream breaks off, and what is said then.
fn broken(answer: Vec<u8>) -> (usize, String) {
    let (address, _server) = serve(answer);
    let mut items: Vec<_> = Video::open(&address).unwrap().collect();
    let error = items.pop().unwrap().unwrap_err();
    assert!(!error.is_single_frame(), "{error}");
    assert!(items.iter().all(Result::is_ok));
    (items.len(), error.to_string())
}

#[test]
fn a_stream_that_ends_between_images_has_ended() {
    for end in ["", "--b\r\n", "\r\n--b--\r\n", "--b"] {
        let mut answer = multipart(&[("", jpeg(40)), ("", jpeg(90))]);
        answer.extend_from_slice(end.as_bytes());
        let (address, _server) = serve(answer);
        let items: Vec<_> = Video::open(&address).unwrap().collect();
        assert!(items.len() == 2 && items.iter().all(Result::is_ok), "{end}");
    }
}

#[test]
fn a_connection_that_is_cut_within_an_image_is_no_end() {
    let image = jpeg(90);
    let length = format!("Content-Length: {}\r\n", image.len());
    for header in ["", &length] {
        for left in [0, 1, image.len() / 2, image.len() - 1] {
            let cut = image[..left].to_vec();
            let mut answer = multipart(&[("", jpeg(40)), (header, cut)]);
            // without the line behind the image
            answer.truncate(answer.len() - 2);
            let (frames, said) = broken(answer);
            assert_eq!(frames, 1);
            assert!(said.contains("cut within an image"), "{said}");
        }
    }
    let mut answer = multipart(&[("", jpeg(40))]);
    answer.extend_from_slice(b"--b\r\nContent-Type: image/jpeg\r\nContent-");
    let (frames, said) = broken(answer);
    assert!(frames == 1 && said.contains("within a header"), "{said}");
}

#[test]
fn an_image_that_is_too_large_is_no_end() {
    for length in ["33554433", "18446744073709551615", "99999999999999999999"] {
        let header = format!("Content-Length: {length}\r\n");
        let (frames, said) = broken(multipart(&[("", jpeg(40)), (&header, jpeg(90))]));
        assert_eq!(frames, 1);
        assert!(said.contains(length) && said.contains("32 MiB"), "{said}");
    }
    let (frames, said) = broken(multipart(&[("", jpeg(40)), ("", vec![7; (1 << 25) + 100])]));
    assert_eq!(frames, 1);
    assert!(said.contains("more than 33554432"), "{said}");
}

#[test]
fn a_header_that_does_not_end_is_an_error() {
    for line in ["\r\n", "--b\r\n\r\n", "x: y\r\n", "x"] {
        let mut answer = multipart(&[("", jpeg(40))]);
        answer.extend_from_slice(line.repeat(1_000_000).as_bytes());
        let (frames, said) = broken(answer);
        assert_eq!(frames, 1);
        assert!(said.contains("a header that does not end"), "{said}");
    }
}

/// A server that sends an image and then a byte now and then, for a minute.
fn dripping() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}/video", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let mut answer = multipart(&[("", jpeg(40)), ("", Vec::new())]);
        answer.truncate(answer.len() - 2);
        for bytes in std::iter::once(answer.as_slice()).chain([[1].as_slice(); 600]) {
            if stream.write_all(bytes).is_err() {
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    });
    address
}

#[test]
fn a_server_that_drips_is_given_up_in_time() {
    let patience = Patience {
        limit: Some(Duration::from_millis(500)),
        interrupted: None,
    };
    let begin = Instant::now();
    let items: Vec<_> = Video::open_within(dripping(), patience).unwrap().collect();
    assert_eq!(items.len(), 2);
    let stalled = matches!(items[1], Err(VideoError::Stalled { .. }));
    assert!(stalled, "{:?}", items[1]);
    assert!(begin.elapsed() < Duration::from_secs(20));
}
