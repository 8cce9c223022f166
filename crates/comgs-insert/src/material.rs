//! The material of a part, optimised with the same loop as light and tone (DiPIR Sec. 6, "Material optimization").
//!
//! At fixed roughness the direct light is linear in albedo and F₀ ([`crate::transport::Lobes`]), so an iteration costs what
//! it costs for light alone. The roughness moves between two that were traced. Two things break the linear form: a
//! roughness that leaves them, and light that meets the object twice. Where either matters the lobes are traced again,
//! with a narrower bracket each time; that it was done, and why, is part of the [`Summary`].

mod row;

pub use row::{row, row_vjp};

use crate::error::InsertError;
use crate::light::LightMap;
use crate::object::{Factors, Object};
use crate::session::fitting_height;
use crate::transport::{ForegroundConfig, LobeRow, Lobes, count_pixels, lobe_channels, trace_lobes};
use comgs_geom::Camera;
use comgs_optim::{Adam, AdamConfig};
use glam::Vec3;
use serde::Serialize;

/// What of a material is optimised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Property {
    /// The factor on the base colour.
    Albedo,
    /// That on the roughness.
    Roughness,
    /// That on the metalness.
    Metallic,
    /// Radiance sent out.
    Emission,
}

/// Parameters: base colour (3), roughness, metalness, emission (3).
const PARAMETERS: usize = 8;

/// Share of light by more than one interaction up to which the linear form is taken to hold. Its error is at most that
/// share times the relative change of the material.
pub const LINEAR: f32 = 0.01;

/// How the search goes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MaterialSettings {
    /// The part ([`Object::parts`]).
    pub part: usize,
    /// What is free.
    pub free: Vec<Property>,
    /// Iterations from one tracing to the next where the linear form does not hold.
    pub every: usize,
    /// Half the bracket of roughness at first; [`NARROWER`] times as wide, at least [`LEAST_HALF`], after each in whose middle
    /// half the roughness ended, and wider again where it ran into an end.
    pub half_bracket: f32,
    /// Learning rate at first; it falls to a tenth, exponentially.
    pub rate: f32,
}

/// Factor on the bracket at every tracing.
pub const NARROWER: f32 = 0.6;
/// Half the narrowest bracket.
pub const LEAST_HALF: f32 = 0.02;
/// Half the widest bracket as a share of the roughness in its middle: what lies between two highlights of very different
/// width is like neither, and the search went back and forth between brackets.
pub const WIDEST: f32 = 0.3;
/// The first gradients are of another size than the last; a thousand iterations of memory for them (β₂ = 0.999) left an
/// emission 4 % short after 300.
const ADAM: AdamConfig = AdamConfig { beta1: 0.9, beta2: 0.98, epsilon: 1e-15 };
/// A bracket that the roughness has run into is traced anew after so many iterations at the soonest.
const SOONEST: usize = 20;

impl MaterialSettings {
    /// For a part; traced anew eight times in `iterations`.
    #[must_use]
    pub fn new(part: usize, free: Vec<Property>, iterations: usize) -> Self {
        Self { part, free, every: (iterations / 8).max(SOONEST), half_bracket: 0.15, rate: 0.02 }
    }
}

/// How and why lobes were traced.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// The part's factors at first.
    pub before: Factors,
    /// And at the end.
    pub after: Factors,
    /// What was free.
    pub free: Vec<Property>,
    /// Times that the lobes were traced.
    pub traced: usize,
    /// Factors on the roughness at each of them.
    pub brackets: Vec<[f32; 2]>,
    /// Share of light by more than one interaction when they were first.
    pub indirect: f32,
    /// In words.
    pub why: String,
}

/// A part's material being looked for.
pub struct Search<'a> {
    object: &'a mut Object,
    camera: &'a Camera,
    config: ForegroundConfig,
    settings: MaterialSettings,
    check: &'a (dyn Fn(usize) -> bool + Sync),
    /// Traced with different random numbers. One says what the object looks like, the other how that changes: with one
    /// alone, noise is part of what is squared, and a highlight that was traced more smoothly pulls the roughness up (to
    /// 0.40 instead of 0.35 for the test's copper, 0.376 with eight times the samples).
    twins: [Lobes; 2],
    /// Which of them shows.
    shows: usize,
    factors: Factors,
    before: Factors,
    adam: Adam,
    gradient: [f64; PARAMETERS],
    /// Rows under the map of the iteration, for the gradient; kept while the map stays the same.
    lit: [Option<Lit>; 2],
    brackets: Vec<[f32; 2]>,
    /// How often the bracket has become narrower.
    narrowed: u32,
    last: usize,
    indirect: f32,
}

struct Lit {
    map: LightMap,
    /// Whether every row was asked for.
    whole: bool,
    lobes: Vec<LobeRow>,
    rest: Vec<[f32; 3]>,
}

impl<'a> Search<'a> {
    /// Traces the lobes for the first time. `memory` is the most that the matrices may take, in bytes; the map is made
    /// coarser where they would take more, and [`Search::height`] says so. `check` is asked with numbers of rows done.
    ///
    /// # Errors
    /// [`InsertError::Memory`], [`InsertError::Stopped`], [`InsertError::Input`] for an object out of the frame, a part that
    /// is not there or not seen, and when nothing is free.
    pub fn new(
        object: &'a mut Object,
        camera: &'a Camera,
        config: &ForegroundConfig,
        memory: usize,
        settings: MaterialSettings,
        check: &'a (dyn Fn(usize) -> bool + Sync),
    ) -> Result<Self, InsertError> {
        let names = object.parts();
        let wrong = |expected: String, got: String| InsertError::Input {
            what: "the material to optimise",
            expected,
            got,
        };
        if settings.part >= names.len() {
            return Err(wrong(format!("a part of {}", names.join(", ")), settings.part.to_string()));
        }
        if settings.free.is_empty() {
            return Err(wrong("albedo, roughness, metallic or emission".into(), "none of them".into()));
        }
        let pixels = count_pixels(object, camera, config);
        if pixels == 0 {
            return Err(crate::session::out_of_frame(object, camera));
        }
        let factors = object.factors(settings.part);
        let bracket = bracket(&settings, &factors, 0, object.largest_factor());
        let channels = 2 * (3 + lobe_channels(bracket));
        let height = fitting_height(pixels, config.height, channels, memory)?;
        let config = ForegroundConfig { height, ..*config };
        let twins = trace_twins(object, camera, &config, settings.part, bracket, check)?;
        let lobes = &twins[0];
        if lobes.rows.iter().all(|r| r.share == 0.0) {
            return Err(wrong("a part that the photo shows".into(), names[settings.part].clone()));
        }
        Ok(Self {
            indirect: lobes.indirect,
            object,
            camera,
            config,
            settings,
            check,
            twins,
            shows: 0,
            factors,
            before: factors,
            adam: Adam::new(PARAMETERS),
            gradient: [0.0; PARAMETERS],
            lit: [None, None],
            brackets: vec![bracket],
            narrowed: 0,
            last: 0,
        })
    }

    /// Rows of the map that the lobes were traced for.
    #[must_use]
    pub fn height(&self) -> usize {
        self.config.height
    }

    /// The object.
    #[must_use]
    pub fn object(&self) -> &Object {
        self.object
    }

    /// The lobes as they were last traced.
    #[must_use]
    pub fn lobes(&self) -> &Lobes {
        &self.twins[0]
    }

    /// The part's factors as they are.
    #[must_use]
    pub fn factors(&self) -> Factors {
        self.factors
    }

    /// What was done, and the object with the part's new material.
    #[must_use]
    pub fn finish(self) -> Summary {
        self.object.set_factors(self.settings.part, self.factors);
        let why = match (self.lobes().roughness[0] < self.lobes().roughness[1], self.indirect > LINEAR) {
            (false, false) => {
                "the linear form holds: roughness is fixed and hardly any light meets the object twice"
            }
            (true, false) => "traced again because the roughness moves",
            (false, true) => {
                "traced again because light meets the object twice, which is not linear in its material"
            }
            (true, true) => "traced again because the roughness moves and light meets the object twice",
        };
        let (before, after) = (self.before, self.factors);
        Summary {
            before,
            after,
            free: self.settings.free,
            traced: self.brackets.len(),
            brackets: self.brackets,
            indirect: self.indirect,
            why: why.into(),
        }
    }

    fn tau(&self) -> f32 {
        let [low, high] = self.twins[0].roughness;
        if low == high { 0.0 } else { (self.factors.roughness - low) / (high - low) }
    }

    /// Rows of a twin under a map.
    fn light(&mut self, twin: usize, map: &LightMap, wanted: impl Fn(usize) -> bool + Sync) {
        let before = self.lit[twin].take();
        self.lit[twin] = match before {
            Some(lit) if lit.map == *map && lit.whole => Some(lit),
            before => {
                // A map that stays the same is worth all rows at once.
                let whole = before.is_some_and(|b| b.map == *map);
                let wanted = |row: usize| whole || wanted(row);
                let lobes = self.twins[twin].times(map, wanted);
                let rest = self.twins[twin].foreground.matrix.times(map, wanted);
                Some(Lit { map: map.clone(), whole, lobes, rest })
            }
        };
    }

    /// Radiance by row under a map. The twins take turns.
    pub(crate) fn radiance(
        &mut self,
        map: &LightMap,
        wanted: impl Fn(usize) -> bool + Sync,
    ) -> Vec<[f32; 3]> {
        self.shows = 1 - self.shows;
        for twin in 0..2 {
            self.light(twin, map, &wanted);
        }
        let tau = self.tau();
        let rows = &self.twins[self.shows].rows;
        let mut out = vec![[0.0; 3]; rows.len()];
        if let Some(lit) = &self.lit[self.shows] {
            for k in (0..rows.len()).filter(|k| wanted(*k)) {
                out[k] = row(&lit.lobes[k], &rows[k], lit.rest[k], &self.factors, tau);
            }
        }
        out
    }

    /// Adds the gradient with respect to the map, where there is one to add to, and keeps that with respect to the
    /// material: both through the twin that did not show.
    pub(crate) fn radiance_vjp(&mut self, by_radiance: &[[f32; 3]], by_map: Option<&mut LightMap>) {
        let other = 1 - self.shows;
        let (twin, Some(lit)) = (&self.twins[other], &self.lit[other]) else { return };
        let tau = self.tau();
        let mut by_parameters = [0.0f64; PARAMETERS];
        let by_lobes: Vec<LobeRow> = by_radiance
            .iter()
            .enumerate()
            .map(|(k, g)| {
                if *g == [0.0; 3] || twin.rows[k].share == 0.0 {
                    return [[0.0; 3]; 5];
                }
                row_vjp(&lit.lobes[k], &twin.rows[k], &self.factors, tau, *g, &mut by_parameters)
            })
            .collect();
        let [low, high] = twin.roughness;
        by_parameters[3] = if low < high { by_parameters[3] / f64::from(high - low) } else { 0.0 };
        self.gradient = by_parameters;
        if let Some(by_map) = by_map {
            twin.transposed(&by_lobes, by_map);
            twin.foreground.matrix.transposed(by_radiance, by_map);
        }
    }

    /// One step of the parameters (`step` counts from 1, `progress` goes from 0 to 1), and a new tracing where it is due;
    /// returns how many gradient entries were not finite.
    pub(crate) fn step(&mut self, step: u32, progress: f32) -> Result<usize, InsertError> {
        let free = |p: Property| self.settings.free.contains(&p);
        let most = self.object.largest_factor();
        let f = &mut self.factors;
        let mut values = [0.0f32; PARAMETERS];
        values[..3].copy_from_slice(&f.albedo.to_array());
        (values[3], values[4]) = (f.roughness, f.metallic);
        values[5..].copy_from_slice(&f.emission.to_array());
        let gates = [
            (0..3, Property::Albedo),
            (3..4, Property::Roughness),
            (4..5, Property::Metallic),
            (5..8, Property::Emission),
        ];
        let mut gradient = self.gradient.map(|g| g as f32);
        for (range, property) in gates {
            if !free(property) {
                gradient[range].fill(0.0);
            }
        }
        let rate = self.settings.rate * 0.1f32.powf(progress);
        let dropped = self.adam.step(&mut values, &gradient, rate, step, &ADAM);
        if values.iter().any(|v| !v.is_finite()) {
            return Err(InsertError::Diverged { iteration: step as usize - 1 });
        }
        let [low, high] = self.twins[0].roughness;
        f.albedo = Vec3::from_slice(&values[..3]).clamp(Vec3::ZERO, Vec3::splat(most));
        if low < high {
            f.roughness = values[3].clamp(low, high);
        }
        f.metallic = values[4].clamp(0.0, most);
        f.emission = Vec3::from_slice(&values[5..]).max(Vec3::ZERO);
        let ran_into = low < high
            && ((f.roughness == low && low > 0.0) || (f.roughness == high && high < most))
            && step as usize >= self.last + SOONEST;
        let bent = low < high || self.indirect > LINEAR;
        if ran_into || (bent && step as usize >= self.last + self.settings.every) {
            self.trace(step as usize, ran_into)?;
        }
        Ok(dropped)
    }

    fn trace(&mut self, step: usize, ran_into: bool) -> Result<(), InsertError> {
        let part = self.settings.part;
        self.object.set_factors(part, self.factors);
        // A roughness that still runs is given more room, one that has settled less.
        let off_middle = (2.0 * self.tau() - 1.0).abs();
        self.narrowed = match (ran_into, off_middle < 0.5) {
            (true, _) => self.narrowed.saturating_sub(1),
            (false, true) => self.narrowed + 1,
            (false, false) => self.narrowed,
        };
        let bracket = bracket(&self.settings, &self.factors, self.narrowed, self.object.largest_factor());
        self.twins = trace_twins(self.object, self.camera, &self.config, part, bracket, self.check)?;
        self.lit = [None, None];
        self.brackets.push(bracket);
        self.last = step;
        Ok(())
    }
}

/// Sets the second twin's light apart from the first's; the camera's rays are the same.
const TWIN_STREAM: u64 = 0x7477_696e;

fn trace_twins(
    object: &Object,
    camera: &Camera,
    config: &ForegroundConfig,
    part: usize,
    bracket: [f32; 2],
    check: &(dyn Fn(usize) -> bool + Sync),
) -> Result<[Lobes; 2], InsertError> {
    let trace = |stream: u64| {
        let config = ForegroundConfig { stream, ..*config };
        trace_lobes(object, camera, &config, part, bracket, check).ok_or(InsertError::Stopped)
    };
    Ok([trace(0)?, trace(TWIN_STREAM)?])
}

/// Roughness factors around the present one, or twice the present one where it is fixed.
fn bracket(settings: &MaterialSettings, factors: &Factors, narrowed: u32, most: f32) -> [f32; 2] {
    let middle = factors.roughness;
    if !settings.free.contains(&Property::Roughness) {
        return [middle; 2];
    }
    let half = settings.half_bracket * NARROWER.powi(narrowed.min(64) as i32);
    let half = half.min(WIDEST * middle).max(LEAST_HALF);
    [(middle - half).max(0.0), (middle + half).min(most).max(LEAST_HALF)]
}
