//! A relit frame.

use super::shade::Lit;
use comgs_image::Image;
use comgs_raster::Frame;
use glam::Vec3;

/// One relit frame. Pixels without a surface ([`super::points::MIN_WEIGHT`]) are empty in every plane.
#[derive(Clone, Debug, PartialEq)]
pub struct RelitFrame {
    /// W · L_o, linear, premultiplied, 3 channels.
    pub radiance: Image,
    /// W, 1 channel in [0, 1].
    pub weight: Image,
    /// Where they were asked for.
    pub layers: Option<RelitLayers>,
    /// What the frame cost.
    pub stats: RelitStats,
}

/// What a relit frame is made of. The three kinds of radiance are premultiplied and add up to the frame's; the rest
/// are means over what the pixel sees (planes over W), 0 where it sees nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct RelitLayers {
    /// Of the light, by the matte term, 3 channels.
    pub diffuse: Image,
    /// Of the light, by the highlight, 3 channels.
    pub specular: Image,
    /// Of the object itself, 3 channels.
    pub indirect: Image,
    /// 1 − O, mean over the hemisphere by cosine, 1 channel in [0, 1]: ambient occlusion.
    pub visibility: Image,
    /// Unbiased z-depth, world units, 1 channel.
    pub depth: Image,
    /// World space, unit, 3 channels: what was shaded with ([`comgs_raster::surface_normals`]).
    pub normal: Image,
    /// Linear base colour, 3 channels.
    pub albedo: Image,
    /// 1 channel.
    pub roughness: Image,
    /// 1 channel.
    pub metallic: Image,
}

/// What a frame cost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RelitStats {
    /// Seconds for the G-buffer.
    pub raster_s: f64,
    /// Seconds for the shading.
    pub shade_s: f64,
    /// Pixels that were shaded.
    pub points: usize,
}

impl RelitFrame {
    /// The radiance over a background of 3 channels: `C + (1 − W) · background`.
    ///
    /// # Panics
    /// When the background has another size or number of channels.
    #[must_use]
    pub fn over(&self, background: &Image) -> Image {
        let shape = |i: &Image| (i.width, i.height, i.channels);
        assert_eq!(shape(background), shape(&self.radiance), "a background of the frame's shape");
        let mut out = self.radiance.clone();
        let behind = background.data.chunks_exact(3).zip(&self.weight.data);
        for (pixel, (behind, weight)) in out.data.chunks_exact_mut(3).zip(behind) {
            for c in 0..3 {
                pixel[c] += (1.0 - weight) * behind[c];
            }
        }
        out
    }

    /// Puts shaded points at their pixels.
    pub(super) fn assemble(
        frame: &Frame,
        normals: Option<&Image>,
        lit: &[(u32, Lit, f32)],
        layers: bool,
    ) -> Self {
        let (width, height) = (frame.weight.width, frame.weight.height);
        let zeros = |channels| Image::zeros(width, height, channels);
        let mut out =
            Self { radiance: zeros(3), weight: zeros(1), layers: None, stats: RelitStats::default() };
        out.stats.points = lit.len();
        for &(i, lit, _) in lit {
            let i = i as usize;
            let weight = frame.weight.data[i];
            out.weight.data[i] = weight;
            put(&mut out.radiance, i, weight * lit.total());
        }
        if layers {
            out.layers = Some(RelitLayers::assemble(frame, normals, lit));
        }
        out
    }
}

impl RelitLayers {
    fn assemble(frame: &Frame, normals: Option<&Image>, lit: &[(u32, Lit, f32)]) -> Self {
        let zeros = |channels| Image::zeros(frame.weight.width, frame.weight.height, channels);
        let mut out = Self {
            diffuse: zeros(3),
            specular: zeros(3),
            indirect: zeros(3),
            visibility: zeros(1),
            depth: zeros(1),
            normal: zeros(3),
            albedo: zeros(3),
            roughness: zeros(1),
            metallic: zeros(1),
        };
        let (Some(depth), Some(normal), Some(material)) = (&frame.depth, normals, &frame.material) else {
            return out;
        };
        for &(i, lit, visibility) in lit {
            let i = i as usize;
            let weight = frame.weight.data[i];
            put(&mut out.diffuse, i, weight * lit.diffuse);
            put(&mut out.specular, i, weight * lit.specular);
            put(&mut out.indirect, i, weight * lit.indirect);
            out.visibility.data[i] = visibility;
            out.depth.data[i] = depth.data[i] / weight;
            put(&mut out.normal, i, Vec3::from_slice(&normal.data[3 * i..]).normalize_or_zero());
            let m = &material.data[5 * i..5 * i + 5];
            put(&mut out.albedo, i, Vec3::new(m[0], m[1], m[2]) / weight);
            out.roughness.data[i] = m[3] / weight;
            out.metallic.data[i] = m[4] / weight;
        }
        out
    }
}

fn put(image: &mut Image, pixel: usize, value: Vec3) {
    image.data[3 * pixel..3 * pixel + 3].copy_from_slice(&value.to_array());
}
