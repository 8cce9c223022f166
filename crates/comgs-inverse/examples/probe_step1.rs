//! Scratch.
use comgs_image::{Image, write_png};
use comgs_inverse::{Kind, Observer, Quality, TrainConfig, TrainStatus, TrainView, train};
use comgs_raster::{Planes, RasterConfig, render};
use comgs_scene::{Capture, LoadOptions, Split, View};
use glam::{DVec3, Vec3};
use std::path::Path;
use std::time::{Duration, Instant};

struct Log(Instant);
impl Observer for Log {
    fn progress(&mut self, s: &TrainStatus) {
        if self.0.elapsed() > Duration::from_secs(15) {
            self.0 = Instant::now();
            println!("{:6.1} s {:5}/{} {:.2} dB {} surfels", s.elapsed_s, s.iteration, s.iterations, s.psnr_db, s.surfels);
        }
    }
}
fn to_train(view: View) -> TrainView {
    TrainView {
        hdr: view.encoding == comgs_image::Encoding::Linear,
        camera: view.camera,
        color: view.color,
        mask: view.alpha,
        valid: view.valid,
    }
}
fn blur3(img: &Image, sigma: f32) -> Image {
    let r = (3.0 * sigma).ceil() as isize;
    let w: Vec<f32> = (-r..=r).map(|i| (-(i * i) as f32 / (2.0 * sigma * sigma)).exp()).collect();
    let (wd, h, c) = (img.width as isize, img.height as isize, img.channels);
    let pass = |src: &Image, dx: isize, dy: isize| {
        let mut out = Image::zeros(src.width, src.height, c);
        for y in 0..h {
            for x in 0..wd {
                for (k, i) in (-r..=r).enumerate() {
                    let (xx, yy) = (x + i * dx, y + i * dy);
                    if xx >= 0 && yy >= 0 && xx < wd && yy < h {
                        for q in 0..c {
                            out.data[((y * wd + x) as usize) * c + q] += w[k] * src.data[((yy * wd + xx) as usize) * c + q];
                        }
                    }
                }
            }
        }
        out
    };
    pass(&pass(img, 1, 0), 0, 1)
}
fn angle(a: Vec3, b: Vec3) -> f32 {
    (a.dot(b) / (a.length() * b.length()).max(1e-9)).clamp(-1.0, 1.0).acos().to_degrees()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (capture, kind, out) = (&arguments[0], &arguments[1], Path::new(&arguments[2]));
    let kind = if kind == "object" { Kind::Object } else { Kind::Scene };
    let mut config = serde_json::to_value(TrainConfig::preset(kind, Quality::Balanced)).unwrap();
    let mut loaded = None;
    for pair in &arguments[3..] {
        let (key, value) = pair.split_once('=').expect("key=value");
        if key == "load" {
            loaded = Some(value.to_owned());
            continue;
        }
        assert!(config.get(key).is_some(), "no key {key}");
        config[key] = if key == "time_budget" {
            serde_json::to_value(Duration::from_secs_f64(value.parse().unwrap())).unwrap()
        } else {
            serde_json::from_str(value).expect("a number")
        };
    }
    if let Some(n) = config["iterations"].as_u64() {
        if !arguments.iter().any(|a| a.starts_with("density_interval")) {
            config["density_interval"] = ((n / 24).max(50)).into();
        }
        if let Some(m) = config["max_surfels"].as_u64()
            && !arguments.iter().any(|a| a.starts_with("initial_surfels"))
        {
            config["initial_surfels"] = (m * 6 / 10).into();
        }
    }
    let config: TrainConfig = serde_json::from_value(config).unwrap();
    let load = |split| Capture::open(capture, split).and_then(|c| c.load(&LoadOptions::default()));
    let views: Vec<TrainView> = load(Split::Train).unwrap().into_iter().map(to_train).collect();
    let trained = if let Some(p) = &loaded {
        let (cloud, _) = comgs_surfel::ply::read_surfels(Path::new(p)).unwrap();
        let cams: Vec<_> = views.iter().map(|v| &v.camera).collect();
        let near = comgs_inverse::train::near_plane(&comgs_inverse::view::Rig::new(&cams).unwrap());
        comgs_inverse::Trained { cloud, report: comgs_inverse::TrainReport { near, ..Default::default() } }
    } else {
        train(&views, None, &config, None, &mut Log(Instant::now())).unwrap()
    };
    std::fs::create_dir_all(out).unwrap();
    if loaded.is_none() {
        comgs_surfel::ply::write_surfels(&out.join("cloud.ply"), &trained.cloud, comgs_surfel::ply::PlyStyle::Asset).unwrap();
    }
    {
        let mut s: Vec<(f32, f32)> = (0..trained.cloud.len()).map(|i| {
            let l = trained.cloud.log_scales[i].map(f32::exp);
            (l[0].max(l[1]), l[0] * l[1])
        }).collect();
        s.sort_by(|a, b| a.0.total_cmp(&b.0));
        let area: f32 = s.iter().map(|x| x.1).sum();
        let mut acc = 0.0; let mut next = 0.1;
        print!("max sigma, area-weighted deciles:");
        for x in &s { acc += x.1; if acc >= next * area { print!(" {:.4}", x.0); next += 0.2; } }
        println!("; unweighted median {:.4}, 6 pi area {:.2}", s[s.len() / 2].0, area * 6.28);
    }
    let r = &trained.report;
    std::fs::create_dir_all(out).unwrap();
    let mut op: Vec<f32> = trained.cloud.opacity_logits.iter().map(|l| 1.0 / (1.0 + (-l).exp())).collect();
    op.sort_by(f32::total_cmp);
    let q = |f: f64| op[((op.len() - 1) as f64 * f) as usize];
    println!("steps {} init {:.1}s total {:.1}s surfels {} train {:.2} dB; opacity deciles {:.2} {:.2} {:.2} {:.2} {:.2}", r.iterations, r.init_seconds, r.seconds, r.surfels, r.train_psnr_db, q(0.1), q(0.3), q(0.5), q(0.7), q(0.9));

    let raster = RasterConfig { near: trained.report.near, order: if std::env::var("CENTRE").is_ok() { comgs_raster::Order::Centre } else { comgs_raster::Order::Sheet }, ..Default::default() };
    let (mut psnr, mut ssim, mut count) = (0.0, 0.0, 0.0);
    let mut bias = [[0.0f64; 4]; 6];
    let mut all_nd = vec![];
    let mut own = [[0.0f64; 5]; 6];
    let (mut all, mut all_d, mut all_b, mut all_z) = (vec![], vec![], vec![], vec![]);
    for view in load(Split::Test).unwrap() {
        let view = to_train(view);
        let frame = render(&trained.cloud, &view.camera, Planes::GEOMETRY, &raster);
        let color = frame.color.as_ref().unwrap();
        let mut truth = view.color.clone();
        if let Some(mask) = &view.mask {
            truth.data.chunks_exact_mut(3).zip(&mask.data).for_each(|(p, m)| p.iter_mut().for_each(|v| *v *= m));
        }
        psnr += comgs_metrics::psnr_srgb(color, &truth, None).unwrap().db;
        ssim += comgs_metrics::ssim(color, &truth, comgs_metrics::Border::Valid, None).unwrap().mean;
        count += 1.0;
        let (w, h) = (color.width, color.height);
        let normal = frame.normal.as_ref().unwrap();
        let blurred = blur3(normal, 2.0);
        let z = frame.unbiased_depth(0.3);
        let path = Path::new(capture).join(format!("test/normal/{}.exr", view.camera.name));
        let zpath = Path::new(capture).join(format!("test/depth/{}.exr", view.camera.name));
        let (Ok(gt), Some(mask)) = (comgs_image::read(&path), &view.mask) else { continue };
        let gz = comgs_image::read(&zpath).ok();
        if let Some(gz) = &gz {
            for i in 0..trained.cloud.len() {
                let p = Vec3::from_array(trained.cloud.positions[i]).as_dvec3();
                let Some((q, zc)) = view.camera.project(p) else { continue };
                if !(q.x >= 0.0 && q.y >= 0.0 && q.x < w as f64 && q.y < h as f64) { continue }
                let j = q.y as usize * w + q.x as usize;
                if mask.data[j] <= 0.99 { continue }
                let g = f64::from(gz.color.data[gz.color.channels * j]);
                if g <= 0.0 { continue }
                let t = Vec3::from_slice(&gt.color.data[3 * j..3 * j + 3]);
                let back = -view.camera.ray_world(q.x, q.y).as_vec3();
                let tilt = angle(t, back);
                let hgt = (zc - g) * f64::from(tilt.to_radians().cos());
                if tilt > 75.0 || hgt.abs() > 0.05 { continue }
                let mut n = trained.cloud.rotation(i).z_axis;
                if n.dot(back) < 0.0 { n = -n; }
                let bin = ((tilt / 15.0) as usize).min(5);
                own[bin][0] += 1.0;
                own[bin][1] += f64::from(tilt - angle(n, back));
                own[bin][2] += hgt;
                own[bin][3] += hgt * hgt;
                own[bin][4] += f64::from(angle(n, t));
            }
        }
        let shown = normal.map(|v| (0.5 * v + 0.5).clamp(0.0, 1.0).powf(2.2));
        let mut heat = Image::zeros(w, h, 3);
        let at = |x: usize, y: usize| {
            let d = view.camera.ray_world(x as f64 + 0.5, y as f64 + 0.5);
            d * f64::from(z.data[y * w + x])
        };
        for y in 1..h - 1 {
            for x in 1..w - 1 {
                let i = y * w + x;
                let t = Vec3::from_slice(&gt.color.data[3 * i..3 * i + 3]);
                let n = Vec3::from_slice(&normal.data[3 * i..3 * i + 3]);
                if mask.data[i] <= 0.99 || n.length() <= 0.1 || t.length() <= 0.5 {
                    continue;
                }
                let e = angle(n, t);
                let back = -view.camera.ray_world(x as f64 + 0.5, y as f64 + 0.5).as_vec3();
                let tilt = angle(t, back);
                let bin = ((tilt / 15.0) as usize).min(5);
                bias[bin][0] += 1.0;
                bias[bin][1] += f64::from(tilt - angle(n, back));
                all.push(e);
                all_b.push(angle(Vec3::from_slice(&blurred.data[3 * i..3 * i + 3]), t));
                if let Some(g) = &gz {
                    let g = g.color.data[g.color.channels * i];
                    if g > 0.0 { all_z.push((z.data[i] - g).abs()); }
                }
                if [i - 1, i + 1, i - w, i + w].iter().all(|&j| z.data[j] > 0.0) {
                    let a: DVec3 = at(x + 1, y) - at(x - 1, y);
                    let b: DVec3 = at(x, y + 1) - at(x, y - 1);
                    let nd = b.cross(a).as_vec3();
                    all_d.push(angle(nd, t));
                    all_nd.push(angle(nd, n));
                    bias[bin][2] += f64::from(tilt - angle(nd, back));
                    bias[bin][3] += 1.0;
                }
                let v = (e / 30.0).min(1.0).powf(2.2);
                heat.pixel_mut(x, y).copy_from_slice(&[v, v, v]);
            }
        }
        let gshown = gt.color.map(|v| (0.5 * v + 0.5).clamp(0.0, 1.0).powf(2.2));
        let mut both = Image::zeros(5 * w, h, 3);
        for y in 0..h {
            for x in 0..w {
                for (k, image) in [color, &truth, &shown, &gshown, &heat].into_iter().enumerate() {
                    both.pixel_mut(k * w + x, y).copy_from_slice(&image.pixel(x, y)[..3]);
                }
            }
        }
        write_png(&out.join(format!("{}.png", view.camera.name)), &both).unwrap();
    }
    let stat = |name: &str, v: &mut Vec<f32>| {
        if v.is_empty() { return; }
        v.sort_by(f32::total_cmp);
        let mean = v.iter().map(|x| f64::from(*x)).sum::<f64>() / v.len() as f64;
        let q = |f: f64| v[((v.len() - 1) as f64 * f) as usize];
        println!("{name}: mean {mean:.4} median {:.4} p90 {:.4} p99 {:.4}", q(0.5), q(0.9), q(0.99));
    };
    println!("PSNR {:.2} SSIM {:.4}", psnr / count, ssim / count);
    stat("normal", &mut all);
    stat("normal blurred", &mut all_b);
    stat("depth normal", &mut all_d);
    stat("depth", &mut all_z);
    stat("normal to depth normal", &mut all_nd);
    print!("surfels by tilt (bias, height mean, height sd, angle):");
    for b in own { print!("  {:.2} {:.4} {:.4} {:.2}", b[1] / b[0], b[2] / b[0], (b[3] / b[0] - (b[2] / b[0]).powi(2)).sqrt(), b[4] / b[0]); }
    println!();
    print!("bias towards viewer by tilt/15 (N, N_d):");
    for b in bias { print!("  {:.2} {:.2}", b[1] / b[0], b[2] / b[3].max(1.0)); }
    println!();
}
