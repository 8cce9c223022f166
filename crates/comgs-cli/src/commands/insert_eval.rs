//! The benchmark of insertions.

use crate::args;
use crate::output::{say, write};
use comgs_pipeline::Context;
use comgs_pipeline::stages::insert_eval;

pub(super) fn run(a: &args::InsertEval, context: &Context<'_>) -> anyhow::Result<()> {
    let config = insert_eval::Config {
        count: a.count,
        unseen: a.unseen,
        iterations: a.iterations,
        seed: a.seed,
        ..insert_eval::Config::default()
    };
    let mut command =
        format!("comgs insert-eval {} --count {} --unseen {}", name(&a.maps), a.count, a.unseen);
    if let Some(model) = &a.model {
        command.push_str(&format!(" --model {}", name(model)));
    }
    let (maps, model) = (a.maps.clone(), a.model.clone());
    let input = insert_eval::Input { maps, model, output: a.output.clone(), command };
    let made = insert_eval::run(&input, &config, context)?;
    write(format_args!("{}", std::fs::read_to_string(&made.table)?));
    say!("{}", made.table.display());
    Ok(())
}

/// The last part of a path: captions name no folders of anybody's machine.
fn name(path: &std::path::Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}
