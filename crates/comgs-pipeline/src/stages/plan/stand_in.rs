//! Stand-ins: a composition of few surfels and small cameras that pilots are rendered of.

use crate::stages::editing::{Composition, Placed};
use crate::stages::relight::subject::Subject;
use comgs_geom::Camera;
use comgs_light::EnvironmentMap;
use comgs_scene::Asset;
use comgs_surfel::SurfelCloud;
use std::sync::Arc;

/// Surfels of an object from which on some are left out, and that stay about.
const SURFELS: usize = 4500;
/// Rows of the light from which on it is halved, and that stay about.
const LIGHT_ROWS: usize = 64;

/// The composition with small cameras and thinned objects; the scene is the same.
pub(super) fn stand_in(composition: &Composition, cameras: Vec<Camera>) -> Composition {
    let thin = |object: &Placed| Placed {
        name: object.name.clone(),
        subject: Subject {
            asset: Asset {
                record: object.subject.asset.record.clone(),
                surfels: thinned(&object.subject.asset.surfels),
                root: object.subject.asset.root.clone(),
            },
            probes: object.subject.probes.clone(),
            path: object.subject.path.clone(),
        },
        world_from_object: object.world_from_object,
    };
    Composition {
        record: composition.record.clone(),
        scene: Arc::clone(&composition.scene),
        scene_path: composition.scene_path.clone(),
        objects: composition.objects.iter().map(thin).collect(),
        cameras,
        light_path: composition.light_path.clone(),
        map: smaller(&composition.map),
        lamps: composition.lamps.clone(),
        look: composition.look,
    }
}

/// The map at half of its size, and again, as long as enough rows stay.
fn smaller(map: &EnvironmentMap) -> EnvironmentMap {
    let mut rows = map.height();
    while rows >= 2 * LIGHT_ROWS {
        rows /= 2;
    }
    if rows == map.height() {
        return map.clone();
    }
    let image = map.image().resized(2 * rows, rows);
    EnvironmentMap::from_image_repaired(&image).map_or_else(|_| map.clone(), |(map, _)| map)
}

/// One of every k surfels, √k times as large, so that together they still cover the surface; all of a small cloud. Which one
/// changes from k to k: a cloud made row by row must not be thinned to stripes.
fn thinned(cloud: &SurfelCloud) -> SurfelCloud {
    let k = (cloud.len() / SURFELS).max(1);
    if k == 1 {
        return cloud.clone();
    }
    let one_of = |first: usize| {
        let scattered = (first as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40;
        (first + scattered as usize % k).min(cloud.len() - 1) as u32
    };
    let kept: Vec<u32> = (0..cloud.len()).step_by(k).map(one_of).collect();
    let mut thin = cloud.gathered(&kept);
    let larger = 0.5 * (k as f32).ln();
    thin.log_scales.iter_mut().flatten().for_each(|s| *s += larger);
    thin
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Camera;
    use comgs_raster::{Planes, RasterConfig, render};
    use comgs_surfel::ColorEncoding;
    use glam::{DVec3, Quat, Vec3};

    /// A ball of discs.
    fn ball(n: usize) -> SurfelCloud {
        let mut cloud = SurfelCloud::empty(0, ColorEncoding::Linear);
        for i in 0..n {
            // Fibonacci points.
            let z = 1.0 - (2.0 * i as f32 + 1.0) / n as f32;
            let angle = 2.399_963_2 * i as f32;
            let r = (1.0 - z * z).sqrt();
            let p = Vec3::new(r * angle.cos(), r * angle.sin(), z);
            let q = Quat::from_rotation_arc(Vec3::Z, p);
            cloud.positions.push(p.to_array());
            cloud.rotations.push([q.w, q.x, q.y, q.z]);
            cloud.log_scales.push([(2.5 / (n as f32).sqrt()).ln(); 2]);
            cloud.opacity_logits.push(3.0);
            cloud.sh.extend([0.3; 3]);
        }
        cloud
    }

    /// Goal: a thinned ball covers what the whole one covers, but for an edge as wide as its discs, with a quarter of the surfels;
    /// a small cloud stays as it is.
    #[test]
    fn a_thinned_cloud_covers_the_same() {
        let whole = ball(4 * SURFELS);
        let thin = thinned(&whole);
        assert_eq!(thin.len(), SURFELS);
        let camera = Camera::look_at("a", 96, 96, 0.6, DVec3::new(0.0, -5.0, 1.0), DVec3::ZERO, DVec3::Z);
        let covered = |cloud: &SurfelCloud| -> f32 {
            render(cloud, &camera, Planes::GEOMETRY, &RasterConfig::default()).weight.data.iter().sum()
        };
        let (a, b) = (covered(&whole), covered(&thin));
        assert!(a > 1000.0 && (b / a - 1.0).abs() < 0.08, "{a} {b}");
        assert_eq!(thinned(&ball(50)), ball(50));
    }
}
