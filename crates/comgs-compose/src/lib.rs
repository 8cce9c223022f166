//! Composition: the shadow an object casts on the scene, depth compositing without fringes, and the layers of a
//! frame.
//!
//! Modules in the order a frame is made: [`objects`] places and merges what is inserted, [`placement`] says
//! whether it stands on anything, [`receivers`] are what the camera sees of the scene, [`shadow`] traces their ratio of
//! Eq. 15–17 which [`denoise`] smooths, [`over`]
//! puts scene and object in order, [`frame`] runs all of it for one camera, and [`layers`] writes the result.
//!
//! Shadows without tracing them for every pixel: [`occlusion_field`] is what an object hides, [`shadow_light`] the light as
//! directions and strong lights, [`field_shadow`] the ratio of any point from the two, [`shadow_cache`] the ratio where
//! frames need it; [`scene_probes`] is the paper's way.
//!
//! [`relight`] shows a decomposed object under another light; [`camera_look`] gives a frame the defocus and noise of photos.
//!
//! Nothing here knows the command line; only [`layers`] and [`relight::write_relit_layers`] write files.

pub mod camera_look;
pub mod denoise;
pub mod field_shadow;
pub mod frame;
pub mod layers;
pub mod objects;
pub mod occlusion_field;
pub mod over;
pub mod placement;
pub mod receivers;
pub mod relight;
pub mod scene_frame;
pub mod scene_probes;
pub mod shadow;
pub mod shadow_cache;
pub mod shadow_light;

pub use camera_look::{CameraLook, Defocus, Noise};
pub use denoise::{AtrousConfig, Denoise};
pub use field_shadow::{Caster, FieldShadow, ShadowRatios};
pub use frame::{ComposeConfig, ComposeError, ComposedFrame, Composer, ObjectShader, ShadowSource};
pub use objects::{PlacedObject, merge};
pub use occlusion_field::{FieldConfig, FieldError, OcclusionField};
pub use over::Ordering;
pub use placement::{PlacementConfig, PlacementReport, check_placement};
pub use receivers::Receivers;
pub use relight::{
    CachedRelighter, Heuristic, Indirect, Mirror, NearField, RelightConfig, RelightError, Relighter,
    RelitFrame, SelfOcclusion, SelfVisibility, Standing,
};
pub use scene_frame::{ObjectFrame, SceneFrame};
pub use scene_probes::{Density, SceneProbeConfig, SceneProbes};
pub use shadow::{DARK, LightSample, LightSource, Occluder, ShadowConfig, shadow_ratio};
pub use shadow_cache::{CacheConfig, CacheStatistics, ReceiverCloud, ShadowCache};
pub use shadow_light::{Beam, Lamp, LampError, ShadowLight, ShadowLightConfig, StrongFrom};
