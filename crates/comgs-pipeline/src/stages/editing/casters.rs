//! Occlusion fields of a composition's objects, baked or read from a cache folder.

use super::{Composition, Settings};
use crate::{Context, Fingerprint, PipelineError, Status};
use comgs_compose::{Caster, FieldConfig, FieldError, occlusion_field};
use comgs_geom::Similarity;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What casts shadows; an object that stands in several places is baked once.
pub(crate) struct Baked {
    casters: Vec<Caster>,
    /// The caster of every object of the composition.
    of: Vec<usize>,
    /// Files that were written.
    pub written: Vec<PathBuf>,
    /// Fields that were read instead of baked.
    pub read: usize,
    /// Seconds of baking.
    pub seconds: f64,
}

impl Baked {
    /// Casters where their objects stand.
    pub fn placed(&self, composition: &Composition) -> Vec<(&Caster, Similarity)> {
        let objects = composition.objects.iter().zip(&self.of);
        objects.map(|(o, &i)| (&self.casters[i], o.world_from_object)).collect()
    }

    /// Bytes of all fields.
    pub fn bytes(&self) -> usize {
        self.casters.iter().map(|c| c.field.memory_bytes()).sum()
    }

    /// Number of different objects.
    pub fn len(&self) -> usize {
        self.casters.len()
    }
}

/// Bakes the fields of all objects. With a cache folder, a field that was baked there of the same object at the same
/// resolution is read, and a new one is kept: `<name>-<hash>.occlusion`. The hash is of the surfels and the resolution, not of
/// the placement, so moving an object bakes nothing.
///
/// # Errors
/// [`PipelineError`]: an invisible object, a cache that cannot be written, a stop.
pub(crate) fn bake(
    composition: &Composition,
    settings: &Settings,
    cache: Option<&Path>,
    context: &Context<'_>,
) -> Result<Baked, PipelineError> {
    bake_at(composition, settings.field(), cache, context)
}

/// Whether [`bake`] would find all fields in the folder.
pub(crate) fn is_baked(composition: &Composition, settings: &Settings, cache: &Path) -> bool {
    let there = |object| cache_file(cache, object, settings.field()).is_ok_and(|file| file.is_file());
    composition.objects.iter().all(there)
}

/// [`bake`] at a resolution of one's own.
pub(crate) fn bake_at(
    composition: &Composition,
    field: FieldConfig,
    cache: Option<&Path>,
    context: &Context<'_>,
) -> Result<Baked, PipelineError> {
    let start = Instant::now();
    let mut baked = Baked { casters: Vec::new(), of: Vec::new(), written: Vec::new(), read: 0, seconds: 0.0 };
    for (i, object) in composition.objects.iter().enumerate() {
        context.check()?;
        let same = |other: &super::Placed| other.subject.path == object.subject.path;
        if let Some(first) = composition.objects[..i].iter().position(same) {
            baked.of.push(baked.of[first]);
            continue;
        }
        context.progress.update(&Status {
            fraction: Some(i as f64 / composition.objects.len() as f64),
            message: format!("occlusion of {}", object.name),
            remaining: None,
        });
        let file = cache.map(|folder| cache_file(folder, object, field)).transpose()?;
        // A file that cannot be read is baked anew and replaced.
        let kept = file
            .as_ref()
            .and_then(|path| std::fs::read(path).ok())
            .and_then(|bytes| occlusion_field::from_bytes(&bytes).ok());
        baked.read += usize::from(kept.is_some());
        let is_new = kept.is_none();
        let cancelled = || context.cancel.is_cancelled();
        let caster = Caster::new(&object.subject.asset.surfels, field, kept, &cancelled)
            .map_err(|e| refused(&object.name, e))?;
        if let Some(path) = file {
            if is_new {
                let bytes = occlusion_field::to_bytes(&caster.field);
                comgs_image::atomic::write_file(&path, |w| w.write_all(&bytes))
                    .map_err(|e| PipelineError::io(&path, e))?;
            }
            baked.written.push(path);
        }
        baked.of.push(baked.casters.len());
        baked.casters.push(caster);
    }
    baked.seconds = start.elapsed().as_secs_f64();
    Ok(baked)
}

fn cache_file(folder: &Path, object: &super::Placed, field: FieldConfig) -> Result<PathBuf, PipelineError> {
    let mut fingerprint = Fingerprint::new("occlusion");
    fingerprint.surfels("object", &object.subject.path)?;
    fingerprint.config("field", &(field.directions, field.resolution))?;
    let hash = fingerprint.finish();
    Ok(folder.join(format!("{}-{}.occlusion", object.name, &hash[..16])))
}

fn refused(name: &str, error: FieldError) -> PipelineError {
    match error {
        FieldError::Cancelled => PipelineError::Cancelled { kept: None },
        other => PipelineError::input(name, "an object that can cast a shadow", other.to_string()),
    }
}
