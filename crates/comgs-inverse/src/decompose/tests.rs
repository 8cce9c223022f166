use super::*;

/// Goal: the bent normal faces the eye (hard case 27), is the normal itself where that faces it already, and its gradient
/// agrees with central differences on both sides of the bend.
#[test]
fn shading_normal_faces_the_eye() {
    let view = Vec3::new(0.1, -0.3, 0.9).normalize();
    let up = Vec3::new(0.4, 0.7, -0.2);
    for sum in [Vec3::new(0.3, 0.2, 0.5), Vec3::new(0.8, 0.1, -0.3), Vec3::new(0.6, 0.2, 0.02)] {
        let n = shading_normal(sum, view).expect("a direction");
        assert!(n.dot(view) > 0.0 && (n.length() - 1.0).abs() < 1e-5);
        if sum.normalize().dot(view) > LEAST_FACING {
            assert!((n - sum.normalize()).length() < 1e-6);
        }
        let g = shading_normal_vjp(sum, view, up);
        for k in 0..3 {
            let step = 2e-3;
            let mut d = Vec3::ZERO;
            d[k] = step;
            let value = |s: Vec3| shading_normal(s, view).expect("a direction").dot(up);
            let slope = (value(sum + d) - value(sum - d)) / (2.0 * step);
            assert!((g[k] - slope).abs() < 5e-3 * (1.0 + slope.abs()), "{sum} {k}: {} {slope}", g[k]);
        }
        assert!(g.length() > 0.0);
    }
    assert!(shading_normal(Vec3::ZERO, view).is_none());
}
