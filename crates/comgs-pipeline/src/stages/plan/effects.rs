//! The effects, each with the same shape: what it is called, what it builds on, what it needs, and how it is turned on. Its
//! forward pass is the renderer's ([`crate::stages::render_composition`]) with that setting; its estimate is the plan's pilot.

use crate::stages::editing::{Composition, Relight, Settings, Shadow};
use comgs_compose::CameraLook;

/// The scene's light on the objects.
pub(crate) const RELIGHT: &str = "scene light on the object";
/// What the objects hide from themselves and each other.
pub(crate) const SELF_OCCLUSION: &str = "self-occlusion";
/// Shadow within a few radii of the objects.
pub(crate) const SHADOW_NEAR: &str = "cast shadow, near";
/// Shadow beyond: a low sun.
pub(crate) const SHADOW_FAR: &str = "cast shadow, far";
/// Light from surfaces near the objects.
pub(crate) const NEAR_FIELD: &str = "near-field light";
/// Light that the objects throw back on the scene.
pub(crate) const BOUNCE: &str = "bounce on the scene";
/// Light between the objects' surfaces.
pub(crate) const INDIRECT: &str = "indirect on the object";

/// The photos' defocus on the objects.
pub(crate) const DEFOCUS: &str = "defocus";
/// The photos' noise on the frames.
pub(crate) const NOISE: &str = "noise";

/// An effect.
pub(crate) struct Effect {
    /// Its name.
    pub name: &'static str,
    /// The effect without which it makes no sense.
    pub needs: Option<&'static str>,
    /// Whether the occlusion fields are baked for it.
    pub needs_occlusion: bool,
    /// Why a composition cannot have it.
    pub missing: fn(&Composition) -> Option<String>,
    /// Adds it.
    pub turn_on: fn(&mut Settings),
}

fn needs_material(composition: &Composition) -> Option<String> {
    let without = composition.objects.iter().find(|o| o.subject.asset.surfels.material.is_none())?;
    Some(format!("{} has no material (run `comgs decompose`)", without.name))
}

fn needs_shadow(composition: &Composition) -> Option<String> {
    (!composition.wants_shadow()).then(|| "the composition asks for no shadow".to_owned())
}

fn no_look(composition: &Composition, none: fn(&CameraLook) -> bool, why: &str) -> Option<String> {
    match &composition.look {
        None => Some("no photos to match were given (`--photos`)".to_owned()),
        Some(look) => none(look).then(|| why.to_owned()),
    }
}

/// All, in the order in which they build on one another.
pub(crate) const EFFECTS: [Effect; 9] = [
    Effect {
        name: RELIGHT,
        needs: None,
        needs_occlusion: false,
        missing: needs_material,
        turn_on: |s| s.relight = Relight::Auto,
    },
    Effect {
        name: SELF_OCCLUSION,
        needs: Some(RELIGHT),
        needs_occlusion: false,
        missing: needs_material,
        turn_on: |s| s.self_occlusion = true,
    },
    Effect {
        name: SHADOW_NEAR,
        needs: None,
        needs_occlusion: true,
        missing: needs_shadow,
        turn_on: |s| {
            s.shadow = Shadow::Auto;
            s.near_only = true;
        },
    },
    Effect {
        name: SHADOW_FAR,
        needs: Some(SHADOW_NEAR),
        needs_occlusion: false,
        missing: needs_shadow,
        turn_on: |s| s.near_only = false,
    },
    Effect {
        name: NEAR_FIELD,
        needs: Some(SELF_OCCLUSION),
        needs_occlusion: false,
        missing: needs_material,
        turn_on: |s| s.near_field = true,
    },
    Effect {
        name: BOUNCE,
        needs: Some(SHADOW_NEAR),
        needs_occlusion: false,
        missing: needs_shadow,
        turn_on: |s| s.bounce = true,
    },
    Effect {
        name: INDIRECT,
        needs: Some(SELF_OCCLUSION),
        needs_occlusion: false,
        missing: needs_material,
        turn_on: |s| s.indirect = true,
    },
    Effect {
        name: DEFOCUS,
        needs: None,
        needs_occlusion: false,
        missing: |c| no_look(c, |look| look.defocus.is_none(), "the photos are sharp at all depths"),
        turn_on: |s| s.defocus = true,
    },
    Effect {
        name: NOISE,
        needs: None,
        needs_occlusion: false,
        missing: |c| no_look(c, |look| look.noise.is_none(), "the photos have no noise that 8 bit show"),
        turn_on: |s| s.noise = true,
    },
];

/// Settings with every effect off.
pub(crate) fn none(settings: &Settings) -> Settings {
    Settings {
        shadow: Shadow::None,
        relight: Relight::Off,
        self_occlusion: false,
        near_field: false,
        indirect: false,
        bounce: false,
        defocus: false,
        noise: false,
        near_only: false,
        ..settings.clone()
    }
}
