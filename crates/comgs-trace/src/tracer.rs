//! The tracer and its rays.

use crate::{
    EyeColours, TraceConfig, TraceError, TracerView,
    bvh::{Bvh, WIDTH},
    disc::{self, LeftOut},
    kernel::Limits,
    traverse::{self, Scratch},
};
use comgs_geom::sh;
use comgs_surfel::SurfelCloud;
use fearless_simd::{Level, Simd, dispatch};
use glam::Vec3;
use rayon::prelude::*;
use std::{borrow::Cow, cell::RefCell};

/// Most surfels a tracer holds: lanes are addressed with 31 bits, and blocks are on average more than a quarter full.
const MAX_SURFELS: usize = 1 << 28;
/// Rays that a thread traces in one go.
const CHUNK: usize = 64;

/// A ray and the part of it that counts, `t_min ≤ t < t_max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where t is 0, world.
    pub origin: Vec3,
    /// Need not have unit length: t counts in units of it. A direction that is zero, denormal (all components
    /// below 1.2e-38) or not finite makes a ray that meets nothing, as does an origin that is not finite.
    pub direction: Vec3,
    /// Start; below 0 is taken as 0. Adjacent parts `[a, b)` and `[b, c)` share no hit.
    pub t_min: f32,
    /// End, exclusive; may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// A ray from its origin to infinity.
    #[must_use]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self { origin, direction, t_min: 0.0, t_max: f32::INFINITY }
    }

    /// A ray that counts from `t_min` up to, and not including, `t_max`.
    #[must_use]
    pub fn between(origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Self {
        Self { origin, direction, t_min, t_max }
    }

    /// The same ray with a direction of ordinary size, and by what t has been multiplied (a power of two, so that
    /// nothing is rounded). `None` when it meets nothing by definition.
    fn scaled(&self) -> Option<(Self, f32)> {
        let largest = self.direction.abs().max_element();
        // NaN in any component fails one of these comparisons.
        let usable = self.origin.is_finite()
            && self.direction.is_finite()
            && largest >= f32::MIN_POSITIVE
            && self.t_max > self.t_min
            && self.t_max > 0.0;
        if !usable {
            return None;
        }
        let t_min = self.t_min.max(0.0);
        if (2.0f32.powi(-20)..2.0f32.powi(20)).contains(&largest) {
            return Some((Self { t_min, ..*self }, 1.0));
        }
        let exponent = (largest.to_bits() >> 23) as i32 - 127;
        // In two steps: 2^126 and more is not a factor that every exponent allows.
        let scale = |v: f32, power: i32| v * 2.0f32.powi(power / 2) * 2.0f32.powi(power - power / 2);
        let ray = Self {
            origin: self.origin,
            direction: Vec3::from_array(self.direction.to_array().map(|c| scale(c, -exponent))),
            t_min: scale(t_min, exponent),
            t_max: scale(self.t_max, exponent),
        };
        Some((ray, 2.0f32.powi(exponent)))
    }
}

/// What a ray collects: weights are `w = T α`, with T the transmittance up to the hit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RadianceHit {
    /// Linear radiance, premultiplied: Σ w c.
    pub radiance: Vec3,
    /// Σ w, in [0, 1].
    pub alpha: f32,
    /// Σ w t, in units of the direction's length; the mean distance is `depth / alpha`.
    pub depth: f32,
    /// Σ w n of the unit normals, each turned to face the ray's origin; not of unit length.
    pub normal: Vec3,
}

/// One surfel on a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance in units of the direction's length.
    pub t: f32,
    /// Opacity of the surfel where the ray meets it.
    pub alpha: f32,
    /// Index in the cloud.
    pub surfel: u32,
}

/// Traces rays through a surfel cloud.
///
/// Not differentiable. Reference: [`crate::reference`].
#[derive(Clone, Debug)]
pub struct Tracer {
    pub(crate) bvh: Bvh,
    pub(crate) limits: Limits,
    config: TraceConfig,
    /// Only the harmonics, cut to `config.sh_degree`; the other columns are empty.
    pub(crate) colours: SurfelCloud,
    left_out: LeftOut,
    held: usize,
    bounds: Option<(Vec3, Vec3)>,
    pub(crate) level: Level,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// Runs `f` with this thread's scratch memory.
pub(crate) fn with_scratch<R>(f: impl FnOnce(&mut Scratch) -> R) -> R {
    SCRATCH.with_borrow_mut(f)
}

impl Tracer {
    /// Builds the tree over a cloud; the cloud is not needed afterwards.
    ///
    /// Surfels that cannot contribute or that have no meaning are left out and counted ([`Tracer::left_out`]).
    ///
    /// # Errors
    /// [`TraceError`] when the configuration is out of range or the columns of the cloud disagree in length.
    pub fn new(cloud: &SurfelCloud, config: &TraceConfig) -> Result<Self, TraceError> {
        let problems = config.problems();
        if !problems.is_empty() {
            return Err(TraceError::Config(problems));
        }
        let lengths: Vec<String> = cloud.problems().into_iter().filter(|p| p.contains("expected")).collect();
        if !lengths.is_empty() {
            return Err(TraceError::Cloud(lengths));
        }
        if cloud.len() > MAX_SURFELS {
            return Err(TraceError::TooMany { got: cloud.len(), limit: MAX_SURFELS });
        }
        let (discs, left_out) = disc::discs(cloud, config);
        let bounds = discs.iter().fold(None, |bounds: Option<(Vec3, Vec3)>, d| {
            let (low, high) = bounds.unwrap_or((d.min(), d.max()));
            Some((low.min(d.min()), high.max(d.max())))
        });
        let degree = config.sh_degree.min(cloud.sh_degree);
        let mut colours = SurfelCloud::empty(degree, cloud.color_encoding);
        let kept = 3 * sh::coefficient_count(degree);
        colours.sh = cloud.sh.chunks_exact(cloud.sh_stride()).flat_map(|c| &c[..kept]).copied().collect();
        Ok(Self {
            bvh: Bvh::new(&discs),
            limits: Limits::new(config),
            config: config.clone(),
            colours,
            left_out,
            held: discs.len(),
            bounds,
            level: Level::new(),
        })
    }

    /// Number of surfels that are traced.
    #[must_use]
    pub fn len(&self) -> usize {
        self.held
    }

    /// Whether no surfel is traced.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.held == 0
    }

    /// Surfels that are not traced, by reason.
    #[must_use]
    pub fn left_out(&self) -> LeftOut {
        self.left_out
    }

    /// The configuration it was built with.
    #[must_use]
    pub fn config(&self) -> &TraceConfig {
        &self.config
    }

    /// Box around all traced discs; `None` when there are none.
    #[must_use]
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        self.bounds
    }

    /// Share of light that passes along a ray between `t_min` and `t_max`: the product of `1 − α` over all hits, in
    /// [0, 1], and exactly 0 where it is below `transmittance_min`. No order is needed, and the walk ends there.
    ///
    /// Rays that meet nothing by definition ([`Ray::direction`]) give 1.
    #[must_use]
    pub fn transmittance(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> f32 {
        let ray = Ray { origin, direction, t_min, t_max };
        with_scratch(|scratch| dispatch!(self.level, simd => self.transmittance_of(simd, &ray, scratch)))
    }

    #[inline(always)]
    fn transmittance_of<S: Simd>(&self, simd: S, ray: &Ray, scratch: &mut Scratch) -> f32 {
        match ray.scaled() {
            Some((ray, _)) => traverse::transmittance(simd, &self.bvh, &ray, &self.limits, scratch),
            None => 1.0,
        }
    }

    /// [`Tracer::transmittance`] of many rays, in parallel; the same values at any thread count. Neighbouring rays
    /// should be close in space: they then find the same nodes in the cache.
    #[must_use]
    pub fn transmittance_batch(&self, rays: &[Ray]) -> Vec<f32> {
        let mut out = vec![1.0; rays.len()];
        out.par_chunks_mut(CHUNK).zip(rays.par_chunks(CHUNK)).for_each(|(out, rays)| {
            with_scratch(
                |scratch| dispatch!(self.level, simd => self.transmittance_chunk(simd, rays, out, scratch)),
            );
        });
        out
    }

    #[inline(always)]
    fn transmittance_chunk<S: Simd>(&self, simd: S, rays: &[Ray], out: &mut [f32], scratch: &mut Scratch) {
        for (out, ray) in out.iter_mut().zip(rays) {
            *out = self.transmittance_of(simd, ray, scratch);
        }
    }

    /// What a ray sees between `t_min` and `t_max`: all hits, exactly sorted by distance (ties by index of the
    /// surfel), blended front to back until the transmittance is below `transmittance_min`.
    ///
    /// A surfel's colour is taken along the line from `origin` to its centre, as the rasteriser takes it. Rays that
    /// meet nothing by definition ([`Ray::direction`]) give the empty hit.
    #[must_use]
    pub fn radiance(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> RadianceHit {
        let ray = Ray { origin, direction, t_min, t_max };
        self.blend(&ray, |surfel, centre| self.colour(surfel, centre, origin, direction))
    }

    /// [`Tracer::radiance`] of many rays, in parallel; the same values at any thread count. For many rays from one
    /// origin, [`Tracer::view`] is faster.
    #[must_use]
    pub fn radiance_batch(&self, rays: &[Ray]) -> Vec<RadianceHit> {
        let mut out = vec![RadianceHit::default(); rays.len()];
        out.par_chunks_mut(CHUNK).zip(rays.par_chunks(CHUNK)).for_each(|(out, rays)| {
            for (out, ray) in out.iter_mut().zip(rays) {
                *out = self.radiance(ray.origin, ray.direction, ray.t_min, ray.t_max);
            }
        });
        out
    }

    /// The tracer with the eye fixed: the surfels' colours towards it are worked out once.
    #[must_use]
    pub fn view(&self, origin: Vec3) -> TracerView<'_> {
        TracerView::new(self, Cow::Owned(self.eye_colours(origin)))
    }

    /// What [`Tracer::view`] works out first, to be kept and handed to [`Tracer::view_with`].
    #[must_use]
    pub fn eye_colours(&self, origin: Vec3) -> EyeColours {
        EyeColours::new(self, origin)
    }

    /// The tracer seen from an eye whose colours are known: those of this tracer, or of one of the same cloud.
    #[must_use]
    pub fn view_with<'a>(&'a self, eye: &'a EyeColours) -> TracerView<'a> {
        TracerView::new(self, Cow::Borrowed(eye))
    }

    /// Every surfel on a ray between `t_min` and `t_max`, sorted by distance and then by index, without any early
    /// stop.
    #[must_use]
    pub fn hits(&self, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) -> Vec<Hit> {
        let limits = Limits { transmittance_min: 0.0, ..self.limits };
        let Some((ray, factor)) = (Ray { origin, direction, t_min, t_max }).scaled() else {
            return Vec::new();
        };
        with_scratch(|scratch| {
            dispatch!(self.level, simd => traverse::sorted_hits(simd, &self.bvh, &ray, &limits, scratch));
            let hit = |h: &traverse::RawHit| Hit { t: h.t() / factor, alpha: h.alpha, surfel: h.surfel() };
            scratch.hits.iter().map(hit).collect()
        })
    }

    /// Radiance of a surfel at `centre` towards `origin`; along `direction` when the two coincide.
    pub(crate) fn colour(&self, surfel: u32, centre: Vec3, origin: Vec3, direction: Vec3) -> Vec3 {
        let towards =
            (centre - origin).try_normalize().or_else(|| direction.try_normalize()).unwrap_or(Vec3::Z);
        self.colours.radiance(surfel as usize, towards)
    }

    /// Sorts and blends; `colour` is asked with the surfel and its centre.
    pub(crate) fn blend(&self, ray: &Ray, colour: impl Fn(u32, Vec3) -> Vec3) -> RadianceHit {
        let Some((ray, factor)) = ray.scaled() else { return RadianceHit::default() };
        with_scratch(|scratch| {
            dispatch!(self.level, simd => traverse::sorted_hits(simd, &self.bvh, &ray, &self.limits, scratch));
            let mut sum = RadianceHit::default();
            let mut transmittance = 1.0f32;
            for hit in &scratch.hits {
                if transmittance < self.limits.transmittance_min {
                    break;
                }
                let block = &self.bvh.blocks[hit.slot as usize / WIDTH];
                let lane = hit.slot as usize % WIDTH;
                let at = |rows: &[[f32; WIDTH]; 3]| Vec3::new(rows[0][lane], rows[1][lane], rows[2][lane]);
                let normal = at(&block.normal);
                let facing = if normal.dot(ray.direction) > 0.0 { -normal } else { normal };
                let weight = transmittance * hit.alpha;
                sum.radiance += weight * colour(hit.surfel(), at(&block.centre));
                sum.alpha += weight;
                sum.depth += weight * hit.t();
                sum.normal += weight * facing;
                transmittance *= 1.0 - hit.alpha;
            }
            sum.alpha = sum.alpha.min(1.0);
            sum.depth /= factor;
            sum
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;
    use comgs_surfel::ColorEncoding;

    /// Goal: every vector width that this machine has gives the same picture to rounding: the baseline (SSE2 on
    /// x86-64) against the best.
    #[test]
    fn levels_agree() {
        let mut rng = Rng::new(1);
        let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
        for _ in 0..600 {
            cloud.positions.push([rng.normal(), rng.normal(), rng.normal()]);
            cloud.rotations.push([rng.normal(), rng.normal(), rng.normal(), rng.normal()]);
            cloud.log_scales.push([rng.range(-3.0, -0.5), rng.range(-3.0, -0.5)]);
            cloud.opacity_logits.push(rng.range(-3.0, 3.0));
            cloud.sh.extend([rng.normal(), rng.normal(), rng.normal()]);
        }
        let best = Tracer::new(&cloud, &TraceConfig::default()).expect("the cloud is sound");
        let baseline = Tracer { level: Level::baseline(), ..best.clone() };
        let (mut met, mut differ) = (0, 0);
        for _ in 0..400 {
            let origin = 3.0 * Vec3::new(rng.normal(), rng.normal(), rng.normal());
            let direction = Vec3::new(rng.normal(), rng.normal(), rng.normal()) - origin;
            let of = |t: &Tracer| t.hits(origin, direction, 0.0, f32::INFINITY);
            let (a, b) = (of(&best), of(&baseline));
            met += a.len();
            // A hit at the very rim of its disc may be decided otherwise, and two at one distance change places.
            if a.iter().map(|h| h.surfel).ne(b.iter().map(|h| h.surfel)) {
                differ += 1;
                continue;
            }
            for (a, b) in a.iter().zip(&b) {
                assert!(
                    (a.t - b.t).abs() <= 1e-5 * (1.0 + a.t) && (a.alpha - b.alpha).abs() < 2e-3,
                    "{a:?} {b:?}"
                );
            }
            let of = |t: &Tracer| t.radiance(origin, direction, 0.0, f32::INFINITY);
            assert!((of(&best).radiance - of(&baseline).radiance).abs().max_element() < 5e-3);
        }
        assert!(met > 2000 && differ < 8, "{met} {differ}");
    }
}
