//! Panoramas of procedural rooms and grounds, for training and judging a completer.
//!
//! ```text
//! cargo run --release -p comgs-synth --example panoramas -- OUT FIRST COUNT [HEIGHT [SAMPLES]]
//! ```
//!
//! Writes for each seed from FIRST on `NNNNN.exr` (radiance), `NNNNN_normal.exr` and `NNNNN_seen.png` (white where the
//! place's cameras looked). What is there already is left alone, so that an interrupted run goes on where it was.

use comgs_image::transfer::linear_from_srgb;
use comgs_image::{write_exr, write_png};
use comgs_synth::places::Place;
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [out, first, count, rest @ ..] = arguments.as_slice() else {
        return Err("usage: panoramas OUT FIRST COUNT [HEIGHT [SAMPLES]]".into());
    };
    let (first, count): (u64, u64) = (first.parse()?, count.parse()?);
    let height = rest.first().map_or(Ok(64), |v| v.parse())?;
    let samples = rest.get(1).map_or(Ok(64), |v| v.parse())?;
    std::fs::create_dir_all(out)?;
    for seed in first..first + count {
        let path = Path::new(out).join(format!("{seed:05}.exr"));
        if path.exists() {
            continue;
        }
        let around = Place::from_seed(seed).surroundings(height, samples, seed);
        write_exr(&path.with_file_name(format!("{seed:05}_normal.exr")), &around.normal)?;
        let code = around.seen.map(linear_from_srgb);
        write_png(&path.with_file_name(format!("{seed:05}_seen.png")), &code)?;
        // Last: a panorama that is there is whole.
        write_exr(&path, &around.radiance)?;
    }
    Ok(())
}
