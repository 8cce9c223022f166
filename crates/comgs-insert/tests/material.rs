//! A part's material: the lobes against plain transport, and materials found again from composites that a path tracer
//! made.

mod support;

use comgs_geom::Camera;
use comgs_image::Image;
use comgs_insert::guidance::Reference;
use comgs_insert::light::{Light, LightMap, Texels};
use comgs_insert::material::{LINEAR, MaterialSettings, Property, Search, Summary, row};
use comgs_insert::object::{Factors, Object};
use comgs_insert::optimise::{Crops, Curves, Lights};
use comgs_insert::tone::{Response, Tone};
use comgs_insert::transport::{ForegroundConfig, ShadowConfig, trace_foreground, trace_lobes, trace_shadow};
use comgs_insert::{Problem, Settings, State, optimise_with};
use comgs_synth::film;
use comgs_synth::recipe::PartRecipe;
use comgs_synth::shape::Shape;
use glam::Vec3;
use support::{camera, object, part, sunny, world};

fn knot(color: [f32; 3], roughness: f32, metallic: f32) -> PartRecipe {
    let shape = Shape::TorusKnot { turns: 2, twists: 3, radius: 0.32, swing: 0.14, tube: 0.09 };
    part(shape, [0.0, 0.0, 0.55], color, roughness, metallic)
}

fn ball(color: [f32; 3], roughness: f32, metallic: f32) -> PartRecipe {
    part(Shape::Sphere { radius: 0.5 }, [0.0, 0.0, 0.5], color, roughness, metallic)
}

fn light() -> LightMap {
    sunny(32, Vec3::new(-0.5, 0.6, 0.8), 6.0)
}

fn radiance(object: &Object, camera: &Camera, config: &ForegroundConfig) -> Vec<[f32; 3]> {
    let f = trace_foreground(object, camera, config, |_| true).unwrap();
    f.matrix.times(&light(), |_| true)
}

/// Goal: put together at the material they were traced at, the lobes are the plain matrix, sample for sample, at both ends
/// of a bracket that has no width and of one that has; a second part is left as it is.
#[test]
fn lobes_put_together_are_plain_transport() {
    let camera = camera(48, 32);
    let parts = [knot([0.7, 0.5, 0.3], 0.4, 0.6), ball([0.3, 0.6, 0.5], 0.3, 0.0)];
    let object = object(&parts);
    let config = ForegroundConfig::default();
    let plain = radiance(&object, &camera, &config);
    for (which, bracket, tau) in [(0, [0.4, 0.4], 0.0), (0, [0.4, 0.6], 0.0), (1, [0.2, 0.3], 1.0)] {
        let lobes = trace_lobes(&object, &camera, &config, which, bracket, |_| true).unwrap();
        let (rows, rest) =
            (lobes.times(&light(), |_| true), lobes.foreground.matrix.times(&light(), |_| true));
        assert!(lobes.rows.iter().any(|r| r.share == 1.0));
        let mut worst = 0.0f32;
        for (k, plain) in plain.iter().enumerate() {
            let ours = row(&rows[k], &lobes.rows[k], rest[k], &object.factors(which), tau);
            for c in 0..3 {
                worst = worst.max((ours[c] - plain[c]).abs() / plain[c].max(0.1));
            }
        }
        println!("part {which} at {bracket:?}: worst {worst:.1e}, indirect {:.4}", lobes.indirect);
        assert!(worst < 2e-4);
    }
}

/// Goal: on a ball, which light meets once, the lobes of one material say what another one looks like: the colour, the
/// metalness and the emission changed, to the noise of tracing it (1 % in the mean, 3 % in the mean absolute error).
#[test]
fn another_material_without_tracing() {
    let camera = camera(48, 32);
    let mut object = object(&[ball([0.7, 0.5, 0.3], 0.4, 0.2)]);
    let config = ForegroundConfig::default();
    let lobes = trace_lobes(&object, &camera, &config, 0, [0.4, 0.4], |_| true).unwrap();
    assert!(lobes.indirect < LINEAR, "{}", lobes.indirect);
    let factors = Factors {
        albedo: Vec3::new(0.2, 0.8, 0.9),
        roughness: 0.4,
        metallic: 0.8,
        emission: Vec3::new(0.05, 0.0, 0.1),
    };
    let (rows, rest) = (lobes.times(&light(), |_| true), lobes.foreground.matrix.times(&light(), |_| true));
    object.set_factors(0, factors);
    assert_eq!(object.factors(0), factors);
    let truth = radiance(&object, &camera, &config);
    let (mut sum, mut truth_sum, mut error) = (0.0f64, 0.0f64, 0.0f64);
    for (k, truth) in truth.iter().enumerate() {
        let ours = row(&rows[k], &lobes.rows[k], rest[k], &factors, 0.0);
        for c in 0..3 {
            sum += f64::from(ours[c]);
            truth_sum += f64::from(truth[c]);
            error += f64::from((ours[c] - truth[c]).abs());
        }
    }
    println!("mean {:+.2} %, error {:.2} %", 100.0 * (sum / truth_sum - 1.0), 100.0 * error / truth_sum);
    assert!((sum / truth_sum - 1.0).abs() < 0.01 && error / truth_sum < 0.03);
}

/// The path tracer's picture of a part under the light, over a grey photo, tone-mapped.
fn target(recipe: &PartRecipe, camera: &Camera, photo: &Image) -> Image {
    let picture = film::render(&world(std::slice::from_ref(recipe), false, &light()), camera, 512, 11);
    let mut out = photo.clone();
    for i in 0..camera.width * camera.height {
        let v = picture.coverage.data[i];
        for c in 0..3 {
            let k = 3 * i + c;
            let x = picture.straight.data[k].max(0.0);
            out.data[k] = (1.0 - v) * photo.data[k] + v * x / (1.0 + x);
        }
    }
    out
}

/// What a search from `start` finds for a part that is in truth `truth`, the light known; the shadow is left out of both.
fn found(start: &PartRecipe, truth: &PartRecipe, free: Vec<Property>) -> Summary {
    let camera = camera(60, 40);
    let photo = Image::filled(60, 40, 3, 0.4);
    let target = target(truth, &camera, &photo);
    let mut object = object(std::slice::from_ref(start));
    let none = vec![1.0; 60 * 40];
    let shadow = trace_shadow(&object, &camera, &none, &ShadowConfig::default(), |_| true).unwrap();
    let settings = Settings {
        lights: Lights::Fixed,
        curves: Curves::Fixed,
        crops: Crops::Whole,
        iterations: 600,
        ..Settings::dipir()
    };
    let check = |_: usize| true;
    let config = ForegroundConfig::default();
    let wanted = MaterialSettings::new(0, free, settings.iterations);
    let mut search = Search::new(&mut object, &camera, &config, 1 << 30, wanted, &check).unwrap();
    let outline = search.lobes().foreground.outline();
    let problem = Problem { photo: &photo, foreground: &outline, shadow: &shadow };
    let map = Light::Texels(Texels::from_map(&light()));
    let state = State { foreground: map.clone(), shadow: map, tone: Tone::identity(Response::Reinhard) };
    let mut guidance = Reference::new(&target, outline.pixels.len());
    let started = std::time::Instant::now();
    let outcome =
        optimise_with(Some(&problem), state, &mut guidance, &settings, Some(&mut search), |_| true).unwrap();
    let summary = search.finish();
    println!(
        "{:?} traced {} times, indirect {:.3}, loss {:.4} from {:.4}, {:.1} s: {}, {:.3?}",
        summary.after,
        summary.traced,
        summary.indirect,
        outcome.losses.last().unwrap().guidance,
        outcome.losses[0].guidance,
        started.elapsed().as_secs_f32(),
        summary.why,
        summary.brackets
    );
    assert_eq!(object.factors(0), summary.after);
    assert!(outcome.light.data.iter().zip(&light().data).all(|(a, b)| (a - b).abs() <= 1e-3 * b.max(1e-3)));
    summary
}

/// Goal: the colour of a ball is found with one tracing, because the linear form holds.
#[test]
fn a_colour_is_found_with_one_tracing() {
    let truth = [0.25, 0.5, 0.75];
    let s = found(&ball([0.7; 3], 0.4, 0.0), &ball(truth, 0.4, 0.0), vec![Property::Albedo]);
    assert!((s.after.albedo - Vec3::from_array(truth)).abs().max_element() < 0.015);
    assert_eq!((s.traced, s.after.roughness), (1, 0.4));
    assert!(s.why.contains("linear form holds"));
}

/// Goal: colour and roughness of a glossy ball are found from a matte one: the roughness through brackets that are traced
/// again.
#[test]
fn a_roughness_is_found_by_brackets() {
    let truth = [0.6, 0.3, 0.2];
    let free = vec![Property::Albedo, Property::Roughness];
    let s = found(&ball([0.7; 3], 0.85, 0.0), &ball(truth, 0.3, 0.0), free);
    assert!((s.after.albedo - Vec3::from_array(truth)).abs().max_element() < 0.02);
    assert!((s.after.roughness - 0.3).abs() < 0.03, "{}", s.after.roughness);
    assert!(s.traced > 3 && s.why.contains("the roughness moves"));
}

/// Goal: copper that reflects itself is found from grey plastic: light that meets the object twice is traced again, and
/// without that the colour would be wrong.
#[test]
fn a_metal_that_reflects_itself_is_found_by_tracing_again() {
    let truth = [0.9, 0.6, 0.45];
    let free = vec![Property::Albedo, Property::Roughness, Property::Metallic];
    let s = found(&knot([0.6; 3], 0.6, 0.1), &knot(truth, 0.35, 1.0), free);
    assert!(s.indirect > LINEAR && s.why.contains("meets the object twice"));
    assert!((s.after.albedo - Vec3::from_array(truth)).abs().max_element() < 0.04);
    assert!((s.after.roughness - 0.35).abs() < 0.04, "{}", s.after.roughness);
    assert!(s.after.metallic > 0.93, "{}", s.after.metallic);
}

/// Goal: a lamp's own light is told from the light on it.
#[test]
fn an_emission_is_found() {
    let mut truth = ball([0.5; 3], 0.6, 0.0);
    truth.material.emission = [0.6, 0.3, 0.05];
    let free = vec![Property::Emission];
    let s = found(&ball([0.5; 3], 0.6, 0.0), &truth, free);
    assert!((s.after.emission - Vec3::new(0.6, 0.3, 0.05)).abs().max_element() < 0.02);
}

/// Goal: a part that is not there, one that the camera does not see, and a search without anything to find are refused
/// with what there is.
#[test]
fn what_cannot_be_searched() {
    let camera = camera(24, 16);
    let hidden = part(Shape::Sphere { radius: 0.1 }, [0.0, 0.0, 0.5], [0.5; 3], 0.5, 0.0);
    let mut object = object(&[ball([0.5; 3], 0.5, 0.0), hidden]);
    let check = |_: usize| true;
    let mut refused = |part: usize, free: Vec<Property>, memory: usize| {
        let settings = MaterialSettings::new(part, free, 100);
        let config = ForegroundConfig::default();
        Search::new(&mut object, &camera, &config, memory, settings, &check).err().unwrap().to_string()
    };
    assert!(refused(2, vec![Property::Albedo], 1 << 30).contains("material 0, material 1"));
    assert!(refused(1, vec![Property::Albedo], 1 << 30).contains("a part that the photo shows"));
    assert!(refused(0, vec![], 1 << 30).contains("albedo, roughness, metallic or emission"));
    assert!(refused(0, vec![Property::Roughness], 1 << 10).contains("--memory"));
}
