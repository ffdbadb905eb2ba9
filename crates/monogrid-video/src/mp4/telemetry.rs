//! The track beside the picture in which cameras of GoPro write where they are and how they move.

use super::{Sample, Samples, children, survey};
use crate::VideoError;
use monogrid_datasets::CameraTelemetry;
use shiguredo_mp4::boxes::{MdhdBox, StblBox, TrakBox};
use shiguredo_mp4::{BoxHeader, BoxType, Decode};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

/// Largest packet that is read, bytes: that of a second has some ten thousand.
const MAX_PACKET_BYTES: u32 = 1 << 20;

/// What a camera of GoPro wrote into an MP4 beside the picture; `None` where there is no such
/// track.
///
/// # Errors
/// When the file cannot be read.
pub fn read_telemetry(path: &Path) -> Result<Option<CameraTelemetry>, VideoError> {
    let name = path.to_string_lossy();
    let failed = |error| VideoError::io(&name, error);
    let mut file = File::open(path).map_err(failed)?;
    let file_bytes = file.metadata().map_err(failed)?.len();
    let Some(index) = survey(&mut file, file_bytes).map_err(failed)?.index else {
        return Ok(None);
    };
    let mut tracks = children(&index).filter(|(kind, _)| *kind == TrakBox::TYPE);
    let Some((samples, units)) = tracks.find_map(|track| packets(track.1, file_bytes)) else {
        return Ok(None);
    };
    let mut found = CameraTelemetry::default();
    let to_ns = |time: i64| (time as f64 * 1e9 / f64::from(units)) as i64;
    let mut samples = samples.peekable();
    let mut length = 0;
    while let Some(sample) = samples.next() {
        if let Some(next) = samples.peek() {
            length = next.time.saturating_sub(sample.time);
        }
        let Some(packet) = read_packet(&mut file, sample).map_err(failed)? else {
            break;
        };
        let end = sample.time.saturating_add(length.max(1));
        found.add(&packet, [sample.time, end].map(to_ns));
    }
    Ok(Some(found))
}

/// The packets of a track of this kind, and its units per second.
fn packets(track: &[u8], file_bytes: u64) -> Option<(Samples, u32)> {
    let inside = |bytes, kind: &[u8; 4]| {
        let payload = BoxHeader::decode_header_and_payload(bytes).ok()?.1;
        let mut found = children(payload).filter(|child| child.0 == BoxType::Normal(*kind));
        found.next().map(|child| child.1)
    };
    let media = inside(track, b"mdia")?;
    let table = inside(inside(media, b"minf")?, b"stbl")?;
    let kinds = inside(table, b"stsd")?;
    // behind the header of the list and the size of its first element
    if kinds.get(20..24)? != b"gpmd" {
        return None;
    }
    let (header, _) = MdhdBox::decode(inside(media, b"mdhd")?).ok()?;
    let (table, _) = StblBox::decode(table).ok()?;
    Some((
        Samples::new(table, file_bytes).ok()?,
        header.timescale.get(),
    ))
}

/// `None` where the file ends before its end.
fn read_packet(file: &mut File, sample: Sample) -> std::io::Result<Option<Vec<u8>>> {
    if sample.bytes > MAX_PACKET_BYTES {
        return Ok(None);
    }
    file.seek(SeekFrom::Start(sample.offset))?;
    let mut packet = Vec::new();
    file.take(sample.bytes.into()).read_to_end(&mut packet)?;
    Ok((packet.len() == sample.bytes as usize).then_some(packet))
}
