//! Materials: two finishes and a pattern that mixes them, evaluated in the part's own coordinates, so no mesh needs
//! texture coordinates and no texture has seams.

use crate::brdf::Brdf;
use crate::noise::Noise;
use glam::Vec3;
use serde::{Deserialize, Serialize};

/// Base colour, roughness and metalness, with the meaning that the whole pipeline gives them (see [`Brdf`]).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finish {
    /// Base colour, linear Rec.709 in [0, 1].
    pub color: [f32; 3],
    /// Perceptual roughness in [0, 1]; the GGX width is its square.
    #[serde(default = "default_roughness")]
    pub roughness: f32,
    /// 0 dielectric, 1 metal.
    #[serde(default)]
    pub metallic: f32,
}

fn default_roughness() -> f32 {
    0.5
}

/// What a surface is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Material {
    /// Where the pattern is 0.
    pub a: Finish,
    /// Where the pattern is 1; the same as `a` when left out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub b: Option<Finish>,
    /// How the two are mixed.
    #[serde(default)]
    pub pattern: Pattern,
    /// Strength in [0, 1] of a fine irregular change of brightness: real surfaces are never plain, and plain ones give a
    /// reconstruction nothing to hold on to.
    #[serde(default)]
    pub grain: f32,
    /// Size of that grain in the part's units.
    #[serde(default = "default_grain_size")]
    pub grain_size: f32,
    /// No highlight at all: a pure Lambert surface.
    #[serde(default)]
    pub matte: bool,
    /// Radiance sent out by the front side, linear; zero for all but lamps.
    #[serde(default)]
    pub emission: [f32; 3],
}

fn default_grain_size() -> f32 {
    0.05
}

/// A pattern over the part's own coordinates. Sizes are in the part's units (metres in a scene).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Pattern {
    /// Only `a`.
    #[default]
    Plain,
    /// Cubes of side `size`, alternating.
    Checker {
        /// Side of a cube.
        size: f32,
    },
    /// Layers along `axis`, half of each period `b`.
    Stripes {
        /// Normal of the layers.
        axis: [f32; 3],
        /// Thickness of an `a` and a `b` layer together.
        period: f32,
        /// Waviness of the layers, in periods.
        #[serde(default)]
        wobble: f32,
    },
    /// A cloudy mixture.
    Noise {
        /// Size of the largest features.
        size: f32,
        /// How hard the borders are: 1 is soft, 8 nearly two-coloured.
        contrast: f32,
    },
    /// Round spots of `b`.
    Spots {
        /// Distance between spots.
        size: f32,
        /// Radius of the largest spot as a share of that distance, up to 0.5.
        radius: f32,
    },
    /// Boards along x; the joint between them is dark. A mixture of `a` and `b` for each board, with grain along it.
    Planks {
        /// Width of a board, along y.
        width: f32,
        /// Length of a board, along x.
        length: f32,
        /// Width of the joint.
        gap: f32,
    },
    /// Bricks or tiles in the x, y plane; a mixture of `a` and `b` for each tile, joints dark.
    Tiles {
        /// Size along x and y.
        size: [f32; 2],
        /// Width of the joint.
        gap: f32,
        /// Shift of every second row in tile lengths: 0 for tiles, 0.5 for bricks.
        #[serde(default)]
        shift: f32,
    },
    /// Wood: rings around an axis along x that wander a little.
    Wood {
        /// Distance of the rings.
        rings: f32,
    },
}

impl Material {
    /// One plain finish.
    #[must_use]
    pub fn plain(color: [f32; 3], roughness: f32, metallic: f32) -> Self {
        Self {
            a: Finish { color, roughness, metallic },
            b: None,
            pattern: Pattern::Plain,
            grain: 0.0,
            grain_size: default_grain_size(),
            matte: false,
            emission: [0.0; 3],
        }
    }

    /// Two dielectric finishes of one roughness under a pattern.
    #[must_use]
    pub fn mixed(a: [f32; 3], b: [f32; 3], roughness: f32, pattern: Pattern) -> Self {
        let b = Some(Finish { color: b, roughness, metallic: 0.0 });
        Self { b, pattern, ..Self::plain(a, roughness, 0.0) }
    }

    /// With grain.
    #[must_use]
    pub fn grainy(self, grain: f32, grain_size: f32) -> Self {
        Self { grain, grain_size, ..self }
    }

    /// Pure Lambert.
    #[must_use]
    pub fn lambert(self) -> Self {
        Self { matte: true, ..self }
    }

    /// Whether it sends out light.
    #[must_use]
    pub fn emits(&self) -> bool {
        self.emission.iter().any(|&e| e > 0.0)
    }

    /// The reflectance at a point of the part.
    pub(crate) fn at(&self, p: Vec3, noise: &Noise) -> Brdf {
        let (mix, shade) = self.pattern.at(p, noise);
        let b = self.b.unwrap_or(self.a);
        let grain = 1.0 + self.grain * noise.fractal(p / self.grain_size, 3);
        let color = Vec3::from(self.a.color).lerp(Vec3::from(b.color), mix) * shade * grain;
        Brdf {
            // Albedo stays below 1 whatever the grain does: no surface gives more than it gets.
            albedo: color.clamp(Vec3::splat(0.001), Vec3::splat(0.98)),
            roughness: self.a.roughness + (b.roughness - self.a.roughness) * mix,
            metallic: self.a.metallic + (b.metallic - self.a.metallic) * mix,
            matte: self.matte,
        }
    }

    /// Problems, each with its field.
    pub(crate) fn problems(&self, at: &str, out: &mut Vec<String>) {
        for (name, finish) in [("a", Some(self.a)), ("b", self.b)] {
            let Some(finish) = finish else { continue };
            for (field, values) in [
                ("color", &finish.color[..]),
                ("roughness", &[finish.roughness]),
                ("metallic", &[finish.metallic]),
            ] {
                if values.iter().any(|v| !(0.0..=1.0).contains(v)) {
                    out.push(format!("{at}.{name}.{field}: expected values in [0, 1], got {values:?}"));
                }
            }
        }
        if !(0.0..=1.0).contains(&self.grain) {
            out.push(format!("{at}.grain: expected a value in [0, 1], got {}", self.grain));
        }
        if !(self.grain_size > 0.0 && self.grain_size.is_finite()) {
            out.push(format!("{at}.grain_size: expected a positive size, got {}", self.grain_size));
        }
        if self.emission.iter().any(|e| !(e.is_finite() && *e >= 0.0)) {
            out.push(format!("{at}.emission: expected finite values of at least 0, got {:?}", self.emission));
        }
        let lengths: &[f32] = match &self.pattern {
            Pattern::Plain => &[],
            Pattern::Checker { size } => &[*size],
            Pattern::Stripes { period, .. } => &[*period],
            Pattern::Noise { size, contrast } => &[*size, *contrast],
            Pattern::Spots { size, radius } => &[*size, *radius],
            Pattern::Planks { width, length, .. } => &[*width, *length],
            Pattern::Tiles { size, .. } => &[size[0], size[1]],
            Pattern::Wood { rings } => &[*rings],
        };
        if lengths.iter().any(|l| !(*l > 0.0 && l.is_finite())) {
            out.push(format!("{at}.pattern: expected positive sizes, got {:?}", self.pattern));
        }
    }
}

/// 0 below `low`, 1 above `high`, smooth between.
fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Coordinates are moved by this much of a cell, so that a face at coordinate 0 does not lie on the border of two cells.
const OFF_LATTICE: f32 = 1e-3;

/// How dark a joint is.
const JOINT: f32 = 0.35;

impl Pattern {
    /// Share of `b` in [0, 1] and a factor on the colour.
    fn at(&self, p: Vec3, noise: &Noise) -> (f32, f32) {
        match *self {
            Self::Plain => (0.0, 1.0),
            Self::Checker { size } => {
                let c = (p / size + OFF_LATTICE).floor();
                ((c.x + c.y + c.z).rem_euclid(2.0).round() % 2.0, 1.0)
            }
            Self::Stripes { axis, period, wobble } => {
                let axis = Vec3::from(axis).normalize_or(Vec3::Z);
                let shift = if wobble > 0.0 { wobble * noise.fractal(p / (2.0 * period), 2) } else { 0.0 };
                let phase = (axis.dot(p) / period + shift + OFF_LATTICE).rem_euclid(1.0);
                // Borders are two hundredths of a period wide, so that they do not alias at thumbnail size.
                (smoothstep(0.49, 0.51, phase) * (1.0 - smoothstep(0.98, 1.0, phase)), 1.0)
            }
            Self::Noise { size, contrast } => {
                ((0.5 + 0.5 * contrast * noise.fractal(p / size, 3)).clamp(0.0, 1.0), 1.0)
            }
            Self::Spots { size, radius } => {
                let q = p / size;
                let cell = q.floor();
                let mut mix = 0.0f32;
                for i in 0..27 {
                    let step = Vec3::new((i % 3 - 1) as f32, (i / 3 % 3 - 1) as f32, (i / 9 - 1) as f32);
                    let c = cell + step;
                    let id = [c.x as i32, c.y as i32, c.z as i32];
                    let random = |k: i32| noise.cell([id[0], id[1].wrapping_add(k * 57), id[2]]);
                    let centre = c + 0.25 + 0.5 * Vec3::new(random(1), random(2), random(3));
                    let r = radius * (0.5 + 0.5 * random(4));
                    mix = mix.max(1.0 - smoothstep(r * 0.9, r * 1.1, q.distance(centre)));
                }
                (mix, 1.0)
            }
            Self::Planks { width, length, gap } => {
                let row = (p.y / width + OFF_LATTICE).floor();
                let x = p.x / length + noise.cell([row as i32, 11, 3]) + OFF_LATTICE;
                let board = x.floor();
                let joint =
                    joint(p.y / width + OFF_LATTICE - row, gap / width).max(joint(x - board, gap / length));
                let tone = noise.cell([board as i32, row as i32, 1]);
                // The grain of the wood runs along the board.
                let offset = 7.3 * tone + row;
                let fibre = noise.fractal(
                    Vec3::new(p.x / (12.0 * width) + offset, 1.7 * p.y / width * 6.0, p.z / width),
                    3,
                );
                ((0.5 * tone + 0.35 + 0.45 * fibre).clamp(0.0, 1.0), 1.0 - (1.0 - JOINT) * joint)
            }
            Self::Tiles { size, gap, shift } => {
                let y = p.y / size[1] + OFF_LATTICE;
                let row = y.floor();
                let x = p.x / size[0] + shift * row.rem_euclid(2.0) + OFF_LATTICE;
                let column = x.floor();
                let joint = joint(y - row, gap / size[1]).max(joint(x - column, gap / size[0]));
                let tone = noise.cell([column as i32, row as i32, 2]);
                (tone, 1.0 - (1.0 - JOINT) * joint)
            }
            Self::Wood { rings } => {
                let q = p / rings;
                let r = q.y.hypot(q.z + 3.0)
                    + 0.8 * noise.fractal(Vec3::new(q.x * 0.08, q.y * 0.4, q.z * 0.4), 2);
                let wave = 0.5 + 0.5 * (2.0 * std::f32::consts::PI * r).sin();
                let fibre = 0.25 * noise.smooth(Vec3::new(q.x * 0.3, q.y * 6.0, q.z * 6.0));
                ((0.8 * wave + fibre + 0.1).clamp(0.0, 1.0), 1.0)
            }
        }
    }
}

/// 1 in the joint that straddles the ends of [0, 1), 0 inside the tile; `gap` is its width.
fn joint(t: f32, gap: f32) -> f32 {
    if gap <= 0.0 {
        return 0.0;
    }
    let edge = t.min(1.0 - t);
    1.0 - smoothstep(0.35 * gap, 0.65 * gap, edge)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn albedo(m: &Material, p: Vec3) -> Vec3 {
        m.at(p, &Noise::new(1)).albedo
    }

    /// Goal: a checkerboard alternates along each axis, also through 0.
    #[test]
    fn checker_alternates() {
        let m = Material::mixed([0.1; 3], [0.9; 3], 0.5, Pattern::Checker { size: 0.5 });
        for (p, expected) in [
            (Vec3::new(0.2, 0.2, 0.0), 0.1),
            (Vec3::new(0.7, 0.2, 0.0), 0.9),
            (Vec3::new(-0.2, 0.2, 0.0), 0.9),
            (Vec3::new(-0.2, -0.2, 0.0), 0.1),
            (Vec3::new(0.2, 0.2, 0.6), 0.9),
        ] {
            assert_eq!(albedo(&m, p).x, expected, "{p}");
        }
    }

    /// Goal: stripes give half of each colour, joints are dark, and every pattern stays in the range of its two colours.
    #[test]
    fn patterns_stay_in_range() {
        let patterns = [
            Pattern::Plain,
            Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.2, wobble: 0.3 },
            Pattern::Noise { size: 0.3, contrast: 2.0 },
            Pattern::Spots { size: 0.3, radius: 0.4 },
            Pattern::Planks { width: 0.1, length: 1.0, gap: 0.005 },
            Pattern::Tiles { size: [0.3, 0.2], gap: 0.01, shift: 0.5 },
            Pattern::Wood { rings: 0.02 },
        ];
        for pattern in patterns {
            let m = Material::mixed([0.2; 3], [0.6; 3], 0.5, pattern.clone());
            let mut seen = (f32::MAX, f32::MIN);
            for i in 0..4000 {
                let t = i as f32;
                let p = Vec3::new(
                    (t * 0.618).fract() * 3.0 - 1.5,
                    (t * 0.754).fract() * 3.0 - 1.5,
                    (t * 0.569).fract(),
                );
                let v = albedo(&m, p).x;
                assert!((0.2 * JOINT - 1e-4..=0.6 + 1e-4).contains(&v), "{pattern:?} {v}");
                seen = (seen.0.min(v), seen.1.max(v));
            }
            if pattern != Pattern::Plain {
                assert!(seen.1 - seen.0 > 0.2, "{pattern:?} has no contrast: {seen:?}");
            }
        }
        let stripes = Material::mixed(
            [0.0; 3],
            [0.8; 3],
            0.5,
            Pattern::Stripes { axis: [0.0, 0.0, 1.0], period: 0.3, wobble: 0.0 },
        );
        let mean: f32 =
            (0..3000).map(|i| albedo(&stripes, Vec3::Z * i as f32 * 1e-3).x).sum::<f32>() / 3000.0;
        assert!((mean - 0.4).abs() < 0.01, "{mean}");
    }
}
