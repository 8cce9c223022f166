//! `tradeoff relight`: what the accuracy of the objects' light costs, knob by knob, against converged samples and against ground
//! truth.

use crate::stages::editing::{
    Composition, Lighting, OwnLight, RelitObjects, Settings, Shading, Shadow, lit_map, shading_config,
};
use crate::stages::eval::composition::TruthFrames;
use crate::stages::relight::subject::refused;
use crate::stages::render_composition::Ground;
use crate::tradeoff::drive::{Measured, Setting, chosen, drive};
use crate::tradeoff::{Better, Metric, Sweep, cpu_seconds, machine};
use crate::{Context, PipelineError};
use comgs_compose::{
    Indirect, ObjectShader, RelightConfig, Relighter, SceneFrame, SelfOcclusion, ShadowSource,
};
use comgs_image::{Image, transfer::srgb_from_linear};
use comgs_inverse::Quality;
use comgs_light::EnvironmentSampler;
use comgs_trace::{TraceConfig, Tracer};
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// `composition.json`; its objects need material.
    pub composition: PathBuf,
    /// Composition with ground truth.
    pub truth: Option<PathBuf>,
    /// Folder for `relight.csv`, `.md`, `.svg`, `.png`.
    pub output: PathBuf,
    /// The command, as it is to be printed below the plot.
    pub command: String,
}

/// Knobs of the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Knobs to turn, by name ([`KNOBS`]); all when empty.
    pub knobs: Vec<String>,
    /// Cameras, at most.
    pub views: usize,
    /// Samples a pixel of the reference.
    pub reference_rays: u32,
    /// Frames of which the fastest counts.
    pub repeats: usize,
    /// Seed.
    pub seed: u64,
}

impl Default for Config {
    fn default() -> Self {
        Self { knobs: Vec::new(), views: 2, reference_rays: 2048, repeats: 3, seed: 0 }
    }
}

/// The knobs, in the order of the table.
pub const KNOBS: [&str; 6] = ["way", "quality", "samples", "highlight", "self-occlusion", "indirect"];

/// A way to the objects' light.
#[derive(Clone, Debug, PartialEq)]
enum Way {
    /// As `render --composition` makes it.
    Stage { quality: Quality, shading: Shading, rays: Option<u32>, self_occlusion: bool, indirect: bool },
    /// Samples at every pixel with an occlusion of one's own.
    Sampled { rays: u32, occlusion: SelfOcclusion },
}

fn settings() -> Vec<Setting<Way>> {
    let stage = |quality, shading, rays, self_occlusion, indirect| Way::Stage {
        quality,
        shading,
        rays,
        self_occlusion,
        indirect,
    };
    let balanced = Quality::Balanced;
    let cached = |rays| stage(balanced, Shading::Cached, rays, true, false);
    let sampled = |rays| stage(balanced, Shading::Sampled, Some(rays), true, false);
    let plain = stage(balanced, Shading::Auto, None, true, false);
    let mut out = Vec::new();
    let mut of = |knob: &'static str, label: &str, way: Way| {
        // What goes by the defaults is one run, whatever it is called.
        let way = if way == cached(None) || way == cached(Some(8)) { plain.clone() } else { way };
        let is_default = way == plain;
        out.push(Setting { knob, label: label.to_owned(), is_default, way });
    };
    of("way", "cached", cached(None));
    of("way", "sampled, 128", sampled(128));
    of("way", "traced, 128", Way::Sampled { rays: 128, occlusion: SelfOcclusion::Trace });
    for (label, quality) in
        [("draft", Quality::Draft), ("balanced", balanced), ("reference", Quality::Reference)]
    {
        of("quality", label, stage(quality, Shading::Auto, None, true, false));
    }
    for rays in [16, 32, 64, 256] {
        of("samples", &rays.to_string(), sampled(rays));
    }
    of("samples", "cached", cached(None));
    for rays in [2, 4, 8, 16, 32] {
        of("highlight", &rays.to_string(), cached(Some(rays)));
    }
    of("self-occlusion", "kept on the surfels", cached(None));
    of("self-occlusion", "none", stage(balanced, Shading::Auto, None, false, false));
    for (label, occlusion) in
        [("probes, 128 samples", SelfOcclusion::Probes), ("traced, 128 samples", SelfOcclusion::Trace)]
    {
        of("self-occlusion", label, Way::Sampled { rays: 128, occlusion });
    }
    of("self-occlusion", "both, 128 samples", sampled(128));
    of("indirect", "none", cached(None));
    of("indirect", "one bounce, cached", stage(balanced, Shading::Cached, None, true, true));
    of("indirect", "one bounce, 128 samples", stage(balanced, Shading::Sampled, Some(128), true, true));
    out
}

/// Runs all settings and writes one table and one plot; after every run what is done so far.
///
/// Seconds are of what a frame spends on the objects (rendering, shading, ordering), the fastest of some; its processor time, a mean,
/// and the preparation stand beside it. Errors: sRGB PSNR of the objects' pixels against many samples of which each is traced, without bounced light (a way with
/// bounced light is not compared with it); with ground truth, PSNR of the frame in the true object region, without shadows on the
/// scene, which lie elsewhere.
///
/// # Errors
/// [`PipelineError`]: objects without material, what `render --composition` refuses.
pub fn run(input: &Input, config: &Config, context: &Context<'_>) -> Result<Sweep, PipelineError> {
    let chosen = chosen(settings(), &config.knobs, &KNOBS)?;
    context.progress.begin("tradeoff relight");
    let composition = Composition::load(&input.composition, None, |text| context.progress.warn(&text))?;
    if let Some(object) = composition.objects.iter().find(|o| o.subject.asset.surfels.material.is_none()) {
        let expected = "an object with material (run `comgs decompose` first)";
        return Err(PipelineError::input(&object.name, expected, "surfels without material"));
    }
    // What the object does not have cannot be tried.
    let has_probes = matches!(&composition.objects[..], [object] if object.subject.probe_set().is_some());
    let possible = |s: &Setting<Way>| {
        has_probes || !matches!(s.way, Way::Sampled { occlusion: SelfOcclusion::Probes, .. })
    };
    let chosen: Vec<_> = chosen.into_iter().filter(possible).collect();
    let truth = input.truth.as_ref().map(|t| TruthFrames::new(t)).transpose()?;
    let bench = Bench::new(&composition, config, truth, context)?;
    let sweep = Sweep {
        title: "What the accuracy of the objects' light costs".to_owned(),
        command: input.command.clone(),
        machine: machine(),
        metrics: metrics(bench.truth.is_some()),
        rows: Vec::new(),
    };
    drive(sweep, &chosen, &input.output, "relight", context, |setting| bench.measure(&setting.way))
}

fn metrics(truth: bool) -> Vec<Metric> {
    let mut out = vec![Metric::new("samples_db", "object against samples", "dB", Better::Up, 2)];
    if truth {
        out.push(Metric::new("truth_db", "object against truth", "dB", Better::Up, 2));
    }
    out.extend([
        Metric::new("cpu_ms", "processor time of a frame", "ms", Better::Down, 1),
        Metric::new("shade_ms", "shading of a frame", "ms", Better::Down, 1),
        Metric::new("prepare_s", "preparation", "s", Better::Down, 2),
        Metric::new("own_s", "of it, once an object", "s", Better::Down, 2),
    ]);
    out
}

/// What every setting is measured on.
struct Bench<'a> {
    composition: &'a Composition,
    config: &'a Config,
    tracer: Tracer,
    sampler: EnvironmentSampler,
    scenes: Vec<SceneFrame>,
    truth: Option<TruthFrames>,
    /// Frames of the reference, and where the objects are in them.
    reference: Vec<(Image, Image)>,
}

/// Coverage from which on a pixel is the objects'.
const COVERED: f32 = 0.9;

impl<'a> Bench<'a> {
    fn new(
        composition: &'a Composition,
        config: &'a Config,
        truth: Option<TruthFrames>,
        context: &Context<'_>,
    ) -> Result<Self, PipelineError> {
        let tracer = Tracer::new(&composition.scene.surfels, &TraceConfig::default())?;
        let sampler = EnvironmentSampler::new(&composition.map);
        let (scenes, reference) = Default::default();
        let mut bench = Self { composition, config, tracer, sampler, scenes, truth, reference };
        let (scenes, reference) = bench.references(context)?;
        (bench.scenes, bench.reference) = (scenes, reference);
        Ok(bench)
    }

    /// What the cameras see of the scene, and the frames of the reference.
    #[allow(clippy::type_complexity, reason = "used here alone")]
    fn references(
        &self,
        context: &Context<'_>,
    ) -> Result<(Vec<SceneFrame>, Vec<(Image, Image)>), PipelineError> {
        let all = &self.composition.cameras;
        let n = all.len().min(self.config.views.max(1));
        let settings = self.settings(Quality::Balanced, Shading::Sampled);
        let ground = Ground::new(self.composition, &self.tracer, &self.sampler, &settings)?;
        let rays = self.config.reference_rays.max(1);
        let relighter = self.relighter(&ground, &settings, rays, SelfOcclusion::Trace)?;
        let (mut scenes, mut reference) = (Vec::new(), Vec::new());
        for k in 0..n {
            context.check()?;
            let camera = &all[k * all.len() / n];
            context.progress.update(&crate::Status {
                fraction: None,
                message: format!("reference of {}, {rays} samples", camera.name),
                remaining: None,
            });
            let scene = ground.composer.scene_frame(camera);
            let frame = ground.composer.frame_over(&scene, ShadowSource::Configured, Some(&relighter));
            scenes.push(scene);
            reference.push((frame.beauty, frame.mask));
        }
        Ok((scenes, reference))
    }

    fn settings(&self, quality: Quality, shading: Shading) -> Settings {
        Settings { quality, shading, shadow: Shadow::None, seed: self.config.seed, ..Settings::default() }
    }

    /// Samples with an occlusion of one's own.
    fn relighter<'g>(
        &self,
        ground: &'g Ground<'g>,
        settings: &Settings,
        rays: u32,
        self_occlusion: SelfOcclusion,
    ) -> Result<RelitObjects<'g>, PipelineError> {
        let config = RelightConfig {
            self_occlusion,
            indirect: Indirect::None,
            seed: settings.seed,
            raster: self.composition.raster(),
            ..shading_config(self.composition, settings)
        };
        let config = config.with_rays(rays);
        let map = lit_map(self.composition);
        let made = Relighter::new(ground.composer.objects(), ground.probes.as_ref(), &map, config)
            .map_err(|e| refused(&self.composition.objects[0].subject.path, &e))?;
        Ok(RelitObjects::Sampled(Box::new(made)))
    }

    /// Seconds of a frame's objects, and measures.
    fn measure(&self, way: &Way) -> Result<Measured, PipelineError> {
        let settings = match *way {
            Way::Stage { quality, shading, rays, self_occlusion, indirect } => {
                Settings { rays, self_occlusion, indirect, ..self.settings(quality, shading) }
            }
            Way::Sampled { .. } => self.settings(Quality::Balanced, Shading::Sampled),
        };
        let ground = Ground::new(self.composition, &self.tracer, &self.sampler, &settings)?;
        let start = Instant::now();
        let own = match way {
            Way::Stage { .. } => OwnLight::new(self.composition, &settings)?,
            Way::Sampled { .. } => None,
        };
        let own_s = start.elapsed().as_secs_f64();
        let relit = match *way {
            Way::Sampled { rays, occlusion } => Some(self.relighter(&ground, &settings, rays, occlusion)?),
            Way::Stage { .. } => {
                let lighting = Lighting {
                    cloud: ground.composer.objects(),
                    probes: ground.probes.as_ref(),
                    tracer: ground.object_tracer.as_ref(),
                    light: &ground.light,
                    baked: None,
                    own: own.as_ref(),
                    near: None,
                };
                RelitObjects::new(self.composition, lighting, &lit_map(self.composition), &settings)?
            }
        };
        let prepare_s = start.elapsed().as_secs_f64();
        let shader = relit.as_ref().map(|r| r as &dyn ObjectShader);
        let (mut frame_s, mut shade_s, mut square, mut counted) = (0.0, 0.0, 0.0f64, 0usize);
        let (mut truth_db, mut cpu_s) = (Vec::new(), 0.0);
        let repeats = self.config.repeats.max(1);
        for (scene, (reference, mask)) in self.scenes.iter().zip(&self.reference) {
            let (mut best, mut shade, mut object) = (f64::INFINITY, f64::INFINITY, None);
            let cpu = cpu_seconds();
            for _ in 0..repeats {
                let start = Instant::now();
                let made = ground.composer.object_frame(scene, shader);
                best = best.min(start.elapsed().as_secs_f64());
                shade = shade.min(made.stats().relight_s);
                object = Some(made);
            }
            let Some(object) = object else { continue };
            // Zero where the system does not tell.
            cpu_s += cpu.zip(cpu_seconds()).map_or(0.0, |(from, to)| to - from) / repeats as f64;
            let beauty = ground.composer.blend(scene, &object, ShadowSource::Configured).beauty;
            (frame_s, shade_s) = (frame_s + best, shade_s + shade);
            let code = |v: f32| f64::from(srgb_from_linear(v.clamp(0.0, 1.0)));
            for (i, covered) in mask.data.iter().enumerate() {
                if *covered >= COVERED {
                    let at = 3 * i..3 * i + 3;
                    let pair = beauty.data[at.clone()].iter().zip(&reference.data[at]);
                    square += pair.map(|(a, b)| (code(*a) - code(*b)).powi(2)).sum::<f64>();
                    counted += 3;
                }
            }
            let name = &scene.camera().name;
            if let Some(scores) = self.truth.as_ref().map(|t| t.judge(name, &beauty)).transpose()? {
                truth_db.extend(scores.and_then(|s| s.object).map(|s| s.psnr_db));
            }
        }
        let n = self.scenes.len().max(1) as f64;
        let mut values = BTreeMap::from([
            ("shade_ms".to_owned(), 1e3 * shade_s / n),
            ("prepare_s".to_owned(), prepare_s),
            ("own_s".to_owned(), own_s),
        ]);
        if cpu_s > 0.0 {
            values.insert("cpu_ms".to_owned(), 1e3 * cpu_s / n);
        }
        if counted > 0 && !settings.indirect {
            values.insert("samples_db".to_owned(), -10.0 * (square / counted as f64).log10());
        }
        if !truth_db.is_empty() {
            values.insert("truth_db".to_owned(), truth_db.iter().sum::<f64>() / truth_db.len() as f64);
        }
        Ok((frame_s / n, values))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every knob has at least two values, and of each the default is one.
    #[test]
    fn every_knob_has_values_and_a_default() {
        for knob in KNOBS {
            let own: Vec<_> = settings().into_iter().filter(|s| s.knob == knob).collect();
            assert!(own.len() >= 2, "{knob}");
            assert_eq!(own.iter().filter(|s| s.is_default).count(), 1, "{knob}");
        }
    }
}
