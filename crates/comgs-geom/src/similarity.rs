//! Similarity transforms: uniform scale, rotation, translation. Probes and surfels need nothing more general:
//! a mirrored or sheared disc is not a disc.

use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// `p ↦ scale · rotation · p + translation`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// Uniform scale, > 0.
    pub scale: f64,
    /// Rotation, unit quaternion.
    pub rotation: DQuat,
    /// Translation in units of the target space.
    pub translation: DVec3,
}

/// Why a matrix is not a similarity.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SimilarityError {
    /// Some entry is NaN or infinite.
    #[error("the transform has non-finite entries")]
    NotFinite,
    /// The bottom row is not (0, 0, 0, 1).
    #[error("the transform is projective: its bottom row is {0:?}, expected [0, 0, 0, 1]")]
    Projective([f64; 4]),
    /// Negative determinant.
    #[error("the transform mirrors space; objects can be rotated, moved and scaled uniformly, not mirrored")]
    Mirrored,
    /// Scale of (nearly) nothing.
    #[error("the transform shrinks the object to nothing (scale {0:.3e})")]
    Degenerate(f64),
    /// Different scales along different axes.
    #[error("the transform shears or scales unevenly (relative deviation {0:.3e}); a similarity is needed")]
    Sheared(f64),
}

/// Largest relative deviation from a similarity that is taken for rounding.
const SHEAR_TOLERANCE: f64 = 1e-3;

impl Similarity {
    /// The identity.
    pub const IDENTITY: Self = Self { scale: 1.0, rotation: DQuat::IDENTITY, translation: DVec3::ZERO };

    /// From a 4×4 matrix.
    ///
    /// # Errors
    /// [`SimilarityError`] when the matrix is not finite, projective, mirrored, degenerate or sheared.
    pub fn from_matrix(m: DMat4) -> Result<Self, SimilarityError> {
        if !m.is_finite() {
            return Err(SimilarityError::NotFinite);
        }
        let bottom = m.row(3);
        if (bottom - glam::DVec4::W).abs().max_element() > 1e-6 {
            return Err(SimilarityError::Projective(bottom.to_array()));
        }
        let linear = DMat3::from_mat4(m);
        let det = linear.determinant();
        let scale = det.abs().cbrt();
        if scale < 1e-12 {
            return Err(SimilarityError::Degenerate(scale));
        }
        if det < 0.0 {
            return Err(SimilarityError::Mirrored);
        }
        let unit = linear * (1.0 / scale);
        let deviation = (unit.transpose() * unit - DMat3::IDENTITY)
            .to_cols_array()
            .iter()
            .fold(0.0f64, |a, v| a.max(v.abs()));
        if deviation > SHEAR_TOLERANCE {
            return Err(SimilarityError::Sheared(deviation));
        }
        Ok(Self { scale, rotation: DQuat::from_mat3(&unit).normalize(), translation: m.w_axis.truncate() })
    }

    /// As an affine map.
    #[must_use]
    pub fn to_affine(self) -> DAffine3 {
        DAffine3::from_scale_rotation_translation(DVec3::splat(self.scale), self.rotation, self.translation)
    }

    /// Moves a point.
    #[must_use]
    pub fn transform_point(&self, p: DVec3) -> DVec3 {
        self.rotation * (p * self.scale) + self.translation
    }

    /// The inverse map.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self { scale, rotation, translation: rotation * (-self.translation * scale) }
    }

    /// `self ∘ other`: first `other`, then `self`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            scale: self.scale * other.scale,
            rotation: (self.rotation * other.rotation).normalize(),
            translation: self.transform_point(other.translation),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: what is a similarity is taken apart exactly, what is not is refused by name.
    #[test]
    fn from_matrix_takes_similarities_only() {
        let s = Similarity {
            scale: 0.34,
            rotation: DQuat::from_rotation_z(0.7) * DQuat::from_rotation_x(-0.2),
            translation: DVec3::new(0.3, -1.2, 0.3),
        };
        let m = DMat4::from(s.to_affine());
        let back = Similarity::from_matrix(m).unwrap();
        assert!((back.scale - s.scale).abs() < 1e-12);
        let p = DVec3::new(0.2, 0.4, -0.9);
        assert!((back.transform_point(p) - m.transform_point3(p)).length() < 1e-12);
        assert!((s.inverse().transform_point(s.transform_point(p)) - p).length() < 1e-12);
        assert!((s.compose(&s.inverse()).transform_point(p) - p).length() < 1e-12);

        let mirrored = m * DMat4::from_scale(DVec3::new(-1.0, 1.0, 1.0));
        assert_eq!(Similarity::from_matrix(mirrored), Err(SimilarityError::Mirrored));
        let sheared = m * DMat4::from_scale(DVec3::new(1.2, 1.0, 1.0));
        assert!(matches!(Similarity::from_matrix(sheared), Err(SimilarityError::Sheared(_))));
        assert!(matches!(
            Similarity::from_matrix(m * DMat4::from_scale(DVec3::splat(1e-15))),
            Err(SimilarityError::Degenerate(_))
        ));
        assert_eq!(Similarity::from_matrix(m * f64::NAN), Err(SimilarityError::NotFinite));
    }
}
