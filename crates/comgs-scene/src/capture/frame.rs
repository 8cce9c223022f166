//! What a list of cameras says, before any image is looked for. Shared by the three formats.

use super::{ProblemKind, Severity, Split};
use comgs_geom::Lens;
use glam::{DAffine3, DMat4, DVec4};

/// A camera list after parsing: the frames that could be understood, and what is wrong with the others.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Listing {
    /// Frames in file order.
    pub frames: Vec<Frame>,
    /// Problems found on the way.
    pub faults: Vec<Fault>,
    /// A point cloud that the list names, relative to its folder.
    pub points: Option<String>,
}

/// A problem of a camera list, by its place in the list.
#[derive(Clone, Debug, PartialEq)]
pub struct Fault {
    /// Whether it can be lived with.
    pub severity: Severity,
    /// Class.
    pub kind: ProblemKind,
    /// Path inside the file, such as `cameras.3.intr`.
    pub location: String,
    /// What, expected, got.
    pub message: String,
}

impl Fault {
    pub(crate) fn error(kind: ProblemKind, location: impl Into<String>, message: impl Into<String>) -> Self {
        Self { severity: Severity::Error, kind, location: location.into(), message: message.into() }
    }
}

/// One frame as listed.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Name of the view.
    pub name: String,
    /// Path inside the list, such as `cameras.3`.
    pub location: String,
    /// Image as listed: a name or a relative path, maybe without its extension.
    pub file: String,
    /// Mask as listed.
    pub mask: Option<String>,
    /// Declared size in pixels; without it the image file tells.
    pub size: Option<(usize, usize)>,
    /// Focal length and principal point at the declared size.
    pub intrinsics: Intrinsics,
    /// Lens model.
    pub lens: Lens,
    /// Pose, OpenCV axes.
    pub world_from_camera: DAffine3,
    /// The split that the list itself puts the frame in.
    pub split: Option<Split>,
}

/// A focal length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Focal {
    /// In pixels.
    Pixels(f64),
    /// As the full field of view in radians.
    Angle(f64),
}

impl Focal {
    fn pixels(self, size: usize) -> f64 {
        match self {
            Self::Pixels(f) => f,
            Self::Angle(angle) => 0.5 * size as f64 / (0.5 * angle).tan(),
        }
    }

    /// Whether the value can be a focal length at all.
    #[must_use]
    pub fn is_sound(self) -> bool {
        match self {
            Self::Pixels(f) => f.is_finite() && f > 0.0,
            Self::Angle(a) => a > 0.0 && a < std::f64::consts::PI,
        }
    }
}

/// Focal length and principal point, as far as a list states them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Intrinsics {
    /// Horizontal focal length.
    pub x: Focal,
    /// Vertical focal length; the horizontal one in pixels when absent.
    pub y: Option<Focal>,
    /// Principal point x; the image's middle when absent.
    pub cx: Option<f64>,
    /// Principal point y; the image's middle when absent.
    pub cy: Option<f64>,
}

impl Intrinsics {
    /// `[fx, fy, cx, cy]` in pixels for an image of this size.
    #[must_use]
    pub fn resolve(&self, width: usize, height: usize) -> [f64; 4] {
        let fx = self.x.pixels(width);
        [
            fx,
            self.y.map_or(fx, |y| y.pixels(height)),
            self.cx.unwrap_or(0.5 * width as f64),
            self.cy.unwrap_or(0.5 * height as f64),
        ]
    }
}

/// A rigid pose from a matrix. `Err` says why it is none.
pub(crate) fn pose(m: DMat4) -> Result<DAffine3, String> {
    if !m.is_finite() {
        return Err("the pose has non-finite entries".into());
    }
    if (m.row(3) - DVec4::W).abs().max_element() > 1e-6 {
        let row = m.row(3).to_array();
        return Err(format!("the pose's last row is {row:?}, expected [0, 0, 0, 1]"));
    }
    Ok(DAffine3::from_mat4(m))
}

/// Whether a text can name a file in any folder: no separators, no parent folder, nothing unprintable.
pub(crate) fn is_plain_name(name: &str) -> bool {
    !name.is_empty()
        && name.len() <= 200
        && name != "."
        && name != ".."
        && !name.chars().any(|c| c.is_control() || "/\\:*?\"<>|".contains(c))
}

/// Gives frames of path-like `file`s short unique names: the file's stem, or where stems repeat the whole path joined
/// by underscores.
pub(crate) fn name_by_file(frames: &mut [Frame]) {
    let stem = |file: &str| {
        let last = file.rsplit(['/', '\\']).next().unwrap_or(file);
        without_extension(last).to_owned()
    };
    let mut seen = std::collections::HashMap::new();
    for frame in frames.iter() {
        *seen.entry(stem(&frame.file)).or_insert(0usize) += 1;
    }
    for frame in frames {
        let short = stem(&frame.file);
        frame.name = if seen[&short] == 1 {
            short
        } else {
            let parts: Vec<&str> = without_extension(&frame.file)
                .split(['/', '\\'])
                .filter(|p| !matches!(*p, "" | "." | ".."))
                .collect();
            parts.join("_")
        };
    }
}

/// A file name without a known image extension (a dot may well be part of the name: `frame.0001`).
pub(crate) fn without_extension(file: &str) -> &str {
    for extension in super::files::EXTENSIONS {
        let cut = file.len().saturating_sub(extension.len());
        if cut > 1 && file.is_char_boundary(cut) {
            let (head, tail) = file.split_at(cut);
            if tail.eq_ignore_ascii_case(extension) && head.ends_with('.') {
                return &head[..cut - 1];
            }
        }
    }
    file
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(file: &str) -> Frame {
        Frame {
            name: String::new(),
            location: String::new(),
            file: file.into(),
            mask: None,
            size: None,
            intrinsics: Intrinsics { x: Focal::Angle(1.0), y: None, cx: None, cy: None },
            lens: Lens::Pinhole,
            world_from_camera: DAffine3::IDENTITY,
            split: None,
        }
    }

    /// Goal: names are stems where those are unique, else paths; dots in names survive.
    #[test]
    fn frames_are_named_by_their_files() {
        let mut frames = ["./a/0001.JPG", "b/0001.jpg", "b/frame.0002", "b/x.png"].map(frame);
        name_by_file(&mut frames);
        assert_eq!(frames.each_ref().map(|f| f.name.as_str()), ["a_0001", "b_0001", "frame.0002", "x"]);
        for bad in ["", "..", "a/b", "a\\b", "a\nb", "c:d"] {
            assert!(!is_plain_name(bad), "{bad:?}");
        }
        assert!(is_plain_name("frame.0002 é"));
        assert_eq!(without_extension("é.png"), "é");
        assert_eq!(without_extension(".png"), ".png");
    }

    /// Goal: fields of view become focal lengths, and what is absent has the documented default.
    #[test]
    fn intrinsics_resolve() {
        let half = std::f64::consts::FRAC_PI_2;
        let i = Intrinsics { x: Focal::Angle(half), y: None, cx: None, cy: Some(3.0) };
        let [fx, fy, cx, cy] = i.resolve(100, 50);
        assert!((fx - 50.0).abs() < 1e-12 && fx == fy && cx == 50.0 && cy == 3.0);
        assert!(
            !Focal::Angle(4.0).is_sound()
                && !Focal::Pixels(f64::NAN).is_sound()
                && !Focal::Pixels(-3.0).is_sound()
                && Focal::Pixels(3.0).is_sound()
        );
    }
}
