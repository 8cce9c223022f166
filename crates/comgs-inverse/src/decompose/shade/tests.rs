use super::*;
use comgs_geom::octahedral::{texel_direction, texel_solid_angle};
use comgs_probe::ProbeConfig;

/// Light with a bright spot, different in every channel.
fn light(size: usize) -> OctahedralLight {
    let mut rng = Rng::new(5);
    let mut texels: Vec<f32> = (0..3 * size * size).map(|_| rng.range(0.2, 1.0)).collect();
    for c in 0..3 {
        texels[3 * (size * size / 3) + c] = 30.0;
    }
    OctahedralLight::from_texels(size, texels).expect("sound texels")
}

/// Two probes above the plane z = 0, whose textures hold random radiance and occlusion.
fn probes() -> ProbeSet {
    let mut rng = Rng::new(8);
    let resolution = 8;
    let texel =
        |rng: &mut Rng| [rng.range(0.0, 0.5), rng.range(0.0, 0.5), rng.range(0.0, 0.5), rng.range(0.1, 0.9)];
    ProbeSet {
        positions: vec![Vec3::new(0.0, 0.0, 0.1), Vec3::new(0.6, 0.0, 0.1)],
        normals: vec![Vec3::Z; 2],
        resolution,
        texels: (0..2 * resolution * resolution).map(|_| texel(&mut rng)).collect(),
        moments: vec![[1.0, 1.0]; 2 * resolution * resolution],
        spacing: 0.6,
        far_distance: 1.0,
    }
}

fn points() -> Vec<Point> {
    let materials = [
        Material { albedo: Vec3::new(0.6, 0.3, 0.1), roughness: 0.6, metallic: 0.1 },
        Material { albedo: Vec3::new(0.2, 0.5, 0.8), roughness: 0.35, metallic: 0.8 },
        Material { albedo: Vec3::splat(0.4), roughness: 0.9, metallic: 0.4 },
    ];
    let view = Vec3::new(0.3, -0.2, 0.8).normalize();
    let normals = [Vec3::Z, Vec3::new(0.2, 0.1, 0.9).normalize(), Vec3::new(-0.3, 0.0, 0.8).normalize()];
    (0..3)
        .map(|i| Point {
            position: Vec3::new(0.2 * i as f32, 0.1, 0.0),
            normal: normals[i],
            view,
            material: materials[i],
        })
        .collect()
}

/// f · n·l in f64, written again from the definition: the judge of the f32 kernel's value and slopes.
fn reflectance(p: &Point64, l: [f64; 3]) -> [f64; 3] {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (n_v, n_l) = (dot(p.normal, p.view), dot(p.normal, l));
    if n_v <= 0.0 || n_l <= 0.0 {
        return [0.0; 3];
    }
    let sum: [f64; 3] = std::array::from_fn(|k| p.view[k] + l[k]);
    let length = dot(sum, sum).sqrt();
    let h = sum.map(|v| v / length);
    let (n_h, v_h) = (dot(p.normal, h), dot(p.view, h));
    let a2 = p.roughness.powi(4);
    let spread = n_h * n_h * (a2 - 1.0) + 1.0;
    let d = a2 / (std::f64::consts::PI * spread * spread);
    let masking = (n_v * n_v * (1.0 - a2) + a2).sqrt();
    let shadowing = (n_l * n_l * (1.0 - a2) + a2).sqrt();
    let visibility = 0.5 / (n_l * masking + n_v * shadowing);
    std::array::from_fn(|c| {
        let f0 = 0.04 + p.metallic * (p.albedo[c] - 0.04);
        let f = f0 + (1.0 - f0) * (1.0 - v_h).powi(5);
        ((1.0 - p.metallic) * p.albedo[c] / std::f64::consts::PI + d * f * visibility) * n_l
    })
}

#[derive(Clone, Copy)]
struct Point64 {
    normal: [f64; 3],
    view: [f64; 3],
    albedo: [f64; 3],
    roughness: f64,
    metallic: f64,
}

impl Point64 {
    fn new(p: &Point) -> Self {
        let of = |v: Vec3| v.to_array().map(f64::from);
        Self {
            normal: of(p.normal),
            view: of(p.view),
            albedo: of(p.material.albedo),
            roughness: f64::from(p.material.roughness),
            metallic: f64::from(p.material.metallic),
        }
    }
}

/// Radiance of the samples that were drawn, for another surface, in f64.
fn replay(shaded: &Shaded, i: usize, p: &Point64) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for s in &shaded.samples[i * shaded.stride..][..shaded.counts[i] as usize] {
        let f = reflectance(p, s.direction.to_array().map(f64::from));
        for c in 0..3 {
            sum[c] += f64::from(s.scale) * f[c] * f64::from(s.incoming[c]);
        }
    }
    sum
}

/// Goal: the mean over many rotations is the integral of Eq. 6, by brute force over the sphere in f64, for matte and polished
/// surfaces; without probes, and with probes that occlude and shine.
#[test]
fn shading_is_unbiased() {
    let light = light(32);
    let set = probes();
    let config = ProbeConfig { visibility: comgs_probe::VisibilityWeight::None, ..ProbeConfig::default() };
    let (index, lookup) = (set.index(&config), LookupConfig::new(&set, &config));
    let points = points();
    for incident in [Incident::Open, Incident::Probes { set: &set, index: &index, lookup: &lookup }] {
        let mut mean = vec![Vec3::ZERO; points.len()];
        let rounds = 400;
        for seed in 0..rounds {
            let proposal = Proposal::new(&light, seed);
            let lighting = Lighting { light: &light, proposal: &proposal, incident, rays: 64, seed };
            let mut shaded = Shaded::default();
            shade(&points, &lighting, &mut shaded);
            for (m, r) in mean.iter_mut().zip(&shaded.radiance) {
                *m += *r / rounds as f32;
            }
        }
        let n = 384;
        for (point, mean) in points.iter().zip(mean) {
            let p = Point64::new(point);
            let mut truth = [0.0f64; 3];
            for t in 0..n * n {
                let direction = texel_direction(t % n, t / n, n);
                let omega = f64::from(texel_solid_angle(t % n, t / n, n));
                let f = reflectance(&p, direction.to_array().map(f64::from));
                let direct = light.radiance(direction);
                let [r, g, b, o] = match incident {
                    Incident::Probes { .. } => {
                        let near = index.query(point.position, point.normal, &set, &lookup);
                        set.lookup(&near, direction)
                    }
                    _ => [0.0; 4],
                };
                for (c, own) in [r, g, b].into_iter().enumerate() {
                    truth[c] += omega * f[c] * f64::from((1.0 - o) * direct[c] + own);
                }
            }
            for c in 0..3 {
                // 25,600 samples in all, stratified: half a per cent of noise.
                let relative = f64::from(mean[c]) / truth[c] - 1.0;
                assert!(relative.abs() < 0.015, "channel {c}: {} {}", mean[c], truth[c]);
            }
        }
    }
}

/// Goal: the gradients with respect to albedo, roughness, metallic and normal are those of the samples' sum, by central
/// differences of the f64 reference; none is zero.
#[test]
fn surface_gradients() {
    let light = light(32);
    let proposal = Proposal::new(&light, 1);
    let points = points();
    let lighting =
        Lighting { light: &light, proposal: &proposal, incident: Incident::Open, rays: 64, seed: 3 };
    let mut shaded = Shaded::default();
    shade(&points, &lighting, &mut shaded);
    let up = [Vec3::new(0.7, -0.4, 0.9), Vec3::new(0.2, 1.0, -0.3), Vec3::new(-0.5, 0.6, 0.8)];
    let mut grad_light = vec![0.0; light.texels().len()];
    let grads = shade_vjp(&points, &lighting, &shaded, &up, &mut grad_light, None);
    for i in 0..points.len() {
        let p = Point64::new(&points[i]);
        let value = |p: &Point64| {
            let r = replay(&shaded, i, p);
            (0..3).map(|c| r[c] * f64::from(up[i][c])).sum::<f64>()
        };
        let check = |name: &str, got: f32, change: &dyn Fn(&mut Point64, f64)| {
            let step = 1e-5;
            let (mut a, mut b) = (p, p);
            change(&mut a, step);
            change(&mut b, -step);
            let slope = (value(&a) - value(&b)) / (2.0 * step);
            // f32 sums over 64 samples of a highlight.
            let error = (f64::from(got) - slope).abs();
            assert!(error < 2e-3 * slope.abs().max(0.05), "{i} {name}: {got} {slope}");
        };
        // The normal moves on the sphere; what the kernel's formula gives along it is for the normalisation to drop.
        let n = points[i].normal;
        let across = grads[i].normal - n * n.dot(grads[i].normal);
        for c in 0..3 {
            check("albedo", grads[i].albedo[c], &|p, d| p.albedo[c] += d);
            check("normal", across[c], &|p, d| {
                p.normal[c] += d;
                let length = p.normal.iter().map(|v| v * v).sum::<f64>().sqrt();
                p.normal = p.normal.map(|v| v / length);
            });
        }
        let g = grads[i];
        assert!(
            g.albedo.min_element() != 0.0 && g.roughness != 0.0 && g.metallic != 0.0 && across.length() > 0.0
        );
        check("roughness", grads[i].roughness, &|p, d| p.roughness += d);
        check("metallic", grads[i].metallic, &|p, d| p.metallic += d);
    }
}

/// Goal: radiance is linear in the light's texels and in the probes' textures given the other, so the gradients must give the
/// exact difference for any change: ⟨∂, δ⟩ = change of ⟨up, L_o⟩ with the same samples.
#[test]
fn light_and_probe_gradients() {
    let light = light(32);
    let set = probes();
    let config = ProbeConfig { visibility: comgs_probe::VisibilityWeight::None, ..ProbeConfig::default() };
    let (index, lookup) = (set.index(&config), LookupConfig::new(&set, &config));
    let incident = Incident::Probes { set: &set, index: &index, lookup: &lookup };
    // Drawn from another light: the pool's radiances are looked up there, so the table must be the light's own.
    let proposal = Proposal::new(&light, 1);
    let points = points();
    let lighting = Lighting { light: &light, proposal: &proposal, incident, rays: 64, seed: 3 };
    let mut shaded = Shaded::default();
    shade(&points, &lighting, &mut shaded);
    let up = [Vec3::new(0.7, -0.4, 0.9), Vec3::new(0.2, 1.0, -0.3), Vec3::new(-0.5, 0.6, 0.8)];
    let mut grad_light = vec![0.0; light.texels().len()];
    let mut grad_probes = vec![[0.0; 4]; set.texels.len()];
    let _ = shade_vjp(&points, &lighting, &shaded, &up, &mut grad_light, Some(&mut grad_probes));
    // The sum over the samples again, with other incident light.
    let value = |light: &OctahedralLight, set: &ProbeSet| -> f64 {
        let mut sum = 0.0;
        for (i, point) in points.iter().enumerate() {
            let p = Point64::new(point);
            for s in &shaded.samples[i * shaded.stride..][..shaded.counts[i] as usize] {
                let f = reflectance(&p, s.direction.to_array().map(f64::from));
                let [r, g, b, o] = set.lookup(&shaded.neighbours[i], s.direction).map(f64::from);
                let direct = light.radiance(s.direction);
                for (c, own) in [r, g, b].into_iter().enumerate() {
                    let incoming = (1.0 - o) * f64::from(direct[c]) + own;
                    sum += f64::from(up[i][c] * s.scale) * f[c] * incoming;
                }
            }
        }
        sum
    };
    let base = value(&light, &set);
    let mut rng = Rng::new(11);
    let change: Vec<f32> = light.texels().iter().map(|_| rng.range(0.0, 0.1)).collect();
    let moved = light.texels().iter().zip(&change).map(|(t, d)| t + d).collect();
    let moved = OctahedralLight::from_texels(light.size(), moved).expect("sound texels");
    let expected: f64 = grad_light.iter().zip(&change).map(|(g, d)| f64::from(g * d)).sum();
    let got = value(&moved, &set) - base;
    assert!(expected.abs() > 1e-3 && (expected / got - 1.0).abs() < 2e-3, "light {expected} {got}");

    let mut other = set.clone();
    let mut expected = 0.0f64;
    for (texel, g) in other.texels.iter_mut().zip(&grad_probes) {
        for k in 0..4 {
            let d = rng.range(-0.05, 0.05);
            texel[k] += d;
            expected += f64::from(d * g[k]);
        }
    }
    let got = value(&light, &other) - base;
    assert!(expected.abs() > 1e-3 && (expected / got - 1.0).abs() < 5e-3, "probes {expected} {got}");
}

/// Goal (hard case 29): same seed, same picture, at one thread and at two; another seed, another noise.
#[test]
fn same_seed_same_bytes() {
    let light = light(32);
    let proposal = Proposal::new(&light, 1);
    let points: Vec<Point> = (0..200).flat_map(|_| points()).collect();
    let up = vec![Vec3::new(0.3, 0.2, 0.1); points.len()];
    let run = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let lighting =
                Lighting { light: &light, proposal: &proposal, incident: Incident::Open, rays: 32, seed };
            let mut shaded = Shaded::default();
            shade(&points, &lighting, &mut shaded);
            let mut grad_light = vec![0.0; light.texels().len()];
            let grads = shade_vjp(&points, &lighting, &shaded, &up, &mut grad_light, None);
            (shaded.radiance, grads, grad_light)
        })
    };
    let one = run(1, 4);
    assert!(one == run(2, 4));
    assert!(one.0 != run(2, 5).0);
}
