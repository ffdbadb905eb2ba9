//! Tables of an SQLite file, read row by row: the part of the published file format that a closed
//! recording uses.
//!
//! A table is a tree of pages. Its leaves hold rows: a list of types, then the values; what does
//! not fit goes on in a chain of overflow pages. Nothing is looked up and nothing written, which is
//! why a hundred lines take the place of a library in C.

use crate::magic;
use crate::part::Input;
use std::io::{Read, Seek, SeekFrom};

const HEADER_BYTES: usize = 100;
const LEAF: u8 = 0x0d;
const INTERIOR: u8 = 0x05;

/// Most bytes of a row.
const MAX_ROW_BYTES: u64 = 1 << 30;

/// A value of a row.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    Null,
    Integer(i64),
    Text(String),
    Blob(Vec<u8>),
    /// A number that is not whole: no recording has one where we look.
    Real,
}

/// A row: its number, and the values of its columns in the order of the table's definition.
pub type Row = (i64, Vec<Value>);

/// An open file.
#[derive(Debug)]
pub struct Database {
    file: Input,
    page_bytes: usize,
    /// Bytes of a page that hold data.
    usable: usize,
    num_pages: u32,
}

impl Database {
    pub fn open(mut file: Input) -> Result<Self, String> {
        let mut header = [0; HEADER_BYTES];
        file.read_exact(&mut header)
            .map_err(|_| "the file is shorter than its header".to_owned())?;
        if !header.starts_with(magic::SQLITE) {
            return Err("it does not begin as an SQLite file".to_owned());
        }
        let page_bytes = match u16::from_be_bytes([header[16], header[17]]) {
            1 => 65536,
            bytes => usize::from(bytes),
        };
        if !(512..=65536).contains(&page_bytes) || !page_bytes.is_power_of_two() {
            return Err(format!(
                "pages of {page_bytes} bytes, expected a power of two from 512 to 65536"
            ));
        }
        let usable = page_bytes - usize::from(header[20]);
        if usable < 480 {
            return Err(format!(
                "pages have {usable} bytes for data, expected at least 480"
            ));
        }
        let length = file.length().map_err(|error| error.to_string())?;
        Ok(Self {
            file,
            page_bytes,
            usable,
            num_pages: u32::try_from(length / page_bytes as u64).unwrap_or(u32::MAX),
        })
    }

    /// The rows of a table, in the order of their numbers.
    pub fn table(self, name: &str) -> Result<Rows, String> {
        // the table of tables has type, name, table, page where the table begins, text
        let file = self.file.clone();
        for row in Rows::new(Self { file, ..self }, 1) {
            let (_, values) = row?;
            if let [Value::Text(kind), Value::Text(found), _, page, ..] = values.as_slice()
                && (kind.as_str(), found.as_str()) == ("table", name)
            {
                let page = match page {
                    Value::Integer(page) => u32::try_from(*page).ok(),
                    _ => None,
                };
                let page = page.ok_or_else(|| format!("table {name} has no first page"))?;
                return Ok(Rows::new(self, page));
            }
        }
        Err(format!("there is no table {name}"))
    }

    fn page(&mut self, number: u32) -> Result<Vec<u8>, String> {
        if number == 0 || number > self.num_pages {
            return Err(format!("page {number} of {} is asked for", self.num_pages));
        }
        let mut page = vec![0; self.page_bytes];
        let offset = u64::from(number - 1) * self.page_bytes as u64;
        let sought = self.file.seek(SeekFrom::Start(offset));
        sought
            .and_then(|_| self.file.read_exact(&mut page))
            .map_err(|error| error.to_string())?;
        Ok(page)
    }

    /// The bytes of a row that begin at `start` of a leaf, with what overflows.
    fn payload(&mut self, page: &[u8], start: usize, length: u64) -> Result<Vec<u8>, String> {
        if length > MAX_ROW_BYTES {
            return Err(format!(
                "a row claims {length} bytes, expected at most {MAX_ROW_BYTES}"
            ));
        }
        let length = length as usize;
        let cut = || "a row ends outside its page".to_owned();
        let local = self.local_bytes(length);
        let mut bytes = page.get(start..start + local).ok_or_else(cut)?.to_vec();
        let mut next = match local == length {
            true => 0,
            false => be_u32(page, start + local).ok_or_else(cut)?,
        };
        // in a circle, too, there are no more than the row claims
        while bytes.len() < length {
            let page = self.page(next)?;
            let more = (length - bytes.len()).min(self.usable - 4);
            bytes.extend_from_slice(&page[4..4 + more]);
            next = be_u32(&page, 0).unwrap_or(0);
        }
        Ok(bytes)
    }

    /// How much of a row of so many bytes lies in its leaf (file format, 1.6).
    fn local_bytes(&self, length: usize) -> usize {
        let most = self.usable - 35;
        if length <= most {
            return length;
        }
        let least = (self.usable - 12) * 32 / 255 - 23;
        let fitting = least + (length - least) % (self.usable - 4);
        if fitting <= most { fitting } else { least }
    }
}

/// The rows of a table.
pub struct Rows {
    database: Database,
    /// Pages that wait, the next one last.
    waiting: Vec<u32>,
    /// The present leaf and its cells that wait, the next one last.
    leaf: (Vec<u8>, Vec<usize>),
    /// Every page belongs to the tree once.
    pages_left: u32,
    /// Rows do not share bytes: together they have no more than the file.
    bytes_left: u64,
}

impl Rows {
    fn new(database: Database, root: u32) -> Self {
        Self {
            pages_left: database.num_pages,
            bytes_left: u64::from(database.num_pages) * database.page_bytes as u64,
            database,
            waiting: vec![root],
            leaf: (Vec::new(), Vec::new()),
        }
    }

    /// Opens the next page of the tree.
    fn open(&mut self, number: u32) -> Result<(), String> {
        self.pages_left = self
            .pages_left
            .checked_sub(1)
            .ok_or("pages of a table in a circle")?;
        let page = self.database.page(number)?;
        // the first page begins with the header of the file
        let head = if number == 1 { HEADER_BYTES } else { 0 };
        let kind = page[head];
        let count = usize::from(u16::from_be_bytes([page[head + 3], page[head + 4]]));
        let pointers = head + if kind == INTERIOR { 12 } else { 8 };
        let cell = |k: usize| {
            let at = pointers + 2 * k;
            let bytes = page.get(at..at + 2)?;
            Some(usize::from(u16::from_be_bytes([bytes[0], bytes[1]])))
        };
        let cells: Option<Vec<usize>> = (0..count).rev().map(cell).collect();
        let cells = cells.ok_or("more cells than a page can hold")?;
        match kind {
            LEAF => self.leaf = (page, cells),
            INTERIOR => {
                self.waiting.extend(be_u32(&page, head + 8));
                for cell in cells {
                    let child = be_u32(&page, cell).ok_or("a cell outside its page")?;
                    self.waiting.push(child);
                }
            }
            other => {
                return Err(format!(
                    "page {number} is of kind {other}, expected one of a table"
                ));
            }
        }
        Ok(())
    }

    fn row(&mut self, cell: usize) -> Result<Row, String> {
        let page = &self.leaf.0;
        let cut = "a row ends outside its page";
        let (length, after) = varint(page, cell).ok_or(cut)?;
        let (number, start) = varint(page, after).ok_or(cut)?;
        self.bytes_left = self
            .bytes_left
            .checked_sub(length)
            .ok_or("rows of more bytes than the file has: some lie in others")?;
        let bytes = self.database.payload(page, start, length)?;
        let values = values(&bytes).ok_or("a row ends within its values")?;
        Ok((number.cast_signed(), values))
    }
}

impl Iterator for Rows {
    type Item = Result<Row, String>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(cell) = self.leaf.1.pop() {
                let row = self.row(cell);
                if row.is_err() {
                    self.leaf.1.clear();
                    self.waiting.clear();
                }
                return Some(row);
            }
            let page = self.waiting.pop()?;
            if let Err(error) = self.open(page) {
                self.waiting.clear();
                return Some(Err(error));
            }
        }
    }
}

fn be_u32(bytes: &[u8], at: usize) -> Option<u32> {
    let bytes = bytes.get(at..)?.first_chunk()?;
    Some(u32::from_be_bytes(*bytes))
}

/// A number of one to nine bytes, seven bits each and eight in the ninth, and where the next one
/// begins.
fn varint(bytes: &[u8], at: usize) -> Option<(u64, usize)> {
    let mut value = 0;
    for k in 0..8 {
        let byte = *bytes.get(at + k)?;
        value = value << 7 | u64::from(byte & 0x7f);
        if byte < 0x80 {
            return Some((value, at + k + 1));
        }
    }
    Some((value << 8 | u64::from(*bytes.get(at + 8)?), at + 9))
}

/// The values of a row: the types behind their length, then the values.
fn values(bytes: &[u8]) -> Option<Vec<Value>> {
    let (types_end, mut at) = varint(bytes, 0)?;
    let types_end = usize::try_from(types_end)
        .ok()
        .filter(|end| *end <= bytes.len())?;
    let mut rest = &bytes[types_end..];
    let mut values = Vec::new();
    while at < types_end {
        let (kind, next) = varint(bytes, at)?;
        at = next;
        let length = match kind {
            0 | 8 | 9 => 0,
            1..=4 => kind,
            5 => 6,
            6 | 7 => 8,
            10 | 11 => return None,
            _ => (kind - 12) / 2,
        };
        let (value, after) = rest.split_at_checked(usize::try_from(length).ok()?)?;
        rest = after;
        values.push(match kind {
            0 => Value::Null,
            7 => Value::Real,
            8 => Value::Integer(0),
            9 => Value::Integer(1),
            1..=6 => Value::Integer(signed(value)),
            _ if kind % 2 == 0 => Value::Blob(value.to_vec()),
            _ => Value::Text(String::from_utf8_lossy(value).into_owned()),
        });
    }
    Some(values)
}

/// Two's complement, the highest byte first.
fn signed(bytes: &[u8]) -> i64 {
    let sign = bytes.first().map_or(0, |byte| byte.cast_signed() >> 7);
    let bytes = bytes.iter();
    bytes.fold(sign.into(), |value, byte| value << 8 | i64::from(*byte))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_all_lengths() {
        assert_eq!(varint(&[0x7f], 0), Some((127, 1)));
        assert_eq!(varint(&[0x81, 0x00], 0), Some((128, 2)));
        assert_eq!(varint(&[0xff; 9], 0), Some((u64::MAX, 9)));
        assert_eq!(varint(&[0x80; 8], 0), None);
        assert_eq!(signed(&[0xff]), -1);
        assert_eq!(signed(&[0x01, 0x00, 0x00]), 65536);
        assert_eq!(signed(&[]), 0);
    }

    #[test]
    fn a_row_of_every_type() {
        // header of 7 bytes: null, i8, 0, 1, blob of 1, text of 2
        let row = [7, 0, 1, 8, 9, 14, 17, 0xfe, 0xaa, b'h', b'i'];
        let expected = [
            Value::Null,
            Value::Integer(-2),
            Value::Integer(0),
            Value::Integer(1),
            Value::Blob(vec![0xaa]),
            Value::Text("hi".to_owned()),
        ];
        assert_eq!(values(&row).unwrap(), expected);
        for cut in 0..row.len() {
            assert!(values(&row[..cut]).is_none(), "{cut}");
        }
    }

    const PAGE: usize = 512;

    /// A page of this kind with so many cells, which are all the same one.
    fn page_of(kind: u8, cell: &[u8], count: usize, head: usize) -> Vec<u8> {
        let mut page = vec![0; PAGE];
        let start = PAGE - cell.len();
        page[start..].copy_from_slice(cell);
        page[head] = kind;
        page[head + 3..head + 5].copy_from_slice(&(count as u16).to_be_bytes());
        for k in 0..count {
            let at = head + 8 + 2 * k;
            page[at..at + 2].copy_from_slice(&(start as u16).to_be_bytes());
        }
        page
    }

    /// The rows of a table whose first page is the second of a file of so many bytes.
    fn rows_of(page: Vec<u8>, file_bytes: u64) -> Rows {
        // texts of five bytes and of one, a number of one
        let types = [6, 23, 15, 15, 1, 15];
        let table = [&types[..], b"table", b"t", b"t", &[2], b"x"].concat();
        let table = [&[table.len() as u8, 1], table.as_slice()].concat();
        let mut bytes = page_of(LEAF, &table, 1, HEADER_BYTES);
        bytes[..magic::SQLITE.len()].copy_from_slice(magic::SQLITE);
        bytes[16..18].copy_from_slice(&(PAGE as u16).to_be_bytes());
        bytes.extend(page);
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        file.as_file().set_len(file_bytes).unwrap();
        let input = Input::of(std::fs::File::open(file.path()).unwrap());
        Database::open(input).unwrap().table("t").unwrap()
    }

    #[test]
    fn rows_that_lie_in_one_another_end_where_the_file_would() {
        // one of fifty bytes
        let row = [&[52, 1, 2, 112][..], &[7; 50]].concat();
        let rows = rows_of(page_of(LEAF, &row, 40, 0), 1024);
        let (whole, broken): (Vec<_>, Vec<_>) = rows.partition(Result::is_ok);
        // a file of 1024 bytes, rows of 52
        assert_eq!(whole.len(), 19);
        let error = broken.into_iter().next().unwrap().unwrap_err();
        assert!(error.contains("more bytes than the file"), "{error}");
    }

    #[test]
    fn a_table_that_leads_to_itself_has_an_end() {
        let mut page = page_of(INTERIOR, &[], 0, 0);
        page[8..12].copy_from_slice(&2_u32.to_be_bytes());
        let read: Vec<_> = rows_of(page, 1024).collect();
        assert_eq!(read, [Err("pages of a table in a circle".to_owned())]);
    }

    #[test]
    fn a_row_of_more_than_a_gigabyte_is_refused_before_it_is_read() {
        // 2^30 and one more
        let row = [0x84, 0x80, 0x80, 0x80, 0x01, 1];
        let read: Vec<_> = rows_of(page_of(LEAF, &row, 1, 0), 1 << 31).collect();
        let [Err(error)] = read.as_slice() else {
            panic!("{read:?}");
        };
        assert!(error.contains("claims 1073741825 bytes"), "{error}");
    }
}
