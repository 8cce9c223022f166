//! Renders a built-in recipe, or a recipe file, into a folder: `render_recipe <name|file.json> <folder> [samples]`.

use comgs_synth::{Overrides, Recipe, builtin, write_root};
use std::ops::ControlFlow;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, name, folder, rest @ ..] = &arguments[..] else {
        return Err("usage: render_recipe <name|file.json> <folder> [samples]".into());
    };
    let recipe = if name.ends_with(".json") {
        Recipe::from_json(&std::fs::read_to_string(name)?)?
    } else {
        builtin::recipe(name)?
    };
    let samples = rest.first().map(|s| s.parse()).transpose()?;
    let recipe = recipe.with(&Overrides { samples, ..Overrides::default() });
    let mut last = -1;
    let summary = write_root(&recipe, Path::new(folder), &mut |progress| {
        let percent = (100.0 * progress.fraction) as i32;
        if percent != last {
            eprint!("\r{percent:3} %  {:<60}", progress.doing);
            last = percent;
        }
        ControlFlow::Continue(())
    })?;
    eprintln!();
    println!(
        "{} files, {:.1} million paths in {:.1} s: {:.2} million paths a second",
        summary.files,
        summary.paths * 1e-6,
        summary.seconds,
        summary.paths * 1e-6 / summary.seconds
    );
    Ok(())
}
