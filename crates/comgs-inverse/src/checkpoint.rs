//! The whole state of a training as bytes: a resumed run continues to the same bytes as an uninterrupted one.
//!
//! Layout: magic, version (u32), length of a JSON header (u32), the header, then the columns as little-endian f32.

use crate::config::TrainConfig;
use crate::density::Evidence;
use crate::train::State;
use comgs_geom::Rng;
use comgs_optim::Adam;
use comgs_surfel::{ColorEncoding, SurfelCloud};
use serde::{Deserialize, Serialize};

const MAGIC: &[u8; 8] = b"COMGSCKP";
const VERSION: u32 = 1;

/// Most surfels that a checkpoint may declare.
const MAX_SURFELS: usize = 100_000_000;

#[derive(Serialize, Deserialize)]
struct Header {
    config: TrainConfig,
    views: String,
    iteration: u32,
    surfels: usize,
    sh_degree: usize,
    srgb: bool,
    rng: [u64; 2],
    queue: Vec<u32>,
    dropped: u64,
    psnr: f32,
    elapsed_s: f64,
}

/// Serialises a state.
pub(crate) fn to_bytes(state: &State, config: &TrainConfig, views: &str) -> Vec<u8> {
    let cloud = &state.cloud;
    let header = Header {
        config: config.clone(),
        views: views.to_owned(),
        iteration: state.iteration,
        surfels: cloud.len(),
        sh_degree: cloud.sh_degree,
        srgb: cloud.color_encoding == ColorEncoding::Srgb,
        rng: state.rng.state(),
        queue: state.queue.clone(),
        dropped: state.dropped_gradients,
        psnr: state.psnr_db,
        elapsed_s: state.elapsed_s,
    };
    sealed(MAGIC, VERSION, &header, &columns(state))
}

/// A checkpoint's bytes: magic, version (u32), length of a JSON header (u32), the header, columns of little-endian f32.
pub(crate) fn sealed(magic: &[u8; 8], version: u32, header: &impl Serialize, columns: &[&[f32]]) -> Vec<u8> {
    let json = serde_json::to_vec(header).unwrap_or_default();
    let floats: usize = columns.iter().map(|c| c.len()).sum();
    let mut out = Vec::with_capacity(16 + json.len() + 4 * floats);
    out.extend_from_slice(magic);
    out.extend_from_slice(&version.to_le_bytes());
    out.extend_from_slice(&(json.len() as u32).to_le_bytes());
    out.extend_from_slice(&json);
    for v in columns.iter().flat_map(|c| c.iter()) {
        out.extend_from_slice(&v.to_le_bytes());
    }
    out
}

/// The header of [`sealed`] bytes, and the bytes of the columns.
///
/// # Errors
/// A sentence that says what is wrong: not of this kind, damaged, or of another version.
pub(crate) fn opened<'a, H: for<'de> Deserialize<'de>>(
    bytes: &'a [u8],
    magic: &[u8; 8],
    kind: &str,
    version: u32,
) -> Result<(H, &'a [u8]), String> {
    let rest = bytes.strip_prefix(magic).ok_or_else(|| format!("it is not a checkpoint of a {kind}"))?;
    let (found, rest) = rest.split_at_checked(4).ok_or("it is truncated")?;
    let found = u32::from_le_bytes(found.try_into().expect("four bytes"));
    if found != version {
        return Err(format!("it has version {found}, expected {version}"));
    }
    let (length, rest) = rest.split_at_checked(4).ok_or("it is truncated")?;
    let length = u32::from_le_bytes(length.try_into().expect("four bytes")) as usize;
    let (json, rest) = rest.split_at_checked(length).ok_or("it is truncated")?;
    let header = serde_json::from_slice(json).map_err(|e| format!("its header is damaged ({e})"))?;
    Ok((header, rest))
}

fn columns(state: &State) -> Vec<&[f32]> {
    let c = &state.cloud;
    let mut columns: Vec<&[f32]> = vec![
        c.positions.as_flattened(),
        c.rotations.as_flattened(),
        c.log_scales.as_flattened(),
        &c.opacity_logits,
        &c.sh,
    ];
    for adam in &state.adam {
        columns.push(&adam.first);
        columns.push(&adam.second);
    }
    columns.extend([&state.evidence.error[..], &state.evidence.weight, &state.evidence.views]);
    columns
}

/// Reads a state back.
///
/// # Errors
/// A sentence that says what is wrong: damaged, of another version, or of another capture or configuration.
pub(crate) fn from_bytes(bytes: &[u8], config: &TrainConfig, views: &str) -> Result<State, String> {
    let (header, mut rest): (Header, &[u8]) = opened(bytes, MAGIC, "reconstruction", VERSION)?;
    // A time budget may change between runs; anything else would not be the same training.
    if (TrainConfig { time_budget: None, ..header.config })
        != (TrainConfig { time_budget: None, ..config.clone() })
    {
        return Err("it belongs to another configuration".into());
    }
    if header.views != views {
        return Err("it belongs to other photos".into());
    }
    let n = header.surfels;
    if n > MAX_SURFELS || header.sh_degree > 3 {
        return Err("its header is damaged".into());
    }
    let sh = n * 3 * comgs_geom::sh::coefficient_count(header.sh_degree);
    let widths = [3 * n, 4 * n, 2 * n, n, sh];
    let floats: usize = 3 * widths.iter().sum::<usize>() + 3 * n;
    if rest.len() != floats * 4 {
        return Err(format!("it is truncated ({} bytes of data, expected {})", rest.len(), floats * 4));
    }
    let mut take = |count: usize| -> Vec<f32> {
        let (now, later) = rest.split_at(count * 4);
        rest = later;
        now.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes"))).collect()
    };
    let mut cloud = SurfelCloud::empty(
        header.sh_degree,
        if header.srgb { ColorEncoding::Srgb } else { ColorEncoding::Linear },
    );
    cloud.positions = bytemuck::cast_slice(&take(3 * n)).to_vec();
    cloud.rotations = bytemuck::cast_slice(&take(4 * n)).to_vec();
    cloud.log_scales = bytemuck::cast_slice(&take(2 * n)).to_vec();
    cloud.opacity_logits = take(n);
    cloud.sh = take(sh);
    let adam = widths.map(|w| Adam { first: take(w), second: take(w) });
    let evidence = Evidence { error: take(n), weight: take(n), views: take(n) };
    Ok(State {
        iteration: header.iteration,
        cloud,
        adam,
        evidence,
        rng: Rng::from_state(header.rng),
        queue: header.queue,
        dropped_gradients: header.dropped,
        psnr_db: header.psnr,
        elapsed_s: header.elapsed_s,
    })
}
