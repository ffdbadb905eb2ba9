//! A phone as camera: MJPEG from a server on this machine.
#![allow(clippy::unwrap_used, clippy::print_stderr, reason = "tests")]

use monogrid_datasets::encode_jpeg;
use monogrid_image::Image;
use monogrid_video::{Video, VideoError};
use std::io::{Read, Write};
use std::net::TcpListener;
use std::thread::JoinHandle;

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
