//! Commands that work on a composition.

use crate::args;
use crate::output::{say, write};
use comgs_pipeline::Context;
use comgs_pipeline::stages::editing::{Relight, Settings, Shading, Shadow};
use comgs_pipeline::stages::{animate, plan, render, render_composition, shadow};

/// The stages' settings.
fn settings(a: &args::Editing) -> Settings {
    let on = |s: args::Switch| s == args::Switch::On;
    Settings {
        quality: a.quality.unwrap_or(args::Quality::Balanced).into(),
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
    let (mut planned, mut ready) = (None, None);
    if a.tolerance.is_some() || a.budget.is_some() {
        let input = plan::Input {
            composition: composition.clone(),
            cameras: a.cameras.clone(),
            cache: a.cache.clone(),
            photos: a.editing.photos.clone(),
        };
        let limits = plan::Limits {
            tolerance: a.tolerance.unwrap_or(plan::TOLERANCE),
            budget_s: a.budget,
            any_quality: a.editing.quality.is_none(),
        };
        let (made, rest) = plan::run_for(&input, &chosen, &limits, context)?;
        write(format_args!("{}", made.to_text()));
        chosen = made.settings.clone();
        (planned, ready) = (Some(made), Some(rest));
    }
    let input = render_composition::Input {
        composition: composition.clone(),
        cameras: a.cameras.clone(),
        photos: a.editing.photos.clone(),
        cache: a.cache.clone(),
        output: a.output.clone(),
    };
    let config = render_composition::Config { settings: chosen, layers: a.layers, plan: planned };
    let made = render_composition::run_planned(&input, &config, ready, context)?;
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
    let input = plan::Input {
        composition: a.composition.clone(),
        cameras: a.cameras.clone(),
        cache: a.cache.clone(),
        photos: a.photos.clone(),
    };
    let quality = a.quality.unwrap_or(args::Quality::Balanced).into();
    let settings = Settings { quality, seed: a.seed, ..Settings::default() };
    let any_quality = a.quality.is_none();
    let limits = plan::Limits { tolerance: a.tolerance, budget_s: a.budget, any_quality };
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
