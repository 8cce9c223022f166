//! The commands about light.

use crate::args;
use crate::output::{say, write};
use anyhow::bail;
use comgs_metrics::spheres::Protocol;
use comgs_pipeline::Context;
use comgs_pipeline::stages::completers::{Fill, ModelConfig};
use comgs_pipeline::stages::{light, model, panorama, panorama_eval};

impl From<args::Completion> for Fill {
    fn from(completion: args::Completion) -> Self {
        match completion {
            args::Completion::Diffusion => Self::Diffusion,
            args::Completion::Harmonic => Self::Harmonic,
            args::Completion::Sh => Self::Sh,
            args::Completion::Constant => Self::Constant,
            args::Completion::None => Self::None,
        }
    }
}

impl From<&args::Model> for ModelConfig {
    fn from(a: &args::Model) -> Self {
        Self {
            model: a.model.clone(),
            onnxruntime: a.onnxruntime.clone(),
            steps: a.steps.map(|n| n as usize),
            samples: a.samples as usize,
            seed: a.seed,
            fallback: a.fallback.map(Into::into),
        }
    }
}

pub(super) fn run_light(a: &args::Light, context: &Context<'_>) -> anyhow::Result<()> {
    let (at, size) = match (&a.at, &a.transform) {
        (Some(at), _) => (*at, 0.0),
        (None, Some(transform)) => light::placed(transform, a.object.as_deref())?,
        (None, None) => bail!("one of --at and --transform is needed"),
    };
    let input = light::Input { scene: a.scene.clone(), output: a.output.clone(), report: a.report.clone() };
    let config = light::Config {
        completion: a.completion.into(),
        model: (&a.model).into(),
        evidence: a.evidence == args::Switch::On,
        height: a.height,
        near: a.near.unwrap_or(0.5 * size),
        ..light::Config::at(at.into())
    };
    let made = light::run(&input, &config, context)?;
    say!("seen    {:.1} % of the sphere", 100.0 * made.coverage);
    for path in [&made.environment, &made.pictures.environment, &made.pictures.sweep, &made.pictures.alpha] {
        say!("{}", path.display());
    }
    Ok(())
}

pub(super) fn run_panorama(a: &args::Panorama, context: &Context<'_>) -> anyhow::Result<()> {
    match &a.what {
        args::PanoramaWhat::Complete(a) => {
            let input = panorama::Input {
                partial: a.input.clone(),
                mask: a.mask.clone(),
                normals: a.normals.clone(),
                output: a.output.clone(),
            };
            let config = panorama::Config { completion: a.completion.into(), model: (&a.model).into() };
            let made = panorama::run(&input, &config, context)?;
            say!("known   {:.1} % of the sphere", 100.0 * made.coverage);
            say!("by      {}", made.by);
            say!("{}", made.environment.display());
            say!("{}", made.picture.display());
        }
        args::PanoramaWhat::Eval(a) => {
            let input =
                panorama_eval::Input { maps: a.maps.clone(), masks: a.masks.clone(), bank: a.bank.clone() };
            let config = panorama_eval::Config {
                held_out: a.held_out,
                protocol: match a.protocol {
                    args::SphereProtocol::Linear => Protocol::Linear,
                    args::SphereProtocol::Legacy => Protocol::Legacy,
                },
                height: 64,
                model: (&a.model).into(),
                more_steps: a.more_steps.clone(),
                more_samples: a.more_samples.clone(),
                model_only: a.model_only,
                representations: a.representations,
            };
            let lines = panorama_eval::run(&input, &config, context)?;
            if let Some(path) = &a.json {
                comgs_pipeline::record::write_json(path, &lines)?;
            }
            write(format_args!("{}", panorama_eval::to_markdown(&lines)));
        }
    }
    Ok(())
}

pub(super) fn run_model(a: &args::ModelCommand, context: &Context<'_>) -> anyhow::Result<()> {
    let args::ModelWhat::Check(a) = &a.what;
    write(format_args!("{}", model::run(a.bundle.as_deref(), a.onnxruntime.clone(), context)?));
    Ok(())
}
