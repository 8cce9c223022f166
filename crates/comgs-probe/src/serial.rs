//! Probes as safetensors bytes.

use crate::{MAX_RESOLUTION, ProbeConfig, ProbeError, ProbeSet, VisibilityWeight};
use glam::Vec3;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::collections::HashMap;

/// Version that is written and the only one that is read.
const VERSION: u32 = 1;
/// Everything but the tensors is one entry of the metadata: the crate keeps them in a hash map, whose order changes
/// from run to run, and the same probes shall be the same bytes.
const METADATA: &str = "comgs_probes";
/// Largest header that is parsed, bytes. Written ones have less than 1000; JSON of hostile size costs many times its
/// size in memory.
const MAX_HEADER: u64 = 1 << 16;

/// Bytes of a safetensors file: `positions [n, 3]`, `normals [n, 3]`, `texels [n, res, res, 4]`,
/// `moments [n, res, res, 2]`, all F32 and little endian, and one metadata entry `comgs_probes` with the version, the
/// configuration and the set's lengths. The same set gives the same bytes. Inverse: [`from_bytes`].
///
/// # Errors
/// [`ProbeError::Set`] and [`ProbeError::Config`] for what could not be read back.
pub fn to_bytes(set: &ProbeSet, config: &ProbeConfig) -> Result<Vec<u8>, ProbeError> {
    let problems = set.problems();
    if !problems.is_empty() {
        return Err(ProbeError::Set(problems));
    }
    let problems = config.check();
    if !problems.is_empty() {
        return Err(ProbeError::Config(problems));
    }
    let (n, side) = (set.len(), set.resolution);
    let columns: [(&str, Vec<usize>, Vec<u8>); 4] = [
        ("positions", vec![n, 3], little_endian(bytemuck::cast_slice(&set.positions))),
        ("normals", vec![n, 3], little_endian(bytemuck::cast_slice(&set.normals))),
        ("texels", vec![n, side, side, 4], little_endian(set.texels.as_flattened())),
        ("moments", vec![n, side, side, 2], little_endian(set.moments.as_flattened())),
    ];
    let mut views = Vec::new();
    for (name, shape, bytes) in &columns {
        views.push((*name, TensorView::new(Dtype::F32, shape.clone(), bytes).map_err(unreadable)?));
    }
    let metadata = HashMap::from([(METADATA.to_owned(), describe(set, config))]);
    safetensors::serialize(views, Some(metadata)).map_err(unreadable)
}

/// Probes and their configuration from the bytes of [`to_bytes`]. Everything is checked: lengths, shapes, that values
/// are finite and in range. Memory beyond the bytes given is that of one set, which is no larger than they are.
///
/// # Errors
/// [`ProbeError::Format`] for bytes that are no such file, [`ProbeError::Set`] and [`ProbeError::Config`] for one with
/// unusable values.
pub fn from_bytes(bytes: &[u8]) -> Result<(ProbeSet, ProbeConfig), ProbeError> {
    let Some(header) = bytes.first_chunk::<8>().map(|b| u64::from_le_bytes(*b)) else {
        return Err(ProbeError::Format(format!("{} bytes, expected at least 8", bytes.len())));
    };
    if header > MAX_HEADER {
        return Err(ProbeError::Format(format!("a header of {header} bytes, expected at most {MAX_HEADER}")));
    }
    let (_, info) = SafeTensors::read_metadata(bytes).map_err(unreadable)?;
    let text = info.metadata().as_ref().and_then(|m| m.get(METADATA));
    let text = text.ok_or_else(|| ProbeError::Format(format!("no metadata entry {METADATA}")))?;
    let description = Description::parse(text)?;
    let file = SafeTensors::deserialize(bytes).map_err(unreadable)?;
    let n = file.tensor("positions").map_err(unreadable)?.shape().first().copied().unwrap_or(0);
    let side = description.texture;
    let expected = [("positions", vec![n, 3]), ("normals", vec![n, 3])]
        .into_iter()
        .chain([("texels", vec![n, side, side, 4]), ("moments", vec![n, side, side, 2])]);
    let mut columns = Vec::new();
    for (name, shape) in expected {
        columns.push(column(&file, name, &shape)?);
    }
    if file.len() != columns.len() {
        return Err(ProbeError::Format(format!("{} tensors, expected {}", file.len(), columns.len())));
    }
    let [positions, normals, texels, moments] = columns.try_into().expect("four columns were read");
    let vectors = |column: Vec<f32>| column.chunks_exact(3).map(Vec3::from_slice).collect();
    let set = ProbeSet {
        positions: vectors(positions),
        normals: vectors(normals),
        resolution: side,
        texels: texels.as_chunks::<4>().0.to_vec(),
        moments: moments.as_chunks::<2>().0.to_vec(),
        spacing: description.spacing,
        far_distance: description.far_distance,
    };
    let problems = set.problems();
    if !problems.is_empty() {
        return Err(ProbeError::Set(problems));
    }
    let problems = description.config.check();
    if !problems.is_empty() {
        return Err(ProbeError::Config(problems));
    }
    Ok((set, description.config))
}

fn unreadable(error: safetensors::SafeTensorError) -> ProbeError {
    ProbeError::Format(error.to_string())
}

fn little_endian(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn column(file: &SafeTensors<'_>, name: &str, shape: &[usize]) -> Result<Vec<f32>, ProbeError> {
    let tensor = file.tensor(name).map_err(unreadable)?;
    if tensor.dtype() != Dtype::F32 || tensor.shape() != shape {
        return Err(ProbeError::Format(format!(
            "tensor {name} is {:?} {:?}, expected F32 {shape:?}",
            tensor.dtype(),
            tensor.shape()
        )));
    }
    Ok(tensor.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect())
}

/// `key=value` pairs, separated by spaces. Floats are written with as many digits as bring them back exactly.
fn describe(set: &ProbeSet, config: &ProbeConfig) -> String {
    let visibility = match config.visibility {
        VisibilityWeight::None => "none",
        VisibilityWeight::Chebyshev => "chebyshev",
    };
    format!(
        "version={VERSION} spacing={} far_distance={} texture={} count={} resolution={} offset={} neighbours={} \
         radius={} far={} visibility={visibility}",
        set.spacing,
        set.far_distance,
        set.resolution,
        config.count,
        config.resolution,
        config.offset,
        config.neighbours,
        config.radius,
        config.far
    )
}

/// The metadata entry, read.
struct Description {
    spacing: f32,
    far_distance: f32,
    texture: usize,
    config: ProbeConfig,
}

impl Description {
    fn parse(text: &str) -> Result<Self, ProbeError> {
        let pairs: HashMap<&str, &str> = text.split_whitespace().filter_map(|p| p.split_once('=')).collect();
        let version: u32 = value(&pairs, "version")?;
        if version != VERSION {
            return Err(ProbeError::Format(format!("version {version}, expected {VERSION}")));
        }
        let visibility: String = value(&pairs, "visibility")?;
        let visibility = match visibility.as_str() {
            "none" => VisibilityWeight::None,
            "chebyshev" => VisibilityWeight::Chebyshev,
            other => {
                return Err(ProbeError::Format(format!(
                    "visibility is {other:?}, expected none or chebyshev"
                )));
            }
        };
        let texture = value(&pairs, "texture")?;
        if !(2..=MAX_RESOLUTION).contains(&texture) {
            return Err(ProbeError::Format(format!("texture is {texture}, expected 2 to {MAX_RESOLUTION}")));
        }
        Ok(Self {
            spacing: value(&pairs, "spacing")?,
            far_distance: value(&pairs, "far_distance")?,
            texture,
            config: ProbeConfig {
                count: value(&pairs, "count")?,
                resolution: value(&pairs, "resolution")?,
                offset: value(&pairs, "offset")?,
                neighbours: value(&pairs, "neighbours")?,
                radius: value(&pairs, "radius")?,
                far: value(&pairs, "far")?,
                visibility,
            },
        })
    }
}

fn value<T: std::str::FromStr>(pairs: &HashMap<&str, &str>, key: &str) -> Result<T, ProbeError> {
    let text = pairs.get(key).ok_or_else(|| ProbeError::Format(format!("the metadata have no {key}")))?;
    text.parse().map_err(|_| ProbeError::Format(format!("{key} is {text:?}, expected a number")))
}
