//! Seconds and error of every way to a shadow, on one composition, in one run.
//!
//! `cargo run --release -p comgs-compose --example shadow_cost -- SCENE.asset OBJECT.asset COMPOSITION [VIEWS] [FOLDER]`
//!
//! FOLDER keeps the reference for the next run. COMPOSITION is a SynCom composition with `transform.json`, `cameras.json`, `envmap_gt.exr`. Errors are of the ratio, in
//! the pixels that the reference darkens by 5 % or more: PSNR of the ratio against traced rays (1024 a pixel, not smoothed).

use comgs_compose::shadow_light::ShadowLightConfig;
use comgs_compose::{
    CacheConfig, Caster, ComposeConfig, Composer, Denoise, FieldConfig, FieldShadow, PlacedObject,
    ReceiverCloud, ShadowCache, ShadowConfig, ShadowLight, ShadowSource,
};
use comgs_geom::Camera;
use comgs_image::{Image, Layer};
use comgs_light::{EnvironmentMap, EnvironmentSampler, SplitConfig};
use comgs_raster::RasterConfig;
use comgs_scene::{Asset, TransformFile, read_cameras};
use comgs_trace::{TraceConfig, Tracer};
use std::path::Path;
use std::time::Instant;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [scene, object, composition, ..] = &words[..] else {
        eprintln!("SCENE.asset OBJECT.asset COMPOSITION [VIEWS]");
        std::process::exit(2);
    };
    let views: usize = words.get(3).map_or(2, |v| v.parse().expect("a number of views"));
    let folder = Path::new(composition);
    let scene = Asset::load(scene).expect("scene asset");
    let object = Asset::load(object).expect("object asset");
    let place = TransformFile::read(folder.join("transform.json")).expect("transform.json").objects[0].1;
    let cameras: Vec<Camera> =
        read_cameras(&folder.join("cameras.json")).expect("cameras.json").into_iter().take(views).collect();
    let image = comgs_image::read(&folder.join("envmap_gt.exr")).expect("envmap_gt.exr").color;
    let map = EnvironmentMap::from_image_repaired(&image).expect("a map").0;
    let sampler = EnvironmentSampler::new(&map);
    let tracer = Tracer::new(&scene.surfels, &TraceConfig::default()).expect("scene tracer");
    let placed = [PlacedObject { cloud: &object.surfels, world_from_object: place }];
    let near = scene.record.training.as_ref().and_then(|t| t.metrics.get("near").copied());
    let raster = RasterConfig { near: near.map_or(0.01, |n| n as f32), ..RasterConfig::default() };
    let traced = |rays: u32, denoise: Denoise| {
        let shadow = ShadowConfig { rays, denoise, ..ShadowConfig::default() };
        let config = ComposeConfig { raster, shadow: Some(shadow), ..ComposeConfig::default() };
        Composer::new(&scene.surfels, &tracer, &placed, &sampler, config).expect("a composer")
    };
    let reference = traced(1024, Denoise::Off);
    let truth: Vec<Image> = cameras
        .iter()
        .map(|camera| {
            let kept = words.get(4).map(|f| Path::new(f).join(format!("{}.exr", camera.name)));
            match &kept {
                Some(path) if path.is_file() => comgs_image::read(path).expect("a kept reference").color,
                _ => {
                    let shadow = reference.frame(camera).shadow;
                    if let Some(path) = &kept {
                        let channels = &["R", "G", "B"];
                        let layer = Layer { name: "", channels, image: &shadow, full_float: true };
                        comgs_image::write_layers(path, &[layer]).expect("FOLDER can be written");
                    }
                    shadow
                }
            }
        })
        .collect();
    println!(
        "{:60} {:>9} {:>9} {:>9} {:>8} {:>8}",
        "shadow", "prepare s", "shadow ms", "frame ms", "dB", "bias"
    );
    let report = |name: &str,
                  repeats: usize,
                  prepare: f64,
                  frame: &dyn Fn(&Camera) -> comgs_compose::ComposedFrame| {
        let (mut shadow_s, mut frame_s, mut square, mut bias, mut n) = (0.0, 0.0, 0.0f64, 0.0f64, 0);
        for (camera, truth) in cameras.iter().zip(&truth) {
            // The best of some: other programs run beside.
            let (mut best, mut best_shadow) = (f64::INFINITY, f64::INFINITY);
            let mut last = None;
            for _ in 0..repeats {
                let start = Instant::now();
                let f = frame(camera);
                best = best.min(start.elapsed().as_secs_f64());
                best_shadow = best_shadow.min(f.stats.shadow_s);
                last = Some(f);
            }
            let f = last.expect("a frame");
            shadow_s += best_shadow / cameras.len() as f64;
            frame_s += best / cameras.len() as f64;
            for (a, t) in f.shadow.data.chunks_exact(3).zip(truth.data.chunks_exact(3)) {
                if t[1] < 0.95 {
                    for c in 0..3 {
                        square += f64::from(a[c] - t[c]).powi(2);
                        bias += f64::from(a[c] - t[c]);
                        n += 1;
                    }
                }
            }
        }
        let db = -10.0 * (square / n.max(1) as f64).log10();
        println!(
            "{name:60} {prepare:9.2} {:9.1} {:9.1} {db:8.2} {:8.4}",
            1e3 * shadow_s,
            1e3 * frame_s,
            bias / n.max(1) as f64
        );
    };
    for (rays, denoise) in [(64, Denoise::default()), (256, Denoise::default()), (256, Denoise::Off)] {
        let name = format!("traced {rays}{}", if denoise == Denoise::Off { "" } else { " smoothed" });
        let composer = traced(rays, denoise);
        report(&name, 1, 0.0, &|c| composer.frame(c));
    }
    let config = ComposeConfig { raster, shadow: None, ..ComposeConfig::default() };
    let start = Instant::now();
    let composer = Composer::new(&scene.surfels, &tracer, &placed, &sampler, config).expect("a composer");
    let place_s = start.elapsed().as_secs_f64();
    report("none", 3, place_s, &|c| composer.frame(c));
    let mut receivers = ReceiverCloud::default();
    let start = Instant::now();
    for camera in &cameras {
        receivers.add(camera, &composer.receivers(camera));
    }
    println!("receivers: {} in {:.2} s", receivers.len(), start.elapsed().as_secs_f64());
    for (directions, resolution) in [(12, 48), (12, 96), (16, 32), (16, 64), (16, 96), (24, 64), (24, 128)] {
        let start = Instant::now();
        let field = FieldConfig { directions, resolution };
        let caster = Caster::new(&object.surfels, field, None, &|| false).expect("a field");
        let bake = start.elapsed().as_secs_f64();
        let on = || Some(SplitConfig::default());
        for (cuts, split, beam_rays) in [
            (256, None, 1),
            (64, on(), 16),
            (256, on(), 16),
            (256, on(), 64),
            (512, on(), 16),
            (1024, on(), 16),
        ] {
            if (cuts, beam_rays) != (256, 16) && (directions, resolution) != (16, 64) {
                continue;
            }
            let casters = [(&caster, place)];
            let start = Instant::now();
            let light = ShadowLightConfig { directions: cuts, split: split.clone(), beam_rays };
            let light = ShadowLight::new(&map, &[], &light).expect("a light");
            let exact = FieldShadow::new(&light, &casters);
            let light_s = start.elapsed().as_secs_f64();
            let split = split.as_ref().map_or("whole".to_owned(), |_| format!("split, {beam_rays} rays"));
            let name = format!("field {directions}² × {resolution}², {cuts} parts, {split}");
            println!(
                "  bake {bake:.2} s, {:.1} MB, light {light_s:.3} s, {} directions, strong share {:.2}, {} beams",
                caster.field.memory_bytes() as f64 / 1e6,
                light.directions.len(),
                light.strong_share(),
                light.beams.len()
            );
            if (directions, resolution) == (16, 64) {
                report(&name, 1, bake + light_s, &|c| {
                    composer.frame_with(c, ShadowSource::Exact(&exact), None)
                });
            }
            for (tolerance, pixels) in [(0.01, 1.0), (0.01, 2.0), (0.02, 2.0), (0.05, 4.0)] {
                if tolerance != 0.01 && (directions, resolution) != (16, 64) {
                    continue;
                }
                let config = CacheConfig { tolerance, pixels, ..CacheConfig::default() };
                let cache = ShadowCache::build(&receivers, &exact, &config);
                let s = cache.statistics();
                let label = format!("{name}, cached {tolerance} {pixels} px");
                report(&label, 3, light_s + s.seconds, &|c| {
                    composer.frame_with(c, ShadowSource::Cached(&cache, &exact), None)
                });
                println!(
                    "      {} cells, {} evaluated, {:.2} MB, build {:.3} s",
                    s.cells,
                    s.evaluated,
                    s.bytes as f64 / 1e6,
                    s.seconds
                );
            }
        }
    }
}
