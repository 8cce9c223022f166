//! A composition as the editing and rendering stages hold it: assets, light, what casts shadows.

mod casters;
mod own_light;
mod photos;
mod relit;
mod settings;

pub(crate) use casters::{Baked, bake, bake_at, is_baked};
pub(crate) use own_light::{OwnLight, is_cached, shading_config};
pub(crate) use relit::{Lighting, RelitObjects, lit_map};
pub use settings::{Relight, Settings, Shading, Shadow};

use crate::stages::frames;
use crate::stages::relight::subject::{Subject, read_light};
use crate::{Fingerprint, PipelineError, source};
use comgs_compose::{CameraLook, Lamp, PlacedObject, PlacementConfig, check_placement, objects};
use comgs_geom::{Camera, Similarity};
use comgs_light::EnvironmentMap;
use comgs_raster::RasterConfig;
use comgs_scene::{Asset, AssetKind, CompositionRecord, LampRecord, ShadowPolicy};
use comgs_trace::Tracer;
use glam::{DVec3, Vec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// An object in its place.
pub(crate) struct Placed {
    pub name: String,
    pub subject: Subject,
    pub world_from_object: Similarity,
}

/// Everything that `composition.json` names, read.
pub(crate) struct Composition {
    pub record: CompositionRecord,
    /// Shared with stand-ins that differ in objects and cameras.
    pub scene: Arc<Asset>,
    pub scene_path: PathBuf,
    pub objects: Vec<Placed>,
    pub cameras: Vec<Camera>,
    pub light_path: PathBuf,
    pub map: EnvironmentMap,
    pub lamps: Vec<Lamp>,
    /// Noise and defocus of the scene's photos, where they were given.
    pub look: Option<CameraLook>,
}

impl Composition {
    /// Reads a composition; `cameras` replaces those it names. What is odd is told to `warn`.
    ///
    /// # Errors
    /// [`PipelineError`]: what cannot be read, no object, no light.
    pub fn load(
        path: &Path,
        cameras: Option<&Path>,
        warn: impl FnMut(String),
    ) -> Result<Self, PipelineError> {
        let record = CompositionRecord::read(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let named = |relative: &str| folder.join(relative);
        if record.objects.is_empty() {
            return Err(PipelineError::input(path.display().to_string(), "at least one object", "none"));
        }
        let Some(light) = &record.light else {
            let expected = "a light (made with `comgs compose` or `comgs light`)";
            return Err(PipelineError::input(path.display().to_string(), expected, "none"));
        };
        let cameras = frames::read_cameras(&cameras.map_or_else(|| named(&record.cameras), Path::to_owned))?;
        let light_path = named(light);
        let map = read_light(&light_path, warn)?;
        let scene_path = named(&record.scene);
        let scene = Arc::new(source::load_surfels(&scene_path, AssetKind::Scene)?);
        let mut objects: Vec<Placed> = Vec::new();
        for object in &record.objects {
            let world_from_object = object.similarity.similarity().map_err(|(field, reason)| {
                PipelineError::input(format!("{}.{field}", object.name), "a similarity", reason)
            })?;
            let subject = Subject::load_any(&named(&object.asset))?;
            objects.push(Placed { name: object.name.clone(), subject, world_from_object });
        }
        let lamps = record.lamps.iter().map(lamp).collect();
        let mut read =
            Self { record, scene, scene_path, objects, cameras, light_path, map, lamps, look: None };
        // The map stays where it was taken when objects move.
        let middle = read.middle().as_dvec3().to_array();
        read.record.light_at.get_or_insert(middle);
        Ok(read)
    }

    /// What a result depends on, but for cameras and settings.
    pub fn fingerprint(&self, stage: &str) -> Result<Fingerprint, PipelineError> {
        let mut fingerprint = Fingerprint::new(stage);
        fingerprint.surfels("scene", &self.scene_path)?;
        for object in &self.objects {
            fingerprint.surfels(&object.name, &object.subject.path)?;
            fingerprint.config("transform", &object.world_from_object)?;
        }
        fingerprint.path("light", &self.light_path)?;
        fingerprint.config("lamps", &self.record.lamps)?;
        fingerprint.config("effects", &self.record.effects)?;
        fingerprint.config("light_at", &self.record.light_at)?;
        fingerprint.config("look", &self.look)?;
        Ok(fingerprint)
    }

    /// Whether the record asks for shadows.
    pub fn wants_shadow(&self) -> bool {
        self.record.effects.shadow != ShadowPolicy::None
    }

    /// Objects as the composer takes them.
    pub fn placed(&self) -> Vec<PlacedObject<'_>> {
        let of = |o: &Placed| o.world_from_object;
        self.objects
            .iter()
            .map(|o| PlacedObject { cloud: &o.subject.asset.surfels, world_from_object: of(o) })
            .collect()
    }

    /// The rasteriser as the scene was trained with it.
    pub fn raster(&self) -> RasterConfig {
        source::raster_config(&self.scene)
    }

    /// Centre of the objects' bounding spheres, world.
    pub fn middle(&self) -> Vec3 {
        let spheres: Vec<_> = self.spheres();
        spheres.iter().map(|s| s.0).sum::<Vec3>() / spheres.len().max(1) as f32
    }

    /// Where the map was taken, as far as the record knows; else the middle of the objects.
    pub fn light_centre(&self) -> Vec3 {
        self.record.light_at.map_or_else(|| self.middle(), |at| DVec3::from_array(at).as_vec3())
    }

    /// Bounding spheres of the objects, world.
    pub fn spheres(&self) -> Vec<(Vec3, f32)> {
        self.objects
            .iter()
            .filter_map(|o| {
                let (centre, radius) = objects::bounding_sphere(&o.subject.asset.surfels)?;
                let s = o.world_from_object;
                Some((s.transform_point(centre.as_dvec3()).as_vec3(), radius * s.scale as f32))
            })
            .collect()
    }

    /// What is odd about the placements (hard cases 30 and 33).
    pub fn placement_warnings(&self, scene: &Tracer) -> Vec<String> {
        let mut warnings = Vec::new();
        let extent = self.scene.surfels.bounds().map_or(0.0, |(low, high)| (high - low).length());
        for (object, (_, radius)) in self.objects.iter().zip(self.spheres()) {
            if 2.0 * radius > extent {
                warnings.push(format!(
                    "{}: the object is larger than the scene ({:.3} across, the scene {extent:.3})",
                    object.name,
                    2.0 * radius
                ));
            }
        }
        let placed = self.objects.iter().map(|o| (o.name.as_str(), &o.subject.asset, o.world_from_object));
        warnings.extend(placement_warnings(&self.scene, scene, placed, None));
        warnings
    }
}

/// What is odd about placements in a scene (hard case 33).
pub(crate) fn placement_warnings<'a>(
    scene: &Asset,
    tracer: &Tracer,
    placed: impl Iterator<Item = (&'a str, &'a Asset, Similarity)>,
    coverage: Option<f64>,
) -> Vec<String> {
    let world_up = DVec3::from_array(scene.record.up);
    let mut warnings = Vec::new();
    for (name, asset, s) in placed {
        let own_up = DVec3::from_array(asset.record.up);
        let Some(extent) = objects::extent(&asset.surfels, own_up) else { continue };
        let to_world = |p: DVec3| s.transform_point(extent.upright_from_object.inverse() * p);
        let size = (extent.high - extent.low) * s.scale;
        let report = check_placement(
            tracer,
            to_world(extent.base()),
            world_up,
            0.5 * size.x.min(size.y),
            size.z,
            coverage,
            &PlacementConfig::default(),
        );
        warnings.extend(report.warnings.into_iter().map(|w| format!("{name}: {w}")));
    }
    warnings
}

fn lamp(record: &LampRecord) -> Lamp {
    let vector = |v: [f64; 3]| DVec3::from_array(v).as_vec3();
    match *record {
        LampRecord::Directional { direction, irradiance, angular_radius_deg } => Lamp::Directional {
            direction: vector(direction),
            irradiance: vector(irradiance),
            angular_radius: angular_radius_deg.to_radians() as f32,
        },
        LampRecord::Point { position, intensity, radius } => {
            Lamp::Point { position: vector(position), intensity: vector(intensity), radius: radius as f32 }
        }
    }
}
