//! What to compute and with which thresholds.

use fearless_simd::Level;

/// The planes to compute; the weight plane always comes along.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Planes {
    /// Linear radiance.
    pub color: bool,
    /// z-depth.
    pub depth: bool,
    /// World-space normals.
    pub normal: bool,
    /// Albedo, roughness, metallic (needs material columns; without them the plane is zero).
    pub material: bool,
}

impl Planes {
    /// Colour and weight.
    pub const COLOR: Self = Self { color: true, depth: false, normal: false, material: false };
    /// Colour, weight, depth and normal.
    pub const GEOMETRY: Self = Self { color: true, depth: true, normal: true, material: false };
    /// Everything.
    pub const ALL: Self = Self { color: true, depth: true, normal: true, material: true };
}

/// The screen-space low-pass filter that keeps surfels smaller than a pixel visible and differentiable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LowPass {
    /// None: a surfel between pixel centres disappears.
    Off,
    /// ρ = min(ρ₃, |x − x_c|² / σ²) with σ in pixels. Where the filter wins, the depth is the centre's. 2DGS §4.3 has
    /// σ = √½, which draws the edge-on discs of a silhouette one to two pixels too wide; photos do not show these, so training sinks the
    /// whole surface and bends its normals. The default of 0.3 leaves a surfel between four pixel centres a response of 6 % and
    /// so a gradient; on the captured cow at 1,000 steps it gives 4.8° instead of 6.6° (blended normals) and 35.7 instead of 34.8 dB.
    Sigma(f32),
}

/// Thresholds of the blend. [`RasterConfig::default`] has the values of 2DGS but for the narrower [`LowPass`].
#[derive(Clone, Copy, Debug)]
pub struct RasterConfig {
    /// Nearest z-depth that is drawn, world units, > 0.
    pub near: f32,
    /// Responses below this are dropped, in (0, 1).
    pub alpha_min: f32,
    /// Responses are clamped to this, in (0, 1); the gradient is zero where it clamps.
    pub alpha_max: f32,
    /// A pixel stops before the surfel that would take its transmittance below this, in [0, 1).
    pub transmittance_min: f32,
    /// Screen-space filter.
    pub low_pass: LowPass,
    /// Instruction set; [`Level::new`] by default. All levels are tested against the reference.
    pub level: Level,
}

impl Default for RasterConfig {
    fn default() -> Self {
        Self {
            near: 0.01,
            alpha_min: 1.0 / 255.0,
            alpha_max: 0.99,
            transmittance_min: 1e-4,
            low_pass: LowPass::Sigma(0.3),
            level: Level::new(),
        }
    }
}

impl RasterConfig {
    /// 1/σ² of the low-pass filter; a huge finite number when it is off, so that products with 0 stay finite.
    #[must_use]
    pub fn low_pass_inverse_variance(&self) -> f32 {
        match self.low_pass {
            LowPass::Off => 1e30,
            LowPass::Sigma(s) => 1.0 / (s * s).max(1e-30),
        }
    }

    /// Problems with the values; empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut require = |ok: bool, text: String| {
            if !ok {
                problems.push(text);
            }
        };
        require(self.near > 0.0 && self.near.is_finite(), format!("near is {}, expected > 0", self.near));
        require(
            self.alpha_min > 0.0 && self.alpha_min < self.alpha_max,
            format!("alpha_min is {}, expected in (0, alpha_max)", self.alpha_min),
        );
        require(self.alpha_max < 1.0, format!("alpha_max is {}, expected < 1", self.alpha_max));
        require(
            (0.0..1.0).contains(&self.transmittance_min),
            format!("transmittance_min is {}, expected in [0, 1)", self.transmittance_min),
        );
        problems
    }
}
