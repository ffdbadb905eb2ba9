//! Where the samples of a track lie and when each is shown, read from the run-length tables one by
//! one.

use shiguredo_mp4::Either;
use shiguredo_mp4::boxes::{StblBox, StszBox};

/// One coded frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Sample {
    /// Where it begins in the file, bytes.
    pub(crate) offset: u64,
    /// Its length, bytes.
    pub(crate) bytes: u32,
    /// When it is shown, units of the track.
    pub(crate) time: i64,
}

/// The samples of a track in the order of decoding.
#[derive(Clone)]
pub(crate) struct Samples {
    table: StblBox,
    count: usize,
    /// Number of the next sample, from 0.
    next: usize,
    /// Chunks begun so far.
    chunks: usize,
    /// Run of equal chunks (`stsc`) that holds the present one.
    chunk_run: usize,
    left_in_chunk: u32,
    /// Where the next sample of the chunk begins, bytes.
    offset: u64,
    decode_time: i64,
    durations: Runs,
    shifts: Runs,
}

/// Position in a run-length table.
#[derive(Clone, Copy, Default)]
struct Runs {
    run: usize,
    used: u32,
}

impl Runs {
    /// The value for the next sample; the last one goes on when the table is too short.
    fn advance<V: Copy + Default>(&mut self, entry: impl Fn(usize) -> Option<(u32, V)>) -> V {
        while let Some((length, value)) = entry(self.run) {
            if self.used < length {
                self.used += 1;
                return value;
            }
            self.run += 1;
            self.used = 0;
        }
        let last = self.run.checked_sub(1).and_then(entry);
        last.map(|(_, value)| value).unwrap_or_default()
    }
}

impl Samples {
    /// The samples of a table; samples cannot be longer than the file in total.
    pub(crate) fn new(table: StblBox, file_bytes: u64) -> Result<Self, String> {
        let (count, bytes) = match &table.stsz_box {
            StszBox::Fixed {
                sample_size,
                sample_count,
            } => (
                *sample_count as usize,
                u64::from(*sample_count) * u64::from(sample_size.get()),
            ),
            StszBox::Variable { entry_sizes } => {
                let bytes = entry_sizes.iter().map(|&bytes| u64::from(bytes));
                (entry_sizes.len(), bytes.sum())
            }
        };
        if bytes > file_bytes {
            return Err(format!(
                "{bytes} bytes of samples in {file_bytes} of the file"
            ));
        }
        Ok(Self {
            table,
            count,
            next: 0,
            chunks: 0,
            chunk_run: 0,
            left_in_chunk: 0,
            offset: 0,
            decode_time: 0,
            durations: Runs::default(),
            shifts: Runs::default(),
        })
    }

    /// Goes to the next chunk that has samples; `None` when there is none.
    fn begin_chunk(&mut self) -> Option<()> {
        while self.left_in_chunk == 0 {
            self.offset = match &self.table.stco_or_co64_box {
                Either::A(offsets) => u64::from(*offsets.chunk_offsets.get(self.chunks)?),
                Either::B(offsets) => *offsets.chunk_offsets.get(self.chunks)?,
            };
            self.chunks += 1;
            let runs = &self.table.stsc_box.entries;
            while runs
                .get(self.chunk_run + 1)
                .is_some_and(|next| next.first_chunk.get() as usize <= self.chunks)
            {
                self.chunk_run += 1;
            }
            self.left_in_chunk = runs.get(self.chunk_run)?.sample_per_chunk;
        }
        Some(())
    }
}

impl Iterator for Samples {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        if self.next >= self.count {
            return None;
        }
        self.begin_chunk()?;
        let bytes = match &self.table.stsz_box {
            StszBox::Fixed { sample_size, .. } => sample_size.get(),
            StszBox::Variable { entry_sizes } => *entry_sizes.get(self.next)?,
        };
        let durations = &self.table.stts_box.entries;
        let duration = self
            .durations
            .advance(|run| durations.get(run).map(|e| (e.sample_count, e.sample_delta)));
        let shifts = self.table.ctts_box.as_ref().map_or(&[][..], |t| &t.entries);
        let shift = self
            .shifts
            .advance(|run| shifts.get(run).map(|e| (e.sample_count, e.sample_offset)));
        let sample = Sample {
            offset: self.offset,
            bytes,
            time: self.decode_time.saturating_add(shift),
        };
        self.next += 1;
        self.left_in_chunk -= 1;
        self.offset = self.offset.saturating_add(u64::from(bytes));
        self.decode_time = self.decode_time.saturating_add(i64::from(duration));
        Some(sample)
    }
}
