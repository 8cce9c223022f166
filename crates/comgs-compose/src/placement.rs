//! Whether a placement makes sense: is there a surface under the base, how far away is it, was the place observed?

use glam::{DVec3, Vec3};

/// What a ray meets in the scene.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfaceHit {
    /// Accumulated weight along the ray, in [0, 1].
    pub alpha: f32,
    /// Mean distance along the unit direction; meaningless where `alpha` is small.
    pub distance: f32,
    /// Mean normal, facing the ray's origin, any length.
    pub normal: Vec3,
}

/// Something with surfaces that rays can find.
pub trait Surfaces: Sync {
    /// What the ray meets within `t_max`.
    fn hit(&self, origin: Vec3, direction: Vec3, t_max: f32) -> SurfaceHit;
}

/// Thresholds of [`check_placement`].
#[derive(Clone, Debug, PartialEq)]
pub struct PlacementConfig {
    /// Gap under the base, in object heights, from which the object counts as floating or sunk.
    pub gap_fraction: f64,
    /// Share of the footprint's rays that must meet a surface.
    pub coverage_min: f64,
    /// Share of the panorama at the placement that must have been reconstructed.
    pub panorama_coverage_min: f64,
    /// Angle in degrees between the ground's normal and up beyond which the ground counts as sloping.
    pub slope_max_deg: f64,
}

impl Default for PlacementConfig {
    fn default() -> Self {
        Self { gap_fraction: 0.05, coverage_min: 0.5, panorama_coverage_min: 0.5, slope_max_deg: 20.0 }
    }
}

/// The figures behind a placement's warnings.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacementReport {
    /// Median height of the base over the surface below it in world units: positive floats, negative is sunk.
    /// `None` when there is no surface.
    pub gap: Option<f64>,
    /// Mean unit normal of the ground under the footprint.
    pub ground_normal: Option<DVec3>,
    /// Share of the footprint's rays that met a surface, in [0, 1].
    pub ground_coverage: f64,
    /// What is wrong, in words with figures; empty when nothing is.
    pub warnings: Vec<String>,
}

/// Weight from which a ray has met a surface.
const SURFACE_ALPHA: f32 = 0.5;
/// Rays across the footprint, per side.
const GRID: i32 = 5;

/// Looks down through the footprint of an object that stands at `base`.
///
/// Rays start one object height above the base, so that a base under the floor finds the floor above it, and end
/// four heights below. `footprint` is the radius of the disc on which the object stands, `height` its extent along
/// `up` (all world units, both > 0). `panorama_coverage`, when known, is the share of the sphere around the
/// placement that the scene's reconstruction covers (hard case 33).
#[must_use]
pub fn check_placement(
    scene: &dyn Surfaces,
    base: DVec3,
    up: DVec3,
    footprint: f64,
    height: f64,
    panorama_coverage: Option<f64>,
    config: &PlacementConfig,
) -> PlacementReport {
    let up = up.normalize_or(DVec3::Z);
    let side = up.any_orthonormal_vector();
    let across = up.cross(side);
    let (lift, reach) = (height, 5.0 * height);
    let mut gaps = Vec::new();
    let mut normal = DVec3::ZERO;
    let mut rays = 0usize;
    for i in 0..GRID * GRID {
        let (x, y) = (f64::from(i % GRID) / 2.0 - 1.0, f64::from(i / GRID) / 2.0 - 1.0);
        if x * x + y * y > 1.01 {
            continue;
        }
        rays += 1;
        let origin = base + up * lift + (side * x + across * y) * (0.7 * footprint);
        let hit = scene.hit(origin.as_vec3(), -up.as_vec3(), reach as f32);
        if hit.alpha >= SURFACE_ALPHA && hit.distance.is_finite() {
            gaps.push(f64::from(hit.distance) - lift);
            normal += hit.normal.as_dvec3();
        }
    }
    gaps.sort_by(f64::total_cmp);
    let gap = (!gaps.is_empty()).then(|| gaps[gaps.len() / 2]);
    let ground_normal = normal.try_normalize().filter(|_| gap.is_some());
    let ground_coverage = gaps.len() as f64 / rays as f64;
    let mut report = PlacementReport { gap, ground_normal, ground_coverage, warnings: Vec::new() };
    report.warnings = warnings(&report, up, height, panorama_coverage, config);
    report
}

fn warnings(
    report: &PlacementReport,
    up: DVec3,
    height: f64,
    panorama_coverage: Option<f64>,
    config: &PlacementConfig,
) -> Vec<String> {
    let mut warnings = Vec::new();
    let percent = |share: f64| (share * 100.0).round();
    if let Some(gap) = report.gap {
        let share = gap / height;
        if share > config.gap_fraction {
            warnings.push(format!(
                "the object floats: its base is {gap:.3} above the surface below it ({} % of its height)",
                percent(share)
            ));
        } else if share < -config.gap_fraction {
            warnings.push(format!(
                "the object is sunk: its base is {:.3} below a surface ({} % of its height)",
                -gap,
                percent(-share)
            ));
        }
        if report.ground_coverage < config.coverage_min {
            warnings.push(format!(
                "only {} % of the object's footprint has a surface under it",
                percent(report.ground_coverage)
            ));
        }
    } else {
        warnings.push(format!(
            "there is no surface within {:.3} above or {:.3} below the base: the object hangs in mid-air or in \
             unobserved space",
            height,
            4.0 * height
        ));
    }
    if let Some(normal) = report.ground_normal {
        let slope = normal.dot(up).clamp(-1.0, 1.0).acos().to_degrees();
        if slope > config.slope_max_deg {
            warnings.push(format!("the ground slopes by {slope:.0}° under the object, which stands upright"));
        }
    }
    if let Some(coverage) = panorama_coverage
        && coverage < config.panorama_coverage_min
    {
        warnings.push(format!(
            "the scene's reconstruction covers only {} % of the sphere around the placement; the rest of its light \
             is guessed",
            percent(coverage)
        ));
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor at a height, in a half space of x.
    struct Floor {
        height: f32,
        x_max: f32,
        normal: Vec3,
    }

    impl Surfaces for Floor {
        fn hit(&self, origin: Vec3, direction: Vec3, t_max: f32) -> SurfaceHit {
            let distance = (self.height - origin.z) / direction.z;
            if !(0.0..=t_max).contains(&distance) || origin.x > self.x_max {
                return SurfaceHit::default();
            }
            SurfaceHit { alpha: 0.98, distance, normal: self.normal }
        }
    }

    fn check(floor: &Floor, base_z: f64, coverage: Option<f64>) -> PlacementReport {
        let base = DVec3::new(0.0, 0.0, base_z);
        check_placement(floor, base, DVec3::Z, 0.3, 0.5, coverage, &PlacementConfig::default())
    }

    /// Goal: standing is silent; under the floor, in mid-air, over an edge, in unobserved space and on a slope are
    /// each warned with their figure (hard case 33).
    #[test]
    fn every_bad_placement_is_named_with_its_figure() {
        let floor = Floor { height: 0.2, x_max: 10.0, normal: Vec3::Z };
        let standing = check(&floor, 0.2, Some(0.8));
        assert!(standing.warnings.is_empty(), "{standing:?}");
        assert!(standing.gap.unwrap().abs() < 1e-6 && standing.ground_coverage == 1.0);

        let floating = check(&floor, 0.3, None);
        assert!(
            floating.warnings[0].contains("floats") && floating.warnings[0].contains("20 %"),
            "{floating:?}"
        );
        let sunk = check(&floor, 0.1, None);
        assert!(sunk.warnings[0].contains("sunk") && sunk.warnings[0].contains("0.100"), "{sunk:?}");
        let nowhere = check(&floor, 5.0, None);
        assert!(nowhere.gap.is_none() && nowhere.warnings[0].contains("mid-air"), "{nowhere:?}");
        let unobserved = check(&floor, 0.2, Some(0.31));
        assert!(unobserved.warnings[0].contains("31 %"), "{unobserved:?}");

        let edge = Floor { x_max: f32::NEG_INFINITY, ..floor };
        assert!(check(&edge, 0.2, None).gap.is_none());
        // `side` of a z-up frame is a horizontal axis; half the footprint lies beyond this edge.
        let edge = Floor { x_max: -0.05, ..floor };
        let over_edge = check(&edge, 0.2, None);
        assert!(over_edge.warnings[0].contains("footprint"), "{over_edge:?}");
        let slope = Floor { normal: Vec3::new(0.6, 0.0, 0.8), ..floor };
        assert!(check(&slope, 0.2, None).warnings[0].contains("37°"));
    }
}
