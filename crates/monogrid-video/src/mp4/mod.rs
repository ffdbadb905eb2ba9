//! MP4 and MOV (ISO 14496-12): the video track, its samples, when and how they are shown.

mod samples;
mod telemetry;

pub(crate) use samples::{Sample, Samples};
pub use telemetry::read_telemetry;

use crate::VideoError;
use crate::opened::Elsewhere;
use crate::pixels::PixelShape;
use crate::turn::Turn;
use shiguredo_mp4::boxes::{
    AvccBox, ElstBox, HdlrBox, MvhdBox, SampleEntry, TkhdBox, TrakBox, UnknownBox,
};
use shiguredo_mp4::{BoxHeader, BoxType, Decode};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

/// Largest index (`moov`) that is read, bytes: that of a day at 60 Hz.
const MAX_INDEX_BYTES: u64 = 1 << 28;

/// Boxes of a file that are looked at for its index and for fragments.
const MAX_BOXES: usize = 100_000;

/// The video track of a file.
pub(crate) struct Track {
    /// What is needed before the first sample.
    pub(crate) config: AvccBox,
    /// Samples in the order of decoding.
    pub(crate) samples: Samples,
    /// When they are shown.
    pub(crate) timing: Timing,
    /// How they are turned.
    pub(crate) turn: Turn,
    /// The shape of the pixels as they are stored; `None` where the container does not say it.
    pub(crate) pixels: Option<PixelShape>,
    /// Whether the container mirrors them, which is not done.
    pub(crate) is_mirrored: bool,
}

/// From times of the track to times of the film.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Timing {
    /// Units per second of the track.
    units_per_second: u32,
    /// First time of the track that is shown, units.
    begin: i64,
    /// First time of the track that is not shown any more, units.
    end: Option<i64>,
    /// When showing begins, nanoseconds.
    delay_ns: i64,
}

impl Timing {
    /// When a sample is shown, nanoseconds; `None` when the edit list leaves it out.
    pub(crate) fn shown_ns(&self, time: i64) -> Option<i64> {
        if time < self.begin || self.end.is_some_and(|end| time >= end) {
            return None;
        }
        let since_begin = i128::from(time) - i128::from(self.begin);
        let nanoseconds = since_begin * 1_000_000_000 / i128::from(self.units_per_second);
        i64::try_from(nanoseconds + i128::from(self.delay_ns)).ok()
    }
}

/// Reads the index of a file: its track of H.264, or what there is instead.
pub(crate) fn read(
    name: &str,
    file: &mut File,
    file_bytes: u64,
) -> Result<Result<Track, Elsewhere>, VideoError> {
    let survey = survey(file, file_bytes).map_err(|e| VideoError::io(name, e))?;
    let Some(index) = survey.index else {
        // whose index may be behind the fragments, or with another file
        if survey.has_fragments {
            return Ok(Err(Elsewhere::new(FRAGMENTS)));
        }
        return Err(content(
            name,
            "no index (moov): the recording was not finished",
        ));
    };
    let boxes: Vec<_> = children(&index).collect();
    let is_video_track =
        |(kind, bytes): &&(BoxType, &[u8])| *kind == TrakBox::TYPE && is_video(bytes);
    let tracks: Vec<&[u8]> = boxes.iter().filter(is_video_track).map(|b| b.1).collect();
    let is_mirrored = tracks.first().is_some_and(|track| is_mirrored(track));
    let elsewhere = |found: String| Ok(Err(Elsewhere { found, is_mirrored }));
    // the box that announces fragments lies before or behind the tracks
    if survey.has_fragments || boxes.iter().any(|b| b.0 == BoxType::Normal(*b"mvex")) {
        return elsewhere(FRAGMENTS.to_owned());
    }
    let header = boxes.iter().find(|b| b.0 == MvhdBox::TYPE);
    let header = header.and_then(|header| MvhdBox::decode(header.1).ok());
    let units_per_second = header.map_or(1000, |(header, _)| header.timescale.get());
    let mut other = None;
    for bytes in tracks {
        let track = TrakBox::decode(bytes).map_err(|_| "an unusual video track".to_owned());
        match track.and_then(|(track, _)| open_track(track, units_per_second, file_bytes)) {
            Ok(track) => return Ok(Ok(track)),
            Err(found) => other = other.or(Some(found)),
        }
    }
    let known_bytes: usize = boxes.iter().map(|b| b.1.len()).sum();
    match other {
        Some(found) => elsewhere(found),
        None if known_bytes < index.len() => elsewhere("an index that is damaged".to_owned()),
        None => Err(content(name, "no video track")),
    }
}

/// What a file is whose samples are not all in its index.
const FRAGMENTS: &str = "MP4 in fragments";

fn content(name: &str, found: &str) -> VideoError {
    VideoError::content(name, "MP4 or MOV", found, "a complete file with video")
}

/// What lies in a file.
#[derive(Default)]
struct Survey {
    /// The content of the index (`moov`).
    index: Option<Vec<u8>>,
    /// Whether samples lie in fragments (`moof`), whatever the index says.
    has_fragments: bool,
}

/// Looks at the boxes of a file, up to the first fragment. What is between them does not matter.
fn survey(file: &mut File, file_bytes: u64) -> std::io::Result<Survey> {
    let mut survey = Survey::default();
    let mut position = 0;
    for _ in 0..MAX_BOXES {
        if position >= file_bytes {
            break;
        }
        file.seek(SeekFrom::Start(position))?;
        let mut head = Vec::new();
        file.take(MAX_HEAD_BYTES).read_to_end(&mut head)?;
        let Some((kind, head_bytes, size)) = box_head(&head) else {
            break;
        };
        let size = size.unwrap_or(file_bytes - position);
        let Some(bytes) = size.checked_sub(head_bytes) else {
            break;
        };
        match &kind {
            b"moof" => survey.has_fragments = true,
            b"moov" if survey.index.is_none() => {
                if bytes > MAX_INDEX_BYTES || bytes > file_bytes {
                    break;
                }
                file.seek(SeekFrom::Start(position + head_bytes))?;
                let mut index = Vec::new();
                file.take(bytes).read_to_end(&mut index)?;
                survey.index = Some(index);
            }
            _ => {}
        }
        if survey.has_fragments && survey.index.is_some() {
            break;
        }
        position = position.saturating_add(size);
    }
    Ok(survey)
}

/// Bytes of a header with a long size.
const MAX_HEAD_BYTES: u64 = 16;

/// Kind of a box, bytes of its header, and of all of it (`None`: to the end). A box with a kind of
/// its own (`uuid`) has 16 bytes more in front of its content, which nobody reads.
fn box_head(head: &[u8]) -> Option<([u8; 4], u64, Option<u64>)> {
    let (size, rest) = head.split_first_chunk()?;
    let (kind, rest) = rest.split_first_chunk()?;
    Some(match u32::from_be_bytes(*size) {
        0 => (*kind, 8, None),
        1 => (*kind, 16, Some(u64::from_be_bytes(*rest.first_chunk()?))),
        size => (*kind, 8, Some(size.into())),
    })
}

/// The boxes in the content of a box, each with its header, up to the first that is damaged.
fn children(mut content: &[u8]) -> impl Iterator<Item = (BoxType, &[u8])> {
    std::iter::from_fn(move || {
        let (header, payload) = BoxHeader::decode_header_and_payload(content).ok()?;
        let end = header.external_size().checked_add(payload.len())?;
        let (this, rest) = content.split_at_checked(end)?;
        content = rest;
        Some((header.box_type, this))
    })
}

/// Whether the display matrix of a track mirrors its picture, turned or not.
fn is_mirrored(track: &[u8]) -> bool {
    let payload = BoxHeader::decode_header_and_payload(track).map_or(&[][..], |b| b.1);
    let mut headers = children(payload).filter(|child| child.0 == TkhdBox::TYPE);
    let header = headers.find_map(|header| TkhdBox::decode(header.1).ok());
    header.is_some_and(|(header, _)| mirrors(&header.matrix))
}

fn mirrors(matrix: &[i32; 9]) -> bool {
    let [a, b, c, d] = [matrix[0], matrix[1], matrix[3], matrix[4]].map(i64::from);
    a * d < b * c
}

/// Whether the handler (`mdia/hdlr`) of a track is video; other tracks may be of any make.
fn is_video(track: &[u8]) -> bool {
    let payload = |bytes| BoxHeader::decode_header_and_payload(bytes).map_or(&[][..], |b| b.1);
    children(payload(track))
        .filter(|child| child.0 == BoxType::Normal(*b"mdia"))
        .flat_map(|media| children(payload(media.1)))
        .filter(|child| child.0 == HdlrBox::TYPE)
        .filter_map(|handler| HdlrBox::decode(handler.1).ok())
        .any(|(handler, _)| handler.handler_type == HdlrBox::HANDLER_TYPE_VIDE)
}

/// A track that can be decoded here; otherwise what it is.
fn open_track(
    track: TrakBox,
    movie_units_per_second: u32,
    file_bytes: u64,
) -> Result<Track, String> {
    let units_per_second = track.mdia_box.mdhd_box.timescale.get();
    let edits = track.edts_box.and_then(|edits| edits.elst_box);
    let timing = timing(edits.as_ref(), units_per_second, movie_units_per_second)?;
    let matrix = track.tkhd_box.matrix;
    let is_mirrored = mirrors(&matrix);
    let turn = match is_mirrored {
        true => Turn::None,
        false => Turn::from_matrix([matrix[0], matrix[1], matrix[3], matrix[4]])
            .ok_or("a display matrix that is no quarter turn")?,
    };
    let table = track.mdia_box.minf_box.stbl_box;
    let (config, pixels) = match table.stsd_box.entries.as_slice() {
        [SampleEntry::Avc1(entry)] => (entry.avcc_box.clone(), pixel_shape(&entry.unknown_boxes)),
        [entry] => return Err(codec_name(entry)),
        _ => return Err("several codecs in one track".to_owned()),
    };
    Ok(Track {
        config,
        samples: Samples::new(table, file_bytes)?,
        timing,
        turn,
        pixels,
        is_mirrored,
    })
}

/// The shape of the pixels, among the boxes of a codec (`pasp`).
fn pixel_shape(boxes: &[UnknownBox]) -> Option<PixelShape> {
    let mut shapes = boxes
        .iter()
        .filter(|b| b.box_type == BoxType::Normal(*b"pasp"));
    let payload = &shapes.next()?.payload;
    let (width, rest) = payload.split_first_chunk()?;
    let height = rest.first_chunk()?;
    let [width, height] = [width, height].map(|side| u32::from_be_bytes(*side).into());
    Some(PixelShape::new(width, height))
}

/// The name of a codec as people know it.
fn codec_name(entry: &SampleEntry) -> String {
    match entry {
        SampleEntry::Hev1(_) | SampleEntry::Hvc1(_) => "H.265 (HEVC)".to_owned(),
        SampleEntry::Vp08(_) => "VP8".to_owned(),
        SampleEntry::Vp09(_) => "VP9".to_owned(),
        SampleEntry::Av01(_) => "AV1".to_owned(),
        SampleEntry::Unknown(UnknownBox { box_type, .. }) => format!("codec {box_type}"),
        _ => "another codec".to_owned(),
    }
}

/// Reads the edit list: at most an empty edit (a delay), then one piece of the track.
fn timing(
    edits: Option<&ElstBox>,
    units_per_second: u32,
    movie_units_per_second: u32,
) -> Result<Timing, String> {
    let mut timing = Timing {
        units_per_second,
        begin: 0,
        end: None,
        delay_ns: 0,
    };
    let mut entries = edits.map_or(&[][..], |edits| &edits.entries);
    let movie = i128::from(movie_units_per_second);
    if let [empty, rest @ ..] = entries
        && empty.media_time < 0
    {
        let delay_ns = i128::from(empty.edit_duration) * 1_000_000_000 / movie;
        timing.delay_ns = i64::try_from(delay_ns).map_err(|_| "an endless delay")?;
        entries = rest;
    }
    match entries {
        [] => {}
        [piece] if piece.media_time >= 0 => {
            timing.begin = piece.media_time;
            // rounded up: the duration is counted in the coarser units of the film
            let units = (i128::from(piece.edit_duration) * i128::from(units_per_second) + movie
                - 1)
                / movie;
            timing.end = (units > 0)
                .then(|| i64::try_from(units).ok()?.checked_add(piece.media_time))
                .flatten();
        }
        _ => return Err("an edit list of several pieces".to_owned()),
    }
    Ok(timing)
}

#[cfg(test)]
mod tests {
    use super::{ElstBox, timing};
    use shiguredo_mp4::FixedPointNumber;
    use shiguredo_mp4::boxes::ElstEntry;

    fn edit(edit_duration: u64, media_time: i64) -> ElstEntry {
        ElstEntry {
            edit_duration,
            media_time,
            media_rate: FixedPointNumber::new(1, 0),
        }
    }

    #[test]
    fn an_edit_list_delays_and_cuts() {
        let entries = vec![edit(500, -1), edit(2000, 90)];
        let timing = timing(Some(&ElstBox { entries }), 90, 1000).unwrap();
        assert_eq!(timing.shown_ns(89), None);
        assert_eq!(timing.shown_ns(90), Some(500_000_000));
        assert_eq!(timing.shown_ns(91), Some(511_111_111));
        assert_eq!(timing.shown_ns(269), Some(2_488_888_888));
        assert_eq!(timing.shown_ns(270), None);
    }

    #[test]
    fn without_an_edit_list_times_are_those_of_the_track() {
        let timing = timing(None, 1000, 1000).unwrap();
        assert_eq!(timing.shown_ns(33), Some(33_000_000));
        assert_eq!(timing.shown_ns(-1), None);
    }

    #[test]
    fn several_pieces_are_left_to_ffmpeg() {
        let entries = vec![edit(10, 0), edit(10, 100)];
        assert!(timing(Some(&ElstBox { entries }), 1000, 1000).is_err());
    }
}
