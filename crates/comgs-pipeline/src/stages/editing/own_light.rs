//! What the objects of a composition hide from themselves, made once for any place and light.

use super::{Baked, Composition, Relight, Settings, Shading, Shadow};
use crate::PipelineError;
use crate::stages::relight::subject::refused;
use comgs_compose::{Caster, RelightConfig, SelfVisibility, Standing};
use comgs_inverse::Quality;
use comgs_trace::{TraceConfig, Tracer};

/// Self-occlusion of every object; one that stands in several places is looked at once.
pub(crate) struct OwnLight {
    made: Vec<(Tracer, SelfVisibility)>,
    /// The one of every object of the composition.
    of: Vec<usize>,
}

impl OwnLight {
    /// Makes it where the settings cache the objects' light ([`is_cached`]) and ask what they hide from themselves.
    ///
    /// # Errors
    /// [`PipelineError`]: an object that is not seen or cannot be traced.
    pub fn new(composition: &Composition, settings: &Settings) -> Result<Option<Self>, PipelineError> {
        if !is_cached(composition, settings) || !(settings.self_occlusion || settings.indirect) {
            return Ok(None);
        }
        let (mut made, mut of): (Vec<(Tracer, SelfVisibility)>, Vec<usize>) = Default::default();
        for (i, object) in composition.objects.iter().enumerate() {
            let same = |other: &super::Placed| other.subject.path == object.subject.path;
            if let Some(first) = composition.objects[..i].iter().position(same) {
                of.push(of[first]);
                continue;
            }
            let config = shading_config(composition, settings);
            let cloud = &object.subject.asset.surfels;
            let tracer = Tracer::new(cloud, &TraceConfig::occlusion())?;
            let own =
                SelfVisibility::new(cloud, object.subject.probe_set(), &tracer, settings.indirect, &config)
                    .map_err(|e| refused(&object.subject.path, &e))?;
            of.push(made.len());
            made.push((tracer, own));
        }
        Ok(Some(Self { made, of }))
    }

    /// Every object where it stands.
    pub fn standing<'a>(&'a self, composition: &'a Composition) -> Vec<(Standing<'a>, &'a SelfVisibility)> {
        let objects = composition.objects.iter().zip(&self.of);
        objects
            .map(|(object, &i)| {
                let (tracer, own) = &self.made[i];
                let cloud = &object.subject.asset.surfels;
                (Standing { cloud, tracer, world_from_object: object.world_from_object }, own)
            })
            .collect()
    }

    /// Bytes of it, trees aside.
    pub fn bytes(&self) -> usize {
        self.made.iter().map(|m| m.1.memory_bytes()).sum()
    }
}

/// Whether the objects' matte light is kept on their surfels: not with [`Shading::Sampled`], nor where light goes from object to
/// object or bounces on one without probes, or where several objects have no fields to hide each other's light with.
pub(crate) fn is_cached(composition: &Composition, settings: &Settings) -> bool {
    let wanted = match settings.shading {
        Shading::Auto => settings.quality != Quality::Reference || settings.near_field,
        Shading::Cached => true,
        Shading::Sampled => false,
    };
    let single = composition.objects.len() == 1;
    let probes = composition.objects.iter().all(|o| o.subject.probe_set().is_some());
    let fields = settings.shadow == Shadow::Auto && composition.wants_shadow();
    let occluded = settings.self_occlusion || settings.indirect;
    let material = composition.objects.iter().all(|o| o.subject.asset.surfels.material.is_some());
    wanted
        && material
        && settings.relight != Relight::Off
        && (!occluded || single || fields)
        && (!settings.indirect || (single && probes))
}

/// The relighting of a quality, with the lookup that the first object's probes were learnt through.
pub(crate) fn shading_config(composition: &Composition, settings: &Settings) -> RelightConfig {
    let preset = match settings.quality {
        Quality::Draft => RelightConfig::draft(),
        Quality::Balanced => RelightConfig::balanced(),
        Quality::Reference => RelightConfig::reference(),
    };
    let preset = settings.rays.map_or(preset.clone(), |rays| RelightConfig {
        highlight_rays: rays.min(1024),
        ..preset.with_rays(rays)
    });
    let lookup = composition.objects[0].subject.probes.as_ref();
    lookup.map_or(preset.clone(), |(_, lookup)| preset.with_lookup(lookup))
}

/// The other objects' casters with their places, for every object.
pub(crate) fn others<'a>(
    baked: &'a Baked,
    composition: &Composition,
) -> Vec<Vec<(&'a Caster, comgs_geom::Similarity)>> {
    let all = baked.placed(composition);
    (0..all.len())
        .map(|i| all.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, c)| *c).collect())
        .collect()
}
