//! `transform.json`: where objects stand in a scene.
//!
//! Per object name one of `transform` (16 numbers, row-major object-to-world similarity), `transformation` (the same), or
//! `location` + `rotation` + `scale`. Rotations are Euler angles in radians; `rotation_type` gives the order in which
//! the axes are turned about, each fixed in the world (default `XYZ`: first x, then y, then z, as Blender means it).

use crate::SceneError;
use crate::json::{self, Number, Numbers};
use comgs_geom::Similarity;
use glam::{DMat4, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use std::collections::BTreeMap;
use std::path::Path;

/// Largest accepted file.
const MAX_BYTES: u64 = 1 << 20;
/// Angles beyond this are taken for degrees and refused, radians being expected.
const MAX_RADIANS: f64 = 4.0 * std::f64::consts::PI;

/// Placements by object name, in file order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransformFile {
    /// `world_from_object` similarities.
    pub objects: Vec<(String, Similarity)>,
}

#[derive(Deserialize)]
struct Entry {
    transform: Option<Numbers>,
    transformation: Option<Numbers>,
    location: Option<Numbers>,
    rotation: Option<Numbers>,
    rotation_type: Option<String>,
    scale: Option<Scale>,
}

/// One number, or three that must be the same.
#[derive(Deserialize)]
#[serde(untagged)]
enum Scale {
    One(Number),
    Three([Number; 3]),
}

impl TransformFile {
    /// A file with one object.
    #[must_use]
    pub fn single(name: &str, world_from_object: Similarity) -> Self {
        Self { objects: vec![(name.to_owned(), world_from_object)] }
    }

    /// The placement of an object; the only one there is, when no name is given.
    #[must_use]
    pub fn get(&self, name: Option<&str>) -> Option<&Similarity> {
        match (name, self.objects.as_slice()) {
            (Some(name), objects) => objects.iter().find(|(n, _)| n == name).map(|(_, s)| s),
            (None, [(_, only)]) => Some(only),
            (None, _) => None,
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`SceneError::Json`] with the object's name: a mirrored, sheared or shrunken transform is refused, since surfels
    /// and probes need a similarity.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, SceneError> {
        let path = path.as_ref();
        Self::parse(&json::read_limited(path, MAX_BYTES)?, path)
    }

    /// Parses the bytes of a file; `path` is only for messages.
    ///
    /// # Errors
    /// As [`TransformFile::read`].
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, SceneError> {
        let bytes = json::without_literals(bytes);
        // serde_json's own map keeps file order, but holds values parsed; names come from there, values raw.
        let raw: BTreeMap<String, &RawValue> = json::parse(&bytes, "", path)?;
        let order: serde_json::Map<String, serde_json::Value> = json::parse(&bytes, "", path)?;
        let mut objects = Vec::new();
        for name in order.keys() {
            let Some(value) = raw.get(name) else { continue };
            let entry: Entry = json::parse(value.get().as_bytes(), name, path)?;
            let similarity = similarity(&entry)
                .map_err(|(field, reason)| SceneError::json(path, format!("{name}.{field}"), reason))?;
            objects.push((name.clone(), similarity));
        }
        if objects.is_empty() {
            return Err(SceneError::json(path, "", "no object is listed"));
        }
        Ok(Self { objects })
    }

    /// Writes a file with `transform` matrices; it is whole or unchanged.
    ///
    /// # Errors
    /// [`SceneError::Write`].
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), SceneError> {
        #[derive(Serialize)]
        struct Out {
            transform: [f64; 16],
        }
        let mut map = serde_json::Map::new();
        let path = path.as_ref();
        for (name, similarity) in &self.objects {
            let transform = DMat4::from(similarity.to_affine()).transpose().to_cols_array();
            let value = serde_json::to_value(Out { transform })
                .map_err(|e| SceneError::Write { path: path.to_owned(), reason: std::io::Error::other(e) })?;
            map.insert(name.clone(), value);
        }
        json::write(path, &map)
    }
}

fn similarity(entry: &Entry) -> Result<Similarity, (&'static str, String)> {
    let matrix = match (&entry.transform, &entry.transformation) {
        (Some(m), _) => Some(("transform", m)),
        (None, Some(m)) => Some(("transformation", m)),
        (None, None) => None,
    };
    if let Some((field, numbers)) = matrix {
        let m = numbers.matrix().map_err(|reason| (field, reason))?;
        return Similarity::from_matrix(m).map_err(|e| (field, e.to_string()));
    }
    let triple = |field, numbers: &Option<Numbers>| match numbers {
        None => Err((field, "missing (and there is no transform either)".to_owned())),
        Some(Numbers(v)) => match v[..] {
            [x, y, z] if x.is_finite() && y.is_finite() && z.is_finite() => Ok(DVec3::new(x, y, z)),
            _ => Err((field, format!("{v:?}, expected three finite numbers"))),
        },
    };
    let translation = triple("location", &entry.location)?;
    let angles = triple("rotation", &entry.rotation)?;
    if angles.abs().max_element() > MAX_RADIANS {
        return Err(("rotation", format!("{angles} looks like degrees, expected radians")));
    }
    let scale = match &entry.scale {
        None => return Err(("scale", "missing".to_owned())),
        Some(Scale::One(Number(s))) => *s,
        Some(Scale::Three([a, b, c])) => {
            let (a, b, c) = (a.0, b.0, c.0);
            if !((a - b).abs().max((a - c).abs()) <= 1e-3 * a.abs()) {
                let text = format!("{a}, {b}, {c} differ; objects are scaled evenly or not at all");
                return Err(("scale", text));
            }
            a
        }
    };
    if !(scale > 1e-12) || !scale.is_finite() {
        return Err(("scale", format!("{scale}, expected a positive number")));
    }
    let order = entry.rotation_type.as_deref().unwrap_or("XYZ");
    let rotation = euler(order, angles)
        .ok_or_else(|| ("rotation_type", format!("{order:?}, expected an order of axes such as XYZ")))?;
    Ok(Similarity { scale, rotation, translation })
}

/// Turns about the world's axes, one after the other in the order named.
fn euler(order: &str, angles: DVec3) -> Option<DQuat> {
    let mut letters: Vec<char> = order.chars().collect();
    letters.sort_unstable();
    if letters != ['X', 'Y', 'Z'] {
        return None;
    }
    order.chars().try_fold(DQuat::IDENTITY, |so_far, axis| {
        let turn = match axis {
            'X' => DQuat::from_rotation_x(angles.x),
            'Y' => DQuat::from_rotation_y(angles.y),
            'Z' => DQuat::from_rotation_z(angles.z),
            _ => return None,
        };
        Some(turn * so_far)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn here() -> &'static Path {
        Path::new("transform.json")
    }

    fn parse(text: &str) -> Result<TransformFile, SceneError> {
        TransformFile::parse(text.as_bytes(), here())
    }

    /// Goal: the three spellings of one placement agree, and the order of objects is the file's.
    #[test]
    fn three_spellings() {
        // A quarter turn about z, twice the size, moved by (1, 2, 3).
        let m = "[0,-2,0,1, 2,0,0,2, 0,0,2,3, 0,0,0,1]";
        let text = format!(
            r#"{{"z": {{"transform": {m}}}, "a": {{"transformation": [[0,-2,0,1],[2,0,0,2],[0,0,2,3],[0,0,0,1]]}},
            "m": {{"location": [1,2,3], "rotation": [0,0,1.5707963267948966], "scale": [2,2,2]}}}}"#
        );
        let file = parse(&text).unwrap();
        assert_eq!(file.objects.iter().map(|(n, _)| n.as_str()).collect::<Vec<_>>(), ["z", "a", "m"]);
        for (name, s) in &file.objects {
            let p = s.transform_point(DVec3::X);
            assert!(p.distance(DVec3::new(1.0, 4.0, 3.0)) < 1e-12, "{name}: {p}");
        }
        assert_eq!(file.get(Some("a")), Some(&file.objects[1].1));
        assert_eq!(file.get(None), None);
    }

    /// Goal: XYZ turns about x first (as Blender's XYZ Euler does), and other orders differ.
    #[test]
    fn euler_orders() {
        let q = std::f64::consts::FRAC_PI_2;
        // y → z by the turn about x; then z → x by the turn about y.
        let turned = euler("XYZ", DVec3::new(q, q, 0.0)).unwrap() * DVec3::Y;
        assert!(turned.distance(DVec3::X) < 1e-12, "{turned}");
        let other = euler("YXZ", DVec3::new(q, q, 0.0)).unwrap() * DVec3::Y;
        assert!(other.distance(DVec3::Z) < 1e-12, "{other}");
        assert!(euler("XXZ", DVec3::ZERO).is_none());
    }

    /// Goal: what is no placement is refused with the object and field.
    #[test]
    fn refused_transforms() {
        for (text, expected) in [
            (
                r#"{"cow": {"transform": [-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]}}"#,
                "cow.transform: the transform mirrors",
            ),
            (
                r#"{"cow": {"transform": [1,0,0,0, 0,2,0,0, 0,0,1,0, 0,0,0,1]}}"#,
                "cow.transform: the transform shears",
            ),
            (
                r#"{"cow": {"transform": [NaN,0,0,0, 0,2,0,0, 0,0,1,0, 0,0,0,1]}}"#,
                "cow.transform: the transform has non",
            ),
            (r#"{"cow": {"transform": [1,2]}}"#, "cow.transform: 2 numbers"),
            (r#"{"cow": {"transform": [1,"x"]}}"#, "cow.transform[1]: invalid type"),
            (r#"{"cow": {}}"#, "cow.location: missing"),
            (r#"{"cow": {"location": [0,0,0], "rotation": [90,0,0], "scale": 1}}"#, "cow.rotation: "),
            (r#"{"cow": {"location": [0,0,0], "rotation": [0,0,0], "scale": [1,1,2]}}"#, "cow.scale: "),
            (r#"{"cow": {"location": [0,0,0], "rotation": [0,0,0], "scale": -1}}"#, "cow.scale: "),
            (
                r#"{"cow": {"location": [0,0,0], "rotation": [0,0,0], "scale": 1, "rotation_type": "quaternion"}}"#,
                "cow.rotation_type: ",
            ),
            ("{}", "no object"),
            ("[]", "invalid type"),
        ] {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.starts_with(expected), "{text}: {error}");
            assert!(error.ends_with("transform.json"));
        }
    }

    /// Goal: what is written reads back.
    #[test]
    fn round_trip() {
        let s = Similarity {
            scale: 0.27,
            rotation: DQuat::from_rotation_z(0.6) * DQuat::from_rotation_x(-1.1),
            translation: DVec3::new(0.06, 0.03, 0.65),
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transform.json");
        TransformFile::single("cow", s).write(&path).unwrap();
        let back = TransformFile::read(&path).unwrap();
        let back = back.get(None).unwrap();
        let p = DVec3::new(0.3, -0.4, 0.5);
        assert!(back.transform_point(p).distance(s.transform_point(p)) < 1e-12);
    }
}
