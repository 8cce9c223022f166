//! Decomposes a reconstructed object and scores normals, albedo and relighting, for trying settings without the command
//! line: `cargo run --release -p comgs-inverse --example decompose -- ASSET CAPTURE RELIT OUT [key=value …]`, where a key
//! is a field of `DecomposeConfig`. ASSET is made by `comgs reconstruct`; RELIT is a folder `object_relit/NAME`.

use comgs_image::{Image, write_png};
use comgs_inverse::decompose::proposal::Proposal;
use comgs_inverse::decompose::shade::{Incident, Lighting, Shaded, shade};
use comgs_inverse::decompose::{self, DecomposeConfig, shading_points};
use comgs_inverse::{Decomposed, Observer, TrainStatus, TrainView};
use comgs_light::{EnvironmentMap, OctahedralLight};
use comgs_probe::LookupConfig;
use comgs_raster::{Planes, RasterConfig, render, surface_normals};
use comgs_scene::{Asset, Capture, LoadOptions, Split, View};
use glam::Vec3;
use std::path::Path;
use std::time::{Duration, Instant};

struct Log(Instant);

impl Observer for Log {
    fn progress(&mut self, s: &TrainStatus) {
        if self.0.elapsed() > Duration::from_secs(10) || s.iteration == 0 {
            self.0 = Instant::now();
            println!(
                "{:6.1} s  {:5}/{}  {:.2} dB  {:.0} s left  {}",
                s.elapsed_s, s.iteration, s.iterations, s.psnr_db, s.remaining_s, s.phase
            );
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

fn over_black(view: &TrainView) -> Image {
    let mut out = view.color.clone();
    if let Some(mask) = &view.mask {
        let pixels = out.data.chunks_exact_mut(3).zip(&mask.data);
        pixels.for_each(|(p, m)| p.iter_mut().for_each(|v| *v *= m));
    }
    out
}

/// The object under a light, its albedo multiplied by a factor a channel.
fn relit(
    d: &Decomposed,
    light: &OctahedralLight,
    camera: &comgs_geom::Camera,
    raster: &RasterConfig,
    factor: Vec3,
) -> Image {
    let frame = render(&d.cloud, camera, Planes::ALL, raster);
    let mut points = Vec::new();
    let pixels = shading_points(&frame, camera, &mut points);
    points.iter_mut().for_each(|p| p.material.albedo = (p.material.albedo * factor).min(Vec3::ONE));
    let config = decompose::probes::probe_config(&DecomposeConfig::default());
    let found = d.probes.as_ref().map(|set| (set, set.index(&config), LookupConfig::new(set, &config)));
    let incident = match &found {
        Some((set, index, lookup)) => Incident::Probes { set, index, lookup },
        None => Incident::Open,
    };
    let proposal = Proposal::new(light, 3);
    let mut shaded = Shaded::default();
    // Indirect light of the capture has no place under another light.
    let mut dark = found.as_ref().map(|(set, ..)| (*set).clone());
    if let Some(set) = &mut dark {
        set.texels.iter_mut().for_each(|t| t[..3].fill(0.0));
    }
    let incident = match (&dark, incident) {
        (Some(set), Incident::Probes { index, lookup, .. }) => Incident::Probes { set, index, lookup },
        (_, other) => other,
    };
    let lighting = Lighting { light, proposal: &proposal, incident, rays: 256, seed: 1 };
    shade(&points, &lighting, &mut shaded);
    let mut image = Image::zeros(camera.width, camera.height, 3);
    for (&i, radiance) in pixels.iter().zip(&shaded.radiance) {
        let i = i as usize;
        image.data[3 * i..3 * i + 3].copy_from_slice(&(*radiance * frame.weight.data[i]).to_array());
    }
    image
}

fn side_by_side(images: &[&Image]) -> Image {
    let (w, h) = (images[0].width, images[0].height);
    let mut out = Image::zeros(w * images.len(), h, 3);
    for (k, image) in images.iter().enumerate() {
        for y in 0..h {
            for x in 0..w {
                out.pixel_mut(k * w + x, y).copy_from_slice(&image.rgb(x, y));
            }
        }
    }
    out
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [asset, capture, relit_root, out] = std::array::from_fn(|i| Path::new(&arguments[i]));
    let mut config = serde_json::to_value(DecomposeConfig::default()).expect("plain values");
    for pair in &arguments[4..] {
        let (key, value) = pair.split_once('=').expect("key=value");
        assert!(config.get(key).is_some(), "{key} is no field of DecomposeConfig");
        config[key] = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    }
    let config: DecomposeConfig = serde_json::from_value(config).expect("fields of DecomposeConfig");
    let cloud = Asset::load(asset).expect("an asset").surfels;
    let load = |split| Capture::open(capture, split).and_then(|c| c.load(&LoadOptions::default()));
    let views: Vec<TrainView> = load(Split::Train).expect("capture").into_iter().map(to_train).collect();
    let made = comgs_inverse::decompose(&views, &cloud, &config, None, &mut Log(Instant::now()))
        .expect("decomposition");
    println!("{:#?}", made.report);
    let map = made.light.to_environment(256);
    write_png(&out.join("light.png"), map.image()).expect("a writable folder");

    let raster = RasterConfig { near: 0.02, ..Default::default() };
    let test: Vec<TrainView> = load(Split::Test).expect("test views").into_iter().map(to_train).collect();
    let plane = |folder: &str, name: &str| {
        comgs_image::read(&capture.join(format!("test/{folder}/{name}.exr"))).ok().map(|i| i.color)
    };
    // Albedo of all views, aligned by one least-squares factor a channel.
    let (mut cross, mut square) = ([0.0f64; 3], [0.0f64; 3]);
    let (mut normals, mut count) = (0.0f64, 0.0f64);
    let (mut rough, mut metal) = (0.0f64, 0.0f64);
    let mut albedos = Vec::new();
    for view in &test {
        let name = &view.camera.name;
        let frame = render(&made.cloud, &view.camera, Planes::ALL, &raster);
        let material = frame.material.as_ref().expect("material");
        let mask = view.mask.as_ref().expect("mask");
        let truth = plane("albedo", name).expect("albedo");
        let n_true = plane("normal", name).expect("normal");
        let (r_true, m_true) = (plane("roughness", name).expect("r"), plane("metallic", name).expect("m"));
        let normal = surface_normals(&frame, &view.camera).expect("normals");
        for i in 0..mask.data.len() {
            if mask.data[i] < 0.99 || frame.weight.data[i] < 0.5 {
                continue;
            }
            let w = frame.weight.data[i];
            for c in 0..3 {
                let (a, b) =
                    (f64::from(material.data[5 * i + c] / w), f64::from(truth.data[truth.channels * i + c]));
                cross[c] += a * b;
                square[c] += a * a;
            }
            let n = Vec3::from_slice(&normal.data[3 * i..]).normalize_or_zero();
            let t = Vec3::from_slice(&n_true.data[n_true.channels * i..]).normalize_or_zero();
            normals += f64::from(n.dot(t).clamp(-1.0, 1.0).acos().to_degrees());
            rough += f64::from((material.data[5 * i + 3] / w - r_true.data[r_true.channels * i]).abs());
            metal += f64::from((material.data[5 * i + 4] / w - m_true.data[m_true.channels * i]).abs());
            count += 1.0;
        }
        let mut over = truth.select(&[0, 1, 2]);
        over.data.chunks_exact_mut(3).zip(&mask.data).for_each(|(p, m)| p.iter_mut().for_each(|v| *v *= m));
        let mut other = Image::zeros(mask.width, mask.height, 3);
        for i in 0..mask.data.len() {
            let (r, m) = (material.data[5 * i + 3], material.data[5 * i + 4]);
            other.data[3 * i..3 * i + 3].copy_from_slice(&[r, m, 0.0]);
        }
        let mut rm = Image::zeros(mask.width, mask.height, 3);
        for i in 0..mask.data.len() {
            rm.data[3 * i] = r_true.data[r_true.channels * i] * mask.data[i];
            rm.data[3 * i + 1] = m_true.data[m_true.channels * i] * mask.data[i];
        }
        albedos.push((name.clone(), material.select(&[0, 1, 2]), over, other, rm));
    }
    let factor = Vec3::from_array(std::array::from_fn(|c| (cross[c] / square[c]) as f32));
    let (mut raw, mut aligned) = (0.0, 0.0);
    for (k, (name, mine, truth, other, rm)) in albedos.iter().enumerate() {
        let mut scaled = mine.clone();
        scaled.data.chunks_exact_mut(3).for_each(|p| (0..3).for_each(|c| p[c] *= factor[c]));
        raw += comgs_metrics::psnr_srgb(mine, truth, None).expect("sizes").db;
        aligned += comgs_metrics::psnr_srgb(&scaled, truth, None).expect("sizes").db;
        if k % 6 == 2 {
            let all = side_by_side(&[&scaled, truth, other, rm]);
            write_png(&out.join(format!("albedo_{name}.png")), &all).expect("a writable folder");
        }
    }
    let n = albedos.len() as f64;
    println!(
        "normal MAE {:.2}°  roughness MAE {:.3}  metallic MAE {:.3}",
        normals / count,
        rough / count,
        metal / count
    );
    println!("albedo {:.2} dB aligned (factor {factor:.3}), {:.2} dB unaligned", aligned / n, raw / n);
    let cameras = comgs_scene::read_cameras(relit_root.join("cameras.json")).expect("cameras");
    let mut all = Vec::new();
    for entry in std::fs::read_dir(relit_root).expect("relit root").flatten().filter(|e| e.path().is_dir()) {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = relit_root.parent().expect("a parent").join(format!("envmaps/{name}.exr"));
        let image = comgs_image::read(&path).expect("a map").color;
        let (map, _) = EnvironmentMap::from_image_repaired(&image).expect("a sound map");
        let light = OctahedralLight::from_environment(&map, 256);
        let (mut raw, mut aligned, mut ssim, mut n) = (0.0, 0.0, 0.0, 0.0);
        for camera in &cameras {
            let Ok(truth) = comgs_image::read(&entry.path().join(format!("{}.png", camera.name))) else {
                continue;
            };
            let mut goal = truth.color.select(&[0, 1, 2]);
            if let Some(alpha) = &truth.alpha {
                goal.data
                    .chunks_exact_mut(3)
                    .zip(&alpha.data)
                    .for_each(|(p, m)| p.iter_mut().for_each(|v| *v *= m));
            }
            let a = relit(&made, &light, camera, &raster, Vec3::ONE);
            let b = relit(&made, &light, camera, &raster, factor);
            raw += comgs_metrics::psnr_srgb(&a, &goal, None).expect("sizes").db;
            aligned += comgs_metrics::psnr_srgb(&b, &goal, None).expect("sizes").db;
            ssim += comgs_metrics::ssim(&b, &goal, comgs_metrics::Border::Valid, None).expect("sizes").mean;
            if n as usize % 6 == 2 {
                let all = side_by_side(&[&a, &b, &goal]);
                write_png(&out.join(format!("relit_{name}_{}.png", camera.name)), &all)
                    .expect("a writable folder");
            }
            n += 1.0;
        }
        println!(
            "relit {name}: {:.2} dB aligned, {:.2} dB unaligned, SSIM {:.4}",
            aligned / n,
            raw / n,
            ssim / n
        );
        all.push(aligned / n);
    }
    println!("relit mean {:.2} dB aligned", all.iter().sum::<f64>() / all.len() as f64);
    let mut truth_view = over_black(&test[2]);
    let incident = relit(&made, &made.light, &test[2].camera, &raster, Vec3::ONE);
    truth_view = side_by_side(&[&incident, &truth_view]);
    write_png(&out.join("recovered.png"), &truth_view).expect("a writable folder");
}
