//! `comgs tradeoff`.

use crate::args;
use crate::output::say;
use comgs_pipeline::Context;
use comgs_pipeline::stages::{tradeoff_reconstruct, tradeoff_relight, tradeoff_shadow};

pub(super) fn run(a: &args::Tradeoff, context: &Context<'_>) -> anyhow::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let command = format!("comgs {}", words.join(" "));
    let made = match &a.what {
        args::TradeoffWhat::Shadow(a) => {
            let input = tradeoff_shadow::Input {
                composition: a.composition.clone(),
                truth: a.against.clone(),
                output: a.output.clone(),
                command,
            };
            let config = tradeoff_shadow::Config {
                knobs: a.knobs.clone(),
                views: a.views,
                reference_rays: a.reference_rays,
                repeats: a.repeats,
                seed: a.seed,
            };
            tradeoff_shadow::run(&input, &config, context)?
        }
        args::TradeoffWhat::Relight(a) => {
            let input = tradeoff_relight::Input {
                composition: a.composition.clone(),
                truth: a.against.clone(),
                output: a.output.clone(),
                command,
            };
            let config = tradeoff_relight::Config {
                knobs: a.knobs.clone(),
                views: a.views,
                reference_rays: a.reference_rays,
                repeats: a.repeats,
                seed: a.seed,
            };
            tradeoff_relight::run(&input, &config, context)?
        }
        args::TradeoffWhat::Reconstruct(a) => {
            let input = tradeoff_reconstruct::Input {
                capture: a.capture.clone(),
                output: a.output.clone(),
                assets: a.assets.clone().unwrap_or_else(|| a.output.join("assets")),
                command,
            };
            let config = tradeoff_reconstruct::Config {
                knobs: a.knobs.clone(),
                iterations: a.iterations,
                width: a.width,
                surfels: a.surfels,
                repeats: a.repeats,
                seed: a.seed,
            };
            tradeoff_reconstruct::run(&input, &config, context)?
        }
    };
    say!("{}", made.to_markdown()?);
    Ok(())
}
