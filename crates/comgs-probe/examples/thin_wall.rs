//! What leaks through a wall that is thinner than the probes are apart, by offset and visibility weight.
//!
//! ```text
//! cargo run --release -p comgs-probe --example thin_wall -- [probes] [rays a texel]
//! ```
//!
//! The wall is 1 wide, 1 high and has a bright and a dark face. Shading points of the dark face look into empty space:
//! whatever they get has leaked from the probes of the bright face or from inside the wall.

#[path = "../tests/probes/support.rs"]
mod support;
#[path = "../tests/probes/wall.rs"]
mod wall;

use comgs_probe::{ProbeConfig, VisibilityWeight};

fn main() {
    let argument = |i: usize, or: usize| std::env::args().nth(i).and_then(|s| s.parse().ok()).unwrap_or(or);
    let (count, rays) = (argument(1, 500), argument(2, 1));
    println!("{count} probes, {rays} rays a texel");
    println!("  thickness  offset  visibility             occlusion  radiance  other face     lost");
    for thickness in [0.005, 0.02] {
        for offset in [0.0, 0.01, 0.02] {
            for (name, visibility, bias) in [
                ("None", VisibilityWeight::None, 1.0),
                ("Chebyshev, no bias", VisibilityWeight::Chebyshev, 0.0),
                ("Chebyshev", VisibilityWeight::Chebyshev, 1.0),
            ] {
                let config = ProbeConfig { count, offset, visibility, ..ProbeConfig::default() };
                let leak = wall::leak(&config, thickness, rays, |lookup| lookup.normal_bias *= bias);
                println!(
                    "  {thickness:>9} {:>5.0} %  {name:<20} {:>11.4} {:>9.4} {:>11.4} {:>8.4}",
                    100.0 * offset,
                    leak.occlusion,
                    leak.radiance,
                    leak.weight,
                    leak.lost
                );
            }
        }
    }
}
