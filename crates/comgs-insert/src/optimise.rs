//! The optimisation of light and tone (DiPIR Sec. 4.3).

use crate::composite::{Crop, composite, composite_vjp};
use crate::error::InsertError;
use crate::fusion::{Fusion, blend, concentration, consistency, fuse};
use crate::guidance::{Guidance, View};
use crate::light::{Light, LightMap};
use crate::material::Search;
use crate::tone::Tone;
use crate::transport::{Foreground, Shadow};
use comgs_geom::Rng;
use comgs_image::Image;
use comgs_optim::Adam;
use serde::Serialize;

/// What is fixed: the photo, and light's way to it.
#[derive(Clone, Copy, Debug)]
pub struct Problem<'a> {
    /// I_bg, linear, in [0, 1].
    pub photo: &'a Image,
    /// The object.
    pub foreground: &'a Foreground,
    /// The shadow.
    pub shadow: &'a Shadow,
}

/// Whether the tone curves are optimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Curves {
    /// Together with the light.
    Free,
    /// They stay as they are.
    Fixed,
}

/// Whether the light is optimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Lights {
    /// With everything else.
    Free,
    /// It stays as it is; what remains is tone and material.
    Fixed,
}

/// Which part of the image an iteration looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Crops {
    /// A random square around the object.
    Random,
    /// All of it.
    Whole,
}

/// Knobs of the optimisation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Settings {
    /// Iterations.
    pub iterations: usize,
    /// λ of the consistency (Eq. 10).
    pub consistency: f32,
    /// λ of the concentration (Eq. 11).
    pub concentration: f32,
    /// Weight of the smoothness of free texels.
    pub smoothness: f32,
    /// Learning rate of logarithms of radiance at first; it falls to a tenth, exponentially.
    pub light_rate: f32,
    /// Learning rate of the tone curves.
    pub tone_rate: f32,
    /// Whether there is a light to find.
    pub lights: Lights,
    /// Whether there is a tone to learn.
    pub curves: Curves,
    /// What an iteration looks at.
    pub crops: Crops,
    /// Seed of the crops.
    pub seed: u64,
}

impl Settings {
    /// For a guidance that gives the maps themselves: nothing else has a say in them.
    #[must_use]
    pub fn for_maps() -> Self {
        Self { consistency: 0.0, concentration: 0.0, smoothness: 0.0, curves: Curves::Fixed, ..Self::dipir() }
    }

    /// The paper's: 600 iterations, λ = 0.03 and 0.01, random crops. Learning rates are ours; the paper states none.
    #[must_use]
    pub fn dipir() -> Self {
        Self {
            iterations: 600,
            consistency: 0.03,
            concentration: 0.01,
            smoothness: 0.02,
            light_rate: 0.05,
            tone_rate: 0.005,
            lights: Lights::Free,
            curves: Curves::Free,
            crops: Crops::Random,
            seed: 0,
        }
    }
}

/// What is optimised.
#[derive(Clone, Debug)]
pub struct State {
    /// Lights the object.
    pub foreground: Light,
    /// Casts its shadow.
    pub shadow: Light,
    /// The photo's tone.
    pub tone: Tone,
}

/// Losses of one iteration, weights included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Losses {
    /// Of the guidance.
    pub guidance: f32,
    /// Of the maps' consistency.
    pub consistency: f32,
    /// Of the shadow map's concentration.
    pub concentration: f32,
}

/// What an optimisation came to.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Both lights and the tone at the end.
    pub state: State,
    /// The one map that both have been fused to.
    pub light: LightMap,
    /// Losses by iteration.
    pub losses: Vec<Losses>,
    /// Gradient entries that were not finite and were dropped.
    pub dropped: usize,
}

/// Optimises light and tone: [`optimise_with`] without a material.
///
/// # Errors
/// As [`optimise_with`].
pub fn optimise(
    problem: Option<&Problem<'_>>,
    state: State,
    guidance: &mut dyn Guidance,
    settings: &Settings,
    check: impl FnMut(usize) -> bool,
) -> Result<Outcome, InsertError> {
    optimise_with(problem, state, guidance, settings, None, check)
}

/// Optimises light, tone and a part's material, where there is a `material` to look for. `check` is asked before every iteration with its number, and stops the work when it says
/// `false`.
///
/// Both lights are rasterised and fused; the object is lit by `s · fused + (1 − s) · own` and likewise the shadow, with s
/// from 0 at the first to 1 at the last iteration (Eq. 15–18). All of it is differentiated by hand.
///
/// `problem` may be absent for a guidance that does not look at the composite; nothing is rendered for it. With a
/// `material` the object's radiance is that of its lobes, and `problem.foreground` only its outline.
///
/// # Errors
/// [`InsertError::Stopped`], [`InsertError::Diverged`], the guidance's own, or [`InsertError::Input`] when the guidance looks at
/// a composite and there is no problem to make one of.
pub fn optimise_with(
    problem: Option<&Problem<'_>>,
    mut state: State,
    guidance: &mut dyn Guidance,
    settings: &Settings,
    mut material: Option<&mut Search<'_>>,
    mut check: impl FnMut(usize) -> bool,
) -> Result<Outcome, InsertError> {
    let mut adams = [
        Adam::new(state.foreground.parameters().len()),
        Adam::new(state.shadow.parameters().len()),
        Adam::new(4 * crate::tone::PARAMETERS),
    ];
    let looked_at = match (guidance.looks_at_composite(), problem) {
        (false, _) => None,
        (true, Some(problem)) => Some((problem, bounding_box(problem.foreground))),
        (true, None) => {
            return Err(InsertError::Input {
                what: "the guidance",
                expected: "a photo and transport to look at".into(),
                got: "none".into(),
            });
        }
    };
    let mut losses = Vec::with_capacity(settings.iterations);
    let mut dropped = 0;
    for iteration in 0..settings.iterations {
        if !check(iteration) {
            return Err(InsertError::Stopped);
        }
        let progress = iteration as f32 / (settings.iterations - 1).max(1) as f32;
        let own = [state.foreground.rasterise(), state.shadow.rasterise()];
        let fusion = fuse(&own[0], &own[1]);
        let lit = [blend(&own[0], &fusion.map, progress), blend(&own[1], &fusion.map, progress)];
        let (loss, by_lit, by_tone) = match looked_at {
            Some((problem, object)) => {
                let mut rng = Rng::stream(settings.seed, iteration as u64);
                let crop = match settings.crops {
                    Crops::Whole => Crop::whole(problem.photo),
                    Crops::Random => random_crop(problem.photo, object, &mut rng),
                };
                let lights = settings.lights;
                let pass = Pass { problem, tone: &state.tone, crop, lights };
                pass.run(guidance, material.as_deref_mut(), iteration, progress, &lit)?
            }
            None => {
                let crop = Crop { x0: 0, y0: 0, x1: 0, y1: 0 };
                let light = [&lit[0], &lit[1]];
                let pull = guidance.pull(&View { iteration, progress, composite: None, crop, light })?;
                (pull.loss, pull.light.unwrap_or_else(|| nothing(own[0].height)), None)
            }
        };

        let step = iteration as u32 + 1;
        let mut now = Losses { guidance: loss, consistency: 0.0, concentration: 0.0 };
        if settings.lights == Lights::Free {
            let (own, by_lit) = ([&own[0], &own[1]], [&by_lit[0], &by_lit[1]]);
            dropped += step_lights(&mut state, &mut adams, &fusion, own, by_lit, settings, step, &mut now)?;
        }
        losses.push(now);
        if let Some(material) = material.as_deref_mut() {
            dropped += material.step(step, progress)?;
        }
        if let (Curves::Free, Some(grad)) = (settings.curves, by_tone) {
            dropped += state.tone.step(&mut adams[2], &grad, settings.tone_rate, step);
        }
    }
    let light = fuse(&state.foreground.rasterise(), &state.shadow.rasterise()).map;
    Ok(Outcome { state, light, losses, dropped })
}

/// One step of both lights (`step` counts from 1), with their regularisers, whose losses are written to `losses`.
/// Returns how many gradient entries were not finite.
fn step_lights(
    state: &mut State,
    adams: &mut [Adam; 3],
    fusion: &Fusion,
    own: [&LightMap; 2],
    by_lit: [&LightMap; 2],
    settings: &Settings,
    step: u32,
    losses: &mut Losses,
) -> Result<usize, InsertError> {
    let iteration = step as usize - 1;
    let progress = iteration as f32 / (settings.iterations - 1).max(1) as f32;
    let height = own[0].height;
    let mut by_fused = LightMap::zeros(height);
    let mut by_own = [LightMap::zeros(height), LightMap::zeros(height)];
    for (by_lit, by_own) in by_lit.iter().zip(&mut by_own) {
        for (i, g) in by_lit.data.iter().enumerate() {
            by_fused.data[i] += progress * g;
            by_own.data[i] += (1.0 - progress) * g;
        }
    }
    let [by_foreground, by_shadow] = &mut by_own;
    fusion.vjp(own[0], &by_fused, by_foreground, by_shadow);
    losses.consistency = consistency(own[0], own[1], settings.consistency, by_foreground);
    losses.concentration = concentration(own[1], settings.concentration, by_shadow);
    let rate = settings.light_rate * 0.1f32.powf(progress);
    let mut dropped = 0;
    for (k, light) in [&mut state.foreground, &mut state.shadow].into_iter().enumerate() {
        let mut grad = light.rasterise_vjp(own[k], &by_own[k]);
        light.prior(settings.smoothness, &mut grad);
        dropped += light.step(&mut adams[k], &grad, rate, step);
        if light.parameters().iter().any(|p| !p.is_finite()) {
            return Err(InsertError::Diverged { iteration });
        }
    }
    Ok(dropped)
}

/// No gradient.
fn nothing(height: usize) -> [LightMap; 2] {
    [LightMap::zeros(height), LightMap::zeros(height)]
}

/// One way forth and back between maps and guidance.
struct Pass<'a> {
    problem: &'a Problem<'a>,
    tone: &'a Tone,
    crop: Crop,
    lights: Lights,
}

impl Pass<'_> {
    /// Loss of the guidance, and its gradients with respect to the two maps that light the image and to the tone.
    fn run(
        &self,
        guidance: &mut dyn Guidance,
        mut material: Option<&mut Search<'_>>,
        iteration: usize,
        progress: f32,
        lit: &[LightMap; 2],
    ) -> Result<(f32, [LightMap; 2], Option<Vec<f32>>), InsertError> {
        let Problem { photo, foreground, shadow } = *self.problem;
        let crop = self.crop;
        let curves = self.tone.curves();
        let inside = |pixels: &[u32], row: usize| crop.contains(pixels[row] as usize, photo.width);
        let shown = |row: usize| inside(&foreground.pixels, row);
        let radiance = match material.as_deref_mut() {
            Some(material) => material.radiance(&lit[0], shown),
            None => foreground.matrix.times(&lit[0], shown),
        };
        let ratios = shadow.ratios(&lit[1], |row| inside(&shadow.pixels, row));
        let image = composite(photo, foreground, shadow, &radiance, &ratios.beta, &curves, crop);
        let light = [&lit[0], &lit[1]];
        let pull = guidance.pull(&View { iteration, progress, composite: Some(&image), crop, light })?;
        let mut by_lit = pull.light.unwrap_or_else(|| nothing(lit[0].height));
        let Some(grad) = pull.composite else { return Ok((pull.loss, by_lit, None)) };
        let (by_radiance, by_beta, by_curves) =
            composite_vjp(photo, foreground, shadow, &radiance, &ratios.beta, &curves, crop, &grad);
        let free = self.lights == Lights::Free;
        match material {
            Some(material) => material.radiance_vjp(&by_radiance, free.then_some(&mut by_lit[0])),
            None if free => foreground.matrix.transposed(&by_radiance, &mut by_lit[0]),
            None => {}
        }
        if free {
            shadow.ratios_vjp(&ratios, &by_beta, &mut by_lit[1]);
        }
        Ok((pull.loss, by_lit, Some(by_curves.flat(&curves))))
    }
}

/// The object's pixels' bounding box.
fn bounding_box(foreground: &Foreground) -> Crop {
    let (w, h) = (foreground.coverage.width, foreground.coverage.height);
    let mut crop = Crop { x0: w, y0: h, x1: 0, y1: 0 };
    for &pixel in &foreground.pixels {
        let (x, y) = (pixel as usize % w, pixel as usize / w);
        crop =
            Crop { x0: crop.x0.min(x), y0: crop.y0.min(y), x1: crop.x1.max(x + 1), y1: crop.y1.max(y + 1) };
    }
    crop
}

/// A square whose middle lies in the object's box, from as large as the box to as large as the image, inside the image as
/// far as it fits (DiPIR, "Training details").
fn random_crop(photo: &Image, object: Crop, rng: &mut Rng) -> Crop {
    let (w, h) = (photo.width, photo.height);
    if object.x0 >= object.x1 {
        return Crop::whole(photo);
    }
    let least = (object.x1 - object.x0).max(object.y1 - object.y0).min(w.min(h));
    let most = w.max(h);
    let side = least + rng.below(most - least + 1);
    let place = |from: usize, to: usize, n: usize, rng: &mut Rng| {
        let size = side.min(n);
        let middle = from + rng.below(to - from);
        let start = middle.saturating_sub(size / 2).min(n - size);
        (start, start + size)
    };
    let (x0, x1) = place(object.x0, object.x1, w, rng);
    let (y0, y1) = place(object.y0, object.y1, h, rng);
    Crop { x0, y0, x1, y1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: crops lie in the image, hold part of the object, and differ in size.
    #[test]
    fn crops_are_around_the_object() {
        let photo = Image::zeros(60, 40, 3);
        let object = Crop { x0: 50, y0: 10, x1: 60, y1: 30 };
        let mut sizes = std::collections::BTreeSet::new();
        for k in 0..200 {
            let c = random_crop(&photo, object, &mut Rng::stream(1, k));
            assert!(c.x1 <= 60 && c.y1 <= 40 && c.pixels() > 0);
            assert!(c.x1 > object.x0 && c.x0 < object.x1 && c.y1 > object.y0 && c.y0 < object.y1);
            sizes.insert(c.pixels());
        }
        assert!(sizes.len() > 20);
    }
}
