//! Objects as they are inserted: extent, standing transforms, and one merged cloud.

use comgs_geom::Similarity;
use comgs_surfel::{ColorEncoding, MaterialColumns, SurfelCloud, activation::sigmoid};
use glam::{DQuat, DVec3, Vec3};
use thiserror::Error;

/// An object and where it stands.
#[derive(Clone, Debug)]
pub struct PlacedObject<'a> {
    /// Its surfels, in its own space.
    pub cloud: &'a SurfelCloud,
    /// From its own space to the scene's world.
    pub world_from_object: Similarity,
}

/// Why objects cannot be merged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MergeError {
    /// There is nothing to merge, or nothing in it.
    #[error("there is no object with surfels")]
    Empty,
    /// Sums of harmonics mean different things.
    #[error("objects store colour in different ways ({0:?} and {1:?}); they cannot be merged into one cloud")]
    Encoding(ColorEncoding, ColorEncoding),
}

/// One cloud in world space of all placed objects, in the order given. Harmonics of lower degree are padded with
/// zeros; material is kept when every object has it. The same object may appear several times.
///
/// # Errors
/// [`MergeError`] when there are no surfels or colour encodings differ.
pub fn merge(objects: &[PlacedObject<'_>]) -> Result<SurfelCloud, MergeError> {
    let filled: Vec<_> = objects.iter().filter(|o| !o.cloud.is_empty()).collect();
    let first = filled.first().ok_or(MergeError::Empty)?;
    let encoding = first.cloud.color_encoding;
    if let Some(other) = filled.iter().find(|o| o.cloud.color_encoding != encoding) {
        return Err(MergeError::Encoding(encoding, other.cloud.color_encoding));
    }
    let degree = filled.iter().map(|o| o.cloud.sh_degree).max().unwrap_or(0);
    let mut merged = SurfelCloud::empty(degree, encoding);
    let with_material = filled.iter().all(|o| o.cloud.material.is_some());
    let mut material = MaterialColumns::default();
    for object in filled {
        let cloud = object.cloud.transformed(&object.world_from_object);
        let (own, padded) = (cloud.sh_stride(), merged.sh_stride());
        for i in 0..cloud.len() {
            merged.sh.extend_from_slice(cloud.sh_of(i));
            merged.sh.extend(std::iter::repeat_n(0.0, padded - own));
        }
        merged.positions.extend(cloud.positions);
        merged.rotations.extend(cloud.rotations);
        merged.log_scales.extend(cloud.log_scales);
        merged.opacity_logits.extend(cloud.opacity_logits);
        if let (true, Some(m)) = (with_material, cloud.material) {
            material.albedo_logits.extend(m.albedo_logits);
            material.metallic_logits.extend(m.metallic_logits);
            material.roughness_logits.extend(m.roughness_logits);
        }
    }
    merged.material = with_material.then_some(material);
    Ok(merged)
}

/// Response under which a surfel takes no part in rendering or tracing.
const ALPHA_MIN: f32 = 1.0 / 255.0;

/// Radius around a surfel's centre beyond which its response is dropped: `s_max √(2 ln(o / α_min))`; 0 when its
/// peak is already below.
fn cutoff_radius(cloud: &SurfelCloud, i: usize) -> f32 {
    let opacity = sigmoid(cloud.opacity_logits[i]);
    if !(opacity > ALPHA_MIN) {
        return 0.0;
    }
    let [a, b] = cloud.log_scales[i];
    a.max(b).exp() * (2.0 * (opacity / ALPHA_MIN).ln()).sqrt()
}

/// Centre and radius of a sphere around everything of a cloud that can be seen or cast a shadow; `None` when there
/// is nothing. Not the smallest sphere: it is centred on the box of the centres.
#[must_use]
pub fn bounding_sphere(cloud: &SurfelCloud) -> Option<(Vec3, f32)> {
    let visible =
        |i: &usize| cutoff_radius(cloud, *i) > 0.0 && cloud.positions[*i].iter().all(|v| v.is_finite());
    let mut low = Vec3::INFINITY;
    let mut high = Vec3::NEG_INFINITY;
    for i in (0..cloud.len()).filter(visible) {
        let p = Vec3::from_array(cloud.positions[i]);
        low = low.min(p);
        high = high.max(p);
    }
    if !low.is_finite() {
        return None;
    }
    let centre = 0.5 * (low + high);
    let radius = (0..cloud.len())
        .filter(visible)
        .map(|i| (Vec3::from_array(cloud.positions[i]) - centre).length() + cutoff_radius(cloud, i))
        .fold(0.0f32, f32::max);
    Some((centre, radius))
}

/// The box of an object along three axes of its own space, of which the third is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Rotation that turns the object's up into +z.
    pub upright_from_object: DQuat,
    /// Lower corner in upright space.
    pub low: DVec3,
    /// Upper corner in upright space.
    pub high: DVec3,
}

/// Share of the surfel area that may stick out of [`extent`] at each end of each axis: a floater must not lift the
/// object off the floor.
const EXTENT_QUANTILE: f64 = 1e-3;

/// The box that holds an object's body: per axis, the quantiles at 0.1 % and 99.9 % of the surfels' centres ± one
/// standard deviation, weighted by opacity times area. `None` when nothing is visible.
#[must_use]
pub fn extent(cloud: &SurfelCloud, up: DVec3) -> Option<Extent> {
    let upright_from_object = DQuat::from_rotation_arc(up.normalize_or(DVec3::Z), DVec3::Z);
    let rotation = glam::Mat3::from_quat(upright_from_object.as_quat());
    let mut ends: [Vec<(f32, f32, f64)>; 3] = Default::default();
    for i in 0..cloud.len() {
        let opacity = sigmoid(cloud.opacity_logits[i]);
        let centre = rotation * Vec3::from_array(cloud.positions[i]);
        let scale = Vec3::new(cloud.log_scales[i][0].exp(), cloud.log_scales[i][1].exp(), 0.0);
        if !(opacity > 0.1) || !centre.is_finite() || !scale.is_finite() {
            continue;
        }
        let axes = rotation * cloud.rotation(i);
        let weight = f64::from(opacity) * f64::from(scale.x) * f64::from(scale.y);
        // One standard deviation of the projected Gaussian along each axis.
        let (u, v) = (axes.x_axis * scale.x, axes.y_axis * scale.y);
        for (axis, list) in ends.iter_mut().enumerate() {
            let spread = u[axis].hypot(v[axis]);
            list.push((centre[axis] - spread, centre[axis] + spread, weight));
        }
    }
    let mut low = DVec3::ZERO;
    let mut high = DVec3::ZERO;
    for (axis, list) in ends.iter_mut().enumerate() {
        let total: f64 = list.iter().map(|e| e.2).sum();
        if !(total > 0.0) {
            return None;
        }
        list.sort_by(|a, b| a.0.total_cmp(&b.0));
        low[axis] = quantile(list.iter().map(|e| (e.0, e.2)), total * EXTENT_QUANTILE)?;
        list.sort_by(|a, b| b.1.total_cmp(&a.1));
        high[axis] = quantile(list.iter().map(|e| (e.1, e.2)), total * EXTENT_QUANTILE)?;
    }
    Some(Extent { upright_from_object, low, high })
}

/// First value at which the running weight exceeds `threshold`.
fn quantile(values: impl Iterator<Item = (f32, f64)>, threshold: f64) -> Option<f64> {
    let mut sum = 0.0;
    for (value, weight) in values {
        sum += weight;
        if sum > threshold {
            return Some(f64::from(value));
        }
    }
    None
}

impl Extent {
    /// Largest edge of the box.
    #[must_use]
    pub fn largest(&self) -> f64 {
        (self.high - self.low).max_element()
    }

    /// Centre of the base in upright space: the middle of the box at its lowest height.
    #[must_use]
    pub fn base(&self) -> DVec3 {
        let middle = 0.5 * (self.low + self.high);
        DVec3::new(middle.x, middle.y, self.low.z)
    }

    /// The similarity that stands the object on `at` with its base, its up along `world_up`, turned by `yaw_rad`
    /// about up, its largest extent `size` world units.
    #[must_use]
    pub fn stand(&self, at: DVec3, world_up: DVec3, size: f64, yaw_rad: f64) -> Similarity {
        let scale = size / self.largest().max(f64::MIN_POSITIVE);
        let world_from_upright = DQuat::from_rotation_arc(DVec3::Z, world_up.normalize_or(DVec3::Z))
            * DQuat::from_rotation_z(yaw_rad);
        let rotation = (world_from_upright * self.upright_from_object).normalize();
        Similarity { scale, rotation, translation: at - world_from_upright * (self.base() * scale) }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use comgs_surfel::activation::logit;

    /// A closed box of surfels of one colour, `n × n` a face, in `low..high`.
    pub(crate) fn box_cloud(low: Vec3, high: Vec3, n: usize, rgb: [f32; 3]) -> SurfelCloud {
        let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
        let size = high - low;
        for axis in 0..3 {
            let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
            for (end, sign) in [(low, -1.0f32), (high, 1.0)] {
                for i in 0..n * n {
                    let mut p = low;
                    p[axis] = end[axis];
                    p[a] = low[a] + size[a] * ((i % n) as f32 + 0.5) / n as f32;
                    p[b] = low[b] + size[b] * ((i / n) as f32 + 0.5) / n as f32;
                    let mut normal = Vec3::ZERO;
                    normal[axis] = sign;
                    push_surfel(&mut cloud, p, normal, 0.6 * size[a].max(size[b]) / n as f32, 0.98, rgb);
                }
            }
        }
        cloud
    }

    /// Appends a round surfel of degree 0.
    pub(crate) fn push_surfel(
        cloud: &mut SurfelCloud,
        p: Vec3,
        normal: Vec3,
        sigma: f32,
        alpha: f32,
        rgb: [f32; 3],
    ) {
        let q = glam::Quat::from_rotation_arc(Vec3::Z, normal.normalize());
        cloud.positions.push(p.to_array());
        cloud.rotations.push([q.w, q.x, q.y, q.z]);
        cloud.log_scales.push([sigma.ln(); 2]);
        cloud.opacity_logits.push(logit(alpha));
        cloud.sh.extend(rgb.map(|c| (c - 0.5) / comgs_geom::sh::basis(0, Vec3::Z)[0]));
        let padding = cloud.sh_stride() - 3;
        cloud.sh.extend(std::iter::repeat_n(0.0, padding));
    }

    /// Goal: the base stands where it was put, upright and of the size asked for, also when the object's own up is
    /// not z and when a floater hangs below it.
    #[test]
    fn objects_stand_on_their_base() {
        let mut cloud = box_cloud(Vec3::new(-1.0, 0.0, -0.5), Vec3::new(1.0, 3.0, 0.5), 24, [0.5; 3]);
        push_surfel(&mut cloud, Vec3::new(0.0, -2.0, 0.0), Vec3::Y, 0.01, 0.9, [0.5; 3]);
        let extent = extent(&cloud, DVec3::Y).unwrap();
        assert!((extent.largest() - 3.0).abs() < 0.1, "{extent:?}");
        let at = DVec3::new(0.3, -2.0, 0.8);
        let s = extent.stand(at, DVec3::Z, 0.6, 0.7);
        let scale = 0.2;
        assert!((s.scale / scale - 1.0).abs() < 0.05);
        let base = s.transform_point(DVec3::new(0.0, 0.0, 0.0));
        assert!((base - at).length() < 0.02 * 0.6, "{base}");
        let top = s.transform_point(DVec3::new(0.0, 3.0, 0.0));
        assert!((top - at - DVec3::new(0.0, 0.0, 0.6)).length() < 0.02, "{top}");
    }

    /// Goal: the bounding sphere holds every surfel's cut-off ellipse.
    #[test]
    fn bounding_sphere_holds_all() {
        let cloud = box_cloud(Vec3::new(-1.0, 0.0, -0.5), Vec3::new(1.0, 3.0, 0.5), 4, [0.5; 3]);
        let (centre, radius) = bounding_sphere(&cloud).unwrap();
        for i in 0..cloud.len() {
            let reach = (Vec3::from_array(cloud.positions[i]) - centre).length() + cutoff_radius(&cloud, i);
            assert!(reach <= radius * 1.000_01);
        }
        assert_eq!(bounding_sphere(&SurfelCloud::empty(0, ColorEncoding::Linear)), None);
    }

    /// Goal: merging pads harmonics, keeps order, allows the same object twice, and refuses mixed encodings.
    #[test]
    fn merging() {
        let a = box_cloud(Vec3::ZERO, Vec3::ONE, 2, [0.2, 0.4, 0.6]);
        let mut b = SurfelCloud::empty(1, ColorEncoding::Linear);
        push_surfel(&mut b, Vec3::X, Vec3::Z, 0.1, 0.5, [0.9; 3]);
        fn place(cloud: &SurfelCloud) -> PlacedObject<'_> {
            PlacedObject { cloud, world_from_object: Similarity::IDENTITY }
        }
        let merged = merge(&[place(&a), place(&b), place(&a)]).unwrap();
        assert!(merged.problems().is_empty(), "{:?}", merged.problems());
        assert_eq!((merged.len(), merged.sh_degree), (2 * a.len() + 1, 1));
        assert!((merged.radiance(0, Vec3::X) - a.radiance(0, Vec3::X)).length() < 1e-6);
        b.color_encoding = ColorEncoding::Srgb;
        assert!(matches!(merge(&[place(&a), place(&b)]), Err(MergeError::Encoding(..))));
        assert_eq!(merge(&[]), Err(MergeError::Empty));
    }
}
