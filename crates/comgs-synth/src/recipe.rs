//! The record that says what to make.

use crate::SynthError;
use crate::light::Light;
use crate::material::Material;
use crate::rig::{ObjectRig, SceneRig};
use crate::shape::{Placement, Shape};
use crate::world::Part;
use comgs_geom::Similarity;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::sync::Arc;

/// A whole root: objects, scenes, and compositions of the two. Reads and writes as JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// Name of the recipe.
    pub name: String,
    /// Seed of everything random: cameras, patterns, clouds, paths.
    #[serde(default)]
    pub seed: u64,
    /// Height in texels of the environment maps (their width is twice that).
    #[serde(default = "default_environment_height")]
    pub environment_height: usize,
    /// Objects to capture.
    #[serde(default)]
    pub objects: Vec<ObjectRecipe>,
    /// Scenes to capture.
    #[serde(default)]
    pub scenes: Vec<SceneRecipe>,
    /// Objects standing in scenes.
    #[serde(default)]
    pub compositions: Vec<CompositionRecipe>,
}

fn default_environment_height() -> usize {
    256
}

/// A piece of an object or scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartRecipe {
    /// Its form.
    pub shape: Shape,
    /// Its surface.
    pub material: Material,
    /// Its place.
    #[serde(default)]
    pub placement: Placement,
}

/// How many views of what size and quality.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViewPlan {
    /// Width and height in pixels.
    pub size: (usize, usize),
    /// Training views.
    pub train: usize,
    /// Held-out views, with ground truth.
    pub test: usize,
    /// Paths a pixel in training views.
    pub train_samples: u32,
    /// Paths a pixel in test views.
    pub test_samples: u32,
}

/// A light with a name.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NamedLight {
    /// Name of the folder and of the map.
    pub name: String,
    /// The light.
    pub light: Light,
}

/// An object capture: HDR with alpha, under one light, from all around.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectRecipe {
    /// Name of the object.
    pub name: String,
    /// Its parts; together they must fit the unit ball around the origin.
    pub parts: Vec<PartRecipe>,
    /// The light under which it is captured.
    pub light: Light,
    /// Other lights under which the test views are rendered too.
    #[serde(default)]
    pub relit: Vec<NamedLight>,
    /// Views.
    pub views: ViewPlan,
    /// Cameras.
    #[serde(default)]
    pub rig: ObjectRig,
}

/// A scene capture: sRGB pictures from an ellipsoid of cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneRecipe {
    /// Name of the scene.
    pub name: String,
    /// Its parts, z up, metres.
    pub parts: Vec<PartRecipe>,
    /// Light from outside; lamps are parts that emit.
    pub light: Light,
    /// Views.
    pub views: ViewPlan,
    /// Cameras.
    pub rig: SceneRig,
}

/// An object in a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompositionRecipe {
    /// Name of the scene.
    pub scene: String,
    /// Name of the object.
    pub object: String,
    /// World point below the object's origin on which its lowest point stands.
    pub stands_at: [f64; 3],
    /// Turn around z in degrees.
    #[serde(default)]
    pub yaw_deg: f64,
    /// Scale from object to scene units.
    pub scale: f64,
    /// Views, along the scene's test spiral.
    pub views: usize,
    /// Paths a pixel, with and without the object.
    pub samples: u32,
    /// Paths a texel of the true light at the placement.
    pub probe_samples: u32,
}

impl PartRecipe {
    /// The part with its mesh. Blobs take a tenth of a second, so this is done once a part.
    #[must_use]
    pub fn build(&self) -> Part {
        Part {
            mesh: Arc::new(self.shape.mesh()),
            material: self.material.clone(),
            placement: self.placement.similarity(),
            inserted: false,
        }
    }
}

impl CompositionRecipe {
    /// The composition's folder name.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}_with_{}", self.scene, self.object)
    }

    /// Object-to-world transform: scaled and turned, its lowest point at the height of `stands_at`.
    #[must_use]
    pub fn transform(&self, object: &[Part]) -> Similarity {
        let lowest = object.iter().flat_map(Part::points).map(|p| p.z).fold(f64::MAX, f64::min);
        Similarity {
            scale: self.scale,
            rotation: DQuat::from_rotation_z(self.yaw_deg.to_radians()),
            translation: DVec3::from(self.stands_at) - DVec3::Z * (lowest * self.scale),
        }
    }
}

/// What a caller may change about any recipe without editing it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overrides {
    /// Width and height of object views in pixels.
    pub object_size: Option<(usize, usize)>,
    /// Width and height of scene and composition views in pixels.
    pub scene_size: Option<(usize, usize)>,
    /// Training views of each capture.
    pub train_views: Option<usize>,
    /// Test views of each capture, and views of each composition.
    pub test_views: Option<usize>,
    /// Paths a pixel, everywhere.
    pub samples: Option<u32>,
    /// Seed.
    pub seed: Option<u64>,
}

impl Recipe {
    /// From JSON.
    ///
    /// # Errors
    /// [`SynthError::Json`] with line and column, [`SynthError::Recipe`] with all problems at once.
    pub fn from_json(text: &str) -> Result<Self, SynthError> {
        let recipe: Self = serde_json::from_str(text)?;
        recipe.check()?;
        Ok(recipe)
    }

    /// With the given changes.
    #[must_use]
    pub fn with(mut self, overrides: &Overrides) -> Self {
        let change = |plan: &mut ViewPlan, size: Option<(usize, usize)>| {
            plan.size = size.unwrap_or(plan.size);
            plan.train = overrides.train_views.unwrap_or(plan.train);
            plan.test = overrides.test_views.unwrap_or(plan.test);
            plan.train_samples = overrides.samples.unwrap_or(plan.train_samples);
            plan.test_samples = overrides.samples.unwrap_or(plan.test_samples);
        };
        self.objects.iter_mut().for_each(|o| change(&mut o.views, overrides.object_size));
        self.scenes.iter_mut().for_each(|s| change(&mut s.views, overrides.scene_size));
        for c in &mut self.compositions {
            c.views = overrides.test_views.unwrap_or(c.views);
            c.samples = overrides.samples.unwrap_or(c.samples);
        }
        self.seed = overrides.seed.unwrap_or(self.seed);
        self
    }

    /// # Errors
    /// [`SynthError::Recipe`] with every problem found, each with its place in the record.
    pub fn check(&self) -> Result<(), SynthError> {
        let mut out = Vec::new();
        check_name(&self.name, "name", &mut out);
        if !(8..=4096).contains(&self.environment_height) {
            out.push(format!("environment_height: expected 8 to 4096, got {}", self.environment_height));
        }
        if self.objects.is_empty() && self.scenes.is_empty() {
            out.push("objects, scenes: expected at least one of either".into());
        }
        let mut names = HashSet::new();
        for (i, object) in self.objects.iter().enumerate() {
            let at = format!("objects[{i}]");
            check_name(&object.name, &format!("{at}.name"), &mut out);
            if !names.insert(("object", object.name.as_str())) {
                out.push(format!("{at}.name: {:?} is used twice", object.name));
            }
            check_views(&object.views, &at, &mut out);
            object.light.problems(&format!("{at}.light"), &mut out);
            object.rig.problems(&format!("{at}.rig"), &mut out);
            let mut lights = HashSet::new();
            for (k, relit) in object.relit.iter().enumerate() {
                check_name(&relit.name, &format!("{at}.relit[{k}].name"), &mut out);
                relit.light.problems(&format!("{at}.relit[{k}].light"), &mut out);
                if relit.name == "envmaps" || !lights.insert(relit.name.as_str()) {
                    out.push(format!("{at}.relit[{k}].name: {:?} is taken", relit.name));
                }
            }
            if check_parts(&object.parts, &at, &mut out) {
                let built = object.parts.iter().map(PartRecipe::build);
                let radius =
                    built.map(|p| p.points().map(DVec3::length).fold(0.0, f64::max)).fold(0.0, f64::max);
                if radius > 1.0 {
                    out.push(format!(
                        "{at}.parts: expected an object inside the unit ball, it reaches {radius:.3}"
                    ));
                }
            }
        }
        for (i, scene) in self.scenes.iter().enumerate() {
            let at = format!("scenes[{i}]");
            check_name(&scene.name, &format!("{at}.name"), &mut out);
            if !names.insert(("scene", scene.name.as_str())) {
                out.push(format!("{at}.name: {:?} is used twice", scene.name));
            }
            check_views(&scene.views, &at, &mut out);
            scene.light.problems(&format!("{at}.light"), &mut out);
            scene.rig.problems(&format!("{at}.rig"), &mut out);
            check_parts(&scene.parts, &at, &mut out);
        }
        let mut pairs = HashSet::new();
        for (i, c) in self.compositions.iter().enumerate() {
            let at = format!("compositions[{i}]");
            if !names.contains(&("scene", c.scene.as_str())) {
                out.push(format!("{at}.scene: there is no scene {:?}", c.scene));
            }
            if !names.contains(&("object", c.object.as_str())) {
                out.push(format!("{at}.object: there is no object {:?}", c.object));
            }
            if !pairs.insert(c.name()) {
                out.push(format!("{at}: {} is there twice", c.name()));
            }
            let finite = c.yaw_deg.is_finite() && c.stands_at.iter().all(|v| v.is_finite());
            if !(finite && c.scale > 0.0 && c.scale < 1e6) {
                out.push(format!(
                    "{at}: expected a positive scale and a finite place, got scale {}",
                    c.scale
                ));
            }
            if c.views > 100_000
                || c.samples == 0
                || c.probe_samples == 0
                || c.samples.max(c.probe_samples) > 1 << 16
            {
                out.push(format!("{at}: expected at most 100000 views and 1 to 65536 samples"));
            }
        }
        if out.is_empty() { Ok(()) } else { Err(SynthError::Recipe(out)) }
    }
}

/// Names become folders.
fn check_name(name: &str, at: &str, out: &mut Vec<String>) {
    let good = !name.is_empty()
        && name.len() <= 64
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if !good {
        out.push(format!("{at}: expected 1 to 64 letters, digits, '_' or '-', got {name:?}"));
    }
}

fn check_views(plan: &ViewPlan, at: &str, out: &mut Vec<String>) {
    let (w, h) = plan.size;
    if !(1..=8192).contains(&w) || !(1..=8192).contains(&h) {
        out.push(format!("{at}.views.size: expected 1 to 8192 pixels a side, got {w}×{h}"));
    }
    if plan.train > 100_000 || plan.test > 100_000 {
        out.push(format!("{at}.views: expected at most 100000 views, got {} and {}", plan.train, plan.test));
    }
    for (name, samples) in [("train_samples", plan.train_samples), ("test_samples", plan.test_samples)] {
        if !(1..=1 << 16).contains(&samples) {
            out.push(format!("{at}.views.{name}: expected 1 to 65536, got {samples}"));
        }
    }
}

/// Whether the parts are sound enough to be meshed.
fn check_parts(parts: &[PartRecipe], at: &str, out: &mut Vec<String>) -> bool {
    let before = out.len();
    if parts.is_empty() || parts.len() > 10_000 {
        out.push(format!("{at}.parts: expected 1 to 10000 parts, got {}", parts.len()));
    }
    for (i, part) in parts.iter().enumerate() {
        let at = format!("{at}.parts[{i}]");
        part.shape.problems(&format!("{at}.shape"), out);
        part.material.problems(&format!("{at}.material"), out);
        let p = &part.placement;
        let finite = p.at.iter().chain(&p.turn_deg).all(|v| v.abs() < 1e6);
        if !(finite && p.scale > 0.0 && p.scale < 1e6) {
            out.push(format!("{at}.placement: expected a positive scale and a finite place and turn"));
        }
    }
    out.len() == before
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builtin;

    /// Goal: every built-in is sound, and is the same after JSON.
    #[test]
    fn builtins_survive_json() {
        for name in builtin::NAMES {
            let recipe = builtin::recipe(name).unwrap();
            recipe.check().unwrap();
            let text = serde_json::to_string_pretty(&recipe).unwrap();
            assert_eq!(serde_json::from_str::<Recipe>(&text).unwrap(), recipe, "{name}");
        }
        assert!(builtin::recipe("nothing").unwrap_err().to_string().contains("courtyard"));
    }

    /// Goal: the example recipe of the documentation is one.
    #[test]
    fn the_example_recipe_is_sound() {
        let recipe = Recipe::from_json(include_str!("../examples/pebble.json")).unwrap();
        assert_eq!(recipe.compositions[0].name(), "beach_with_pebble");
    }

    /// Goal: all problems of a bad recipe are named at once, each with its place; names that would leave the root are
    /// refused.
    #[test]
    fn problems_are_listed_with_their_place() {
        let mut recipe = builtin::recipe("micro").unwrap();
        recipe.objects[0].name = "../escape".into();
        recipe.objects[0].parts[0].material.a.roughness = f32::NAN;
        recipe.objects[0].views.train_samples = 0;
        recipe.scenes[0].parts[0].placement.scale = -1.0;
        recipe.compositions[0].scene = "elsewhere".into();
        let message = recipe.check().unwrap_err().to_string();
        for expected in [
            "objects[0].name",
            "objects[0].parts[0].material.a.roughness",
            "objects[0].views.train_samples",
            "scenes[0].parts[0].placement",
            "compositions[0].scene",
            "compositions[0].object",
        ] {
            assert!(message.contains(expected), "{expected} is not in {message}");
        }
        let unknown = Recipe::from_json(r#"{"name": "a", "sed": 3}"#).unwrap_err().to_string();
        assert!(unknown.contains("sed"), "{unknown}");
        let mut large = builtin::recipe("vase").unwrap();
        large.objects[0].parts[0].placement.scale = 3.0;
        assert!(large.check().unwrap_err().to_string().contains("unit ball"));
    }

    /// Goal: overrides reach all views, and an object stands with its lowest point where it was put.
    #[test]
    fn overrides_and_standing() {
        let recipe = builtin::recipe("tiny").unwrap();
        let changed =
            recipe.clone().with(&Overrides { samples: Some(3), test_views: Some(1), ..Overrides::default() });
        assert_eq!(changed.scenes[0].views.train_samples, 3);
        assert_eq!((changed.compositions[0].views, changed.compositions[0].samples), (1, 3));
        let c = &recipe.compositions[0];
        let object: Vec<Part> = recipe.objects[0].parts.iter().map(PartRecipe::build).collect();
        let transform = c.transform(&object);
        let moved = object.iter().map(|p| p.moved(&transform, true));
        let lowest = moved.map(|p| p.points().map(|q| q.z).fold(f64::MAX, f64::min)).fold(f64::MAX, f64::min);
        assert!((lowest - c.stands_at[2]).abs() < 1e-6);
    }
}
