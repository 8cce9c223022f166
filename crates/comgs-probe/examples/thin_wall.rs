//! What leaks through a wall that is thinner than the probes are apart.
//!
//! ```text
//! cargo run --release -p comgs-probe --example thin_wall
//! ```
//!
//! The wall is 1 wide, 1 high and has a bright and a dark face with 500 probes on both together. Shading points of the
//! dark face look into empty space: whatever they get has leaked from the probes of the bright face.

#[path = "../tests/support/mod.rs"]
mod support;
#[path = "../tests/support/wall.rs"]
mod wall;

use comgs_probe::{ProbeConfig, VisibilityWeight};

fn main() {
    for rays in [1, 4] {
        for thickness in [0.005, 0.02] {
            println!(
                "\nwall of {thickness}, {rays} rays a texel: occlusion, radiance, weight of the other face, lost"
            );
            for offset in [0.0, 0.01, 0.02] {
                for visibility in [VisibilityWeight::None, VisibilityWeight::Chebyshev] {
                    let config = ProbeConfig { count: 500, offset, visibility, ..ProbeConfig::default() };
                    for (deviation, bias, far) in [
                        (1.0, 1.0, 1.5),
                        (1.0, 0.0, 1.5),
                        (1.0, 2.0, 1.5),
                        (0.3, 1.0, 1.5),
                        (3.0, 1.0, 1.5),
                        (1.0, 1.0, 1.05),
                        (1.0, 1.0, 3.0),
                    ] {
                        let config = ProbeConfig { far, ..config.clone() };
                        let leak = wall::leak(&config, thickness, rays, |lookup| {
                            lookup.min_deviation *= deviation;
                            lookup.normal_bias *= bias;
                        });
                        println!(
                            "  {:>3.0} % {:<10} dev {deviation:.1} bias {bias:.1} far {far:.2} {:>8.4} {:>8.4} {:>8.4} {:>8.4}",
                            100.0 * offset,
                            format!("{visibility:?}"),
                            leak.occlusion,
                            leak.radiance,
                            leak.weight,
                            leak.lost
                        );
                        if visibility == VisibilityWeight::None {
                            break;
                        }
                    }
                }
            }
        }
    }
}
