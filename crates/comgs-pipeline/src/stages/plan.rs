//! `plan`: which effects a composition calls for, why, and at what cost.
//!
//! Effects are tried on small frames of a stand-in with few surfels, one after the other in the order in which they build on one
//! another (`effects::EFFECTS`): the difference of two neighbouring pilots is what an effect changes, as a viewer sees it. What
//! the pilots took, scaled to the frames (`cost`), is what it costs. An effect runs when its change reaches the tolerance,
//! when what it builds on runs, and, under a budget, when it is among those that change most a second. A budget also picks the
//! quality, where none is asked for: the finest at which all that is called for fits.
//!
//! What is not modelled is looked at too (`unmodelled`) and listed with its estimate, so that nobody takes silence for
//! absence.

mod choose;
mod cost;
pub(crate) mod effects;
mod measure;
mod pilot;
mod stand_in;
mod unmodelled;

pub use measure::{Change, change};

use crate::stages::editing::{Baked, Composition, Settings, Shadow, bake_at};
use crate::stages::render_composition::{Ground, Known, Parts, Renderer};
use crate::{Context, PipelineError};
use comgs_compose::{FieldConfig, ReceiverCloud, SceneFrame};
use comgs_inverse::Quality;
use comgs_light::EnvironmentSampler;
use comgs_trace::{TraceConfig, Tracer};
use cost::{Cost, QUALITIES, Work};
use effects::EFFECTS;
use serde::Serialize;
use std::cell::OnceCell;
use std::path::PathBuf;
use std::time::Instant;

/// Default of [`Limits::tolerance`]: one code value of 8 bit.
pub const TOLERANCE: f64 = 0.004;

/// Inputs of the stage.
#[derive(Clone, Debug)]
pub struct Input {
    /// `composition.json`.
    pub composition: PathBuf,
    /// Cameras instead of the composition's.
    pub cameras: Option<PathBuf>,
    /// Photos of the scene whose defocus and noise frames are to have.
    pub photos: Option<PathBuf>,
    /// Folder of occlusion fields: what lies there costs a run nothing.
    pub cache: Option<PathBuf>,
}

/// What an effect must be worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Least mean change of the pixels that an effect touches, sRGB, 1 is white.
    pub tolerance: f64,
    /// Seconds for preparation and all frames.
    pub budget_s: Option<f64>,
    /// Whether the budget picks the quality; else that of the settings stays.
    pub any_quality: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self { tolerance: TOLERANCE, budget_s: None, any_quality: false }
    }
}

/// One line of a plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// Name of the effect.
    pub effect: String,
    /// Estimated change; `None` where it was not measured.
    pub change: Option<Change>,
    /// Estimated seconds for preparation and all frames.
    pub seconds: f64,
    /// Whether it is simulated.
    pub on: bool,
    /// Why, or why not.
    pub reason: String,
}

/// A plan.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plan {
    /// The effects in their order, then what is not modelled.
    pub lines: Vec<Line>,
    /// Estimated seconds of everything that runs, with what always runs.
    pub seconds: f64,
    /// Estimated seconds of all that is called for, budget aside, at every quality.
    pub qualities: Vec<(Quality, f64)>,
    /// Seconds that making the plan took; of them `read_s` for what a run reads and builds too, and is handed.
    pub plan_s: f64,
    /// See `plan_s`.
    pub read_s: f64,
    /// What was asked.
    pub limits: Limits,
    /// What to render with.
    pub settings: Settings,
    /// What cannot be met, in words.
    pub shortfall: Option<String>,
}

/// What a plan has made that a run needs as well.
pub struct Made {
    pub(crate) composition: Composition,
    pub(crate) scene_tracer: Tracer,
    /// Of the full size.
    pub(crate) scenes: Vec<SceneFrame>,
    /// Seconds of reading, and of the scene's trees.
    pub(crate) read_s: (f64, f64),
    pub(crate) warnings: Vec<String>,
}

/// Field of a pilot's casters: the outline of an occluder decides about a pilot of a hundred pixels at this resolution too.
const FIELD: FieldConfig = FieldConfig { directions: 8, resolution: 32 };

/// Makes a plan. `settings` gives quality, seed and the way shadows are made; its effects are chosen anew.
///
/// # Errors
/// [`PipelineError`] for a composition that cannot be rendered.
pub fn run(
    input: &Input,
    settings: &Settings,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Plan, PipelineError> {
    run_for(input, settings, limits, context).map(|(plan, _)| plan)
}

/// [`run`], with what a run in the same process need not make again.
///
/// # Errors
/// Those of [`run`].
pub fn run_for(
    input: &Input,
    settings: &Settings,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<(Plan, Made), PipelineError> {
    context.progress.begin("plan");
    let start = Instant::now();
    let mut warnings = Vec::new();
    let mut composition = Composition::load(&input.composition, input.cameras.as_deref(), |text| {
        context.progress.warn(&text);
        warnings.push(text);
    })?;
    composition.match_photos(input.photos.as_deref(), context)?;
    let load_s = start.elapsed().as_secs_f64();
    let scene_tracer = Tracer::new(&composition.scene.surfels, &TraceConfig::default())?;
    let trees_s = start.elapsed().as_secs_f64() - load_s;
    let settings = Settings { shadow: Shadow::Auto, ..settings.clone() };
    let sampler = EnvironmentSampler::new(&composition.map);
    let read_s = load_s + trees_s;
    let (plan, scenes) =
        plan(&composition, &scene_tracer, &sampler, &settings, limits, input, read_s, context)?;
    let plan = Plan { plan_s: start.elapsed().as_secs_f64(), read_s, ..plan };
    let on = plan.lines.iter().filter(|l| l.on).count();
    context.progress.end(&format!("{on} of {} effects, {:.1} s", EFFECTS.len(), plan.seconds));
    Ok((plan, Made { composition, scene_tracer, scenes, read_s: (load_s, trees_s), warnings }))
}

#[allow(clippy::too_many_arguments, reason = "called once, by `run_for`")]
fn plan(
    composition: &Composition,
    tracer: &Tracer,
    sampler: &EnvironmentSampler,
    settings: &Settings,
    limits: &Limits,
    input: &Input,
    read_s: f64,
    context: &Context<'_>,
) -> Result<(Plan, Vec<SceneFrame>), PipelineError> {
    let start = Instant::now();
    let small = stand_in::stand_in(composition, pilot::cameras(&composition.cameras));
    // The objects' light is traced where it may be; without bounces, which know other ways.
    let mut widest = Settings { quality: Quality::Draft, ..effects::none(settings) };
    EFFECTS.iter().for_each(|effect| (effect.turn_on)(&mut widest));
    let ground = Ground::new(&small, tracer, sampler, &Settings { indirect: false, ..widest })?;
    let fields: OnceCell<Baked> = OnceCell::new();
    let mut pilots = pilot::Pilots::new(&small, &ground, &fields, context)?;
    let merge_s = start.elapsed().as_secs_f64();
    let surfels = |c: &Composition| c.objects.iter().map(|o| o.subject.asset.surfels.len()).sum::<usize>();
    let pixels = composition.cameras.iter().map(|c| c.width * c.height).sum::<usize>();
    let (frame_s, scenes) = full_frame(composition, &small, &ground, settings)?;
    let mut cost = Cost {
        composition,
        cache: input.cache.as_deref(),
        fixed_s: read_s + merge_s,
        frame_s,
        pixels: pixels as f64 / pilots.pixels().max(1) as f64,
        surfels: surfels(composition) as f64 / surfels(&small).max(1) as f64,
        bake: (surfels(&small), FIELD, 0.0),
    };

    let mut tries: Vec<Try> = Vec::new();
    let mut with = effects::none(settings);
    let mut last = pilots.render(&with, context)?;
    let nothing = (with.clone(), last.work);
    for effect in EFFECTS {
        if let Some(why) = (effect.missing)(composition) {
            tries.push(Try { effect: effect.name, outcome: Err(why) });
            continue;
        }
        // What builds on an effect that nobody sees is not tried: a scene that needs little is planned quickly.
        let ground = effect.needs.and_then(|n| tries.iter().find(|t| t.effect == n));
        if let Some(ground) = ground.filter(|g| !g.reaches(limits.tolerance)) {
            let why = format!("not tried: {} is below the tolerance or not there", ground.effect);
            tries.push(Try { effect: effect.name, outcome: Err(why) });
            continue;
        }
        let before = (with.clone(), last.work);
        if effect.needs_occlusion && fields.get().is_none() {
            let baked = bake_at(&small, FIELD, None, context)?;
            cost.bake.2 = baked.seconds;
            // Nothing else fills it meanwhile.
            let _ = fields.set(baked);
        }
        (effect.turn_on)(&mut with);
        let next = pilots.render(&with, context)?;
        let change = change(&last.frames, &next.frames);
        let after = (with.clone(), next.work);
        tries.push(Try { effect: effect.name, outcome: Ok((change, before, after)) });
        last = next;
    }

    let estimate = |quality: Quality, limits: &Limits| {
        let seconds = |(settings, work): &(Settings, Work)| cost.seconds(settings, work, quality);
        let always_s = seconds(&nothing);
        let line = |t: &Try| match &t.outcome {
            Err(why) => {
                Line { effect: t.effect.into(), change: None, seconds: 0.0, on: false, reason: why.clone() }
            }
            Ok((change, before, after)) => {
                let seconds = (seconds(after) - seconds(before)).max(0.0);
                let change = Some(*change);
                Line { effect: t.effect.into(), change, seconds, on: false, reason: String::new() }
            }
        };
        let mut lines: Vec<Line> = tries.iter().map(line).collect();
        let shortfall = choose::choose(&mut lines, always_s, limits);
        let seconds = always_s + lines.iter().filter(|l| l.on).map(|l| l.seconds).sum::<f64>();
        (lines, seconds, shortfall)
    };
    let wanted = Limits { budget_s: None, ..*limits };
    let qualities: Vec<(Quality, f64)> = QUALITIES.iter().map(|&q| (q, estimate(q, &wanted).1)).collect();
    let quality = match limits.budget_s {
        Some(budget) if limits.any_quality => choose::quality(&qualities, budget),
        _ => settings.quality,
    };
    let (mut lines, seconds, shortfall) = estimate(quality, limits);
    let mut chosen = Settings { quality, ..effects::none(settings) };
    for effect in EFFECTS {
        if lines.iter().any(|l| l.on && l.effect == effect.name) {
            (effect.turn_on)(&mut chosen);
        }
    }
    lines.extend(unmodelled::lines(composition));
    let (plan_s, limits) = (0.0, *limits);
    let plan = Plan { lines, seconds, qualities, plan_s, read_s, limits, settings: chosen, shortfall };
    Ok((plan, scenes))
}

/// An effect that was tried: its change, and settings with work before and after; or why it was not.
struct Try {
    effect: &'static str,
    #[allow(clippy::type_complexity, reason = "used here alone")]
    outcome: Result<(Change, (Settings, Work), (Settings, Work)), String>,
}

impl Try {
    fn reaches(&self, tolerance: f64) -> bool {
        self.outcome.as_ref().is_ok_and(|(change, ..)| change.mean >= tolerance)
    }
}

/// One frame of full size without effects, of the stand-in, in seconds; what it saw of the scene serves a run.
fn full_frame(
    composition: &Composition,
    small: &Composition,
    ground: &Ground<'_>,
    settings: &Settings,
) -> Result<(f64, Vec<SceneFrame>), PipelineError> {
    let Some(camera) = composition.cameras.first() else { return Ok((0.0, Vec::new())) };
    let start = Instant::now();
    let scene = ground.composer.scene_frame(camera);
    let none = effects::none(settings);
    let parts = Parts { objects: false, shadow: false, cache: None };
    let renderer = Renderer::for_parts(small, ground, None, None, &ReceiverCloud::default(), &none, parts)?;
    let _ = renderer.frame_over(&scene, Known::default());
    Ok((start.elapsed().as_secs_f64(), vec![scene]))
}

impl Plan {
    /// A table for the terminal.
    #[must_use]
    pub fn to_text(&self) -> String {
        let width = self.lines.iter().map(|l| l.effect.chars().count()).max().unwrap_or(0);
        let mut text =
            format!("{:width$}  {:>4}  {:>8}  {:>8}  why\n", "effect", "runs", "change", "seconds");
        for line in &self.lines {
            let runs = if line.on { "yes" } else { "no" };
            let change = line.change.map_or("–".to_owned(), |c| format!("{:.4}", c.mean));
            text.push_str(&format!(
                "{:width$}  {runs:>4}  {change:>8}  {:>8.2}  {}\n",
                line.effect, line.seconds, line.reason
            ));
        }
        let name = |q: &Quality| format!("{q:?}").to_lowercase();
        let all: Vec<String> =
            self.qualities.iter().map(|(q, seconds)| format!("{} {seconds:.1} s", name(q))).collect();
        let why = match self.limits.budget_s {
            Some(budget) if self.limits.any_quality => {
                format!(", the finest that fits {budget:.1} s, or the cheapest")
            }
            _ => String::new(),
        };
        text.push_str(&format!(
            "quality {}{why}; all that is called for: {}\n",
            name(&self.settings.quality),
            all.join(", ")
        ));
        text.push_str(&format!(
            "estimated {:.1} s in all; the plan took {:.2} s, {:.2} s of them reading\n",
            self.seconds, self.plan_s, self.read_s
        ));
        if let Some(shortfall) = &self.shortfall {
            text.push_str(&format!("{shortfall}\n"));
        }
        text
    }
}
