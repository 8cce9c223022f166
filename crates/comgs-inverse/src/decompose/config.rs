//! Every knob of a decomposition, with unit, range and default.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Where occlusion and indirect light come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Visibility {
    /// Surface Octahedral Probes: interpolated textures, baked once (ComGS §3.1.2).
    Probes,
    /// Every ray of every step is traced: what the probes stand for, at its full price.
    Trace,
    /// Nothing is occluded and there is no indirect light.
    None,
}

/// How the factor that albedo and light share is fixed (photographs cannot tell it).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AlbedoScale {
    /// The stated prior: mean albedo near [`DecomposeConfig::albedo_mean`], light neutral on average.
    Prior,
    /// The prior's result times this factor a channel; light is divided by it.
    Factor([f32; 3]),
    /// The surface seen at a pixel of a training view is a grey card of this albedo.
    GreyCard {
        /// Index of the training view.
        view: usize,
        /// Pixel column.
        x: usize,
        /// Pixel row.
        y: usize,
        /// Its albedo, in (0, 1); 0.18 for a photographer's card.
        albedo: f32,
    },
}

/// Configuration of [`crate::decompose()`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DecomposeConfig {
    /// Number of optimisation steps, > 0 (paper: 2000).
    pub iterations: u32,
    /// Where occlusion and indirect light come from.
    pub visibility: Visibility,
    /// Number of probes (paper: 5000).
    pub probes: usize,
    /// Side of a probe's octahedral texture in texels, 4 to 64 (paper: 16).
    pub probe_resolution: usize,
    /// Distance of a probe from the surface, as a share of the object's size (paper: 0.01).
    pub probe_offset: f32,
    /// Probes that answer a query.
    pub probe_neighbours: usize,
    /// Whether a probe's answer is weighted by what it can see of the shading point (DDGI's Chebyshev weight).
    pub chebyshev: bool,
    /// Light samples a shading point (paper: 128).
    pub rays: u32,
    /// Patches a step, each from another view.
    pub patches: usize,
    /// Side of a patch in pixels, ≥ 16.
    pub patch_size: usize,
    /// Side of the octahedral environment map (paper: 256); a power of two from 16 to 1024.
    pub light_size: usize,
    /// Weight of 1 − SSIM in the photometric loss (Eq. 2).
    pub ssim_weight: f32,
    /// λ_lam of Eq. 12 and 14 (paper: 0.001).
    pub lambertian_weight: f32,
    /// λ_sops of Eq. 13 and 14 (paper: 1).
    pub probe_weight: f32,
    /// λ_d2n of Eq. 3 (paper: 0.05).
    pub depth_normal_weight: f32,
    /// λ_mask of Eq. 4 (paper: 0.05).
    pub mask_weight: f32,
    /// Weight of the prior on the shared scale of albedo and light ([`crate::decompose::scale`]).
    pub scale_weight: f32,
    /// Albedo (luminance) that the prior takes for the mean.
    pub albedo_mean: f32,
    /// How the shared scale is fixed in the end.
    pub albedo_scale: AlbedoScale,
    /// Learning rate of albedo logits at the start.
    pub albedo_rate: f32,
    /// Learning rate of roughness and metallic logits at the start.
    pub material_rate: f32,
    /// Learning rate of the light's logarithms at the start.
    pub light_rate: f32,
    /// Learning rate of probe textures (paper: 0.001).
    pub probe_rate: f32,
    /// Geometry's learning rates as a share of those of step 1 (0.1 as the issue of the paper's step 2 has it).
    pub geometry_rate: f32,
    /// Stop after this time with what there is; schedules follow the clock then.
    pub time_budget: Option<Duration>,
    /// Seed of everything random.
    pub seed: u64,
}

impl Default for DecomposeConfig {
    fn default() -> Self {
        Self {
            iterations: 2000,
            visibility: Visibility::Probes,
            probes: 5000,
            probe_resolution: 16,
            probe_offset: 0.01,
            probe_neighbours: 8,
            chebyshev: false,
            rays: 128,
            patches: 3,
            patch_size: 32,
            light_size: 256,
            ssim_weight: 0.2,
            lambertian_weight: 0.001,
            probe_weight: 1.0,
            depth_normal_weight: 0.05,
            mask_weight: 0.05,
            scale_weight: 0.01,
            albedo_mean: 0.3,
            albedo_scale: AlbedoScale::Prior,
            albedo_rate: 0.03,
            material_rate: 0.03,
            light_rate: 0.03,
            probe_rate: 0.001,
            geometry_rate: 0.1,
            time_budget: None,
            seed: 0,
        }
    }
}

impl DecomposeConfig {
    /// Problems with the values; empty when sound.
    #[must_use]
    pub fn check(&self) -> Vec<String> {
        let mut problems = Vec::new();
        let mut require = |ok: bool, text: String| {
            if !ok {
                problems.push(text);
            }
        };
        require(self.iterations > 0, "iterations is 0, expected > 0".into());
        require(self.probes > 0, "probes is 0, expected > 0".into());
        let resolution = self.probe_resolution;
        require(
            (4..=64).contains(&resolution),
            format!("probe_resolution is {resolution}, expected 4 to 64"),
        );
        let offset = self.probe_offset;
        require((0.0..=0.2).contains(&offset), format!("probe_offset is {offset}, expected 0 to 0.2"));
        let neighbours = self.probe_neighbours;
        require(
            (1..=comgs_probe::MAX_NEIGHBOURS).contains(&neighbours),
            format!("probe_neighbours is {neighbours}, expected 1 to {}", comgs_probe::MAX_NEIGHBOURS),
        );
        require((4..=65_536).contains(&self.rays), format!("rays is {}, expected 4 to 65536", self.rays));
        require((1..=64).contains(&self.patches), format!("patches is {}, expected 1 to 64", self.patches));
        let size = self.patch_size;
        require((16..=1024).contains(&size), format!("patch_size is {size}, expected 16 to 1024"));
        let light = self.light_size;
        require(
            light.is_power_of_two() && (16..=1024).contains(&light),
            format!("light_size is {light}, expected a power of two from 16 to 1024"),
        );
        for (name, v) in [
            ("ssim_weight", self.ssim_weight),
            ("lambertian_weight", self.lambertian_weight),
            ("probe_weight", self.probe_weight),
            ("depth_normal_weight", self.depth_normal_weight),
            ("mask_weight", self.mask_weight),
            ("scale_weight", self.scale_weight),
            ("albedo_rate", self.albedo_rate),
            ("material_rate", self.material_rate),
            ("light_rate", self.light_rate),
            ("probe_rate", self.probe_rate),
            ("geometry_rate", self.geometry_rate),
        ] {
            require(v >= 0.0 && v.is_finite(), format!("{name} is {v}, expected ≥ 0"));
        }
        let mean = self.albedo_mean;
        require(mean > 0.0 && mean < 1.0, format!("albedo_mean is {mean}, expected in (0, 1)"));
        match self.albedo_scale {
            AlbedoScale::Prior => {}
            AlbedoScale::Factor(f) => require(
                f.iter().all(|v| *v > 0.0 && v.is_finite()),
                format!("the albedo scale is {f:?}, expected three factors > 0"),
            ),
            AlbedoScale::GreyCard { albedo, .. } => require(
                albedo > 0.0 && albedo < 1.0,
                format!("the grey card's albedo is {albedo}, expected in (0, 1)"),
            ),
        }
        problems
    }
}
