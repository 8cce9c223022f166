//! The points of a scene that cameras see.

use super::cells::class_of;
use crate::receivers::Receivers;
use comgs_geom::Camera;
use glam::Vec3;
use std::collections::HashSet;
use std::hash::{BuildHasherDefault, Hasher};

/// Points of a scene that a set of cameras sees, thinned to what the cameras resolve. It belongs to the scene and the
/// cameras: objects may move under it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReceiverCloud {
    /// World.
    pub points: Vec<Vec3>,
    /// Unit, world, facing the camera.
    pub normals: Vec<Vec3>,
    /// Side of a pixel of the camera that saw it, at its distance; world units.
    pub footprints: Vec<f32>,
    seen: HashSet<[i32; 5], BuildHasherDefault<Fold>>,
}

/// A hash of few steps for the cubes' numbers: every pixel of every camera is looked up, nobody chooses the numbers.
#[derive(Clone, Copy, Debug, Default)]
struct Fold(u64);

impl Hasher for Fold {
    fn write(&mut self, bytes: &[u8]) {
        for chunk in bytes.chunks(8) {
            let mut word = [0; 8];
            word[..chunk.len()].copy_from_slice(chunk);
            self.write_u64(u64::from_le_bytes(word));
        }
    }

    fn write_u64(&mut self, word: u64) {
        // Fibonacci hashing (Knuth, TAOCP 3, § 6.4), folded so that high bits reach low ones.
        self.0 = (self.0 ^ word).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 ^= self.0 >> 29;
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

impl ReceiverCloud {
    /// Adds what a camera sees. Of points that fall into one cube of a footprint's side with normals of one class, the
    /// first stays. Cubes come in powers of two, so cameras at different distances keep what they resolve.
    ///
    /// # Panics
    /// When receivers and camera differ in size.
    pub fn add(&mut self, camera: &Camera, receivers: &Receivers) {
        assert_eq!((receivers.width, receivers.height), (camera.width, camera.height), "one camera");
        let centre = camera.centre().as_vec3();
        let focal = camera.fx.min(camera.fy) as f32;
        for i in (0..receivers.points.len()).filter(|&i| receivers.is_surface(i)) {
            let (point, normal) = (receivers.points[i], receivers.normals[i]);
            let footprint = (point - centre).length() / focal;
            if !(footprint > 0.0 && footprint.is_finite() && point.is_finite()) {
                continue;
            }
            let level = footprint.log2().floor();
            let cube = level.exp2();
            let [x, y, z] = (point / cube).to_array().map(|v| v.floor() as i32);
            if self.seen.insert([level as i32, class_of(normal) as i32, x, y, z]) {
                self.points.push(point);
                self.normals.push(normal);
                self.footprints.push(footprint);
            }
        }
    }

    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether no camera sees anything.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
