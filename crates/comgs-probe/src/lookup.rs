//! Reading the textures of probes, and the gradients of that.

use crate::{Neighbours, ProbeSet};
use comgs_geom::octahedral;
use glam::{Vec3, Vec4};
use rayon::prelude::*;

/// Bilinear value of an octahedral texture (`resolution²` texels) in a direction of any length. Linear in the
/// texture; gradient: [`sample_vjp`].
///
/// # Panics
/// When the texture is shorter than `resolution²`.
#[inline]
#[must_use]
pub fn sample(texture: &[[f32; 4]], resolution: usize, direction: Vec3) -> [f32; 4] {
    let f = octahedral::footprint(direction, resolution);
    let tap = |k: usize| f.weights[k] * Vec4::from_array(texture[f.texels[k] as usize]);
    ((tap(0) + tap(1)) + (tap(2) + tap(3))).to_array()
}

/// Gradient of [`sample`] with respect to the texture, added to `grad_texture`.
///
/// # Panics
/// As [`sample`].
#[inline]
pub fn sample_vjp(resolution: usize, direction: Vec3, grad: [f32; 4], grad_texture: &mut [[f32; 4]]) {
    let f = octahedral::footprint(direction, resolution);
    let grad = Vec4::from_array(grad);
    for (texel, weight) in f.texels.iter().zip(f.weights) {
        let out = &mut grad_texture[*texel as usize];
        *out = (Vec4::from_array(*out) + weight * grad).to_array();
    }
}

/// Textures that [`weighted_sum`] reads in one pass over its output.
const LANES: usize = 4;

/// `out[i] += Σ_k weight_k · texture_k[i]`, in the order given, four textures at a time.
fn weighted_sum<'a>(out: &mut [f32], mut textures: impl Iterator<Item = (&'a [f32], f32)>) {
    loop {
        let group: [Option<(&[f32], f32)>; LANES] = std::array::from_fn(|_| textures.next());
        match group {
            [Some((a, wa)), Some((b, wb)), Some((c, wc)), Some((d, wd))] => {
                // One length for all, so that the loop needs no bounds.
                let n = out.len();
                let (a, b, c, d) = (&a[..n], &b[..n], &c[..n], &d[..n]);
                for i in 0..n {
                    out[i] += (wa * a[i] + wb * b[i]) + (wc * c[i] + wd * d[i]);
                }
            }
            rest => {
                for (texture, weight) in rest.into_iter().flatten() {
                    for (out, value) in out.iter_mut().zip(texture) {
                        *out += weight * value;
                    }
                }
                return;
            }
        }
    }
}

impl ProbeSet {
    /// The texture at a shading point: `out[i] = Σ_k w_k texture_k[i]` (ComGS Eq. 9 for all directions at once), to be
    /// read with [`sample`]. Linear in the textures; gradient: [`ProbeSet::blend_vjp`]. Zero without neighbours.
    ///
    /// # Panics
    /// When `out` is not of [`ProbeSet::texture_len`].
    pub fn blend(&self, neighbours: &Neighbours, out: &mut [[f32; 4]]) {
        assert_eq!(out.len(), self.texture_len(), "texels of the blended texture");
        let out = out.as_flattened_mut();
        out.fill(0.0);
        weighted_sum(out, neighbours.iter().map(|(probe, w)| (self.texture(probe).as_flattened(), w)));
    }

    /// `[L_in, O]` that arrives at a shading point from a direction: the probes' textures are sampled, then blended
    /// (ComGS Eq. 9). The same as [`sample`] of [`ProbeSet::blend`] to rounding, and faster for few directions.
    #[must_use]
    pub fn lookup(&self, neighbours: &Neighbours, direction: Vec3) -> [f32; 4] {
        let f = octahedral::footprint(direction, self.resolution);
        let mut sum = Vec4::ZERO;
        for (probe, weight) in neighbours.iter() {
            let texture = self.texture(probe);
            let tap = |k: usize| f.weights[k] * Vec4::from_array(texture[f.texels[k] as usize]);
            sum += weight * ((tap(0) + tap(1)) + (tap(2) + tap(3)));
        }
        sum.to_array()
    }

    /// Gradient of [`ProbeSet::blend`] of many shading points with respect to the textures, added to `grad_texels`
    /// (layout of [`ProbeSet::texels`]). `grad_blended` holds [`ProbeSet::texture_len`] texels for each of
    /// `neighbours`.
    ///
    /// Each probe gathers from the points that use it, in the order of the points: parallel over probes, the same
    /// bytes at any thread count.
    ///
    /// # Panics
    /// When a slice has not the length stated.
    pub fn blend_vjp(
        &self,
        neighbours: &[Neighbours],
        grad_blended: &[[f32; 4]],
        grad_texels: &mut [[f32; 4]],
    ) {
        let texture = self.texture_len();
        assert_eq!(grad_blended.len(), neighbours.len() * texture, "texels of the blended gradients");
        assert_eq!(grad_texels.len(), self.len() * texture, "texels of the gradient");
        let users = Users::new(self.len(), neighbours);
        grad_texels.par_chunks_mut(texture).enumerate().for_each(|(probe, out)| {
            let contributions = users.of(probe).iter().map(|&(point, weight)| {
                let start = point as usize * texture;
                (grad_blended[start..start + texture].as_flattened(), weight)
            });
            weighted_sum(out.as_flattened_mut(), contributions);
        });
    }
}

/// For each probe the shading points that use it, and with what weight: the neighbour lists turned round by a
/// counting sort.
struct Users {
    starts: Vec<usize>,
    entries: Vec<(u32, f32)>,
}

impl Users {
    fn new(probes: usize, neighbours: &[Neighbours]) -> Self {
        let mut starts = vec![0usize; probes + 1];
        for (probe, _) in neighbours.iter().flat_map(Neighbours::iter) {
            starts[probe + 1] += 1;
        }
        for probe in 0..probes {
            starts[probe + 1] += starts[probe];
        }
        let mut next = starts.clone();
        let mut entries = vec![(0, 0.0); starts[probes]];
        for (point, neighbours) in neighbours.iter().enumerate() {
            for (probe, weight) in neighbours.iter() {
                entries[next[probe]] = (point as u32, weight);
                next[probe] += 1;
            }
        }
        Self { starts, entries }
    }

    fn of(&self, probe: usize) -> &[(u32, f32)] {
        &self.entries[self.starts[probe]..self.starts[probe + 1]]
    }
}
