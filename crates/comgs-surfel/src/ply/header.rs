//! The header of a PLY file.

use super::{PlyError, Source};
use std::io::{BufRead, Read};
use std::path::Path;

/// Longest accepted header; real ones stay below 4 KiB.
const MAX_HEADER_BYTES: u64 = 1 << 16;

/// How the body is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// Numbers as text.
    Ascii,
    /// Binary, least significant byte first.
    LittleEndian,
    /// Binary, most significant byte first.
    BigEndian,
}

/// A scalar type of a property.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// 8-bit signed.
    I8,
    /// 8-bit unsigned.
    U8,
    /// 16-bit signed.
    I16,
    /// 16-bit unsigned.
    U16,
    /// 32-bit signed.
    I32,
    /// 32-bit unsigned.
    U32,
    /// 32-bit float.
    F32,
    /// 64-bit float.
    F64,
}

impl Scalar {
    /// Size in bytes.
    #[must_use]
    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// By its name in a header, old or new.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    /// The value of the first [`Scalar::size`] bytes, in little or big endian order.
    pub(super) fn decode(self, bytes: &[u8], big_endian: bool) -> f64 {
        let mut b = [0u8; 8];
        let size = self.size();
        b[..size].copy_from_slice(&bytes[..size]);
        if big_endian {
            b[..size].reverse();
        }
        match self {
            Self::I8 => f64::from(b[0].cast_signed()),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::I32 => f64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

/// A column of an element.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Name.
    pub name: String,
    /// Type of the value, or of a list's items.
    pub scalar: Scalar,
    /// For lists, the type of the item count.
    pub list: Option<Scalar>,
}

/// A table of the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// Name (`vertex`, `face`, …).
    pub name: String,
    /// Promised number of rows; not to be believed before it is compared with the file's length.
    pub count: u64,
    /// Columns in file order.
    pub properties: Vec<Property>,
}

impl Element {
    /// Least bytes of a row in a binary file (a list counts as empty); in ASCII two a value.
    pub(super) fn least_stride(&self, layout: Layout) -> u64 {
        let size = |p: &Property| match layout {
            Layout::Ascii => 2,
            _ => p.list.unwrap_or(p.scalar).size() as u64,
        };
        self.properties.iter().map(size).sum()
    }

    /// Index of a property.
    #[must_use]
    pub fn position(&self, name: &str) -> Option<usize> {
        self.properties.iter().position(|p| p.name == name)
    }
}

/// A parsed header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// How the body is stored.
    pub layout: Layout,
    /// Tables in file order.
    pub elements: Vec<Element>,
    /// Text of the comment lines.
    pub comments: Vec<String>,
}

impl Header {
    /// The table called `vertex`.
    #[must_use]
    pub fn vertex(&self) -> Option<&Element> {
        self.elements.iter().find(|e| e.name == "vertex")
    }

    /// Parses the header and leaves the source at the first byte of the body.
    pub(super) fn parse<R: BufRead>(source: &mut Source<'_, R>) -> Result<Self, PlyError> {
        let path = source.path;
        let mut used = 0;
        if next_line(source, &mut used)?.as_deref() != Some("ply") {
            return Err(PlyError::malformed(path, "the first line is not \"ply\""));
        }
        let mut layout = None;
        let mut elements: Vec<Element> = Vec::new();
        let mut comments = Vec::new();
        loop {
            let Some(line) = next_line(source, &mut used)? else {
                return Err(PlyError::malformed(path, "the header has no end_header"));
            };
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                ["comment", ..] => {
                    comments.push(line.trim_start()["comment".len()..].trim().to_owned());
                }
                [] | ["obj_info", ..] => {}
                ["format", name, _version] => layout = Some(parse_layout(name, path)?),
                ["element", name, count] => {
                    let count = count.parse().map_err(|_| {
                        PlyError::malformed(path, format!("element {name} has the count {count:?}"))
                    })?;
                    elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
                }
                ["property", words @ ..] => {
                    let property = parse_property(words).ok_or_else(|| {
                        PlyError::malformed(
                            path,
                            format!("the property {:?} has no known type", words.join(" ")),
                        )
                    })?;
                    let Some(element) = elements.last_mut() else {
                        return Err(PlyError::malformed(path, "a property stands before any element"));
                    };
                    if element.position(&property.name).is_some() {
                        let reason = format!("element {} lists {} twice", element.name, property.name);
                        return Err(PlyError::malformed(path, reason));
                    }
                    element.properties.push(property);
                }
                _ => {
                    return Err(PlyError::malformed(
                        path,
                        format!("the header line {line:?} has no meaning"),
                    ));
                }
            }
        }
        let layout = layout.ok_or_else(|| PlyError::malformed(path, "the header has no format line"))?;
        Ok(Self { layout, elements, comments })
    }
}

fn parse_layout(name: &str, path: &Path) -> Result<Layout, PlyError> {
    match name {
        "ascii" => Ok(Layout::Ascii),
        "binary_little_endian" => Ok(Layout::LittleEndian),
        "binary_big_endian" => Ok(Layout::BigEndian),
        _ => Err(PlyError::malformed(path, format!("the format {name:?} is unknown"))),
    }
}

fn parse_property(words: &[&str]) -> Option<Property> {
    match words {
        ["list", count, scalar, name] => Some(Property {
            name: (*name).to_owned(),
            scalar: Scalar::from_name(scalar)?,
            list: Some(Scalar::from_name(count)?),
        }),
        [scalar, name] => {
            Some(Property { name: (*name).to_owned(), scalar: Scalar::from_name(scalar)?, list: None })
        }
        _ => None,
    }
}

/// The next header line without its end (`\n` or `\r\n`); `None` at the end of the file.
fn next_line<R: BufRead>(source: &mut Source<'_, R>, used: &mut u64) -> Result<Option<String>, PlyError> {
    let mut line = Vec::new();
    let room = MAX_HEADER_BYTES - *used;
    let read = (&mut source.reader).take(room).read_until(b'\n', &mut line).map_err(|e| source.io(e))? as u64;
    *used += read;
    source.remaining = source.remaining.saturating_sub(read);
    if line.pop() != Some(b'\n') {
        if *used >= MAX_HEADER_BYTES {
            let reason = format!("the header is longer than {MAX_HEADER_BYTES} bytes");
            return Err(PlyError::malformed(source.path, reason));
        }
        return Ok(None);
    }
    if line.last() == Some(&b'\r') {
        line.pop();
    }
    match String::from_utf8(line) {
        Ok(text) => Ok(Some(text)),
        // Comments may be in any encoding; nothing else has letters beyond ASCII.
        Err(bad) => Ok(Some(String::from_utf8_lossy(bad.as_bytes()).into_owned())),
    }
}
