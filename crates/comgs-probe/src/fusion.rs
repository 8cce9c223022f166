//! Multi-view depth fusion: many depth maps in, one oriented point cloud out.

use crate::ProbeError;
use comgs_geom::Camera;
use comgs_image::Image;
use glam::{DAffine3, DVec2, DVec3, Vec3};
use rayon::prelude::*;

/// Depth and normals as one camera sees them.
#[derive(Clone, Debug)]
pub struct DepthView {
    /// The camera; its image size is that of both images.
    pub camera: Camera,
    /// Unbiased z-depth, world units, 1 channel; 0 where there is none. What is not finite or negative is none too.
    pub depth: Image,
    /// World-space normal of any length, facing the viewer, 3 channels; 0 where there is none.
    pub normal: Image,
}

/// When points of two views are one.
#[derive(Clone, Debug, PartialEq)]
pub struct FusionConfig {
    /// Largest distance between a pixel and where the other view's point falls, pixels; above 0.
    pub max_reprojection_px: f64,
    /// Largest difference of the two depths in the reference view, as a share of its depth; above 0.
    pub max_relative_depth: f64,
    /// Largest angle between the two normals, degrees; above 0, at most 90.
    pub max_normal_deg: f64,
    /// Views that must agree with a pixel besides its own; at least 1.
    pub min_consistent_views: usize,
    /// Views that a reference is tested against, at least `min_consistent_views`: those that agree best with 64
    /// pixels spread over it. Time is proportional.
    pub neighbours: usize,
    /// Every `stride`-th pixel of every `stride`-th row is tested, at least 1. Surface points repeat from view to
    /// view, so probes need far fewer than all.
    pub stride: usize,
}

impl Default for FusionConfig {
    fn default() -> Self {
        Self {
            max_reprojection_px: 2.0,
            max_relative_depth: 0.01,
            max_normal_deg: 10.0,
            min_consistent_views: 5,
            neighbours: 16,
            stride: 4,
        }
    }
}

impl FusionConfig {
    /// Values out of range, one message each. Empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut require = |sound: bool, text: String| {
            if !sound {
                problems.push(text);
            }
        };
        for (name, v) in [
            ("max_reprojection_px", self.max_reprojection_px),
            ("max_relative_depth", self.max_relative_depth),
        ] {
            require(v > 0.0 && v.is_finite(), format!("{name} is {v}, expected a finite value above 0"));
        }
        let angle = self.max_normal_deg;
        require(
            angle > 0.0 && angle <= 90.0,
            format!("max_normal_deg is {angle}, expected a value in (0, 90]"),
        );
        let (wanted, tested) = (self.min_consistent_views, self.neighbours);
        require(wanted >= 1, format!("min_consistent_views is {wanted}, expected at least 1"));
        require(
            tested >= wanted,
            format!("neighbours is {tested}, expected at least min_consistent_views, which is {wanted}"),
        );
        require(self.stride >= 1, format!("stride is {}, expected at least 1", self.stride));
        problems
    }
}

/// Points on a surface.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OrientedPoints {
    /// World.
    pub positions: Vec<Vec3>,
    /// Unit length, world, towards the cameras that saw the point.
    pub normals: Vec<Vec3>,
}

/// What depth fusion counted.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FusionReport {
    /// Views given.
    pub views: usize,
    /// Other views that had to agree.
    pub needed: usize,
    /// Views that a reference was tested against, at most; fewer than asked for when there are not so many that
    /// stand apart.
    pub tested: usize,
    /// Pixels looked at.
    pub pixels: usize,
    /// Of these, pixels with a depth and a normal that faces the camera.
    pub usable: usize,
    /// Entry k: usable pixels with which exactly k other views agreed.
    pub agreeing: Vec<usize>,
    /// Tests that failed because the point is outside the other view or behind it.
    pub outside: usize,
    /// Because the other view has no depth or normal there.
    pub empty: usize,
    /// Because the depths differ: mostly another surface in front.
    pub depth: usize,
    /// Because the other view's point falls too far from the pixel.
    pub reprojection: usize,
    /// Because the normals differ.
    pub normal: usize,
}

impl FusionReport {
    /// Points made: pixels with which enough views agreed.
    #[must_use]
    pub fn points(&self) -> usize {
        self.agreeing.iter().skip(self.needed).sum()
    }

    /// What the counts say, in a sentence.
    #[must_use]
    pub fn explanation(&self) -> String {
        let best = self.agreeing.iter().rposition(|&n| n > 0).unwrap_or(0);
        let cause = if self.views <= self.needed {
            format!("{} views cannot give {} others that agree", self.views, self.needed)
        } else if self.usable == 0 {
            format!("none of {} pixels has a depth and a normal that faces its camera", self.pixels)
        } else if self.tested < self.needed {
            format!(
                "only {} views stand apart from a reference, {} others must agree",
                self.tested, self.needed
            )
        } else {
            format!("{} others must agree with a pixel, at most {best} did", self.needed)
        };
        format!(
            "{cause} ({} of {} pixels usable in {} views; tests failed: {} outside, {} empty, {} depth, {} \
             reprojection, {} normal)",
            self.usable,
            self.pixels,
            self.views,
            self.outside,
            self.empty,
            self.depth,
            self.reprojection,
            self.normal
        )
    }

    fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.usable += other.usable;
        self.outside += other.outside;
        self.empty += other.empty;
        self.depth += other.depth;
        self.reprojection += other.reprojection;
        self.normal += other.normal;
        for (a, b) in self.agreeing.iter_mut().zip(&other.agreeing) {
            *a += b;
        }
    }
}

/// Fuses depth maps into oriented surface points, after Galliani, Lasinger & Schindler 2015 (§ 4, consistency check).
///
/// A pixel of a reference view becomes a world point. Another view agrees when the world point that it stores at the
/// pixel on which the reference's point falls comes back to the reference within `max_reprojection_px` of the pixel
/// and `max_relative_depth` of its depth, and its normal is within `max_normal_deg`. With enough agreeing views,
/// position and normal are averaged over them and the reference. Points are not merged between references: a spot
/// that n views see gives up to n points (choose probes from them with [`crate::farthest_points`]).
///
/// A view whose centre coincides with the reference's (nearer than a thousandth of its mean depth) is no witness.
/// Deterministic and parallel: the same bytes at any thread count.
///
/// # Errors
/// [`ProbeError::Config`]; [`ProbeError::View`] for a camera or an image that cannot be used;
/// [`ProbeError::NoConsistentPoints`] with all counts when no point is left.
pub fn fuse(
    views: &[DepthView],
    config: &FusionConfig,
) -> Result<(OrientedPoints, FusionReport), ProbeError> {
    let problems = config.check();
    if !problems.is_empty() {
        return Err(ProbeError::Config(problems));
    }
    for (index, view) in views.iter().enumerate() {
        let problems = view_problems(view);
        if !problems.is_empty() {
            return Err(ProbeError::View { index, name: view.camera.name.clone(), problems });
        }
    }
    let views: Vec<Prepared<'_>> = views.iter().map(Prepared::new).collect();
    let tolerance = Tolerance::new(config);
    let mut report =
        FusionReport { views: views.len(), needed: config.min_consistent_views, ..FusionReport::default() };
    report.agreeing = vec![0; config.neighbours.min(views.len()) + 1];
    let witnesses: Vec<Vec<usize>> = (0..views.len())
        .into_par_iter()
        .map(|v| witnesses(&views, v, &tolerance, config.neighbours))
        .collect();
    report.tested = witnesses.iter().map(Vec::len).max().unwrap_or(0);

    let mut points = OrientedPoints::default();
    for (reference, witnesses) in views.iter().zip(&witnesses) {
        let witnesses: Vec<&Prepared<'_>> = witnesses.iter().map(|&w| &views[w]).collect();
        let rows = strided(reference.view.depth.height, config.stride);
        let fused: Vec<(OrientedPoints, FusionReport)> = rows
            .par_iter()
            .map(|&y| fuse_row(reference, &witnesses, y, &tolerance, config, &report))
            .collect();
        for (row, counts) in fused {
            points.positions.extend(row.positions);
            points.normals.extend(row.normals);
            report.add(&counts);
        }
    }
    if points.positions.is_empty() {
        return Err(ProbeError::NoConsistentPoints(Box::new(report)));
    }
    Ok((points, report))
}

fn view_problems(view: &DepthView) -> Vec<String> {
    let mut problems = view.camera.problems();
    let size = (view.camera.width, view.camera.height);
    for (name, image, channels) in [("depth", &view.depth, 1), ("normal", &view.normal, 3)] {
        let got = (image.width, image.height, image.channels);
        if got != (size.0, size.1, channels) {
            problems.push(format!(
                "{name} is {got:?}, expected {:?} as the camera has it",
                (size.0, size.1, channels)
            ));
        } else if image.data.len() != image.pixels() * channels {
            problems.push(format!(
                "{name} has {} samples, expected {}",
                image.data.len(),
                image.pixels() * channels
            ));
        }
    }
    problems
}

struct Tolerance {
    pixels_squared: f64,
    depth: f64,
    cosine: f32,
}

impl Tolerance {
    fn new(config: &FusionConfig) -> Self {
        Self {
            pixels_squared: config.max_reprojection_px * config.max_reprojection_px,
            depth: config.max_relative_depth,
            cosine: config.max_normal_deg.to_radians().cos() as f32,
        }
    }
}

/// A usable pixel.
#[derive(Clone, Copy)]
struct Sample {
    pixel: DVec2,
    depth: f64,
    point: DVec3,
    normal: Vec3,
}

/// Why a view does not agree.
enum Miss {
    Outside,
    Empty,
    Depth,
    Reprojection,
    Normal,
}

/// A view with its pose inverted once.
struct Prepared<'a> {
    view: &'a DepthView,
    camera_from_world: DAffine3,
}

impl<'a> Prepared<'a> {
    fn new(view: &'a DepthView) -> Self {
        Self { view, camera_from_world: view.camera.camera_from_world() }
    }

    fn project(&self, p_world: DVec3) -> Option<(DVec2, f64)> {
        let (p, c) = (self.camera_from_world.transform_point3(p_world), &self.view.camera);
        (p.z > 0.0).then(|| (DVec2::new(c.cx + c.fx * p.x / p.z, c.cy + c.fy * p.y / p.z), p.z))
    }

    /// `None` without a depth, or without a normal that faces the camera.
    fn sample(&self, x: usize, y: usize) -> Option<Sample> {
        let depth = f64::from(self.view.depth.pixel(x, y)[0]);
        let normal = Vec3::from_slice(self.view.normal.pixel(x, y)).try_normalize()?;
        if !(depth > 0.0 && depth.is_finite()) {
            return None;
        }
        let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
        let ray = self.view.camera.ray_world(pixel.x, pixel.y);
        let point = self.view.camera.centre() + ray * depth;
        (normal.as_dvec3().dot(ray) < 0.0).then_some(Sample { pixel, depth, point, normal })
    }

    /// What this view stores where `sample` of `reference` falls on it, if it agrees.
    fn witness(&self, reference: &Self, sample: &Sample, tolerance: &Tolerance) -> Result<Sample, Miss> {
        let (at, _) = self.project(sample.point).ok_or(Miss::Outside)?;
        let (width, height) = (self.view.depth.width, self.view.depth.height);
        if !(at.x >= 0.0 && at.y >= 0.0 && at.x < width as f64 && at.y < height as f64) {
            return Err(Miss::Outside);
        }
        let own = self.sample(at.x as usize, at.y as usize).ok_or(Miss::Empty)?;
        let (back, depth) = reference.project(own.point).ok_or(Miss::Depth)?;
        if !((depth - sample.depth).abs() <= tolerance.depth * sample.depth) {
            return Err(Miss::Depth);
        }
        if !((back - sample.pixel).length_squared() <= tolerance.pixels_squared) {
            return Err(Miss::Reprojection);
        }
        if !(own.normal.dot(sample.normal) >= tolerance.cosine) {
            return Err(Miss::Normal);
        }
        Ok(own)
    }
}

/// Side of the grid of pixels by which witnesses are chosen.
const TRIAL_SIDE: usize = 8;
/// Views nearer to the reference than this share of its mean depth see the same picture.
const MIN_BASELINE: f64 = 1e-3;

/// The views that a reference is tested against: those that agree with most of a few of its pixels, then the nearest
/// ones. Without a usable pixel there are none.
fn witnesses(views: &[Prepared<'_>], reference: usize, tolerance: &Tolerance, limit: usize) -> Vec<usize> {
    let own = &views[reference];
    let trials = trials(own);
    if trials.is_empty() {
        return Vec::new();
    }
    let mean_depth = trials.iter().map(|s| s.depth).sum::<f64>() / trials.len() as f64;
    let centre = own.view.camera.centre();
    let mut ranked: Vec<(usize, f64, usize)> = (0..views.len())
        .filter(|&v| v != reference)
        .map(|v| (v, views[v].view.camera.centre().distance(centre)))
        .filter(|&(_, distance)| distance > MIN_BASELINE * mean_depth)
        .map(|(v, distance)| {
            let agree = trials.iter().filter(|s| views[v].witness(own, s, tolerance).is_ok()).count();
            (trials.len() - agree, distance, v)
        })
        .collect();
    ranked.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    ranked.into_iter().take(limit).map(|(_, _, v)| v).collect()
}

/// Up to 64 usable pixels, spread over those that there are.
fn trials(view: &Prepared<'_>) -> Vec<Sample> {
    let depth = &view.view.depth;
    // A grid of at most 64 × 64 pixels finds a small object in a large image.
    let (dx, dy) = (depth.width.div_ceil(64), depth.height.div_ceil(64));
    let all: Vec<Sample> = (dy / 2..depth.height)
        .step_by(dy)
        .flat_map(|y| (dx / 2..depth.width).step_by(dx).map(move |x| (x, y)))
        .filter_map(|(x, y)| view.sample(x, y))
        .collect();
    let wanted = TRIAL_SIDE * TRIAL_SIDE;
    all.iter().step_by(all.len().div_ceil(wanted).max(1)).copied().collect()
}

/// Every `stride`-th of `0..n`, from the middle of the first stride; at least one.
fn strided(n: usize, stride: usize) -> Vec<usize> {
    ((stride / 2).min(n - 1)..n).step_by(stride).collect()
}

fn fuse_row(
    reference: &Prepared<'_>,
    witnesses: &[&Prepared<'_>],
    y: usize,
    tolerance: &Tolerance,
    config: &FusionConfig,
    report: &FusionReport,
) -> (OrientedPoints, FusionReport) {
    let mut points = OrientedPoints::default();
    let mut counts = FusionReport { agreeing: vec![0; report.agreeing.len()], ..FusionReport::default() };
    for x in strided(reference.view.depth.width, config.stride) {
        counts.pixels += 1;
        let Some(sample) = reference.sample(x, y) else { continue };
        counts.usable += 1;
        let (mut position, mut normal, mut agreeing) = (sample.point, sample.normal, 0);
        for witness in witnesses {
            match witness.witness(reference, &sample, tolerance) {
                Ok(own) => {
                    position += own.point;
                    normal += own.normal;
                    agreeing += 1;
                }
                Err(Miss::Outside) => counts.outside += 1,
                Err(Miss::Empty) => counts.empty += 1,
                Err(Miss::Depth) => counts.depth += 1,
                Err(Miss::Reprojection) => counts.reprojection += 1,
                Err(Miss::Normal) => counts.normal += 1,
            }
        }
        counts.agreeing[agreeing] += 1;
        if agreeing >= config.min_consistent_views {
            points.positions.push((position / (agreeing + 1) as f64).as_vec3());
            points.normals.push(normal.normalize());
        }
    }
    (points, counts)
}
