//! From arguments to stages, and from their results to what is printed.

mod editing;
mod insert;
mod insert_eval;
mod light;
mod tradeoff;

use crate::args::{self, Cli, Command};
use crate::output::{say, write};
use crate::terminal::Terminal;
use anyhow::{Context as _, bail};
use clap::CommandFactory;
use comgs_inverse::{AlbedoScale, Kind, Quality, Visibility};
use comgs_pipeline::stages::{
    ablate, compose, decompose, demo, eval, export, info, material, place, reconstruct, relight, synth,
};
use comgs_pipeline::{CancelToken, Context};
use comgs_scene::{CheckDepth, check_with};
use std::path::Path;
use std::process::ExitCode;

impl From<args::Kind> for Kind {
    fn from(kind: args::Kind) -> Self {
        match kind {
            args::Kind::Object => Self::Object,
            args::Kind::Scene => Self::Scene,
        }
    }
}

impl From<args::Quality> for Quality {
    fn from(quality: args::Quality) -> Self {
        match quality {
            args::Quality::Draft => Self::Draft,
            args::Quality::Balanced => Self::Balanced,
            args::Quality::Reference => Self::Reference,
        }
    }
}

impl From<args::Visibility> for Visibility {
    fn from(visibility: args::Visibility) -> Self {
        match visibility {
            args::Visibility::Probes => Self::Probes,
            args::Visibility::Trace => Self::Trace,
            args::Visibility::None => Self::None,
        }
    }
}

impl From<args::Preset> for material::Preset {
    fn from(preset: args::Preset) -> Self {
        match preset {
            args::Preset::Copper => Self::Copper,
            args::Preset::Silver => Self::Silver,
            args::Preset::Stone => Self::Stone,
            args::Preset::RedMatte => Self::RedMatte,
            args::Preset::RedGlossy => Self::RedGlossy,
        }
    }
}

/// Runs the command that was asked for.
pub(crate) fn run(cli: &Cli, cancel: CancelToken) -> anyhow::Result<ExitCode> {
    let terminal = Terminal::new(cli.quiet);
    let context = Context { progress: &terminal, cancel };
    match &cli.command {
        Command::Reconstruct(a) if a.check => return check(&a.capture),
        Command::Reconstruct(a) => run_reconstruct(a, &context)?,
        Command::Decompose(a) => run_decompose(a, &context)?,
        Command::Place(a) => run_place(a, &context)?,
        Command::Light(a) => light::run_light(a, &context)?,
        Command::Panorama(a) => light::run_panorama(a, &context)?,
        Command::Model(a) => light::run_model(a, &context)?,
        Command::Render(a) => editing::run_render(a, &context)?,
        Command::Shadow(a) => editing::run_shadow(a, &context)?,
        Command::Plan(a) => editing::run_plan(a, &context)?,
        Command::Animate(a) => editing::run_animate(a, &context)?,
        Command::Relight(a) => run_relight(a, &context)?,
        Command::Compose(a) => run_compose(a, &context)?,
        Command::Insert(a) => insert::run(a, &context)?,
        Command::InsertEval(a) => insert_eval::run(a, &context)?,
        Command::Material(a) => run_material(a, &context)?,
        Command::Eval(a) => run_eval(a, &context)?,
        Command::Ablate(a) => run_ablate(a, &context)?,
        Command::Tradeoff(a) => tradeoff::run(a, &context)?,
        Command::Synth(a) => run_synth(a, &context)?,
        Command::Demo(a) => run_demo(a, &context)?,
        Command::Export(a) => run_export(a, &context)?,
        Command::Info(a) => return Ok(run_info(a)),
    }
    Ok(ExitCode::SUCCESS)
}

/// Lists every problem of a capture; fails when it cannot be used.
fn check(capture: &Path) -> anyhow::Result<ExitCode> {
    std::fs::metadata(capture).with_context(|| format!("cannot be read: {}", capture.display()))?;
    let report = check_with(capture, CheckDepth::Pixels);
    say!("{report}");
    Ok(if report.is_sound() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn run_reconstruct(a: &args::Reconstruct, context: &Context<'_>) -> anyhow::Result<()> {
    let Some(output) = a.output.clone() else { bail!("-o ASSET is missing") };
    let input = reconstruct::Input { capture: a.capture.clone(), output };
    let config = reconstruct::Config {
        kind: a.kind.map(Into::into),
        quality: a.quality.into(),
        time_budget_s: a.time_budget,
        seed: a.seed,
        max_surfels: a.budget_surfels,
        max_width: a.max_width,
        resume: if a.resume { reconstruct::Resume::Expected } else { reconstruct::Resume::Never },
        ..reconstruct::Config::default()
    };
    let made = reconstruct::run(&input, &config, context)?;
    say!("{}", made.asset.display());
    Ok(())
}

fn run_decompose(a: &args::Decompose, context: &Context<'_>) -> anyhow::Result<()> {
    let input =
        decompose::Input { asset: a.asset.clone(), capture: a.capture.clone(), output: a.output.clone() };
    let mut config = decompose::Config::preset(a.quality.into());
    let c = &mut config.decompose;
    c.visibility = a.visibility.into();
    c.probes = a.probes.unwrap_or(c.probes);
    c.probe_resolution = a.probe_res;
    c.probe_offset = a.probe_offset;
    c.chebyshev = a.chebyshev == args::Switch::On;
    c.rays = a.rays.unwrap_or(c.rays);
    c.iterations = a.iterations.unwrap_or(c.iterations);
    c.seed = a.seed;
    if let Some(factor) = a.albedo_scale {
        c.albedo_scale = AlbedoScale::Factor(factor);
    }
    config.grey_card = a.grey_card.as_ref().map(|g| decompose::GreyCard {
        view: g.view.clone(),
        x: g.x,
        y: g.y,
        albedo: g.albedo,
    });
    config.time_budget_s = a.time_budget;
    config.max_width = a.max_width;
    config.resume = if a.resume { reconstruct::Resume::Expected } else { reconstruct::Resume::Never };
    let made = decompose::run(&input, &config, context)?;
    say!("{}", made.asset.display());
    Ok(())
}

fn run_place(a: &args::Place, context: &Context<'_>) -> anyhow::Result<()> {
    let at = match (&a.at, &a.pixel) {
        (Some(p), _) => place::At::Point(*p),
        (None, Some(p)) => place::At::Pixel { view: p.view.clone(), x: p.x, y: p.y },
        (None, None) => bail!("one of --at and --pixel is needed"),
    };
    let input = place::Input {
        scene: a.scene.clone(),
        object: a.object.clone(),
        cameras: a.cameras.clone(),
        output: a.output.clone(),
    };
    let placed = place::run(&input, &place::Config { at, size: a.size, yaw_deg: a.yaw }, context)?;
    say!("base    {:.4}", placed.base);
    say!("size    {:.4} ({})", placed.size, placed.size_reason);
    if let Some(normal) = placed.report.ground_normal {
        say!(
            "ground  normal {normal:.3}, under {:.0} % of the footprint",
            100.0 * placed.report.ground_coverage
        );
    }
    if let Some(gap) = placed.report.gap {
        say!("gap     {gap:+.4} (base over ground)");
    }
    say!("{}", a.output.display());
    Ok(())
}

fn run_relight(a: &args::Relight, context: &Context<'_>) -> anyhow::Result<()> {
    let views = match (&a.cameras, a.turntable) {
        (Some(path), _) => relight::Views::Cameras(path.clone()),
        (None, Some(count)) => relight::Views::Turntable(count),
        (None, None) => bail!("one of --cameras and --turntable is needed"),
    };
    let input =
        relight::Input { asset: a.asset.clone(), light: a.env.clone(), views, output: a.output.clone() };
    let config = relight::Config {
        quality: a.quality.into(),
        rays: a.rays,
        visibility: match a.visibility {
            args::SelfShadow::Mixed => relight::Visibility::Mixed,
            args::SelfShadow::Probes => relight::Visibility::Probes,
            args::SelfShadow::Trace => relight::Visibility::Trace,
            args::SelfShadow::None => relight::Visibility::None,
        },
        indirect: a.indirect,
        layers: a.layers,
        background: a.background,
        size: [a.size.0, a.size.1],
        seed: a.seed,
    };
    let made = relight::run(&input, &config, context)?;
    say!("{}", made.frames.display());
    if let Some(preview) = &made.preview {
        say!("{}", preview.display());
    }
    Ok(())
}

fn run_compose(a: &args::Compose, context: &Context<'_>) -> anyhow::Result<()> {
    let input = compose::Input {
        scene: a.scene.clone(),
        objects: a.objects.clone(),
        transform: a.transform.clone(),
        cameras: a.cameras.clone(),
        light: a.light.clone(),
        truth: a.against.clone(),
        output: a.output.clone(),
    };
    let config = compose::Config {
        layers: a.layers,
        shadow: !a.no_shadow,
        shadow_rays: a.shadow_rays,
        denoise: !a.no_denoise,
        split_order: !a.depth_test,
        seed: a.seed,
        reconstruct: reconstruct::Config {
            quality: a.quality.into(),
            time_budget_s: a.time_budget,
            seed: a.seed,
            ..reconstruct::Config::default()
        },
    };
    let made = compose::run(&input, &config, context)?;
    if let Some(evaluation) = &made.evaluation {
        say!("{}", evaluation.to_text());
    }
    say!("{}", made.frames.display());
    say!("{}", made.report.display());
    Ok(())
}

fn run_material(a: &args::Material, context: &Context<'_>) -> anyhow::Result<()> {
    let input = material::Input { asset: a.asset.clone(), output: a.output.clone() };
    let config = material::Config {
        preset: a.preset.map(Into::into),
        albedo: a.albedo,
        roughness: a.roughness,
        metallic: a.metallic,
    };
    say!("{}", material::run(&input, &config, context)?.asset.display());
    Ok(())
}

fn run_eval(a: &args::Eval, context: &Context<'_>) -> anyhow::Result<()> {
    let input = eval::Input {
        subject: a.subject.clone(),
        against: a.against.clone(),
        relit: a.relit.clone(),
        json: a.json.clone(),
    };
    write(format_args!("{}", eval::run(&input, context)?.to_text()));
    Ok(())
}

fn run_ablate(a: &args::Ablate, context: &Context<'_>) -> anyhow::Result<()> {
    let args::AblateWhat::Decompose(a) = &a.what;
    let words: Vec<String> = std::env::args().skip(1).collect();
    let input = ablate::Input {
        capture: a.capture.clone(),
        asset: a.asset.clone(),
        relit: a.relit.clone(),
        output: a.output.clone(),
        command: format!("comgs {}", words.join(" ")),
    };
    let config = ablate::Config {
        iterations: a.iterations,
        knobs: a.knobs.clone(),
        relit_views: a.relit_views,
        quality: a.quality.into(),
        max_width: 1600,
        seed: a.seed,
    };
    let sweep = ablate::run(&input, &config, context)?;
    say!("{}", sweep.to_markdown()?);
    Ok(())
}

fn run_synth(a: &args::Synth, context: &Context<'_>) -> anyhow::Result<()> {
    if a.recipe == "list" && a.output.is_none() {
        for name in synth::builtin_names() {
            say!("{name}");
        }
        return Ok(());
    }
    let Some(output) = a.output.clone() else {
        let missing = clap::error::ErrorKind::MissingRequiredArgument;
        Cli::command().error(missing, "-o ROOT is needed (or `comgs synth list` for the names)").exit()
    };
    let overrides = comgs_synth::Overrides {
        object_size: a.object_size,
        scene_size: a.scene_size,
        train_views: a.train_views,
        test_views: a.test_views,
        samples: a.samples,
        seed: a.seed,
    };
    synth::run(&synth::Input { recipe: a.recipe.clone(), output: output.clone() }, &overrides, context)?;
    say!("{}", output.display());
    Ok(())
}

fn run_demo(a: &args::Demo, context: &Context<'_>) -> anyhow::Result<()> {
    let assets = match &a.assets {
        Some(folder) => folder.clone(),
        None => demo::find_assets()
            .context("assets/demo was not found in this folder or above it; --assets DIR says where it is")?,
    };
    let input = demo::Input { assets, output: a.output.clone() };
    let config = demo::Config { quality: a.quality.into(), seed: a.seed, ..demo::Config::default() };
    let made = demo::run(&input, &config, context)?;
    for evaluation in
        [Some(&made.object), Some(&made.scene), made.compose.evaluation.as_ref(), Some(&made.relit_scores)]
            .into_iter()
            .flatten()
    {
        say!("{}", evaluation.to_text());
    }
    say!("The pictures:");
    say!("  {}", made.compose.report.display());
    say!("  {}", made.compose.frames.display());
    say!("  {}", a.output.join("composed").join("preview.gif").display());
    say!("  {}", made.relit.frames.display());
    say!("  {}", made.hero.display());
    Ok(())
}

fn run_export(a: &args::Export, context: &Context<'_>) -> anyhow::Result<()> {
    let input = export::Input { asset: a.asset.clone(), output: a.output.clone() };
    let made = export::run(&input, &export::Config { viewer: a.viewer }, context)?;
    say!("{}", made.ply.display());
    Ok(())
}

/// Looks at every path; one that cannot be understood does not hide what the others hold.
fn run_info(a: &args::Info) -> ExitCode {
    let mut code = ExitCode::SUCCESS;
    for path in &a.paths {
        match info::run(path) {
            Ok(info) => write(format_args!("{}", info.to_text())),
            Err(error) => code = crate::fail(&error.into()),
        }
    }
    code
}
