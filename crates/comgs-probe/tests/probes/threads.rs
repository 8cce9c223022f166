//! The same bytes at any thread count.

use crate::round::{ball, fibonacci};
use crate::support::{empty, tracer};
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_probe::{
    BakeObserver, DepthView, FusionConfig, LookupConfig, ProbeConfig, bake, fuse, place, to_bytes,
};
use glam::{DVec3, Vec3};

/// Depth and normals of the traced cloud, as a camera sees them.
fn view(tracer: &comgs_trace::Tracer, eye: Vec3) -> DepthView {
    let camera = Camera::look_at("ball", 64, 64, 0.7, eye.as_dvec3(), DVec3::ZERO, DVec3::Z);
    let (mut depth, mut normal) = (Image::zeros(64, 64, 1), Image::zeros(64, 64, 3));
    for y in 0..64 {
        for x in 0..64 {
            // Rays with z = 1 in the camera, so that t is the z-depth.
            let ray = camera.ray_world(x as f64 + 0.5, y as f64 + 0.5).as_vec3();
            let hit = tracer.radiance(eye, ray, 0.0, f32::INFINITY);
            if hit.alpha > 0.9 {
                depth.pixel_mut(x, y)[0] = hit.depth / hit.alpha;
                normal.pixel_mut(x, y).copy_from_slice(&hit.normal.to_array());
            }
        }
    }
    DepthView { camera, depth, normal }
}

/// Goal: from depth maps to gradients, one thread and several give the same bytes: fusion, placement, baking, queries,
/// blending and its gradient.
#[test]
fn one_thread_or_many() {
    let mut cloud = empty();
    ball(&mut cloud, Vec3::ZERO, 0.5, 3000, Vec3::new(0.9, 0.5, 0.2));
    ball(&mut cloud, Vec3::new(0.0, 0.0, 0.7), 0.25, 1000, Vec3::new(0.1, 0.5, 0.9));
    let tracer = tracer(&cloud);
    let views: Vec<DepthView> = fibonacci(30).iter().map(|d| view(&tracer, 2.5 * *d)).collect();
    let run = || {
        let (points, report) = fuse(&views, &FusionConfig { stride: 2, ..FusionConfig::default() }).unwrap();
        let config = ProbeConfig { count: 300, ..ProbeConfig::default() };
        let mut set = place(&points, &config, 1.2).unwrap();
        bake(&tracer, &mut set, 2, BakeObserver::silent()).unwrap();
        let index = set.index(&config);
        let lookup = LookupConfig::new(&set, &config);
        let neighbours = index.query_batch(&points.positions[..500], &points.normals[..500], &set, &lookup);
        let texture = set.texture_len();
        let mut blended = vec![[0.0; 4]; neighbours.len() * texture];
        for (n, out) in neighbours.iter().zip(blended.chunks_exact_mut(texture)) {
            set.blend(n, out);
        }
        let mut grad = vec![[0.0; 4]; set.texels.len()];
        set.blend_vjp(&neighbours, &blended, &mut grad);
        (to_bytes(&set, &config).unwrap(), report, neighbours, grad)
    };
    let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    let one = pool(1).install(run);
    assert!(one.3.iter().any(|g| *g != [0.0; 4]) && one.1.points() > 500);
    for threads in [2, 5] {
        assert_eq!(pool(threads).install(run), one, "{threads} threads");
    }
}
