//! JSON with limits, and with errors that name the place.

use crate::SceneError;
use glam::DMat4;
use serde::de::{self, DeserializeOwned, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;
use std::fmt;
use std::io::Read;
use std::path::Path;

/// Largest JSON file that is read. Ten thousand cameras take about 10 MB.
pub const MAX_BYTES: u64 = 64 << 20;
/// Most frames of a capture.
pub const MAX_FRAMES: usize = 100_000;

/// Reads a regular file of at most `limit` bytes.
///
/// # Errors
/// [`SceneError::Io`] when it cannot be read, [`SceneError::Malformed`] when it is longer or not a regular file.
pub fn read_limited(path: &Path, limit: u64) -> Result<Vec<u8>, SceneError> {
    let meta = std::fs::metadata(path).map_err(SceneError::io(path))?;
    if !meta.is_file() {
        return Err(SceneError::malformed(path, "not a regular file"));
    }
    if meta.len() > limit {
        return Err(SceneError::malformed(path, format!("{} bytes, expected at most {limit}", meta.len())));
    }
    let mut bytes = Vec::with_capacity(meta.len() as usize);
    std::fs::File::open(path)
        .and_then(|file| file.take(limit).read_to_end(&mut bytes))
        .map_err(SceneError::io(path))?;
    Ok(bytes)
}

/// Parses JSON; errors carry the path inside the document, behind `prefix`.
///
/// Nesting is limited to 128 levels.
///
/// # Errors
/// [`SceneError::Json`]; `path` is only for messages.
pub fn parse<'de, T: Deserialize<'de>>(bytes: &'de [u8], prefix: &str, path: &Path) -> Result<T, SceneError> {
    let mut deserializer = serde_json::Deserializer::from_slice(bytes);
    let value = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let inside = error.path().to_string();
        let location = match (prefix.is_empty(), inside.as_str()) {
            (_, "." | "?" | "") => prefix.to_owned(),
            (true, _) => inside,
            (false, _) => format!("{prefix}.{inside}"),
        };
        let mut reason = error.into_inner().to_string();
        // A part of a document has no lines of its own; its path says more.
        if let (false, Some(cut)) = (prefix.is_empty(), reason.rfind(" at line ")) {
            reason.truncate(cut);
        }
        SceneError::json(path, location, reason)
    })?;
    deserializer.end().map_err(|e| SceneError::json(path, "", e.to_string()))?;
    Ok(value)
}

/// Reads and parses a JSON file.
///
/// # Errors
/// As [`read_limited`] and [`parse`].
pub fn read<T: DeserializeOwned>(path: &Path, limit: u64) -> Result<T, SceneError> {
    parse(&read_limited(path, limit)?, "", path)
}

/// Writes a value as indented JSON with a final newline; the file is whole or unchanged.
///
/// # Errors
/// [`SceneError::Write`].
pub fn write<T: Serialize>(path: &Path, value: &T) -> Result<(), SceneError> {
    let text = to_text(value).map_err(SceneError::write(path))?;
    comgs_image::atomic::write_file(path, |w| w.write_all(text.as_bytes())).map_err(SceneError::write(path))
}

/// A value as indented JSON with a final newline.
pub(crate) fn to_text<T: Serialize>(value: &T) -> std::io::Result<String> {
    let mut text = serde_json::to_string_pretty(value).map_err(std::io::Error::other)?;
    text.push('\n');
    Ok(text)
}

/// Puts quotes around the literals `NaN` and `±Infinity`, which Python writes and JSON does not know, so that the number's
/// owner can be named instead of a line and column. [`Number`] reads those words.
#[must_use]
pub fn without_literals(bytes: &[u8]) -> Cow<'_, [u8]> {
    let mut out: Option<Vec<u8>> = None;
    let (mut i, mut copied, mut in_string) = (0, 0, false);
    while i < bytes.len() {
        let rest = &bytes[i..];
        match bytes[i] {
            b'\\' if in_string => i += 1,
            b'"' => in_string = !in_string,
            b'N' | b'I' | b'-' if !in_string => {
                let literals = [&b"NaN"[..], b"Infinity", b"-Infinity"];
                if let Some(literal) = literals.into_iter().find(|l| rest.starts_with(l)) {
                    let out = out.get_or_insert_with(|| Vec::with_capacity(bytes.len() + 16));
                    out.extend_from_slice(&bytes[copied..i]);
                    out.push(b'"');
                    out.extend_from_slice(literal);
                    out.push(b'"');
                    i += literal.len();
                    copied = i;
                    continue;
                }
            }
            _ => {}
        }
        i += 1;
    }
    match out {
        None => Cow::Borrowed(bytes),
        Some(mut out) => {
            out.extend_from_slice(&bytes[copied..]);
            Cow::Owned(out)
        }
    }
}

/// A number, or the word `NaN`, `Infinity` or `-Infinity` (see [`without_literals`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number(pub f64);

/// The value of a non-finite literal.
fn non_finite(word: &str) -> Option<f64> {
    match word {
        "NaN" => Some(f64::NAN),
        "Infinity" => Some(f64::INFINITY),
        "-Infinity" => Some(f64::NEG_INFINITY),
        _ => None,
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        match Item::deserialize(deserializer)? {
            Item::Number(v) => Ok(Self(v)),
            Item::Row(_) => Err(de::Error::custom("invalid type: sequence, expected a number")),
        }
    }
}

/// Numbers of a matrix, flat or as a list of rows, in row-major order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Numbers(pub Vec<f64>);

/// Most numbers that any matrix of the formats has, with room to spare.
const MAX_NUMBERS: usize = 64;

impl Numbers {
    /// As a 4×4 matrix; 12 numbers are a 3×4 matrix without its last row.
    ///
    /// # Errors
    /// A sentence when the count is neither 12 nor 16.
    pub fn matrix(&self) -> Result<DMat4, String> {
        let mut m = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        match self.0.len() {
            n @ (12 | 16) => m[..n].copy_from_slice(&self.0),
            n => return Err(format!("{n} numbers, expected a 4×4 or 3×4 matrix")),
        }
        Ok(DMat4::from_cols_array(&m).transpose())
    }
}

impl<'de> Deserialize<'de> for Numbers {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Rows;
        impl<'de> Visitor<'de> for Rows {
            type Value = Numbers;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of numbers or of rows of numbers")
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Numbers, A::Error> {
                let mut numbers = Vec::new();
                while let Some(item) = seq.next_element::<Item>()? {
                    match item {
                        Item::Number(v) => numbers.push(v),
                        Item::Row(row) => numbers.extend(row),
                    }
                    if numbers.len() > MAX_NUMBERS {
                        return Err(de::Error::custom(format!("more than {MAX_NUMBERS} numbers")));
                    }
                }
                Ok(Numbers(numbers))
            }
        }
        deserializer.deserialize_seq(Rows)
    }
}

/// A number or a row of numbers.
enum Item {
    Number(f64),
    Row(Vec<f64>),
}

impl<'de> Deserialize<'de> for Item {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either;
        impl<'de> Visitor<'de> for Either {
            type Value = Item;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number or a row of numbers")
            }
            fn visit_f64<E: de::Error>(self, v: f64) -> Result<Item, E> {
                Ok(Item::Number(v))
            }
            fn visit_i64<E: de::Error>(self, v: i64) -> Result<Item, E> {
                Ok(Item::Number(v as f64))
            }
            fn visit_u64<E: de::Error>(self, v: u64) -> Result<Item, E> {
                Ok(Item::Number(v as f64))
            }
            fn visit_str<E: de::Error>(self, word: &str) -> Result<Item, E> {
                non_finite(word)
                    .map(Item::Number)
                    .ok_or_else(|| de::Error::invalid_type(de::Unexpected::Str(word), &self))
            }
            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Item, A::Error> {
                let mut row = Vec::new();
                while let Some(Number(v)) = seq.next_element()? {
                    row.push(v);
                    if row.len() > MAX_NUMBERS {
                        return Err(de::Error::custom(format!("more than {MAX_NUMBERS} numbers")));
                    }
                }
                Ok(Item::Row(row))
            }
        }
        deserializer.deserialize_any(Either)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn here() -> &'static Path {
        Path::new("a.json")
    }

    /// Goal: an error says where in the document and in which file.
    #[test]
    fn errors_name_the_place() {
        #[derive(Deserialize, Debug)]
        struct Inner {
            #[serde(rename = "intr")]
            _intr: Numbers,
        }
        let text = br#"{"a": {"intr": [1, 2, "x"]}}"#;
        let error = parse::<std::collections::BTreeMap<String, Inner>>(text, "cameras", here())
            .unwrap_err()
            .to_string();
        assert!(error.starts_with("cameras.a.intr[2]: invalid type: string"), "{error}");
        assert!(error.ends_with("a.json"), "{error}");
        let deep = "[".repeat(100_000);
        assert!(
            parse::<serde_json::Value>(deep.as_bytes(), "", here())
                .unwrap_err()
                .to_string()
                .contains("recursion")
        );
        assert!(parse::<Numbers>(b"[1] 2", "", here()).is_err());
    }

    /// Goal: Python's NaN and Infinity become NaN numbers, and strings that contain those words are left alone.
    #[test]
    fn python_literals() {
        let text = br#"{"NaN \" NaN": [NaN, -Infinity, Infinity, -1, 2]}"#;
        let fixed = without_literals(text);
        assert_eq!(&*fixed, br#"{"NaN \" NaN": ["NaN", "-Infinity", "Infinity", -1, 2]}"#);
        let map: std::collections::BTreeMap<String, Numbers> = parse(&fixed, "", here()).unwrap();
        let numbers = &map["NaN \" NaN"].0;
        assert!(numbers[0].is_nan() && numbers[1..] == [f64::NEG_INFINITY, f64::INFINITY, -1.0, 2.0]);
        assert!(parse::<Option<Number>>(b"\"NaN\"", "", here()).unwrap().is_some_and(|n| n.0.is_nan()));
        assert!(
            parse::<Number>(b"[1]", "", here()).is_err() && parse::<Number>(b"\"1\"", "", here()).is_err()
        );
        assert!(matches!(without_literals(b"[1]"), Cow::Borrowed(_)));
        assert_eq!(&*without_literals(b"\"\\"), b"\"\\");
    }

    /// Goal: flat and nested matrices are the same, row-major; other sizes are refused, long lists early.
    #[test]
    fn matrices() {
        let flat: Numbers = parse(b"[1,0,0,5, 0,1,0,6, 0,0,1,7]", "", here()).unwrap();
        let nested: Numbers = parse(b"[[1,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,1]]", "", here()).unwrap();
        assert_eq!(flat.matrix(), nested.matrix());
        assert_eq!(flat.matrix().unwrap().w_axis.to_array(), [5.0, 6.0, 7.0, 1.0]);
        assert!(parse::<Numbers>(b"[1]", "", here()).unwrap().matrix().is_err());
        let long = format!("[{}1]", "1,".repeat(1000));
        assert!(parse::<Numbers>(long.as_bytes(), "", here()).is_err());
    }
}
