use comgs_geom::{Rng, octahedral, sampling};
use comgs_image::Image;
use comgs_light::*;
use glam::{Vec2, Vec3};
use std::time::Instant;
fn t(name: &str, n: usize, mut f: impl FnMut() -> f32) {
    let mut best = f64::MAX;
    let mut s = 0.0;
    for _ in 0..5 {
        let a = Instant::now();
        s = f();
        best = best.min(a.elapsed().as_secs_f64());
    }
    println!("{name}: {:.2} ns each ({:.3} ms), {s}", best * 1e9 / n as f64, best * 1e3);
}
#[test]
fn speed() {
    let mut rng = Rng::new(1);
    let n = 100_000;
    let ds: Vec<Vec3> =
        (0..n).map(|_| Vec3::new(rng.normal(), rng.normal(), rng.normal()).normalize()).collect();
    let us: Vec<Vec2> = (0..n).map(|_| Vec2::new(rng.uniform(), rng.uniform())).collect();
    for size in [16usize, 256] {
        let map: Vec<f32> = (0..size * size * 3).map(|_| rng.uniform()).collect();
        let light = OctahedralLight::from_texels(size, map.clone()).unwrap();
        t(&format!("footprint {size}"), n, || {
            ds.iter().map(|&d| octahedral::footprint(d, size).weights[0]).sum()
        });
        t(&format!("gather {size}"), n, || {
            ds.iter().map(|&d| octahedral::footprint(d, size).gather(&map)).sum()
        });
        t(&format!("footprint_vjp {size}"), n, || {
            ds.iter().map(|&d| octahedral::footprint_vjp(d, size, [0.1, 0.2, 0.3, 0.4]).x).sum()
        });
        t(&format!("radiance {size}"), n, || ds.iter().map(|&d| light.radiance(d).x).sum());
        let mut g = vec![0.0; map.len()];
        t(&format!("radiance_vjp {size}"), n, || {
            ds.iter().for_each(|&d| light.radiance_vjp(d, Vec3::ONE, &mut g));
            g[0]
        });
        let s = OctahedralSampler::new(&light, Importance::Exact);
        t(&format!("sample {size}"), n, || us.iter().map(|&u| s.sample(u).pdf).sum());
        t(&format!("pdf {size}"), n, || ds.iter().map(|&d| s.pdf(d)).sum());
        t(&format!("sampler::new {size}"), 1, || {
            OctahedralSampler::new(&light, Importance::Exact).pdf(Vec3::X)
        });
        let p = LightPyramid::constant(size, Vec3::ONE);
        t(&format!("to_light {size}"), 1, || p.to_light().texels()[3]);
        let l = p.to_light();
        let mut gl: Vec<Vec<f32>> = p.levels.iter().map(|l| vec![0.0; l.len()]).collect();
        t(&format!("pyramid vjp {size}"), 1, || {
            p.vjp(&l, &map, &mut gl);
            gl[0][0]
        });
        t(&format!("integral {size}"), 1, || light.integral().x);
        t(&format!("solid_angles {size}"), 1, || octahedral::solid_angles(size)[0]);
    }
    let env = EnvironmentMap::from_image(&Image::filled(1024, 512, 3, 1.0)).unwrap();
    t("from_environment 256", 1, || OctahedralLight::from_environment(&env, 256).texel(3).x);
    t("from_environment 512", 1, || OctahedralLight::from_environment(&env, 512).texel(3).x);
    let l = OctahedralLight::constant(256, Vec3::ONE);
    t("to_environment 256", 1, || l.to_environment(256).mean().x);
    for n_lights in [128usize] {
        let m = Material { albedo: Vec3::new(0.8, 0.3, 0.1), roughness: 0.4, metallic: 0.2 };
        let lights: Vec<Vec3> = (0..n_lights)
            .map(|i| sampling::cosine_hemisphere(sampling::hammersley(i as u32, 128, Vec2::ZERO)))
            .collect();
        let px = 2000;
        let sh: Vec<Shading> = (0..px)
            .map(|i| {
                Shading::new(
                    m,
                    (Vec3::Z + 0.5 * ds[i]).normalize(),
                    (Vec3::Z + 0.5 * ds[i + 5000]).normalize(),
                )
            })
            .collect();
        t("brdf eval", px * n_lights, || {
            sh.iter().map(|s| lights.iter().map(|&l| s.eval_cosine(l).x).sum::<f32>()).sum()
        });
        t("brdf vjp", px * n_lights, || {
            sh.iter()
                .map(|s| {
                    let mut g = MaterialGradient::default();
                    lights.iter().for_each(|&l| s.vjp(l, Vec3::ONE, &mut g));
                    g.roughness
                })
                .sum()
        });
        t("brdf reflect+accumulate", px * n_lights, || {
            sh.iter()
                .map(|s| {
                    let mut g = MaterialGradient::default();
                    let mut v = Vec3::ZERO;
                    lights.iter().for_each(|&l| {
                        if let Some(r) = s.reflect(l) {
                            v += r.value();
                            s.accumulate(&r, Vec3::ONE, &mut g)
                        }
                    });
                    g.roughness + v.x
                })
                .sum()
        });
        t("brdf sample", n, || {
            us.iter().enumerate().map(|(i, &u)| sh[i % px].sample(u.x, u).map_or(0.0, |d| d.x)).sum()
        });
        t("brdf pdf", px * n_lights, || {
            sh.iter().map(|s| lights.iter().map(|&l| s.pdf(l)).sum::<f32>()).sum()
        });
        t("Shading::new", n, || {
            us.iter()
                .enumerate()
                .map(|(i, &u)| {
                    Shading::new(Material { roughness: u.x, ..m }, ds[i], ds[(i + 7) % n]).pdf(Vec3::Z)
                })
                .sum()
        });
    }
}
