//! MP4 and MOV (ISO 14496-12): the video track, its samples, when and how they are shown.

mod samples;

pub(crate) use samples::{Sample, Samples};

use crate::VideoError;
use crate::turn::Turn;
use shiguredo_mp4::boxes::{
    AvccBox, ElstBox, HdlrBox, MoovBox, MvhdBox, SampleEntry, TrakBox, UnknownBox,
};
use shiguredo_mp4::{BoxHeader, BoxType, Decode};
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};

/// Largest index (`moov`) that is read, bytes: that of a day at 60 Hz.
const MAX_INDEX_BYTES: u64 = 1 << 28;

/// Boxes in front of the index beyond which the file is taken for damaged.
const MAX_BOXES_BEFORE_INDEX: usize = 1000;

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

/// Reads the index of a file: its track of H.264, or what there is instead, for people.
pub(crate) fn read(
    name: &str,
    file: &mut File,
    file_bytes: u64,
) -> Result<Result<Track, String>, VideoError> {
    let index = read_index(file, file_bytes).map_err(|e| VideoError::io(name, e))?;
    let no_index = || content(name, "no index (moov): the recording was not finished");
    let index = index.ok_or_else(no_index)?;
    let mut movie_units_per_second = 1000;
    let mut other = None;
    for (kind, bytes) in children(&index) {
        if kind == MvhdBox::TYPE
            && let Ok((header, _)) = MvhdBox::decode(bytes)
        {
            movie_units_per_second = header.timescale.get();
        }
        if kind == BoxType::Normal(*b"mvex") {
            return Ok(Err("MP4 in fragments".to_owned()));
        }
        if kind == TrakBox::TYPE && is_video(bytes) {
            let track = TrakBox::decode(bytes).map_err(|_| "an unusual video track".to_owned());
            match track.and_then(|(track, _)| open_track(track, movie_units_per_second, file_bytes))
            {
                Ok(track) => return Ok(Ok(track)),
                Err(found) => other = other.or(Some(found)),
            }
        }
    }
    other
        .map(Err)
        .ok_or_else(|| content(name, "no video track"))
}

fn content(name: &str, found: &str) -> VideoError {
    VideoError::content(name, "MP4 or MOV", found, "a complete file with video")
}

/// The content of the index; `None` when there is none.
fn read_index(file: &mut File, file_bytes: u64) -> std::io::Result<Option<Vec<u8>>> {
    let mut position = 0;
    for _ in 0..MAX_BOXES_BEFORE_INDEX {
        if position >= file_bytes {
            return Ok(None);
        }
        file.seek(SeekFrom::Start(position))?;
        let mut head = Vec::new();
        file.take(16).read_to_end(&mut head)?;
        let Ok((header, header_bytes)) = BoxHeader::decode(&head) else {
            return Ok(None);
        };
        let size = match header.box_size.get() {
            0 => file_bytes - position,
            size => size,
        };
        if size < header_bytes as u64 {
            return Ok(None);
        }
        if header.box_type == MoovBox::TYPE {
            let bytes = size - header_bytes as u64;
            if bytes > MAX_INDEX_BYTES || bytes > file_bytes {
                return Ok(None);
            }
            file.seek(SeekFrom::Start(position + header_bytes as u64))?;
            let mut index = Vec::new();
            file.take(bytes).read_to_end(&mut index)?;
            return Ok(Some(index));
        }
        position = position.saturating_add(size);
    }
    Ok(None)
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
    let turn = Turn::from_matrix([matrix[0], matrix[1], matrix[3], matrix[4]])
        .ok_or("a display matrix that is no quarter turn")?;
    let table = track.mdia_box.minf_box.stbl_box;
    let config = match table.stsd_box.entries.as_slice() {
        [SampleEntry::Avc1(entry)] => entry.avcc_box.clone(),
        [entry] => return Err(codec_name(entry)),
        _ => return Err("several codecs in one track".to_owned()),
    };
    Ok(Track {
        config,
        samples: Samples::new(table, file_bytes)?,
        timing,
        turn,
    })
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
