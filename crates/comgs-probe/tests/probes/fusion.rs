//! Depth fusion against surfaces whose points and normals are known on paper.

use crate::round::fibonacci;
use comgs_geom::{Camera, Rng};
use comgs_image::Image;
use comgs_probe::{DepthView, FusionConfig, OrientedPoints, ProbeError, fuse};
use glam::{DVec3, Vec3};

const RADIUS: f64 = 0.5;

/// What a camera sees of a sphere around the origin: depth and normals of a length that says nothing.
fn sphere_view(eye: DVec3, side: usize) -> DepthView {
    let camera = Camera::look_at("sphere", side, side, 0.7, eye, DVec3::ZERO, DVec3::Z);
    let (mut depth, mut normal) = (Image::zeros(side, side, 1), Image::zeros(side, side, 3));
    for y in 0..side {
        for x in 0..side {
            let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            let (a, b, c) = (ray.length_squared(), eye.dot(ray), eye.length_squared() - RADIUS * RADIUS);
            if b * b > a * c {
                let t = (-b - (b * b - a * c).sqrt()) / a;
                depth.pixel_mut(x, y)[0] = t as f32;
                let n = (eye + ray * t) / RADIUS * (0.1 + 0.9 * x as f64 / side as f64);
                normal.pixel_mut(x, y).copy_from_slice(&n.as_vec3().to_array());
            }
        }
    }
    DepthView { camera, depth, normal }
}

fn sphere_views(n: usize) -> Vec<DepthView> {
    fibonacci(n).iter().map(|d| sphere_view(2.0 * d.as_dvec3(), 120)).collect()
}

/// Largest distance of points from the sphere, and of normals from its normals.
fn errors(points: &OrientedPoints) -> (f64, f64) {
    let distance = |p: &Vec3| (p.as_dvec3().length() - RADIUS).abs();
    let angle = |(p, n): (&Vec3, &Vec3)| f64::from(p.normalize().dot(*n).min(1.0).acos().to_degrees());
    (
        points.positions.iter().map(distance).fold(0.0, f64::max),
        points.positions.iter().zip(&points.normals).map(angle).fold(0.0, f64::max),
    )
}

/// Goal: points of a sphere lie on it, normals are its normals and point to the cameras, all sides are covered, and the
/// counts add up.
#[test]
fn a_sphere_is_recovered() {
    let config = FusionConfig { stride: 2, ..FusionConfig::default() };
    let (points, report) = fuse(&sphere_views(40), &config).unwrap();
    let (distance, angle) = errors(&points);
    // An agreeing point is up to 2 px = 0.025 away on the sphere: the mean of such points lies 0.025² / 2r within.
    assert!(distance < 7e-4, "{distance}");
    // 0.025 of a radius of 0.5 are 2.9°, of which the mean over all views keeps a part.
    assert!(angle < 2.0, "{angle}");
    for d in fibonacci(200) {
        let nearest = points.positions.iter().map(|p| p.normalize().dot(d)).fold(-1.0, f32::max);
        assert!(nearest > 0.998, "nothing near {d}");
    }
    assert_eq!(report.points(), points.positions.len());
    assert_eq!(report.agreeing.iter().sum::<usize>(), report.usable);
    assert_eq!((report.views, report.tested, report.pixels), (40, 16, 40 * 60 * 60));
    assert!(report.points() * 10 > report.usable * 8, "{report:?}");
    let misses = report.outside + report.empty + report.depth + report.reprojection + report.normal;
    let hits: usize = report.agreeing.iter().enumerate().map(|(k, n)| k * n).sum();
    assert_eq!(misses + hits, report.usable * report.tested);
}

/// Goal: a view whose depth is wrong by 3 % contributes next to no points and draws none towards it.
#[test]
fn a_wrong_view_is_outvoted() {
    let mut views = sphere_views(40);
    let wrong = 7;
    views[wrong].depth = views[wrong].depth.map(|d| 1.03 * d);
    let (points, _) = fuse(&views, &FusionConfig::default()).unwrap();
    // The view's own points would be 0.048 off. A few at its limb lie so flat along its rays that they agree: 0.0027.
    let off: Vec<f64> = points.positions.iter().map(|p| (p.as_dvec3().length() - RADIUS).abs()).collect();
    assert!(off.iter().all(|e| *e < 0.005), "{:?}", errors(&points));
    assert!(off.iter().filter(|e| **e > 7e-4).count() * 500 < off.len());
    // The same with its normals turned by 20°: the rest still agrees.
    let mut views = sphere_views(40);
    let tilt = glam::Quat::from_rotation_x(20f32.to_radians());
    for n in views[wrong].normal.data.chunks_exact_mut(3) {
        let turned = tilt * Vec3::from_slice(n);
        n.copy_from_slice(&turned.to_array());
    }
    let (points, report) = fuse(&views, &FusionConfig::default()).unwrap();
    assert!(errors(&points).1 < 2.0 && report.normal > 0);
}

/// Goal: noise within the tolerance is averaged away in part: the points' error is below that of the depths.
#[test]
fn noise_is_averaged() {
    let mut views = sphere_views(40);
    let mut rng = Rng::new(3);
    for view in &mut views {
        view.depth.data.iter_mut().for_each(|d| *d *= 1.0 + 0.001 * rng.normal());
    }
    let (points, _) = fuse(&views, &FusionConfig::default()).unwrap();
    let square: f64 = points.positions.iter().map(|p| (p.as_dvec3().length() - RADIUS).powi(2)).sum();
    let rms = (square / points.positions.len() as f64).sqrt();
    // 0.001 of a depth of 1.6, along the ray; averaged over 6 views and more.
    assert!(rms < 0.0016 / 6f64.sqrt() && rms > 1e-5, "{rms}");
}

/// Goal: too few views, views at one place, views without depth, with inverted or wild normals: refused, with the counts
/// that say why.
#[test]
fn nothing_consistent_is_explained() {
    let config = FusionConfig::default();
    let failed = |views: &[DepthView]| match fuse(views, &config) {
        Err(ProbeError::NoConsistentPoints(report)) => {
            (report.explanation(), ProbeError::NoConsistentPoints(report).to_string())
        }
        other => panic!("{:?}", other.map(|(p, r)| (p.positions.len(), r))),
    };
    let (text, message) = failed(&sphere_views(5));
    assert!(text.starts_with("5 views cannot give 5 others") && message.contains(&text), "{text}");
    assert!(failed(&[]).0.starts_with("0 views cannot"));

    let same: Vec<DepthView> = (0..12).map(|_| sphere_view(2.0 * DVec3::X, 60)).collect();
    assert!(failed(&same).0.starts_with("only 0 views stand apart"), "{}", failed(&same).0);

    let mut blind = sphere_views(12);
    blind.iter_mut().for_each(|v| v.depth.data.fill(0.0));
    assert!(failed(&blind).0.starts_with("none of"), "{}", failed(&blind).0);
    let mut inverted = sphere_views(12);
    inverted.iter_mut().for_each(|v| v.normal = v.normal.map(|n| -n));
    assert!(failed(&inverted).0.starts_with("none of"), "{}", failed(&inverted).0);

    // Each view believes in another size of the sphere.
    let mut unlike = sphere_views(12);
    for (k, view) in unlike.iter_mut().enumerate() {
        view.depth = view.depth.map(|d| d * (0.7 + 0.05 * k as f32));
    }
    let text = failed(&unlike).0;
    assert!(text.starts_with("5 others must agree with a pixel, at most"), "{text}");
}

/// Goal: depths and normals that are not finite, negative or 0 are no points and poison none.
#[test]
fn unusable_pixels_are_passed_over() {
    let mut views = sphere_views(40);
    let mut rng = Rng::new(6);
    let bad = [f32::NAN, f32::INFINITY, -1.0, 0.0];
    for view in &mut views {
        for i in 0..view.depth.data.len() {
            match rng.below(10) {
                0 => view.depth.data[i] = bad[i % 4],
                1 => view.normal.data[3 * i] = bad[i % 2],
                2 => view.normal.data[3 * i..3 * i + 3].fill(0.0),
                _ => {}
            }
        }
    }
    let (points, report) = fuse(&views, &FusionConfig::default()).unwrap();
    let (distance, angle) = errors(&points);
    assert!(distance < 7e-4 && angle < 2.0, "{distance} {angle}");
    assert!(report.empty > 0 && points.positions.iter().chain(&points.normals).all(|v| v.is_finite()));
}

/// Goal: images of another size than the camera's, unusable cameras and settings are named.
#[test]
fn bad_input_is_named() {
    let mut views = sphere_views(8);
    views[3].normal = Image::zeros(120, 119, 3);
    views[3].camera.fx = f64::NAN;
    let error = fuse(&views, &FusionConfig::default()).unwrap_err();
    assert!(matches!(&error, ProbeError::View { index: 3, problems, .. } if problems.len() == 2), "{error}");
    let config = FusionConfig {
        max_reprojection_px: 0.0,
        max_relative_depth: f64::NAN,
        max_normal_deg: 91.0,
        min_consistent_views: 0,
        neighbours: 0,
        stride: 0,
    };
    let error = fuse(&views, &config).unwrap_err();
    assert!(matches!(&error, ProbeError::Config(problems) if problems.len() == 5), "{error}");
}

/// Goal: images smaller than the stride, and a stride larger than the image, still give their one pixel.
#[test]
fn tiny_images() {
    let views: Vec<DepthView> = fibonacci(200).iter().map(|d| sphere_view(2.0 * d.as_dvec3(), 3)).collect();
    let config =
        FusionConfig { stride: 8, max_reprojection_px: 3.0, max_normal_deg: 60.0, ..FusionConfig::default() };
    let report = match fuse(&views, &config) {
        Ok((_, report)) => report,
        Err(ProbeError::NoConsistentPoints(report)) => *report,
        Err(error) => panic!("{error}"),
    };
    assert_eq!(report.pixels, 200);
}
