//! A decomposed asset under other lights, against pictures of the object under them.

use crate::stages::eval::asset::{albedo_pair, times_alpha};
use crate::stages::eval::table::{Column, Section, Table};
use crate::stages::relight::subject::{Subject, read_light};
use crate::stages::{frames, relight, render};
use crate::{Context, PipelineError, Status};
use comgs_compose::Relighter;
use comgs_geom::Camera;
use comgs_image::Image;
use comgs_light::EnvironmentMap;
use comgs_metrics::{MetricError, ScaleFit, psnr_srgb, score};
use comgs_scene::{Capture, LoadOptions, Split};
use comgs_surfel::SurfelCloud;
use comgs_surfel::activation::{logit, sigmoid};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

fn columns() -> Vec<Column> {
    let column = |key, label, digits| Column { key, label, digits };
    vec![
        column("psnr_db", "PSNR dB", 2),
        column("ssim", "SSIM", 4),
        column("flip", "ꟻLIP", 4),
        column("masked.psnr_db", "PSNR in mask", 2),
    ]
}

/// A light and the cameras that have pictures under it.
struct Light {
    name: String,
    map: EnvironmentMap,
    views: Vec<(Camera, PathBuf)>,
}

/// How an asset is relit to be scored: as `comgs relight --indirect` does by default, with twice the samples, because
/// what is left of the noise costs SSIM (0.003 of it at 128 samples a pixel, 0.001 at 256; cow under `city`).
#[must_use]
pub fn settings() -> relight::Config {
    relight::Config { indirect: true, rays: Some(256), ..relight::Config::default() }
}

/// Relights an asset as `config` says, under every map and at every camera of `root` (`object_relit/NAME` of the SynCom
/// layout: `cameras.json`, `<env>/<name>.exr` or `.png`, maps in `../envmaps/<env>.exr`), and compares with the pictures as
/// a viewer sees them: sRGB, clipped to [0, 1], over black (pictures with alpha are multiplied by it).
///
/// Once the asset is taken as it is, and once with its albedo times the least-squares scale of each channel to the true
/// albedo of the test views of `against` ([`ScaleFit`]). One section a light and kind, and where there are several lights
/// one of their means for each kind.
///
/// # Errors
/// [`PipelineError`]: a root without cameras, maps or pictures, an asset without material.
pub fn evaluate(
    asset: &Path,
    against: &Path,
    root: &Path,
    config: &relight::Config,
    context: &Context<'_>,
) -> Result<(Vec<Section>, Vec<String>), PipelineError> {
    let mut subject = Subject::load(asset)?;
    let mut remarks = Vec::new();
    let lights = lights(root, &mut remarks)?;
    let scale = albedo_scale(&subject, against, context)?;
    let kinds = if scale.is_some() { 2 } else { 1 };
    let mut watch = Watch {
        done: 0,
        total: kinds * lights.iter().map(|l| l.views.len()).sum::<usize>(),
        start: Instant::now(),
        context,
    };
    let mut scored = score_all(&subject, &lights, config, "", &mut watch)?;
    let light_text = "sRGB clipped to [0, 1], over black";
    let mut sections =
        sections(&lights, std::mem::take(&mut scored), "", &format!("{light_text}; the asset as it is"));
    match scale {
        Some(scale) => {
            let clipped = scale_albedo(&mut subject.asset.surfels, scale);
            let [r, g, b] = scale;
            let what = format!(
                "{light_text}; albedo times {r:.3} {g:.3} {b:.3}, the linear least-squares scale of each channel to the true \
                 albedo of the test views. Photos cannot tell this factor, which albedo and light share"
            );
            let aligned = score_all(&subject, &lights, config, ", albedo aligned", &mut watch)?;
            sections.extend(self::sections(&lights, aligned, ", albedo aligned", &what));
            if clipped > 0.01 {
                remarks.push(format!(
                    "aligning took the albedo of {:.0} % of the surfels above 1, where it stays",
                    100.0 * clipped
                ));
            }
        }
        None => remarks.push(format!(
            "{} has no ground-truth albedo at its test views; relighting is not scored with aligned albedo",
            against.display()
        )),
    }
    // The lights first, one after the other, each as it is and aligned; then their means.
    sections.sort_by_key(|(light, _)| *light);
    let used = config.for_subject(&subject);
    remarks.push(format!(
        "relit with {} samples a pixel, self-occlusion: {}{}, light between the object's own surfaces: {}",
        used.light_rays + used.brdf_rays,
        format!("{:?}", used.self_occlusion).to_lowercase(),
        if subject.probes.is_none() { " (the asset has no probes)" } else { "" },
        if config.indirect { "one bounce" } else { "none" },
    ));
    Ok((sections.into_iter().map(|(_, section)| section).collect(), remarks))
}

/// The lights of a root, by name.
fn lights(root: &Path, remarks: &mut Vec<String>) -> Result<Vec<Light>, PipelineError> {
    let what = || root.display().to_string();
    let list = root.join("cameras.json");
    if !list.is_file() {
        return Err(PipelineError::input(
            what(),
            "a folder object_relit/NAME with cameras.json",
            "none there",
        ));
    }
    let cameras = frames::read_cameras(&list)?;
    let mut folders: Vec<PathBuf> = std::fs::read_dir(root)
        .map_err(|e| PipelineError::io(root, e))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.is_dir())
        .collect();
    folders.sort();
    let maps = root.parent().unwrap_or(Path::new(".")).join("envmaps");
    let mut lights = Vec::new();
    for folder in folders {
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let picture = |camera: &Camera| {
            let file = |extension: &str| folder.join(format!("{}.{extension}", camera.name));
            [file("exr"), file("png")].into_iter().find(|path| path.is_file())
        };
        let views: Vec<(Camera, PathBuf)> =
            cameras.iter().filter_map(|c| Some((c.clone(), picture(c)?))).collect();
        if views.is_empty() {
            continue;
        }
        let missing = cameras.len() - views.len();
        if missing > 0 {
            remarks.push(format!(
                "{missing} of {} cameras have no picture under {name}; left out",
                cameras.len()
            ));
        }
        let path = maps.join(format!("{name}.exr"));
        if !path.is_file() {
            remarks.push(format!("the light {name} has no map; left out: {}", path.display()));
            continue;
        }
        let map = read_light(&path, |text| remarks.push(text))?;
        lights.push(Light { name, map, views });
    }
    if lights.is_empty() {
        let expected = "pictures <env>/<camera>.exr or .png and their maps ../envmaps/<env>.exr";
        return Err(PipelineError::input(what(), expected, "no light with both"));
    }
    Ok(lights)
}

/// Least-squares scale of the rendered albedo to the true one over the masked pixels of the test views; `None` where the
/// capture has no albedo.
fn albedo_scale(
    subject: &Subject,
    against: &Path,
    context: &Context<'_>,
) -> Result<Option<[f64; 3]>, PipelineError> {
    let capture = Capture::open(against, Split::Test)?;
    let mut fit = ScaleFit::default();
    for record in &capture.views {
        context.check()?;
        context.progress.update(&Status {
            fraction: None,
            message: format!("albedo of view {}", record.camera.name),
            remaining: None,
        });
        let view = record.load(&LoadOptions::default())?;
        let frame = render::render(&subject.asset, &view.camera);
        if let Some((estimate, truth)) = albedo_pair(&frame, &view, record)? {
            fit.add(&estimate, &truth, view.alpha.as_ref()).map_err(failed(&view.camera.name))?;
        }
    }
    Ok(fit.scale(true).ok())
}

fn failed(view: &str) -> impl Fn(MetricError) -> PipelineError {
    move |e| PipelineError::input(format!("view {view}"), "comparable pictures", e.to_string())
}

/// Multiplies the albedo, which stays at 1 at most; the share of surfels that would have gone above.
fn scale_albedo(cloud: &mut SurfelCloud, scale: [f64; 3]) -> f64 {
    let Some(material) = &mut cloud.material else { return 0.0 };
    let mut clipped = 0;
    for logits in &mut material.albedo_logits {
        let scaled: [f32; 3] = std::array::from_fn(|c| sigmoid(logits[c]) * scale[c] as f32);
        clipped += usize::from(scaled.iter().any(|a| *a > 1.0));
        *logits = scaled.map(logit);
    }
    clipped as f64 / material.albedo_logits.len().max(1) as f64
}

/// Says how far the frames are.
struct Watch<'a> {
    done: usize,
    total: usize,
    start: Instant,
    context: &'a Context<'a>,
}

impl Watch<'_> {
    fn next(&mut self, message: String) -> Result<(), PipelineError> {
        self.context.check()?;
        let remaining = (self.done > 0).then(|| {
            let each = self.start.elapsed().as_secs_f64() / self.done as f64;
            Duration::from_secs_f64(each * (self.total - self.done) as f64)
        });
        let fraction = Some(self.done as f64 / self.total.max(1) as f64);
        self.context.progress.update(&Status { fraction, message, remaining });
        self.done += 1;
        Ok(())
    }
}

/// A table a light.
fn score_all(
    subject: &Subject,
    lights: &[Light],
    config: &relight::Config,
    kind: &str,
    watch: &mut Watch<'_>,
) -> Result<Vec<Table>, PipelineError> {
    let mut tables = Vec::new();
    for light in lights {
        let relighter = relight::prepare(subject, &light.map, config.for_subject(subject), watch.context)?;
        let mut table = Table { columns: columns(), rows: Vec::new() };
        for (camera, picture) in &light.views {
            watch.next(format!("relit {}{kind}, view {}", light.name, camera.name))?;
            table.rows.push((camera.name.clone(), compare(&relighter, camera, picture)?));
        }
        tables.push(table.without_empty_columns());
    }
    Ok(tables)
}

fn compare(
    relighter: &Relighter<'_>,
    camera: &Camera,
    picture: &Path,
) -> Result<Vec<Option<f64>>, PipelineError> {
    let loaded = comgs_image::read(picture)?;
    let truth = times_alpha(rgb(&loaded.color), loaded.alpha.as_ref());
    let frame = relighter.render(camera);
    let name = picture.display().to_string();
    let failed = failed(&name);
    let scores = score(&frame.radiance, &truth, None).map_err(&failed)?;
    let in_mask = match &loaded.alpha {
        Some(alpha) => match psnr_srgb(&frame.radiance, &truth, Some(alpha)) {
            Ok(psnr) => Some(psnr.db),
            Err(MetricError::NothingToMeasure { .. }) => None,
            Err(other) => return Err(failed(other)),
        },
        None => None,
    };
    Ok(vec![Some(scores.psnr_db), scores.ssim, Some(scores.flip), in_mask])
}

/// Three channels of a grey or coloured picture.
fn rgb(image: &Image) -> Image {
    if image.channels == 1 { image.select(&[0, 0, 0]) } else { image.clone() }
}

/// One section a light with its place in the order, and where there are several lights their means, last.
fn sections(lights: &[Light], tables: Vec<Table>, kind: &str, what: &str) -> Vec<(usize, Section)> {
    let mut means = Table { columns: columns(), rows: Vec::new() };
    let mut sections = Vec::new();
    for (k, (light, table)) in lights.iter().zip(tables).enumerate() {
        let row = means.columns.iter().map(|c| table.mean(c.key)).collect();
        means.rows.push((light.name.clone(), row));
        let views = table.rows.len();
        let what = format!("{views} views under {}.exr, {what}", light.name);
        sections.push((k, Section { name: format!("relit {}{kind}", light.name), what, table }));
    }
    if lights.len() > 1 {
        let what = format!("means of all views under each of {} lights, {what}", lights.len());
        let section = Section { name: format!("relit{kind}"), what, table: means.without_empty_columns() };
        sections.push((lights.len(), section));
    }
    sections
}
