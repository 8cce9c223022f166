//! Recipes that need no file: objects, lights and complete roots.

use crate::SynthError;
use crate::builtin_scenes::{courtyard, room};
use crate::light::{Light, SoftBox};
use crate::material::{Finish, Material, Pattern};
use crate::recipe::{CompositionRecipe, NamedLight, ObjectRecipe, PartRecipe, Recipe, ViewPlan};
use crate::rig::ObjectRig;
use crate::shape::{Limb, Placement, Shape};
use comgs_image::transfer::linear_from_srgb;

/// Names of the built-in recipes.
pub const NAMES: [&str; 7] = ["vase", "blob", "knot", "room", "courtyard", "tiny", "micro"];

/// A built-in recipe.
///
/// * `vase`, `blob`, `knot`: one object at 256×256 (48 training, 12 test views), relit under two lights
/// * `room`: a furnished room at 320×180 (60 + 12 views) with the vase on its table
/// * `courtyard`: an open courtyard at 320×180 (60 + 12 views) with the blob and the knot in it
/// * `tiny`: thumbnails of the courtyard and the blob, for trying things out in under a minute
/// * `micro`: the smallest root with every part of the layout, for tests
///
/// # Errors
/// [`SynthError::UnknownBuiltin`] with the names there are.
pub fn recipe(name: &str) -> Result<Recipe, SynthError> {
    let root = |objects, scenes, compositions| Recipe {
        name: name.to_owned(),
        seed: 1,
        environment_height: 256,
        objects,
        scenes,
        compositions,
    };
    let object_views =
        ViewPlan { size: (256, 256), train: 48, test: 12, train_samples: 32, test_samples: 64 };
    let scene_views = ViewPlan { size: (320, 180), train: 60, test: 12, train_samples: 48, test_samples: 96 };
    Ok(match name {
        "vase" => root(vec![vase(object_views)], vec![], vec![]),
        "blob" => root(vec![blob(object_views)], vec![], vec![]),
        "knot" => root(vec![knot(object_views)], vec![], vec![]),
        "room" => root(
            vec![vase(object_views)],
            vec![room(scene_views)],
            vec![standing("room", "vase", [0.12, -0.1, 0.46], 25.0, 0.26, 6, 96)],
        ),
        "courtyard" => root(
            vec![blob(object_views), knot(object_views)],
            vec![courtyard(scene_views)],
            vec![
                standing("courtyard", "blob", [0.12, -0.18, 0.78], 35.0, 0.32, 6, 96),
                standing("courtyard", "knot", [-0.02, -0.2, 0.78], -20.0, 0.34, 6, 96),
            ],
        ),
        "tiny" => {
            let object = ViewPlan { size: (96, 96), train: 24, test: 6, train_samples: 32, test_samples: 64 };
            let scene = ViewPlan { size: (128, 72), train: 24, test: 6, train_samples: 48, test_samples: 64 };
            let mut object = blob(object);
            object.relit.truncate(1);
            Recipe {
                environment_height: 64,
                ..root(
                    vec![object],
                    vec![courtyard(scene)],
                    vec![standing("courtyard", "blob", [0.12, -0.18, 0.78], 35.0, 0.32, 3, 96)],
                )
            }
        }
        "micro" => {
            let object = ViewPlan { size: (40, 40), train: 8, test: 2, train_samples: 16, test_samples: 16 };
            let scene = ViewPlan { size: (48, 27), train: 8, test: 2, train_samples: 16, test_samples: 16 };
            let mut object = blob(object);
            object.relit.truncate(1);
            Recipe {
                environment_height: 32,
                ..root(
                    vec![object],
                    vec![courtyard(scene)],
                    vec![standing("courtyard", "blob", [0.12, -0.18, 0.78], 35.0, 0.32, 1, 16)],
                )
            }
        }
        _ => return Err(SynthError::UnknownBuiltin { name: name.to_owned(), known: NAMES.to_vec() }),
    })
}

fn standing(
    scene: &str,
    object: &str,
    stands_at: [f64; 3],
    yaw_deg: f64,
    scale: f64,
    views: usize,
    samples: u32,
) -> CompositionRecipe {
    let probe_samples = samples / 2;
    CompositionRecipe {
        scene: scene.into(),
        object: object.into(),
        stands_at,
        yaw_deg,
        scale,
        views,
        samples,
        probe_samples,
    }
}

/// Linear colour of an sRGB code `0xRRGGBB`.
pub(crate) fn hex(code: u32) -> [f32; 3] {
    [16, 8, 0].map(|shift| linear_from_srgb((code >> shift & 255) as f32 / 255.0))
}

pub(crate) fn part(shape: Shape, material: Material, at: [f32; 3]) -> PartRecipe {
    PartRecipe { shape, material, placement: Placement { at, ..Placement::default() } }
}

pub(crate) fn turned(part: PartRecipe, turn_deg: [f32; 3]) -> PartRecipe {
    PartRecipe { placement: Placement { turn_deg, ..part.placement }, ..part }
}

/// Soft boxes in a grey room: what a product photographer uses.
#[must_use]
pub fn studio() -> Light {
    let soft_box = |azimuth_deg, elevation_deg, size_deg, radiance| SoftBox {
        azimuth_deg,
        elevation_deg,
        size_deg,
        radiance,
    };
    Light::Studio {
        ambient: [0.28, 0.30, 0.34],
        boxes: vec![
            soft_box(35.0, 45.0, [46.0, 34.0], [9.0, 8.4, 7.4]),
            soft_box(160.0, 25.0, [30.0, 60.0], [2.2, 2.6, 3.4]),
            soft_box(-80.0, 60.0, [24.0, 24.0], [4.0, 4.0, 4.0]),
        ],
    }
}

/// A late afternoon: a low warm sun, long shadows.
#[must_use]
pub fn evening() -> Light {
    Light::Sky {
        zenith: [0.16, 0.26, 0.55],
        horizon: [0.95, 0.72, 0.52],
        ground: [0.16, 0.13, 0.10],
        sun_azimuth_deg: -65.0,
        sun_elevation_deg: 18.0,
        sun_radius_deg: 1.8,
        sun_irradiance: [2.6, 1.7, 0.9],
        clouds: 0.5,
    }
}

/// A clear forenoon with some clouds.
#[must_use]
pub fn forenoon() -> Light {
    Light::Sky {
        zenith: [0.20, 0.36, 0.72],
        horizon: [0.62, 0.70, 0.80],
        ground: [0.22, 0.20, 0.17],
        sun_azimuth_deg: 140.0,
        sun_elevation_deg: 42.0,
        sun_radius_deg: 1.6,
        sun_irradiance: [3.0, 2.75, 2.35],
        clouds: 0.45,
    }
}

fn relit() -> Vec<NamedLight> {
    vec![
        NamedLight { name: "evening".into(), light: evening() },
        NamedLight { name: "studio".into(), light: studio() },
    ]
}

/// A glazed vase with wavy bands and brass rims.
#[must_use]
pub fn vase(views: ViewPlan) -> ObjectRecipe {
    let glaze = Material {
        pattern: Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.34, wobble: 0.18 },
        b: Some(Finish { color: hex(0xe9dcc3), roughness: 0.42, metallic: 0.0 }),
        ..Material::plain(hex(0x1f6f78), 0.22, 0.0)
    }
    .grainy(0.18, 0.12);
    let brass = Material::plain(hex(0xd9a441), 0.28, 1.0).grainy(0.1, 0.05);
    let profile = vec![
        [0.0, -0.80],
        [0.30, -0.80],
        [0.30, -0.80],
        [0.34, -0.74],
        [0.50, -0.38],
        [0.54, -0.05],
        [0.42, 0.28],
        [0.20, 0.52],
        [0.17, 0.66],
        [0.28, 0.82],
        [0.28, 0.82],
        [0.25, 0.82],
        [0.25, 0.82],
        [0.14, 0.66],
        [0.15, 0.50],
        [0.20, 0.40],
        [0.0, 0.36],
    ];
    let ring = |radius, tube, z| {
        part(Shape::TorusKnot { turns: 1, twists: 0, radius, swing: 0.0, tube }, brass.clone(), [0.0, 0.0, z])
    };
    // A handle in the x, z plane.
    let handle = |side: f32| {
        let p = |x: f32, z: f32| [side * x, 0.0, z];
        let limb = |from, to, radius| Limb { from, to, radius: [radius, radius] };
        part(
            Shape::Blob {
                limbs: vec![
                    limb(p(0.19, 0.60), p(0.40, 0.66), 0.045),
                    limb(p(0.40, 0.66), p(0.55, 0.50), 0.045),
                    limb(p(0.55, 0.50), p(0.53, 0.28), 0.045),
                    limb(p(0.53, 0.28), p(0.42, 0.16), 0.045),
                ],
                blend: 0.06,
                cells: 56,
            },
            brass.clone(),
            [0.0; 3],
        )
    };
    ObjectRecipe {
        name: "vase".into(),
        parts: vec![
            part(Shape::Lathe { profile, smooth: true }, glaze, [0.0; 3]),
            ring(0.315, 0.03, -0.775),
            ring(0.265, 0.026, 0.822),
            handle(1.0),
            handle(-1.0),
        ],
        light: studio(),
        relit: vec![
            NamedLight { name: "evening".into(), light: evening() },
            NamedLight { name: "forenoon".into(), light: forenoon() },
        ],
        views,
        rig: ObjectRig::default(),
    }
}

/// A spotted animal of no known species, with a collar and a brass bell.
#[must_use]
pub fn blob(views: ViewPlan) -> ObjectRecipe {
    let coat = Material {
        b: Some(Finish { color: hex(0x5a3420), roughness: 0.55, metallic: 0.0 }),
        pattern: Pattern::Spots { size: 0.26, radius: 0.48 },
        ..Material::plain(hex(0xe8a24a), 0.38, 0.0)
    }
    .grainy(0.22, 0.1);
    let limb = |from: [f32; 3], to: [f32; 3], radius: [f32; 2]| Limb { from, to, radius };
    let mut limbs = vec![
        limb([-0.32, 0.0, -0.02], [0.24, 0.0, 0.02], [0.27, 0.25]),
        limb([0.28, 0.0, 0.10], [0.46, 0.0, 0.34], [0.17, 0.16]),
        limb([0.48, 0.0, 0.40], [0.52, 0.0, 0.40], [0.20, 0.19]),
        limb([0.60, 0.0, 0.34], [0.74, 0.0, 0.30], [0.12, 0.09]),
        limb([-0.52, 0.0, 0.06], [-0.68, 0.0, 0.24], [0.07, 0.045]),
        limb([-0.68, 0.0, 0.24], [-0.66, 0.0, 0.40], [0.045, 0.06]),
    ];
    for side in [-1.0f32, 1.0] {
        limbs.extend([
            limb([0.22, side * 0.15, -0.16], [0.26, side * 0.17, -0.60], [0.10, 0.075]),
            limb([0.26, side * 0.17, -0.62], [0.31, side * 0.17, -0.63], [0.085, 0.075]),
            limb([-0.32, side * 0.15, -0.14], [-0.36, side * 0.17, -0.60], [0.11, 0.075]),
            limb([-0.36, side * 0.17, -0.62], [-0.31, side * 0.17, -0.63], [0.085, 0.075]),
            limb([0.42, side * 0.13, 0.54], [0.36, side * 0.21, 0.70], [0.065, 0.03]),
        ]);
    }
    let mut parts = vec![
        part(Shape::Blob { limbs, blend: 0.09, cells: 96 }, coat, [0.0; 3]),
        // The collar, around the neck.
        turned(
            part(
                Shape::TorusKnot { turns: 1, twists: 0, radius: 0.172, swing: 0.0, tube: 0.032 },
                Material::plain(hex(0xb3252b), 0.45, 0.0).grainy(0.2, 0.03),
                [0.36, 0.0, 0.205],
            ),
            [0.0, 36.0, 0.0],
        ),
        part(Shape::Sphere { radius: 0.055 }, Material::plain(hex(0xe0b04c), 0.22, 1.0), [0.525, 0.0, 0.06]),
        part(Shape::Sphere { radius: 0.05 }, Material::plain(hex(0x2a1a14), 0.2, 0.0), [0.815, 0.0, 0.325]),
    ];
    for side in [-1.0f32, 1.0] {
        parts.push(part(
            Shape::Sphere { radius: 0.042 },
            Material::plain(hex(0x0c0c10), 0.12, 0.0),
            [0.635, side * 0.115, 0.475],
        ));
    }
    ObjectRecipe {
        name: "blob".into(),
        parts,
        light: forenoon_object(),
        relit: relit(),
        views,
        rig: ObjectRig::default(),
    }
}

/// The forenoon with a hazier, larger sun: an object capture with sharp sun shadows is harder than it need be.
fn forenoon_object() -> Light {
    let mut light = forenoon();
    if let Light::Sky { sun_radius_deg, sun_irradiance, .. } = &mut light {
        *sun_radius_deg = 6.0;
        *sun_irradiance = [2.2, 2.0, 1.7];
    }
    light
}

/// A trefoil knot, half brushed copper, half blue enamel, on a wooden foot.
#[must_use]
pub fn knot(views: ViewPlan) -> ObjectRecipe {
    let metal = Material {
        b: Some(Finish { color: hex(0x24528f), roughness: 0.3, metallic: 0.0 }),
        pattern: Pattern::Stripes { axis: [0.6, 0.3, 0.74], period: 0.42, wobble: 0.15 },
        ..Material::plain(hex(0xd98a5f), 0.3, 1.0)
    }
    .grainy(0.15, 0.07);
    let wood = Material::mixed(hex(0x7a4a28), hex(0xb98352), 0.5, Pattern::Wood { rings: 0.05 });
    ObjectRecipe {
        name: "knot".into(),
        parts: vec![
            turned(
                part(
                    Shape::TorusKnot { turns: 2, twists: 3, radius: 0.40, swing: 0.17, tube: 0.095 },
                    metal,
                    [0.0, 0.0, 0.17],
                ),
                [90.0, 0.0, 0.0],
            ),
            part(
                Shape::Lathe {
                    profile: vec![
                        [0.0, -0.72],
                        [0.42, -0.72],
                        [0.42, -0.72],
                        [0.44, -0.69],
                        [0.40, -0.62],
                        [0.22, -0.58],
                        [0.14, -0.50],
                        [0.11, -0.42],
                        [0.0, -0.38],
                    ],
                    smooth: true,
                },
                wood,
                [0.0; 3],
            ),
        ],
        light: studio(),
        relit: vec![
            NamedLight { name: "evening".into(), light: evening() },
            NamedLight { name: "forenoon".into(), light: forenoon() },
        ],
        views,
        rig: ObjectRig::default(),
    }
}
