//! `plan`: which effects a composition calls for, why, and at what cost.
//!
//! Effects are tried on small frames, one after the other in the order in which they build on one another
//! (`effects::EFFECTS`): the difference of two neighbouring pilots is what an effect changes, as a viewer sees it, and the
//! difference of their times what it costs, scaled to the frames. An effect runs when its change reaches the tolerance, when what
//! it builds on runs, and, under a budget, when it is among those that change most a second.
//!
//! What is not modelled is looked at too (`unmodelled`) and listed with its estimate, so that nobody takes silence for
//! absence.

pub(crate) mod effects;
mod measure;
mod pilot;
mod unmodelled;

pub use measure::{Change, change};

use crate::stages::editing::{Baked, Composition, Settings, Shadow, bake};
use crate::{Context, PipelineError};
use comgs_light::EnvironmentSampler;
use comgs_trace::{TraceConfig, Tracer};
use effects::{EFFECTS, Effect};
use serde::Serialize;
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
}

/// What an effect must be worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Least mean change of the pixels that an effect touches, sRGB, 1 is white.
    pub tolerance: f64,
    /// Seconds for preparation and all frames.
    pub budget_s: Option<f64>,
}

impl Default for Limits {
    fn default() -> Self {
        Self { tolerance: TOLERANCE, budget_s: None }
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
    /// Seconds that making the plan took.
    pub plan_s: f64,
    /// What was asked.
    pub limits: Limits,
    /// What to render with.
    pub settings: Settings,
    /// What cannot be met, in words.
    pub shortfall: Option<String>,
}

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
    context.progress.begin("plan");
    let start = Instant::now();
    let mut composition =
        Composition::load(&input.composition, input.cameras.as_deref(), |text| context.progress.warn(&text))?;
    composition.match_photos(input.photos.as_deref(), context)?;
    let settings = Settings { shadow: Shadow::Auto, ..settings.clone() };
    // The outline of an occluder decides about a pilot of a hundred pixels at a draft's resolution too.
    let draft = Settings { quality: comgs_inverse::Quality::Draft, ..settings.clone() };
    let baked = bake(&composition, &draft, None, context)?;
    let plan = plan(&composition, &baked, &settings, limits, context)?;
    let plan = Plan { plan_s: start.elapsed().as_secs_f64(), ..plan };
    let on = plan.lines.iter().filter(|l| l.on).count();
    context.progress.end(&format!("{on} of {} effects, {:.1} s", EFFECTS.len(), plan.seconds));
    Ok(plan)
}

fn plan(
    composition: &Composition,
    baked: &Baked,
    settings: &Settings,
    limits: &Limits,
    context: &Context<'_>,
) -> Result<Plan, PipelineError> {
    let tracer = Tracer::new(&composition.scene.surfels, &TraceConfig::default())?;
    let sampler = EnvironmentSampler::new(&composition.map);
    let pilots = pilot::Pilots::new(composition, &tracer, &sampler, baked);
    let mut lines = Vec::new();
    let mut with = effects::none(settings);
    let mut last = pilots.render(&with, context)?;
    let always_s = last.seconds;
    for effect in EFFECTS {
        if let Some(why) = (effect.missing)(composition) {
            lines.push(Line {
                effect: effect.name.into(),
                change: None,
                seconds: 0.0,
                on: false,
                reason: why,
            });
            continue;
        }
        // What builds on an effect that nobody sees is not tried: a scene that needs little is planned quickly.
        let ground = effect.needs.and_then(|n| lines.iter().find(|l: &&Line| l.effect == n));
        if let Some(ground) = ground.filter(|g| g.change.is_none_or(|c| c.mean < limits.tolerance)) {
            let reason = format!("not tried: {} is below the tolerance or not there", ground.effect);
            lines.push(Line { effect: effect.name.into(), change: None, seconds: 0.0, on: false, reason });
            continue;
        }
        (effect.turn_on)(&mut with);
        let next = pilots.render(&with, context)?;
        let change = change(&last.frames, &next.frames);
        // Preparing the occlusion is the near shadow's cost.
        let bake_s = if effect.needs_occlusion { baked.seconds } else { 0.0 };
        let seconds = (next.seconds - last.seconds).max(0.0) + bake_s;
        lines.push(Line {
            effect: effect.name.into(),
            change: Some(change),
            seconds,
            on: false,
            reason: String::new(),
        });
        last = next;
    }
    let shortfall = choose(&mut lines, always_s, limits);
    let mut chosen = effects::none(settings);
    for effect in EFFECTS {
        if lines.iter().any(|l| l.on && l.effect == effect.name) {
            (effect.turn_on)(&mut chosen);
        }
    }
    let seconds = always_s + lines.iter().filter(|l| l.on).map(|l| l.seconds).sum::<f64>();
    lines.extend(unmodelled::lines(composition));
    Ok(Plan { lines, seconds, plan_s: 0.0, limits: *limits, settings: chosen, shortfall })
}

/// Decides; returns what cannot be met.
fn choose(lines: &mut [Line], always_s: f64, limits: &Limits) -> Option<String> {
    let of = |name: &str| EFFECTS.iter().find(|e| e.name == name);
    for line in lines.iter_mut() {
        let Some(change) = line.change else { continue };
        line.on = change.mean >= limits.tolerance;
        line.reason = if line.on {
            format!("changes {:.2} % of the pixels by {:.4}", 100.0 * change.touched, change.mean)
        } else {
            format!("changes {:.4}, below the tolerance of {}", change.mean, limits.tolerance)
        };
    }
    // An effect falls with what it builds on.
    let drop_orphans = |lines: &mut [Line]| {
        for i in 0..lines.len() {
            let Some(needs) = of(&lines[i].effect).and_then(|e: &Effect| e.needs) else { continue };
            let is_there = lines.iter().any(|l| l.effect == needs && l.on);
            if lines[i].on && !is_there {
                lines[i].on = false;
                lines[i].reason = format!("{needs} does not run");
            }
        }
    };
    drop_orphans(lines);
    let budget = limits.budget_s?;
    let mut spent = always_s;
    // Most change a second first, and an effect never before what it builds on.
    let mut open: Vec<usize> = (0..lines.len()).filter(|&i| lines[i].on).collect();
    for line in lines.iter_mut() {
        line.on = false;
    }
    let worth = |l: &Line| l.change.map_or(0.0, |c| c.mean * c.touched) / l.seconds.max(1e-3);
    while !open.is_empty() {
        let ready = |i: &&usize| {
            let needs = of(&lines[**i].effect).and_then(|e| e.needs);
            needs.is_none_or(|n| !open.iter().any(|&k| lines[k].effect == n))
        };
        let Some(&best) = open
            .iter()
            .filter(ready)
            .max_by(|&&a, &&b| worth(&lines[a]).total_cmp(&worth(&lines[b])).then(b.cmp(&a)))
        else {
            break;
        };
        open.retain(|&i| i != best);
        let needs = of(&lines[best].effect).and_then(|e| e.needs);
        let supported = needs.is_none_or(|n| lines.iter().any(|l| l.effect == n && l.on));
        if supported && spent + lines[best].seconds <= budget {
            spent += lines[best].seconds;
            lines[best].on = true;
        } else if supported {
            lines[best].reason =
                format!("{:.1} s more would exceed the budget of {budget:.1} s", lines[best].seconds);
        } else {
            lines[best].reason = format!("{} does not run", needs.unwrap_or("what it builds on"));
        }
    }
    (always_s > budget).then(|| {
        format!(
            "the budget of {budget:.1} s cannot be met: frames without any effect take {always_s:.1} s; the cheapest \
             plan is made"
        )
    })
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
        text.push_str(&format!(
            "estimated {:.1} s in all; the plan took {:.1} s\n",
            self.seconds, self.plan_s
        ));
        if let Some(shortfall) = &self.shortfall {
            text.push_str(&format!("{shortfall}\n"));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(effect: &Effect, mean: f64, seconds: f64) -> Line {
        let change = Some(Change { mean, touched: 0.1 });
        Line { effect: effect.name.into(), change, seconds, on: false, reason: String::new() }
    }

    fn on(lines: &[Line]) -> Vec<&str> {
        lines.iter().filter(|l| l.on).map(|l| l.effect.as_str()).collect()
    }

    /// Goal: what is below the tolerance stays off and so does what builds on it; a budget takes what changes most a second
    /// and never an effect without its ground; a budget that cannot be met gives the cheapest plan and says so.
    #[test]
    fn choices_follow_tolerance_budget_and_order() {
        let all =
            |mean: f64, seconds: f64| EFFECTS.iter().map(|e| line(e, mean, seconds)).collect::<Vec<_>>();
        let limits = |tolerance, budget_s| Limits { tolerance, budget_s };
        let mut lines = all(0.01, 1.0);
        assert_eq!(choose(&mut lines, 1.0, &limits(0.004, None)), None);
        assert_eq!(on(&lines).len(), EFFECTS.len());
        // Without the near shadow neither the far one nor bounced light makes sense.
        let mut lines = all(0.01, 1.0);
        let near = lines.iter().position(|l| l.effect == effects::SHADOW_NEAR).unwrap();
        lines[near].change = Some(Change { mean: 0.001, touched: 0.1 });
        choose(&mut lines, 1.0, &limits(0.004, None));
        assert!(!on(&lines).contains(&effects::SHADOW_FAR) && !on(&lines).contains(&effects::BOUNCE));
        // Budget for two of them: the most worthwhile that stand alone.
        let mut lines = all(0.01, 1.0);
        lines[near].change = Some(Change { mean: 0.2, touched: 0.3 });
        assert_eq!(choose(&mut lines, 1.0, &limits(0.004, Some(3.0))), None);
        assert_eq!(on(&lines).len(), 2);
        assert!(on(&lines).contains(&effects::SHADOW_NEAR), "{:?}", on(&lines));
        // Nothing fits.
        let mut lines = all(0.01, 1.0);
        let shortfall = choose(&mut lines, 5.0, &limits(0.004, Some(2.0))).unwrap();
        assert!(on(&lines).is_empty() && shortfall.contains("2.0 s cannot be met"), "{shortfall}");
    }
}
