//! The two built-in scenes. Every surface has a pattern or grain: photographs have, and reconstruction needs it.

use crate::builtin::{forenoon, hex, part, turned};
use crate::light::Light;
use crate::material::{Finish, Material, Pattern};
use crate::recipe::{PartRecipe, SceneRecipe, ViewPlan};
use crate::rig::SceneRig;
use crate::shape::{Limb, Shape};
use comgs_geom::Rng;

fn block(size: [f32; 3], rounding: f32, material: &Material, at: [f32; 3]) -> PartRecipe {
    part(Shape::Box { size, rounding }, material.clone(), at)
}

fn rectangle(size: [f32; 2], material: &Material, at: [f32; 3], turn_deg: [f32; 3]) -> PartRecipe {
    turned(part(Shape::Rectangle { size }, material.clone(), at), turn_deg)
}

fn lathe(profile: &[[f32; 2]], smooth: bool, material: &Material, at: [f32; 3]) -> PartRecipe {
    part(Shape::Lathe { profile: profile.to_vec(), smooth }, material.clone(), at)
}

fn wood(dark: u32, light: u32) -> Material {
    Material::mixed(hex(dark), hex(light), 0.5, Pattern::Planks { width: 0.11, length: 1.3, gap: 0.006 })
        .grainy(0.12, 0.04)
}

/// A bush of overlapping balls.
fn bush(seed: u64, radius: f32, at: [f32; 3]) -> PartRecipe {
    let mut rng = Rng::stream(seed, 0x6275_7368);
    let limbs = (0..26)
        .map(|_| {
            let d = comgs_geom::sampling::uniform_sphere(glam::Vec2::new(rng.uniform(), rng.uniform()));
            let p = (d * rng.range(0.35, 0.85) * radius).to_array();
            let r = radius * rng.range(0.16, 0.3);
            Limb { from: p, to: p, radius: [r, r] }
        })
        .collect();
    let leaves = Material::mixed(
        hex(0x2f5a24),
        hex(0x86a63e),
        0.6,
        Pattern::Noise { size: 0.07 * radius / 0.3, contrast: 2.4 },
    )
    .grainy(0.5, 0.03);
    part(Shape::Blob { limbs, blend: 0.03, cells: 48 }, leaves, at)
}

fn pot(height: f32, radius: f32, at: [f32; 3]) -> PartRecipe {
    let clay =
        Material::mixed(hex(0xa8552f), hex(0xc9805a), 0.7, Pattern::Noise { size: 0.12, contrast: 1.4 })
            .grainy(0.18, 0.02);
    let (r, h) = (radius, height);
    lathe(
        &[
            [0.0, 0.0],
            [0.7 * r, 0.0],
            [0.92 * r, 0.82 * h],
            [r, 0.82 * h],
            [r, h],
            [0.86 * r, h],
            [0.84 * r, 0.88 * h],
            [0.0, 0.88 * h],
        ],
        false,
        &clay,
        at,
    )
}

/// An open courtyard in the forenoon sun: paving, brick walls, a round table, plants.
#[must_use]
pub(crate) fn courtyard(views: ViewPlan) -> SceneRecipe {
    let paving = Material::mixed(
        hex(0x8d8377),
        hex(0xc2b7a4),
        0.75,
        Pattern::Tiles { size: [0.62, 0.42], gap: 0.022, shift: 0.5 },
    )
    .grainy(0.2, 0.09)
    .lambert();
    let lawn =
        Material::mixed(hex(0x3f6b2c), hex(0x83983f), 0.9, Pattern::Noise { size: 0.5, contrast: 1.6 })
            .grainy(0.45, 0.08)
            .lambert();
    let brick = Material::mixed(
        hex(0x8b4630),
        hex(0xbd7650),
        0.85,
        Pattern::Tiles { size: [0.3, 0.11], gap: 0.016, shift: 0.5 },
    )
    .grainy(0.22, 0.03)
    .lambert();
    let stone =
        Material::mixed(hex(0x9c9488), hex(0xcfc7b7), 0.7, Pattern::Noise { size: 0.2, contrast: 1.2 })
            .grainy(0.15, 0.03);
    let table = wood(0x6b4426, 0xb07b4a);

    let mut parts = vec![
        rectangle([80.0, 80.0], &lawn, [0.0, 0.0, -0.03], [0.0; 3]),
        block([7.6, 7.6, 0.1], 0.0, &paving, [0.0, 0.0, -0.05]),
    ];
    // Two walls in an L with coping stones; each is laid along its own x and stood up, so the bricks lie level.
    let wall = |length: f32, at: [f32; 3], yaw: f32| {
        [
            turned(block([length, 1.7, 0.24], 0.0, &brick, [at[0], at[1], 0.85]), [90.0, 0.0, yaw]),
            turned(block([length + 0.08, 0.34, 0.09], 0.02, &stone, [at[0], at[1], 1.745]), [0.0, 0.0, yaw]),
        ]
    };
    parts.extend(wall(7.3, [-3.4, 0.0, 0.0], 90.0));
    parts.extend(wall(6.5, [0.0, 3.4, 0.0], 0.0));
    // Low balustrade on the other two sides.
    for (x, y, length, yaw) in [(3.5, 0.0, 6.6, 90.0), (0.0, -3.5, 6.6, 0.0)] {
        parts.push(turned(block([length, 0.22, 0.42], 0.03, &stone, [x, y, 0.21]), [0.0, 0.0, yaw]));
    }

    // The table: boards on a turned foot.
    let foot = [
        [0.0, 0.0],
        [0.34, 0.0],
        [0.36, 0.05],
        [0.16, 0.14],
        [0.10, 0.35],
        [0.15, 0.58],
        [0.34, 0.70],
        [0.0, 0.72],
    ];
    parts.push(lathe(&foot, true, &stone, [0.0; 3]));
    parts.push(lathe(
        &[[0.0, 0.72], [0.60, 0.72], [0.62, 0.735], [0.62, 0.765], [0.60, 0.78], [0.0, 0.78]],
        false,
        &table,
        [0.0; 3],
    ));
    // A bowl with fruit and a cup on it.
    let glaze = Material::mixed(
        hex(0x2f6f8f),
        hex(0xe6ded0),
        0.4,
        Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.05, wobble: 0.1 },
    );
    let bowl = [
        [0.0, 0.0],
        [0.07, 0.0],
        [0.08, 0.015],
        [0.15, 0.05],
        [0.18, 0.10],
        [0.18, 0.10],
        [0.165, 0.10],
        [0.165, 0.10],
        [0.13, 0.055],
        [0.0, 0.03],
    ];
    parts.push(lathe(&bowl, true, &glaze, [-0.36, 0.30, 0.78]));
    for (x, y, z, r, color, other) in [
        (-0.40, 0.26, 0.865, 0.052, 0xc8342a, 0xe0a03a),
        (-0.31, 0.29, 0.865, 0.050, 0xe0862a, 0xeaa544),
        (-0.37, 0.36, 0.870, 0.053, 0x8fae3c, 0xc5c957),
        (-0.36, 0.30, 0.945, 0.048, 0xd9b23a, 0xe0c96a),
    ] {
        let skin = Material::mixed(hex(color), hex(other), 0.4, Pattern::Noise { size: 0.05, contrast: 1.4 })
            .grainy(0.1, 0.01);
        parts.push(part(Shape::Sphere { radius: r }, skin, [x, y, z]));
    }
    let cup =
        [[0.0, 0.0], [0.045, 0.0], [0.055, 0.02], [0.055, 0.11], [0.048, 0.11], [0.045, 0.02], [0.0, 0.015]];
    parts.push(lathe(
        &cup,
        false,
        &Material::plain(hex(0xd8cdbb), 0.35, 0.0).grainy(0.15, 0.03),
        [0.42, 0.24, 0.78],
    ));

    // Plants along the walls, and crates, a bench, a ball.
    for (i, (x, y, h, r)) in
        [(-2.8, 2.75, 0.55, 0.36), (-2.85, -0.5, 0.45, 0.3), (0.9, 2.9, 0.5, 0.32), (2.75, -2.7, 0.55, 0.36)]
            .into_iter()
            .enumerate()
    {
        parts.push(pot(h, r, [x, y, 0.0]));
        parts.push(bush(i as u64 + 3, 1.25 * r, [x, y, h + 0.8 * r]));
    }
    let crate_wood = wood(0x7d5a35, 0xc29a63);
    for (x, y, z, size, yaw) in
        [(2.45, 2.3, 0.3, 0.6, 14.0), (2.4, 2.35, 0.8, 0.4, 40.0), (1.85, 2.75, 0.2, 0.4, -20.0)]
    {
        parts.push(turned(block([size; 3], 0.015, &crate_wood, [x, y, z]), [0.0, 0.0, yaw]));
    }
    let bench = wood(0x54606b, 0x8d9aa3);
    parts.push(turned(block([1.5, 0.42, 0.05], 0.01, &bench, [-2.55, 1.1, 0.45]), [0.0, 0.0, 90.0]));
    for y in [0.5, 1.7] {
        parts.push(block([0.36, 0.1, 0.43], 0.01, &stone, [-2.55, y, 0.215]));
    }
    let ball = Material::mixed(
        hex(0xc23b2e),
        hex(0xf0e6d2),
        0.4,
        Pattern::Stripes { axis: [0.3, 0.2, 0.93], period: 0.16, wobble: 0.0 },
    );
    parts.push(part(Shape::Sphere { radius: 0.24 }, ball, [1.35, -1.25, 0.24]));
    // Columns at the open corners.
    let column = Material::mixed(
        hex(0xb9ae9c),
        hex(0xe0d7c6),
        0.7,
        Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.5, wobble: 0.1 },
    )
    .grainy(0.18, 0.05);
    let shaft = [
        [0.0, 0.0],
        [0.24, 0.0],
        [0.24, 0.12],
        [0.17, 0.16],
        [0.14, 2.0],
        [0.2, 2.05],
        [0.24, 2.2],
        [0.0, 2.2],
    ];
    for (x, y) in [(3.3, 3.3), (-3.3, -3.3)] {
        parts.push(lathe(&shaft, false, &column, [x, y, 0.0]));
    }
    SceneRecipe {
        name: "courtyard".into(),
        parts,
        light: forenoon(),
        views,
        rig: SceneRig {
            centre: [0.0, 0.0, 0.85],
            radii: [2.8, 2.8, 2.1],
            elevation_deg: [8.0, 52.0],
            hfov_deg: 64.0,
        },
    }
}

/// A furnished room without a ceiling: sun and sky come in from above, a lamp burns in the corner.
#[must_use]
pub(crate) fn room(views: ViewPlan) -> SceneRecipe {
    let floor = Material::mixed(
        hex(0x6e4a2e),
        hex(0xb98d60),
        0.5,
        Pattern::Planks { width: 0.16, length: 1.5, gap: 0.006 },
    )
    .grainy(0.1, 0.04);
    let plaster = |color, other| {
        Material::mixed(hex(color), hex(other), 0.9, Pattern::Noise { size: 0.35, contrast: 1.0 })
            .grainy(0.08, 0.03)
            .lambert()
    };
    let tiles = |color, other| {
        Material::mixed(
            hex(color),
            hex(other),
            0.9,
            Pattern::Tiles { size: [0.42, 0.42], gap: 0.014, shift: 0.0 },
        )
        .grainy(0.08, 0.05)
        .lambert()
    };
    let outside =
        Material::mixed(hex(0x5f7a3c), hex(0x8d9a55), 0.9, Pattern::Noise { size: 0.6, contrast: 1.5 })
            .grainy(0.3, 0.1)
            .lambert();
    let (half, height) = (2.6, 2.3);
    let mut parts = vec![
        rectangle([60.0, 60.0], &outside, [0.0, 0.0, -0.05], [0.0; 3]),
        block([2.0 * half, 2.0 * half, 0.1], 0.0, &floor, [0.0, 0.0, -0.05]),
    ];
    // Four walls as slabs laid on their backs and stood up, a dado on each.
    for (k, (color, other)) in
        [(0xd9cdb4, 0xe6dcc8), (0x9fb2a5, 0xb9c7b8), (0xd9cdb4, 0xe6dcc8), (0xc9a68a, 0xd8bca2)]
            .into_iter()
            .enumerate()
    {
        let yaw = 90.0 * k as f32;
        let (s, c) = yaw.to_radians().sin_cos();
        let at = |distance: f32, z: f32| [-s * distance, c * distance, z];
        let wall = block(
            [2.0 * half + 0.2, height, 0.1],
            0.0,
            &plaster(color, other),
            at(half + 0.05, 0.5 * height),
        );
        parts.push(turned(wall, [90.0, 0.0, yaw]));
        let dado = block([2.0 * half, 0.8, 0.04], 0.0, &tiles(0x6d7f86, 0x93a3a6), at(half - 0.02, 0.4));
        parts.push(turned(dado, [90.0, 0.0, yaw]));
    }
    // Pictures on the walls.
    let frame = wood(0x3a2618, 0x5d4028);
    let pictures = [
        (0.0, -0.9, [0.9, 0.62], Pattern::Checker { size: 0.13 }, 0x274b6d, 0xe3d3ad),
        (0.0, 0.8, [0.6, 0.6], Pattern::Spots { size: 0.2, radius: 0.48 }, 0xe7d9b5, 0xb5432f),
        (90.0, 0.3, [1.1, 0.6], Pattern::Noise { size: 0.25, contrast: 3.0 }, 0x2d5a6b, 0xe0b15a),
        (
            180.0,
            -0.4,
            [0.8, 0.6],
            Pattern::Stripes { axis: [0.7, 0.7, 0.0], period: 0.2, wobble: 0.5 },
            0x7a2f3d,
            0xe9dcc3,
        ),
        (270.0, 0.5, [0.7, 0.7], Pattern::Wood { rings: 0.06 }, 0x31543d, 0xd7d2a8),
    ];
    for (yaw, along, size, pattern, a, b) in pictures {
        let yaw: f32 = yaw;
        let (s, c) = yaw.to_radians().sin_cos();
        let at = |d: f32| [-s * d + c * along, c * d + s * along, 1.45];
        let canvas = Material::mixed(hex(a), hex(b), 0.8, pattern).lambert();
        let stand = |p: PartRecipe| turned(p, [90.0, 0.0, yaw]);
        parts.push(stand(block([size[0] + 0.1, size[1] + 0.1, 0.04], 0.008, &frame, at(half - 0.02))));
        parts.push(stand(block([size[0], size[1], 0.02], 0.0, &canvas, at(half - 0.045))));
    }
    // A rug, a low table, a sofa, a shelf with books, a lamp, a plant.
    let rug = Material::mixed(
        hex(0x8f2f2b),
        hex(0xe0cda2),
        0.95,
        Pattern::Stripes { axis: [0.7, 0.7, 0.0], period: 0.32, wobble: 0.35 },
    )
    .grainy(0.25, 0.02)
    .lambert();
    parts.push(block([2.5, 1.8, 0.02], 0.0, &rug, [0.0, -0.1, 0.01]));
    let oak = wood(0x7b5231, 0xc08b55);
    parts.push(block([1.06, 0.64, 0.06], 0.015, &oak, [0.0, -0.1, 0.43]));
    for (x, y) in [(-0.45, -0.34), (0.45, -0.34), (-0.45, 0.14), (0.45, 0.14)] {
        parts.push(block([0.07, 0.07, 0.4], 0.01, &oak, [x, y, 0.2]));
    }
    let book = |color, size, at, yaw| {
        let cover = Material::plain(hex(color), 0.6, 0.0).grainy(0.25, 0.03);
        turned(block(size, 0.004, &cover, at), [0.0, 0.0, yaw])
    };
    parts.push(book(0x2f4f7a, [0.26, 0.19, 0.035], [-0.33, -0.26, 0.4775], 20.0));
    parts.push(book(0xc8963c, [0.22, 0.16, 0.03], [-0.34, -0.25, 0.51], -8.0));
    let glaze = Material::mixed(
        hex(0x3c7d74),
        hex(0xd8d3bd),
        0.35,
        Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.06, wobble: 0.1 },
    );
    let bowl = [
        [0.0, 0.0],
        [0.06, 0.0],
        [0.07, 0.01],
        [0.14, 0.045],
        [0.16, 0.08],
        [0.16, 0.08],
        [0.145, 0.08],
        [0.145, 0.08],
        [0.11, 0.05],
        [0.0, 0.025],
    ];
    parts.push(lathe(&bowl, true, &glaze, [-0.30, 0.05, 0.46]));
    let cloth =
        Material::mixed(hex(0x41617d), hex(0x6a8aa3), 0.95, Pattern::Noise { size: 0.12, contrast: 1.3 })
            .grainy(0.25, 0.02)
            .lambert();
    let (sx, sy) = (0.1, 1.9);
    parts.push(block([2.0, 0.8, 0.26], 0.06, &cloth, [sx, sy, 0.25]));
    parts.push(block([2.0, 0.22, 0.55], 0.08, &cloth, [sx, sy + 0.33, 0.55]));
    for side in [-1.0, 1.0] {
        parts.push(block([0.2, 0.8, 0.34], 0.07, &cloth, [sx + 1.02 * side, sy, 0.42]));
    }
    for (x, color, other, yaw) in [(-0.6, 0xc9803a, 0xead9b0, 12.0), (0.75, 0x8c2f39, 0xd9a0a0, -15.0)] {
        let cushion = Material::mixed(hex(color), hex(other), 0.9, Pattern::Checker { size: 0.09 }).lambert();
        parts.push(turned(
            block([0.42, 0.14, 0.4], 0.065, &cushion, [sx + x, sy + 0.1, 0.57]),
            [-18.0, 0.0, yaw],
        ));
    }
    shelf(&mut parts, &frame);
    let brass = Material::plain(hex(0xc9a24e), 0.35, 1.0);
    parts.push(part(Shape::Cylinder { radius: 0.16, height: 0.03 }, brass.clone(), [2.1, 2.1, 0.015]));
    parts.push(part(Shape::Cylinder { radius: 0.016, height: 1.5 }, brass, [2.1, 2.1, 0.77]));
    let bulb = Material { emission: [9.0, 6.6, 4.2], ..Material::plain([0.8, 0.8, 0.8], 0.8, 0.0).lambert() };
    parts.push(part(Shape::Sphere { radius: 0.15 }, bulb, [2.1, 2.1, 1.62]));
    parts.push(pot(0.45, 0.26, [-2.05, 2.05, 0.0]));
    parts.push(bush(21, 0.42, [-2.05, 2.05, 0.75]));
    SceneRecipe {
        name: "room".into(),
        parts,
        light: Light::Sky {
            zenith: [0.30, 0.42, 0.68],
            horizon: [0.72, 0.76, 0.80],
            ground: [0.22, 0.20, 0.17],
            sun_azimuth_deg: -115.0,
            sun_elevation_deg: 52.0,
            sun_radius_deg: 1.6,
            sun_irradiance: [2.6, 2.35, 2.0],
            clouds: 0.4,
        },
        views,
        rig: SceneRig {
            centre: [0.0, 0.0, 0.6],
            radii: [2.15, 2.15, 1.75],
            elevation_deg: [12.0, 52.0],
            hfov_deg: 64.0,
        },
    }
}

/// A shelf against the wall at −x, filled with books of every colour.
fn shelf(parts: &mut Vec<PartRecipe>, board: &Material) {
    let x = -2.4;
    for z in [0.03, 0.45, 0.87, 1.25] {
        parts.push(block([0.3, 1.6, 0.03], 0.004, board, [x, -0.6, z]));
    }
    for y in [-1.41, 0.21] {
        parts.push(block([0.3, 0.03, 1.27], 0.004, board, [x, y, 0.635]));
    }
    let colors =
        [0x7a2e2e, 0x2e4a7a, 0x3d6b45, 0xb98a3a, 0xd8cdb2, 0x5a3f6b, 0x2f6f73, 0xa85b32, 0x303540, 0x9aa05a];
    let mut rng = Rng::new(77);
    for z in [0.045, 0.465, 0.885] {
        let mut y = -1.37;
        while y < 0.12 {
            let (thickness, height) = (rng.range(0.025, 0.06), rng.range(0.2, 0.33));
            if rng.uniform() < 0.12 {
                y += rng.range(0.05, 0.16);
                continue;
            }
            let color = hex(colors[rng.below(colors.len())]);
            let spine = Material {
                b: Some(Finish { color: hex(0xd9c48a), roughness: 0.5, metallic: 0.0 }),
                pattern: Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.17, wobble: 0.0 },
                ..Material::plain(color, 0.6, 0.0)
            };
            // Most spines are plain.
            let cover =
                if rng.uniform() < 0.3 { spine } else { Material::plain(color, 0.6, 0.0) }.grainy(0.2, 0.02);
            let depth = rng.range(0.17, 0.23);
            let at = [x - 0.13 + 0.5 * depth, y + 0.5 * thickness, z + 0.5 * height];
            parts.push(block([depth, thickness * 0.94, height], 0.003, &cover, at));
            y += thickness;
        }
    }
}
