//! The body of a PLY file: rows of the `vertex` element as numbers, whatever their types.

use super::{Element, Header, Layout, PlyError, Property, Source};
use std::io::{BufRead, Read};

/// Longest number in an ASCII body.
const MAX_TOKEN: usize = 64;

/// The checked number of vertices: what the header promises, if the file can hold it.
///
/// Called before any memory is taken, so that a made-up count costs nothing.
pub(super) fn checked_count<R>(header: &Header, source: &Source<'_, R>) -> Result<usize, PlyError> {
    let mut available = source.remaining;
    for element in &header.elements {
        let stride = element.least_stride(header.layout);
        let needed = element.count.checked_mul(stride);
        // The last number of an ASCII file may end without a separator.
        let slack = u64::from(header.layout == Layout::Ascii);
        match needed {
            Some(needed) if needed <= available + slack && (stride > 0 || element.count <= available) => {
                available = available.saturating_sub(needed);
            }
            _ => {
                return Err(PlyError::Truncated {
                    path: source.path.to_owned(),
                    element: element.name.clone(),
                    count: element.count,
                    stride,
                    available,
                });
            }
        }
        if element.name == "vertex" {
            break;
        }
    }
    let vertex =
        header.vertex().ok_or_else(|| PlyError::malformed(source.path, "there is no vertex element"))?;
    usize::try_from(vertex.count)
        .map_err(|_| PlyError::malformed(source.path, "too many vertices for this machine"))
}

/// Hands every vertex to `row`, all properties in file order.
///
/// # Errors
/// [`PlyError`] when the data end early or an ASCII value is no number.
pub(super) fn for_each_vertex<R: BufRead>(
    header: &Header,
    source: &mut Source<'_, R>,
    mut row: impl FnMut(&[f64]),
) -> Result<(), PlyError> {
    for element in &header.elements {
        let wanted = element.name == "vertex";
        if wanted && element.properties.iter().any(|p| p.list.is_some()) {
            return Err(PlyError::malformed(source.path, "a vertex property is a list, expected numbers"));
        }
        match header.layout {
            Layout::Ascii => ascii_rows(element, source, wanted, &mut row)?,
            layout => binary_rows(element, source, layout == Layout::BigEndian, wanted, &mut row)?,
        }
        if wanted {
            break;
        }
    }
    Ok(())
}

fn binary_rows<R: BufRead>(
    element: &Element,
    source: &mut Source<'_, R>,
    big_endian: bool,
    wanted: bool,
    row: &mut impl FnMut(&[f64]),
) -> Result<(), PlyError> {
    let fixed = element.properties.iter().all(|p| p.list.is_none());
    let stride = element.least_stride(Layout::LittleEndian);
    if fixed && !wanted {
        // `checked_count` has seen that the product fits.
        return skip(source, element.count.saturating_mul(stride));
    }
    if fixed {
        let mut bytes = vec![0u8; stride as usize];
        let mut values = vec![0.0; element.properties.len()];
        for _ in 0..element.count {
            fill(source, &mut bytes)?;
            let mut at = 0;
            for (value, property) in values.iter_mut().zip(&element.properties) {
                *value = property.scalar.decode(&bytes[at..], big_endian);
                at += property.scalar.size();
            }
            row(&values);
        }
        return Ok(());
    }
    for _ in 0..element.count {
        for Property { scalar, list, .. } in &element.properties {
            let items = match list {
                None => 1.0,
                Some(count) => {
                    let mut bytes = [0u8; 8];
                    fill(source, &mut bytes[..count.size()])?;
                    count.decode(&bytes, big_endian)
                }
            };
            // A negative, fractional or absurd count ends in an error here or at the end of the file.
            if !(items >= 0.0) || items.fract() != 0.0 {
                return Err(PlyError::malformed(source.path, format!("a list has {items} items")));
            }
            skip(source, (items as u64).saturating_mul(scalar.size() as u64))?;
        }
    }
    Ok(())
}

fn ascii_rows<R: BufRead>(
    element: &Element,
    source: &mut Source<'_, R>,
    wanted: bool,
    row: &mut impl FnMut(&[f64]),
) -> Result<(), PlyError> {
    let mut values = vec![0.0; element.properties.len()];
    for _ in 0..element.count {
        for (value, property) in values.iter_mut().zip(&element.properties) {
            *value = number(source)?;
            if property.list.is_some() {
                let items = *value;
                if !(items >= 0.0) || items.fract() != 0.0 || items > source.remaining as f64 {
                    return Err(PlyError::malformed(source.path, format!("a list has {items} items")));
                }
                for _ in 0..items as u64 {
                    number(source)?;
                }
            }
        }
        if wanted {
            row(&values);
        }
    }
    Ok(())
}

/// The next number of an ASCII body.
fn number<R: BufRead>(source: &mut Source<'_, R>) -> Result<f64, PlyError> {
    let mut token = [0u8; MAX_TOKEN];
    let mut length = 0;
    loop {
        let buffer = source
            .reader
            .fill_buf()
            .map_err(|reason| PlyError::Io { path: source.path.to_owned(), reason })?;
        if buffer.is_empty() {
            break;
        }
        let mut used = 0;
        let mut ended = false;
        for &byte in buffer {
            used += 1;
            if byte.is_ascii_whitespace() {
                if length > 0 {
                    ended = true;
                    break;
                }
            } else {
                if length == MAX_TOKEN {
                    return Err(PlyError::malformed(source.path, "a number is longer than 64 characters"));
                }
                token[length] = byte;
                length += 1;
            }
        }
        source.reader.consume(used);
        source.remaining = source.remaining.saturating_sub(used as u64);
        if ended {
            break;
        }
    }
    let text = String::from_utf8_lossy(&token[..length]);
    if text.is_empty() {
        return Err(PlyError::malformed(source.path, "the file ends in the middle of its data"));
    }
    text.parse().map_err(|_| PlyError::malformed(source.path, format!("{text:?} is not a number")))
}

fn fill<R: BufRead>(source: &mut Source<'_, R>, bytes: &mut [u8]) -> Result<(), PlyError> {
    source.reader.read_exact(bytes).map_err(|e| source.io(e))?;
    source.remaining = source.remaining.saturating_sub(bytes.len() as u64);
    Ok(())
}

fn skip<R: BufRead>(source: &mut Source<'_, R>, count: u64) -> Result<(), PlyError> {
    if count > source.remaining {
        return Err(PlyError::malformed(source.path, "the file ends in the middle of its data"));
    }
    std::io::copy(&mut (&mut source.reader).take(count), &mut std::io::sink()).map_err(|e| source.io(e))?;
    source.remaining -= count;
    Ok(())
}
