//! Reading submaps, whole or block by block.

use super::block::unpack;
use super::directory::{self, END_MAGIC, FORMAT_VERSION, HEADER_BYTES, MAGIC, TRAILER_BYTES};
use super::id::hash_of;
use super::{KIND, SubmapBlock, SubmapId, SubmapInfo};
use crate::files::open_file;
use crate::recording::{KIND_POSES, decode_record};
use crate::{DatasetError, ReadOptions, Record};
use monogrid_geometry::Sim3;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// A keyframe and where it lies in its submap; `None` where it does not lie in its frame.
pub type SubmapPose = (u32, Option<Sim3>);

/// A submap whose directory is known. Blocks are read when they are asked for, by their range of
/// the file.
///
/// No more is allocated than a block can mean: 64 times its bytes, an image 64 times its bytes.
#[derive(Debug)]
pub struct SubmapReader<R = File> {
    input: R,
    path: PathBuf,
    id: SubmapId,
    info: SubmapInfo,
    blocks: Vec<SubmapBlock>,
}

impl SubmapReader {
    /// Opens a file; where its name is that of a submap, it must be that one.
    ///
    /// # Errors
    /// When it cannot be read, is not a submap or another one, is of a later version, or its
    /// directory is damaged.
    pub fn open(path: &Path) -> Result<Self, DatasetError> {
        let (file, _) = open_file(path)?;
        let reader = Self::new(file, path)?;
        let named = path.file_name().and_then(|name| name.to_str());
        let named = named.and_then(SubmapId::of_file_name);
        match named.filter(|id| *id != reader.id) {
            None => Ok(reader),
            Some(_) => Err(reader.unusable(format!(
                "its content is that of {}, expected that of its name; it was renamed, or written \
                 by others",
                reader.id.file_name()
            ))),
        }
    }
}

impl<R: Read + Seek> SubmapReader<R> {
    /// Reads from anything; `path` is only for messages.
    ///
    /// # Errors
    /// As [`SubmapReader::open`].
    pub fn new(mut input: R, path: &Path) -> Result<Self, DatasetError> {
        let unusable = |reason: String| DatasetError::binary(path, KIND, reason);
        let io = |e| DatasetError::io("read", path, e);
        let length = input.seek(SeekFrom::End(0)).map_err(io)?;
        if length < HEADER_BYTES + TRAILER_BYTES {
            return Err(unusable(format!("{length} bytes are too few (truncated?)")));
        }
        let header: [u8; HEADER_BYTES as usize] = read_at(&mut input, 0).map_err(io)?;
        check_header(&header).map_err(unusable)?;
        let end = length - TRAILER_BYTES;
        let trailer: [u8; TRAILER_BYTES as usize] = read_at(&mut input, end).map_err(io)?;
        let (begin, id) = parse_trailer(&trailer, end).ok_or_else(|| {
            unusable("it does not end as submaps do (truncated? it is never appended to)".into())
        })?;
        let mut bytes = vec![0; (end - begin) as usize];
        input.seek(SeekFrom::Start(begin)).map_err(io)?;
        input.read_exact(&mut bytes).map_err(io)?;
        let whole = (hash_of(&bytes) == id.0).then_some(bytes);
        let (info, blocks) = whole
            .and_then(|bytes| directory::decode(&bytes, begin))
            .ok_or_else(|| unusable("its directory is damaged; fetch it again".into()))?;
        Ok(Self {
            input,
            path: path.to_path_buf(),
            id,
            info,
            blocks,
        })
    }

    /// Its name.
    #[must_use]
    pub fn id(&self) -> SubmapId {
        self.id
    }

    /// What holds for all of it.
    #[must_use]
    pub fn info(&self) -> &SubmapInfo {
        &self.info
    }

    /// Its blocks, in the order of the file.
    #[must_use]
    pub fn blocks(&self) -> &[SubmapBlock] {
        &self.blocks
    }

    /// Keyframes in it.
    #[must_use]
    pub fn num_keyframes(&self) -> usize {
        let blocks = self.blocks.iter();
        blocks.filter(|block| block.is_keyframe()).count()
    }

    /// The record of one block; `None` where it is of a kind of a later version, or not asked for.
    ///
    /// # Errors
    /// When the file cannot be read, or the block is not what was written.
    pub fn read(
        &mut self,
        block: &SubmapBlock,
        options: ReadOptions,
    ) -> Result<Option<Record>, DatasetError> {
        let path = &self.path;
        let io = |e| DatasetError::io("read", path, e);
        // the directory has been compared with the length of the file
        let mut stored = vec![0; block.stored_bytes as usize];
        let found = self.input.seek(SeekFrom::Start(block.offset));
        found.map_err(io)?;
        self.input.read_exact(&mut stored).map_err(io)?;
        let what = || format!("its block at byte {}", block.offset);
        if hash_of(&stored) != block.hash {
            return Err(self.unusable(format!("{} is damaged; fetch it again", what())));
        }
        let payload = unpack(block.codec, stored, block.record_bytes as usize);
        let record = payload
            .and_then(|payload| decode_record(block.kind, &payload, options.with_images).ok());
        record.ok_or_else(|| self.unusable(format!("{} is not what its kind says", what())))
    }

    /// All records of known kinds, in the order of the file.
    pub fn records(
        &mut self,
        options: ReadOptions,
    ) -> impl Iterator<Item = Result<Record, DatasetError>> {
        let blocks = self.blocks.clone().into_iter();
        blocks.filter_map(move |block| self.read(&block, options).transpose())
    }

    /// Where its keyframes lie in it, in the order of the file.
    ///
    /// # Errors
    /// As [`SubmapReader::read`].
    pub fn poses(&mut self) -> Result<Vec<SubmapPose>, DatasetError> {
        let mut placed = std::collections::BTreeMap::new();
        let options = ReadOptions { with_images: false };
        for block in self.blocks.clone() {
            if block.kind == KIND_POSES
                && let Some(Record::Poses(snapshot)) = self.read(&block, options)?
            {
                placed.extend(snapshot.poses);
            }
        }
        let keyframes = self.blocks.iter().filter(|block| block.is_keyframe());
        let ids = keyframes.filter_map(|block| block.keyframe);
        Ok(ids.map(|id| (id, placed.get(&id).copied())).collect())
    }

    fn unusable(&self, reason: String) -> DatasetError {
        DatasetError::binary(&self.path, KIND, reason)
    }
}

fn read_at<const N: usize>(input: &mut (impl Read + Seek), at: u64) -> std::io::Result<[u8; N]> {
    let mut bytes = [0; N];
    input.seek(SeekFrom::Start(at))?;
    input.read_exact(&mut bytes)?;
    Ok(bytes)
}

fn check_header(header: &[u8; HEADER_BYTES as usize]) -> Result<(), String> {
    let version = u32::from_le_bytes([header[8], header[9], header[10], header[11]]);
    if header[..8] != MAGIC {
        return Err("it does not start with `mgsubmap`, as .mgs files do".to_owned());
    }
    if version != FORMAT_VERSION || header[12..] != [0; 4] {
        return Err(format!(
            "format version {version}, this program reads version {FORMAT_VERSION}"
        ));
    }
    Ok(())
}

/// Where the directory begins, and its hash; it ends where the trailer begins.
fn parse_trailer(trailer: &[u8; TRAILER_BYTES as usize], end: u64) -> Option<(u64, SubmapId)> {
    let (numbers, rest) = trailer.split_at(16);
    let (hash, magic) = rest.split_at(32);
    let number = |at: usize| Some(u64::from_le_bytes(*numbers[at..].first_chunk()?));
    let (begin, length) = (number(0)?, number(8)?);
    let fits = begin >= HEADER_BYTES && begin.checked_add(length) == Some(end);
    (fits && magic == END_MAGIC).then_some((begin, SubmapId(*hash.first_chunk()?)))
}
