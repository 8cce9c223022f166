//! The whole state of a decomposition as bytes: a resumed run continues to the same bytes as an uninterrupted one.
//!
//! Layout: magic, version (u32), length of a JSON header (u32), the header, then columns of little-endian f32 whose
//! lengths the header states.

use super::{DecomposeConfig, State};
use crate::checkpoint::{opened, sealed};
use crate::view::TrainView;
use comgs_geom::Rng;
use comgs_light::LightPyramid;
use comgs_optim::Adam;
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud};
use serde::{Deserialize, Serialize};

const MAGIC: &[u8; 8] = b"COMGSDEC";
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
struct Header {
    config: DecomposeConfig,
    identity: String,
    iteration: u32,
    sh_degree: usize,
    srgb: bool,
    rng: [u64; 2],
    queue: Vec<u32>,
    dropped: u64,
    psnr: f32,
    elapsed_s: f64,
    /// Floats of each column, in order.
    columns: Vec<usize>,
}

/// What tells one set of views and surfels from another.
pub(super) fn identity(views: &[TrainView], cloud: &SurfelCloud) -> String {
    let sum = |values: &[f32], step: usize| values.iter().step_by(step).map(|&x| f64::from(x)).sum::<f64>();
    let photos: f64 = views.iter().map(|v| sum(&v.color.data, 97) + v.camera.centre().length()).sum();
    let surfels = sum(cloud.positions.as_flattened(), 1) + sum(&cloud.sh, 13);
    format!("{} views {photos:.6e}, {} surfels {surfels:.6e}", views.len(), cloud.len())
}

pub(super) fn to_bytes(state: &State, config: &DecomposeConfig, identity: &str) -> Vec<u8> {
    let columns = columns(state);
    let header = Header {
        config: config.clone(),
        identity: identity.to_owned(),
        iteration: state.iteration,
        sh_degree: state.cloud.sh_degree,
        srgb: state.cloud.color_encoding == ColorEncoding::Srgb,
        rng: state.rng.state(),
        queue: state.queue.clone(),
        dropped: state.dropped_gradients,
        psnr: state.psnr_db,
        elapsed_s: state.elapsed_s,
        columns: columns.iter().map(|c| c.len()).collect(),
    };
    sealed(MAGIC, VERSION, &header, &columns)
}

/// Everything that is floats, in a fixed order.
fn columns(state: &State) -> Vec<&[f32]> {
    let c = &state.cloud;
    let mut columns: Vec<&[f32]> = vec![
        c.positions.as_flattened(),
        c.rotations.as_flattened(),
        c.log_scales.as_flattened(),
        &c.opacity_logits,
        &c.sh,
    ];
    if let Some(m) = &c.material {
        columns.extend([m.albedo_logits.as_flattened(), &m.metallic_logits, &m.roughness_logits]);
    }
    columns.push(state.textures.as_flattened());
    for adam in state.adam.iter().chain([&state.adam_probes]) {
        columns.extend([&adam.first[..], &adam.second]);
    }
    for (level, adam) in state.pyramid.levels.iter().zip(&state.adam_light) {
        columns.extend([&level[..], &adam.first, &adam.second]);
    }
    columns
}

/// Reads a state back.
///
/// # Errors
/// A sentence that says what is wrong: damaged, of another version, or of another object or configuration.
pub(super) fn from_bytes(bytes: &[u8], config: &DecomposeConfig, identity: &str) -> Result<State, String> {
    let (header, mut rest): (Header, &[u8]) = opened(bytes, MAGIC, "decomposition", VERSION)?;
    // A time budget may change between runs; anything else would not be the same optimisation.
    if (DecomposeConfig { time_budget: None, ..header.config })
        != (DecomposeConfig { time_budget: None, ..config.clone() })
    {
        return Err("it belongs to another configuration".into());
    }
    if header.identity != identity {
        return Err("it belongs to other photos or other surfels".into());
    }
    let floats = header.columns.iter().try_fold(0usize, |sum, n| sum.checked_add(*n)).unwrap_or(usize::MAX);
    if floats.checked_mul(4) != Some(rest.len()) {
        return Err("it is truncated".into());
    }
    let mut lengths = header.columns.iter();
    let mut take = || -> Result<Vec<f32>, String> {
        let count = *lengths.next().ok_or("its header is damaged (columns are missing)")?;
        let (now, later) = rest.split_at(count * 4);
        rest = later;
        Ok(now.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().expect("four bytes"))).collect())
    };
    let encoding = if header.srgb { ColorEncoding::Srgb } else { ColorEncoding::Linear };
    let mut cloud = SurfelCloud::empty(header.sh_degree.min(3), encoding);
    cloud.positions = rows(take()?)?;
    cloud.rotations = rows(take()?)?;
    cloud.log_scales = rows(take()?)?;
    cloud.opacity_logits = take()?;
    cloud.sh = take()?;
    cloud.material = Some(MaterialColumns {
        albedo_logits: rows(take()?)?,
        metallic_logits: take()?,
        roughness_logits: take()?,
    });
    if let Some(problem) = cloud.problems().into_iter().next() {
        return Err(format!("its surfels are damaged ({problem})"));
    }
    let textures: Vec<[f32; 4]> = rows(take()?)?;
    let n = cloud.len();
    let mut moments = |count: usize| -> Result<Adam, String> {
        let adam = Adam { first: take()?, second: take()? };
        if adam.first.len() != count || adam.second.len() != count {
            return Err("its moments are damaged".into());
        }
        Ok(adam)
    };
    let adam = [moments(3 * n)?, moments(4 * n)?, moments(2 * n)?, moments(n)?, moments(5 * n)?];
    let adam_probes = moments(4 * textures.len())?;
    let mut pyramid = LightPyramid::constant(config.light_size, glam::Vec3::ONE);
    let mut adam_light = Vec::new();
    for level in &mut pyramid.levels {
        let values = take()?;
        if values.len() != level.len() {
            return Err("its light is damaged".into());
        }
        *level = values;
        let adam = Adam { first: take()?, second: take()? };
        if adam.first.len() != level.len() || adam.second.len() != level.len() {
            return Err("its moments are damaged".into());
        }
        adam_light.push(adam);
    }
    Ok(State {
        iteration: header.iteration,
        cloud,
        pyramid,
        textures,
        adam,
        adam_light,
        adam_probes,
        rng: Rng::from_state(header.rng),
        queue: header.queue,
        dropped_gradients: header.dropped,
        psnr_db: header.psnr,
        elapsed_s: header.elapsed_s,
    })
}

/// Floats as rows of `N`.
fn rows<const N: usize>(flat: Vec<f32>) -> Result<Vec<[f32; N]>, String> {
    let (rows, rest) = flat.as_chunks::<N>();
    if rest.is_empty() { Ok(rows.to_vec()) } else { Err("its columns are damaged".into()) }
}
