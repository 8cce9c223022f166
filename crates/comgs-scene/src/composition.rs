//! `composition.json`: which objects stand where in which scene, under what light, seen by which cameras.

use crate::SceneError;
use crate::json;
use comgs_geom::Similarity;
use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Version of `composition.json` that is written, and the newest that is read.
pub const COMPOSITION_VERSION: u64 = 1;
/// Largest accepted file.
const MAX_BYTES: u64 = 4 << 20;

/// A composition. Paths are relative to the folder of the file, with forward slashes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompositionRecord {
    /// [`COMPOSITION_VERSION`].
    pub version: u64,
    /// The scene's asset.
    pub scene: String,
    /// The objects, in order of placement.
    pub objects: Vec<ObjectRecord>,
    /// Light at the placement: an equirectangular HDR image.
    pub light: Option<String>,
    /// Where it was taken, world; the middle of the objects when absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_at: Option<[f64; 3]>,
    /// Lights that are added to it, none in most compositions.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lamps: Vec<LampRecord>,
    /// What the objects do to the scene.
    pub effects: EffectPolicy,
    /// The cameras to render from: any camera file.
    pub cameras: String,
}

/// A placed object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectRecord {
    /// Name, unique in the composition.
    pub name: String,
    /// The object's asset.
    pub asset: String,
    /// Its place: `world_from_object`.
    pub similarity: SimilarityRecord,
}

/// A light that is added to the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum LampRecord {
    /// From infinitely far away.
    Directional {
        /// Towards the light.
        direction: [f64; 3],
        /// Irradiance of a surface that faces it, linear RGB.
        irradiance: [f64; 3],
        /// Half of the angle it is seen under, degrees; 0 to 28.
        angular_radius_deg: f64,
    },
    /// From a small sphere.
    Point {
        /// World.
        position: [f64; 3],
        /// Radiant intensity, linear RGB per steradian.
        intensity: [f64; 3],
        /// Radius, world units.
        radius: f64,
    },
}

/// Which effects are simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EffectPolicy {
    /// Shadows of objects on the scene.
    pub shadow: ShadowPolicy,
}

/// Shadows of objects on the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ShadowPolicy {
    /// None.
    None,
    /// By tracing the object's transmittance under the light (ComGS Eq. 15–17).
    Traced,
}

/// A similarity as it stands in the file.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimilarityRecord {
    /// Uniform scale, > 0.
    pub scale: f64,
    /// Unit quaternion w, x, y, z.
    pub rotation: [f64; 4],
    /// Translation.
    pub translation: [f64; 3],
}

impl From<Similarity> for SimilarityRecord {
    fn from(s: Similarity) -> Self {
        let q = s.rotation;
        Self { scale: s.scale, rotation: [q.w, q.x, q.y, q.z], translation: s.translation.to_array() }
    }
}

impl SimilarityRecord {
    /// The similarity.
    ///
    /// # Errors
    /// Field and sentence when a value is not finite, the scale is not positive, or the quaternion has no length.
    pub fn similarity(&self) -> Result<Similarity, (&'static str, String)> {
        if !(self.scale > 1e-12) || !self.scale.is_finite() {
            return Err(("scale", format!("{}, expected a positive number", self.scale)));
        }
        let [w, x, y, z] = self.rotation;
        let q = DQuat::from_xyzw(x, y, z, w);
        if !q.is_finite() || !((q.length() - 1.0).abs() < 1e-3) {
            return Err(("rotation", format!("{:?}, expected a unit quaternion w, x, y, z", self.rotation)));
        }
        let translation = DVec3::from_array(self.translation);
        if !translation.is_finite() {
            return Err(("translation", format!("{translation}, expected finite numbers")));
        }
        Ok(Similarity { scale: self.scale, rotation: q.normalize(), translation })
    }
}

impl CompositionRecord {
    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`SceneError::NewerVersion`], or [`SceneError::Json`] with the place.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let path = path.as_ref();
        Self::parse(&json::read_limited(path, MAX_BYTES)?, path)
    }

    /// Parses and checks the bytes of a file; `path` is only for messages.
    ///
    /// # Errors
    /// As [`CompositionRecord::read`].
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        #[derive(Deserialize)]
        struct Probe {
            version: u64,
        }
        let Probe { version } = json::parse(bytes, "", path)?;
        if version > COMPOSITION_VERSION {
            let supported = COMPOSITION_VERSION;
            return Err(SceneError::NewerVersion { path: path.to_owned(), found: version, supported });
        }
        let record: Self = json::parse(bytes, "", path)?;
        let mut names = std::collections::HashSet::new();
        for (i, object) in record.objects.iter().enumerate() {
            object.similarity.similarity().map_err(|(field, reason)| {
                SceneError::json(path, format!("objects[{i}].similarity.{field}"), reason)
            })?;
            if !names.insert(&object.name) {
                let reason = format!("the name {:?} is used twice", object.name);
                return Err(SceneError::json(path, format!("objects[{i}].name"), reason));
            }
        }
        Ok(record)
    }

    /// Writes the file; it is whole or unchanged.
    ///
    /// # Errors
    /// [`SceneError::Write`]; [`SceneError::Json`] when it would not read back.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), SceneError> {
        let path = path.as_ref();
        let text = json::to_text(self).map_err(SceneError::write(path))?;
        Self::parse(text.as_bytes(), path)?;
        json::write(path, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> CompositionRecord {
        let s = Similarity {
            scale: 0.5,
            rotation: DQuat::from_rotation_z(0.3),
            translation: DVec3::new(1.0, 2.0, 3.0),
        };
        CompositionRecord {
            version: COMPOSITION_VERSION,
            scene: "../study.asset".into(),
            objects: vec![ObjectRecord {
                name: "cow".into(),
                asset: "../cow.asset".into(),
                similarity: s.into(),
            }],
            light: Some("env.exr".into()),
            light_at: Some([0.5, -1.0, 0.75]),
            lamps: Vec::new(),
            effects: EffectPolicy { shadow: ShadowPolicy::Traced },
            cameras: "cameras.json".into(),
        }
    }

    /// Goal: round trip, and the similarity survives with its quaternion w first.
    #[test]
    fn round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("composition.json");
        record().write(&path).unwrap();
        let back = CompositionRecord::read(&path).unwrap();
        assert_eq!(back, record());
        assert!((back.objects[0].similarity.rotation[0] - 0.15f64.cos()).abs() < 1e-12);
        assert!(back.objects[0].similarity.similarity().is_ok());
    }

    /// Goal: lamps survive the round trip, and a composition without any is written as it was before there were lamps.
    #[test]
    fn lamps_are_optional() {
        let mut with = record();
        with.lamps = vec![
            LampRecord::Point { position: [1.0, 2.0, 3.0], intensity: [4.0; 3], radius: 0.1 },
            LampRecord::Directional {
                direction: [0.0, 0.0, 1.0],
                irradiance: [1.0; 3],
                angular_radius_deg: 0.5,
            },
        ];
        let text = serde_json::to_string(&with).unwrap();
        assert_eq!(CompositionRecord::parse(text.as_bytes(), Path::new("c.json")).unwrap(), with);
        assert!(!serde_json::to_string(&record()).unwrap().contains("lamps"));
        let wrong = text.replace("\"radius\":0.1", "\"radios\":0.1");
        assert!(CompositionRecord::parse(wrong.as_bytes(), Path::new("c.json")).is_err());
    }

    /// Goal: mistakes are named by their place, misspelt fields included, and nothing unreadable is written.
    #[test]
    fn mistakes_are_named() {
        let text = serde_json::to_string(&record()).unwrap();
        let error = |from: &str, to: &str| {
            assert!(text.contains(from), "{from} in {text}");
            CompositionRecord::parse(text.replacen(from, to, 1).as_bytes(), Path::new("c.json"))
                .unwrap_err()
                .to_string()
        };
        assert!(error("\"traced\"", "\"painted\"").starts_with("effects.shadow: "));
        assert!(error("\"scale\":0.5", "\"scale\":0").starts_with("objects[0].similarity.scale: "));
        assert!(error("\"shadow\"", "\"shadows\"").starts_with("effects.shadows: unknown field"));
        assert!(error("\"version\":1", "\"version\":2").contains("version 2"));
        let mut twice = record();
        twice.objects.push(twice.objects[0].clone());
        let folder = tempfile::tempdir().unwrap();
        assert!(twice.write(folder.path().join("c.json")).unwrap_err().to_string().contains("used twice"));
        let mut nan = record();
        nan.objects[0].similarity.translation[1] = f64::NAN;
        assert!(nan.write(folder.path().join("c.json")).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
