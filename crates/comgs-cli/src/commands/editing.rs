//! Commands that work on a composition.

use crate::args;
use crate::output::{say, write};
use comgs_pipeline::Context;
use comgs_pipeline::stages::editing::{Relight, Settings, Shading, Shadow};
use comgs_pipeline::stages::{animate, plan, render, render_composition, shadow, tradeoff_shadow};

/// The stages' settings.
fn settings(a: &args::Editing) -> Settings {
    let on = |s: args::Switch| s == args::Switch::On;
    Settings {
        quality: a.quality.into(),
        shadow: match a.shadow {
            args::ShadowFrom::Auto => Shadow::Auto,
            args::ShadowFrom::Probes => Shadow::Probes,
            args::ShadowFrom::Trace => Shadow::Trace,
            args::ShadowFrom::None => Shadow::None,
        },
        relight: match a.relight {
            args::RelightObjects::Auto => Relight::Auto,
            args::RelightObjects::Off => Relight::Off,
        },
        shading: match a.shading {
            args::ShadeBy::Auto => Shading::Auto,
            args::ShadeBy::Cached => Shading::Cached,
            args::ShadeBy::Sampled => Shading::Sampled,
        },
        rays: None,
        self_occlusion: on(a.self_occlusion),
        near_field: on(a.near_field),
        indirect: on(a.indirect),
        bounce: on(a.bounce),
        defocus: a.photos.is_some(),
        noise: a.photos.is_some(),
        near_only: false,
        seed: a.seed,
    }
}

pub(super) fn run_render(a: &args::Render, context: &Context<'_>) -> anyhow::Result<()> {
    if let (Some(asset), Some(cameras)) = (&a.asset, &a.cameras) {
        let input =
            render::Input { asset: asset.clone(), cameras: cameras.clone(), output: a.output.clone() };
        render::run(&input, &render::Config { layers: a.layers }, context)?;
        say!("{}", a.output.join("frames").display());
    }
    let Some(composition) = &a.composition else { return Ok(()) };
    let mut chosen = settings(&a.editing);
    let mut planned = None;
    if a.tolerance.is_some() || a.budget.is_some() {
        let photos = a.editing.photos.clone();
        let input = plan::Input { composition: composition.clone(), cameras: a.cameras.clone(), photos };
        let limits = plan::Limits { tolerance: a.tolerance.unwrap_or(plan::TOLERANCE), budget_s: a.budget };
        let made = plan::run(&input, &chosen, &limits, context)?;
        write(format_args!("{}", made.to_text()));
        chosen = made.settings.clone();
        planned = Some(made);
    }
    let input = render_composition::Input {
        composition: composition.clone(),
        cameras: a.cameras.clone(),
        photos: a.editing.photos.clone(),
        cache: a.cache.clone(),
        output: a.output.clone(),
    };
    let config = render_composition::Config { settings: chosen, layers: a.layers, plan: planned };
    let made = render_composition::run(&input, &config, context)?;
    say!("{:.0} ms a frame", 1e3 * made.frame_s);
    say!("{}", made.frames.display());
    Ok(())
}

pub(super) fn run_shadow(a: &args::Shadow, context: &Context<'_>) -> anyhow::Result<()> {
    let input = shadow::Input { composition: a.composition.clone(), output: a.output.clone() };
    let settings = Settings { quality: a.quality.into(), ..Settings::default() };
    let made = shadow::run(&input, &settings, context)?;
    say!("{} objects, {:.1} MB, {:.2} s", made.objects, made.bytes as f64 / 1e6, made.seconds);
    say!("{}", a.output.display());
    Ok(())
}

pub(super) fn run_plan(a: &args::Plan, context: &Context<'_>) -> anyhow::Result<()> {
    let input = plan::Input { composition: a.composition.clone(), cameras: None, photos: a.photos.clone() };
    let settings = Settings { quality: a.quality.into(), seed: a.seed, ..Settings::default() };
    let limits = plan::Limits { tolerance: a.tolerance, budget_s: a.budget };
    write(format_args!("{}", plan::run(&input, &settings, &limits, context)?.to_text()));
    Ok(())
}

pub(super) fn run_animate(a: &args::Animate, context: &Context<'_>) -> anyhow::Result<()> {
    let input = animate::Input {
        composition: a.composition.clone(),
        path: a.path.clone(),
        cameras: a.cameras.clone(),
        photos: a.editing.photos.clone(),
        cache: a.cache.clone(),
        output: a.output.clone(),
    };
    let made = animate::run(&input, &animate::Config { settings: settings(&a.editing) }, context)?;
    say!("{:.0} ms an edit", 1e3 * made.edit_s);
    say!("{}", made.preview.display());
    Ok(())
}

pub(super) fn run_tradeoff(a: &args::Tradeoff, context: &Context<'_>) -> anyhow::Result<()> {
    let args::TradeoffWhat::Shadow(a) = &a.what;
    let words: Vec<String> = std::env::args().skip(1).collect();
    let input = tradeoff_shadow::Input {
        composition: a.composition.clone(),
        truth: a.against.clone(),
        output: a.output.clone(),
        command: format!("comgs {}", words.join(" ")),
    };
    let config = tradeoff_shadow::Config {
        knobs: a.knobs.clone(),
        views: a.views,
        reference_rays: a.reference_rays,
        repeats: a.repeats,
        seed: a.seed,
    };
    say!("{}", tradeoff_shadow::run(&input, &config, context)?.to_markdown()?);
    Ok(())
}
