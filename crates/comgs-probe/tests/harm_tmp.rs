mod support;
use comgs_probe::*;
use support::*;
use glam::Vec3;
#[test]
fn harm() {
    for sign in [1.0f32, -1.0] { for count in [300, 1000, 5000] { for rays in [1usize, 4] {
        let mut cloud = empty();
        ball(&mut cloud, Vec3::ZERO, 0.5, 20000, Vec3::ONE);
        let tracer = tracer(&cloud);
        let dirs = fibonacci(40000);
        let points = OrientedPoints { positions: dirs.iter().map(|d| 0.5 * *d).collect(), normals: dirs.iter().map(|d| sign * *d).collect() };
        for (far, dev, bias) in [(1.5,0.1,0.2),(1.5,0.1,0.1),(1.5,0.1,0.0),(1.5,0.3,0.2),(1.05,0.1,0.2),(3.0,0.1,0.2),(1.5,0.1,0.5)] {
        let config = ProbeConfig { count, far, ..ProbeConfig::default() };
        let set = baked(&points, &tracer, &config, 1.0, rays);
        let index = set.index(&config);
        let lc = LookupConfig { min_deviation: dev*set.spacing, normal_bias: bias*set.spacing, ..LookupConfig::new(&set, &config) };
        let plain = LookupConfig { visibility: VisibilityWeight::None, ..lc.clone() };
        let mut lost = [0.0f32;3]; let mut n = 0.0;
        for d in fibonacci(1777) {
            let (x, normal) = (0.5 * d, sign * d);
            let a = index.query(x, normal, &set, &lc);
            let b = index.query(x, normal, &set, &plain);
            let v: Vec<f32> = (0..a.count as usize).map(|k| a.weights[k] / b.weights[k]).collect();
            let most = v.iter().fold(0.0f32, |a, b| a.max(*b));
            for v in v { n += 1.0; if v < 0.9 * most { lost[0] += 1.0 } if v < 0.5*most { lost[1] += 1.0 } if v < 0.1*most { lost[2] += 1.0 } }
        }
        println!("sign {sign} count {count} rays {rays} far {far} dev {dev} bias {bias}: spacing {:.4} lost<.9 {:.4} <.5 {:.4} <.1 {:.4}", set.spacing, lost[0]/n, lost[1]/n, lost[2]/n);
        if count==5000 { break; }
        }
    }}}
}
