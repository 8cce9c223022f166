//! From a recipe to the contents of a root, in memory: what the files hold, in which order they appear.

use crate::SynthError;
use crate::environment::Environment;
use crate::film::{self, Film};
use crate::light::Light;
use crate::recipe::{CompositionRecipe, ObjectRecipe, PartRecipe, Recipe, SceneRecipe};
use crate::world::{Part, World};
use comgs_geom::{Camera, Rng, Similarity};
use comgs_image::Image;
use glam::{DMat4, Vec3};
use serde_json::{Value, json};
use std::ops::ControlFlow;

/// What one file of the root holds.
#[derive(Clone, Debug)]
pub enum Content {
    /// Linear values: half floats, full floats where there is one channel.
    Exr(Image),
    /// Linear radiance, to be stored as 8-bit sRGB; a fourth channel is straight alpha.
    Png(Image),
    /// One channel in [0, 1], to be stored as it is: code value = 255 · coverage.
    Coverage(Image),
    /// A record.
    Json(Value),
}

/// One file of the root.
#[derive(Clone, Debug)]
pub struct Output {
    /// Path inside the root, with forward slashes.
    pub path: String,
    /// What it holds.
    pub content: Content,
}

/// How far the work is.
#[derive(Clone, Copy, Debug)]
pub struct Progress<'a> {
    /// Share of the paths traced, in [0, 1].
    pub fraction: f64,
    /// What is being rendered: a path inside the root.
    pub doing: &'a str,
}

/// Streams of random numbers, one for each kind of picture.
mod stream {
    pub const OBJECT_TRAIN: u64 = 1;
    pub const OBJECT_TEST: u64 = 2;
    pub const RELIT: u64 = 3;
    pub const SCENE_TRAIN: u64 = 4;
    pub const SCENE_TEST: u64 = 5;
    pub const SCENE_CAMERAS: u64 = 6;
    pub const COMPOSITION: u64 = 7;
    pub const PROBE: u64 = 8;
}

/// Seed of picture `index` of a kind, for the `item`-th object, scene or composition.
fn picture_seed(seed: u64, kind: u64, item: usize, index: usize) -> u64 {
    let mut rng = Rng::stream(seed, (kind << 48) | ((item as u64) << 32) | index as u64);
    (u64::from(rng.next_u32()) << 32) | u64::from(rng.next_u32())
}

/// Parts with their meshes.
#[must_use]
pub fn build(recipes: &[PartRecipe]) -> Vec<Part> {
    recipes.iter().map(PartRecipe::build).collect()
}

/// An object alone under a light (the capture light, or a relighting one).
#[must_use]
pub fn object_world(recipe: &Recipe, object: &[Part], light: &Light) -> World {
    let environment = Environment::new(light.map(recipe.environment_height, recipe.seed));
    let parts: Vec<Part> = object.iter().map(|p| p.moved(&Similarity::IDENTITY, true)).collect();
    World::new(&parts, environment, recipe.seed)
}

/// A scene, with an object standing in it or without.
#[must_use]
pub fn scene_world(
    recipe: &Recipe,
    scene: &[Part],
    light: &Light,
    object: Option<(&[Part], Similarity)>,
) -> World {
    let environment = Environment::new(light.map(recipe.environment_height, recipe.seed));
    let mut all = scene.to_vec();
    if let Some((object, transform)) = object {
        all.extend(object.iter().map(|p| p.moved(&transform, true)));
    }
    World::new(&all, environment, recipe.seed)
}

/// `cameras.json`: pinhole intrinsics, camera-to-world row by row with Blender/OpenGL axes.
#[must_use]
pub fn cameras_json(cameras: &[Camera]) -> Value {
    let entries: serde_json::Map<String, Value> = cameras
        .iter()
        .enumerate()
        .map(|(i, c)| {
            let pose = DMat4::from(Camera::flip_opengl_axes(c.world_from_camera));
            let entry = json!({
                "name": c.name, "width": c.width, "height": c.height,
                "intr": [c.fx, c.fy, c.cx, c.cy],
                "extr": pose.transpose().to_cols_array(),
            });
            (i.to_string(), entry)
        })
        .collect();
    json!({ "cameras": entries })
}

/// Counts paths, reports, and hands files on.
struct Worker<'a> {
    total: f64,
    done: f64,
    sink: &'a mut dyn FnMut(Output) -> Result<(), SynthError>,
    progress: &'a mut dyn FnMut(Progress<'_>) -> ControlFlow<()>,
}

impl Worker<'_> {
    fn put(&mut self, path: String, content: Content) -> Result<(), SynthError> {
        (self.sink)(Output { path, content })
    }

    fn report(&mut self, doing: &str) -> Result<(), SynthError> {
        let fraction = if self.total > 0.0 { (self.done / self.total).min(1.0) } else { 1.0 };
        match (self.progress)(Progress { fraction, doing }) {
            ControlFlow::Continue(()) => Ok(()),
            ControlFlow::Break(()) => Err(SynthError::Stopped),
        }
    }

    fn film(
        &mut self,
        doing: &str,
        world: &World,
        camera: &Camera,
        samples: u32,
        seed: u64,
    ) -> Result<Film, SynthError> {
        self.report(doing)?;
        let film = film::render(world, camera, samples, seed);
        self.done += camera.width as f64 * camera.height as f64 * f64::from(samples);
        Ok(film)
    }
}

/// Renders everything that a recipe describes and hands it to `sink` file by file, so that no more than one view is in
/// memory. `progress` is called before every picture and may stop the work.
///
/// # Errors
/// [`SynthError::Recipe`] before any work, [`SynthError::Stopped`], or what `sink` returns.
pub fn generate(
    recipe: &Recipe,
    sink: &mut dyn FnMut(Output) -> Result<(), SynthError>,
    progress: &mut dyn FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<(), SynthError> {
    recipe.check()?;
    generate_checked(recipe, sink, progress)
}

pub(crate) fn generate_checked(
    recipe: &Recipe,
    sink: &mut dyn FnMut(Output) -> Result<(), SynthError>,
    progress: &mut dyn FnMut(Progress<'_>) -> ControlFlow<()>,
) -> Result<(), SynthError> {
    let mut worker = Worker { total: paths(recipe), done: 0.0, sink, progress };
    let objects: Vec<Vec<Part>> = recipe.objects.iter().map(|o| build(&o.parts)).collect();
    let scenes: Vec<Vec<Part>> = recipe.scenes.iter().map(|s| build(&s.parts)).collect();
    for (i, object) in recipe.objects.iter().enumerate() {
        object_capture(recipe, i, object, &objects[i], &mut worker)?;
    }
    for (i, scene) in recipe.scenes.iter().enumerate() {
        scene_capture(recipe, i, scene, &scenes[i], &mut worker)?;
    }
    for (i, composition) in recipe.compositions.iter().enumerate() {
        // Both are there: the recipe was checked.
        let object = recipe.objects.iter().zip(&objects).find(|(o, _)| o.name == composition.object);
        let scene = recipe.scenes.iter().zip(&scenes).find(|(s, _)| s.name == composition.scene);
        if let (Some((_, object)), Some((scene, scene_parts))) = (object, scene) {
            compose(recipe, i, composition, object, (scene, scene_parts), &mut worker)?;
        }
    }
    let record = serde_json::to_value(recipe)?;
    worker.put("recipe.json".into(), Content::Json(record))?;
    worker.report("done")
}

/// How many paths a recipe asks for.
#[must_use]
pub fn paths(recipe: &Recipe) -> f64 {
    let views =
        |size: (usize, usize), n: usize, samples: u32| (size.0 * size.1 * n) as f64 * f64::from(samples);
    let objects = recipe.objects.iter().map(|o| {
        let (v, lights) = (&o.views, 1 + o.relit.len());
        views(v.size, v.train, v.train_samples) + views(v.size, v.test * lights, v.test_samples)
    });
    let scenes = recipe.scenes.iter().map(|s| {
        views(s.views.size, s.views.train, s.views.train_samples)
            + views(s.views.size, s.views.test, s.views.test_samples)
    });
    let compositions = recipe.compositions.iter().map(|c| {
        let size = recipe.scenes.iter().find(|s| s.name == c.scene).map_or((0, 0), |s| s.views.size);
        let h = recipe.environment_height;
        views(size, 2 * c.views, c.samples) + views((2 * h, h), 1, c.probe_samples)
    });
    objects.chain(scenes).chain(compositions).sum()
}

fn object_capture(
    recipe: &Recipe,
    item: usize,
    object: &ObjectRecipe,
    built: &[Part],
    worker: &mut Worker<'_>,
) -> Result<(), SynthError> {
    let root = format!("object/{}", object.name);
    let plan = &object.views;
    let world = object_world(recipe, built, &object.light);
    let train = object.rig.train(plan.train, plan.size);
    let test = object.rig.test(plan.test, plan.size);
    worker.put(format!("{root}/train_envmap_gt.exr"), Content::Exr(world.environment().map().clone()))?;
    worker.put(format!("{root}/meta.json"), Content::Json(object_meta(recipe, object, built)))?;
    worker.put(format!("{root}/train/cameras.json"), Content::Json(cameras_json(&train)))?;
    worker.put(format!("{root}/test/cameras.json"), Content::Json(cameras_json(&test)))?;
    for (i, camera) in train.iter().enumerate() {
        let path = format!("{root}/train/images/{}.exr", camera.name);
        let seed = picture_seed(recipe.seed, stream::OBJECT_TRAIN, item, i);
        let film = worker.film(&path, &world, camera, plan.train_samples, seed)?;
        worker.put(path, Content::Exr(film::with_alpha(&film.straight, &film.coverage)))?;
    }
    for (i, camera) in test.iter().enumerate() {
        let name = &camera.name;
        let path = format!("{root}/test/images/{name}.exr");
        let seed = picture_seed(recipe.seed, stream::OBJECT_TEST, item, i);
        let film = worker.film(&path, &world, camera, plan.test_samples, seed)?;
        worker.put(path, Content::Exr(film::with_alpha(&film.straight, &film.coverage)))?;
        let albedo = film::with_alpha(&film.albedo, &film.coverage);
        for (plane, image) in [
            ("albedo", albedo),
            ("normal", film.normal),
            ("depth", film.depth),
            ("roughness", film.roughness),
            ("metallic", film.metallic),
        ] {
            worker.put(format!("{root}/test/{plane}/{name}.exr"), Content::Exr(image))?;
        }
    }
    if object.relit.is_empty() {
        return Ok(());
    }
    let root = format!("object_relit/{}", object.name);
    worker.put(format!("{root}/cameras.json"), Content::Json(cameras_json(&test)))?;
    for (k, named) in object.relit.iter().enumerate() {
        let world = object_world(recipe, built, &named.light);
        // Objects may share a light's name only if it is the same light; the map belongs to object and light.
        let map = format!("object_relit/envmaps/{}.exr", relit_map_name(recipe, object, &named.name));
        worker.put(map, Content::Exr(world.environment().map().clone()))?;
        for (i, camera) in test.iter().enumerate() {
            let path = format!("{root}/{}/{}", named.name, camera.name);
            let seed = picture_seed(recipe.seed, stream::RELIT, item, k * test.len() + i);
            let film = worker.film(&path, &world, camera, plan.test_samples, seed)?;
            let picture = film::with_alpha(&film.straight, &film.coverage);
            worker.put(format!("{path}.png"), Content::Png(picture.clone()))?;
            worker.put(format!("{path}.exr"), Content::Exr(picture))?;
        }
    }
    Ok(())
}

/// The light's name, or `<light>_<object>` where objects use one name for different lights.
fn relit_map_name(recipe: &Recipe, object: &ObjectRecipe, light: &str) -> String {
    let of = |o: &ObjectRecipe| o.relit.iter().find(|r| r.name == light).map(|r| r.light.clone());
    let own = of(object);
    let shared = recipe.objects.iter().filter_map(of).all(|l| Some(l) == own);
    if shared { light.to_owned() } else { format!("{light}_{}", object.name) }
}

/// Bounds, samples, and where the light is.
fn object_meta(recipe: &Recipe, object: &ObjectRecipe, built: &[Part]) -> Value {
    let (mut low, mut high) = (Vec3::splat(f32::MAX), Vec3::splat(f32::MIN));
    for p in built.iter().flat_map(Part::points) {
        (low, high) = (low.min(p.as_vec3()), high.max(p.as_vec3()));
    }
    json!({
        "bbox_min": low.to_array(), "bbox_max": high.to_array(),
        "train_env": "train_envmap_gt.exr",
        "seed": recipe.seed,
        "train_samples": object.views.train_samples, "test_samples": object.views.test_samples,
    })
}

fn scene_capture(
    recipe: &Recipe,
    item: usize,
    scene: &SceneRecipe,
    built: &[Part],
    worker: &mut Worker<'_>,
) -> Result<(), SynthError> {
    let root = format!("scene/{}", scene.name);
    let plan = &scene.views;
    let world = scene_world(recipe, built, &scene.light, None);
    let train =
        scene.rig.train(plan.train, plan.size, picture_seed(recipe.seed, stream::SCENE_CAMERAS, item, 0));
    let test = scene.rig.test(plan.test, plan.size);
    let map = world.environment().map().clone();
    worker.put(format!("scene_env/{}.exr", scene.name), Content::Exr(map))?;
    let meta = json!({
        "seed": recipe.seed,
        "train_samples": plan.train_samples, "test_samples": plan.test_samples,
    });
    worker.put(format!("{root}/meta.json"), Content::Json(meta))?;
    worker.put(format!("{root}/train/cameras.json"), Content::Json(cameras_json(&train)))?;
    worker.put(format!("{root}/test/cameras.json"), Content::Json(cameras_json(&test)))?;
    for (i, camera) in train.iter().enumerate() {
        let path = format!("{root}/train/images/{}.png", camera.name);
        let seed = picture_seed(recipe.seed, stream::SCENE_TRAIN, item, i);
        let film = worker.film(&path, &world, camera, plan.train_samples, seed)?;
        worker.put(path, Content::Png(film.color))?;
    }
    for (i, camera) in test.iter().enumerate() {
        let name = &camera.name;
        let path = format!("{root}/test/images/{name}.png");
        let seed = picture_seed(recipe.seed, stream::SCENE_TEST, item, i);
        let film = worker.film(&path, &world, camera, plan.test_samples, seed)?;
        worker.put(path, Content::Png(film.color.clone()))?;
        for (plane, image) in [("images_linear", film.color), ("depth", film.depth), ("normal", film.normal)]
        {
            worker.put(format!("{root}/test/{plane}/{name}.exr"), Content::Exr(image))?;
        }
    }
    Ok(())
}

fn compose(
    recipe: &Recipe,
    item: usize,
    composition: &CompositionRecipe,
    object: &[Part],
    (scene, scene_parts): (&SceneRecipe, &[Part]),
    worker: &mut Worker<'_>,
) -> Result<(), SynthError> {
    let root = format!("composition/{}", composition.name());
    let transform = composition.transform(object);
    let matrix = DMat4::from(transform.to_affine()).transpose().to_cols_array();
    let cameras = scene.rig.test(composition.views, scene.views.size);
    let empty = scene_world(recipe, scene_parts, &scene.light, None);
    let full = scene_world(recipe, scene_parts, &scene.light, Some((object, transform)));
    worker.put(format!("{root}/cameras.json"), Content::Json(cameras_json(&cameras)))?;
    worker.put(
        format!("{root}/transform.json"),
        Content::Json(json!({ (composition.object.as_str()): { "transform": matrix } })),
    )?;
    let meta = json!({
        "seed": recipe.seed, "samples": composition.samples, "probe_samples": composition.probe_samples,
    });
    worker.put(format!("{root}/meta.json"), Content::Json(meta))?;

    let probe = format!("{root}/envmap_gt.exr");
    worker.report(&probe)?;
    let seed = picture_seed(recipe.seed, stream::PROBE, item, 0);
    let height = recipe.environment_height;
    let map =
        film::panorama(&empty, transform.translation.as_vec3(), height, composition.probe_samples, seed);
    worker.done += (2 * height * height) as f64 * f64::from(composition.probe_samples);
    worker.put(probe, Content::Exr(map))?;

    for (i, camera) in cameras.iter().enumerate() {
        let name = &camera.name;
        // One seed for both: a path that never meets the object is the same path, so noise cancels in the difference.
        let seed = picture_seed(recipe.seed, stream::COMPOSITION, item, i);
        let path = format!("{root}/images/{name}.png");
        let with = worker.film(&path, &full, camera, composition.samples, seed)?;
        let without =
            worker.film(&format!("{root}/empty/{name}.png"), &empty, camera, composition.samples, seed)?;
        worker.put(path, Content::Png(with.color.clone()))?;
        worker.put(format!("{root}/images_linear/{name}.exr"), Content::Exr(with.color))?;
        worker.put(format!("{root}/mask/{name}.png"), Content::Coverage(with.mask))?;
        worker.put(format!("{root}/empty/{name}.png"), Content::Png(without.color.clone()))?;
        worker.put(format!("{root}/empty_linear/{name}.exr"), Content::Exr(without.color))?;
    }
    Ok(())
}
