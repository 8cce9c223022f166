//! Trains on a capture and scores held-out views, for trying settings without the command line:
//! `cargo run --release -p comgs-inverse --example reconstruct -- CAPTURE object|scene OUT [key=value …]`, where a key is
//! a field of `TrainConfig` (`iterations=2000 max_surfels=30000 time_budget=120 …`).

use comgs_image::{Image, write_png};
use comgs_inverse::{Kind, Observer, Quality, TrainConfig, TrainStatus, TrainView, train};
use comgs_raster::{Planes, RasterConfig, render, surface_normals};
use comgs_scene::{Capture, LoadOptions, Split, View};
use std::path::Path;
use std::time::{Duration, Instant};

struct Log(Instant);

impl Observer for Log {
    fn progress(&mut self, s: &TrainStatus) {
        if self.0.elapsed() > Duration::from_secs(10) || s.iteration == 0 {
            self.0 = Instant::now();
            println!(
                "{:6.1} s  {:5}/{}  {:.2} dB  {} surfels  {:.0} s left  {}",
                s.elapsed_s, s.iteration, s.iterations, s.psnr_db, s.surfels, s.remaining_s, s.phase
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

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (capture, kind, out) = (&arguments[0], &arguments[1], Path::new(&arguments[2]));
    let kind = if kind == "object" { Kind::Object } else { Kind::Scene };
    let mut config =
        serde_json::to_value(TrainConfig::preset(kind, Quality::Balanced)).expect("plain values");
    for pair in &arguments[3..] {
        let (key, value) = pair.split_once('=').expect("key=value");
        config[key] = if key == "time_budget" {
            serde_json::to_value(Duration::from_secs_f64(value.parse().expect("seconds")))
                .expect("a duration")
        } else {
            serde_json::from_str(value).expect("a number")
        };
    }
    let config: TrainConfig = serde_json::from_value(config).expect("fields of TrainConfig");
    let load = |split| Capture::open(capture, split).and_then(|c| c.load(&LoadOptions::default()));
    let views: Vec<TrainView> = load(Split::Train).expect("capture").into_iter().map(to_train).collect();
    let trained = train(&views, None, &config, None, &mut Log(Instant::now())).expect("training");
    println!("{:#?}", trained.report);

    let raster = RasterConfig { near: trained.report.near, ..Default::default() };
    let (mut sum, mut ssim, mut count) = (0.0, 0.0, 0.0);
    let (mut normal_sum, mut normal_count) = (0.0, 0.0);
    for view in load(Split::Test).expect("test views") {
        let view = to_train(view);
        let frame = render(&trained.cloud, &view.camera, Planes::GEOMETRY, &raster);
        let color = frame.color.as_ref().expect("colour");
        let mut truth = view.color.clone();
        if let Some(mask) = &view.mask {
            truth
                .data
                .chunks_exact_mut(3)
                .zip(&mask.data)
                .for_each(|(p, m)| p.iter_mut().for_each(|v| *v *= m));
        }
        sum += comgs_metrics::psnr_srgb(color, &truth, None).expect("sizes").db;
        ssim += comgs_metrics::ssim(color, &truth, comgs_metrics::Border::Valid, None).expect("sizes").mean;
        count += 1.0;
        let normal = surface_normals(&frame, &view.camera).expect("geometry planes");
        let shown = normal.map(|v| (0.5 * v + 0.5).clamp(0.0, 1.0).powf(2.2));
        let mut both = Image::zeros(3 * color.width, color.height, 3);
        for y in 0..color.height {
            for x in 0..color.width {
                for (k, image) in [color, &truth, &shown].into_iter().enumerate() {
                    both.pixel_mut(k * color.width + x, y).copy_from_slice(image.pixel(x, y));
                }
            }
        }
        write_png(&out.join(format!("{}.png", view.camera.name)), &both).expect("a writable folder");
        let path = Path::new(capture).join(format!("test/normal/{}.exr", view.camera.name));
        if let (Ok(gt), Some(mask)) = (comgs_image::read(&path), &view.mask) {
            for ((n, t), m) in normal.data.chunks_exact(3).zip(gt.color.data.chunks_exact(3)).zip(&mask.data)
            {
                let length = n.iter().map(|v| v * v).sum::<f32>().sqrt();
                let truth_length = t.iter().map(|v| v * v).sum::<f32>().sqrt();
                if *m > 0.99 && length > 0.1 && truth_length > 0.5 {
                    let dot: f32 = n.iter().zip(t).map(|(a, b)| a * b).sum::<f32>() / (length * truth_length);
                    normal_sum += f64::from(dot.clamp(-1.0, 1.0).acos().to_degrees());
                    normal_count += 1.0;
                }
            }
        }
    }
    println!(
        "test PSNR {:.2} dB, SSIM {:.4}, normal MAE {:.2}°",
        sum / count,
        ssim / count,
        normal_sum / normal_count
    );
}
