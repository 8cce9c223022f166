//! Whose files are whose: stages that share a folder, a stem or an asset leave one another's results alone, and what cannot
//! be written is told before any work.

mod common;

use comgs_pipeline::stages::{compose, eval, export, info, light, place, render};
use comgs_pipeline::{Context, PipelineError, record::read_record};
use comgs_scene::Asset;
use common::{World, world};
use glam::DVec3;
use std::path::Path;

fn place_at(world: &World, output: &Path, x: f64) -> Result<place::Output, PipelineError> {
    let input = place::Input {
        scene: world.scene.clone(),
        object: world.object.clone(),
        cameras: None,
        output: output.to_owned(),
    };
    let config = place::Config { at: place::At::Point([x, 0.0, 0.0]), size: Some(0.8), yaw_deg: 0.0 };
    place::run(&input, &config, &Context::silent())
}

fn light_at(world: &World, output: &Path, z: f64) -> Result<light::Output, PipelineError> {
    let input = light::Input { scene: world.scene.clone(), output: output.to_owned(), report: None };
    let config = light::Config { height: 8, ..light::Config::at(DVec3::new(0.0, 0.0, z)) };
    light::run(&input, &config, &Context::silent())
}

fn render_to(world: &World, output: &Path) -> Result<render::Output, PipelineError> {
    let input = render::Input {
        asset: world.scene.clone(),
        cameras: world.cameras.clone(),
        output: output.to_owned(),
    };
    render::run(&input, &render::Config { layers: true }, &Context::silent())
}

/// Goal: rendering an asset into its own folder is refused and the asset stays whole.
#[test]
fn an_asset_is_not_an_output_folder() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let text = render_to(&world, &world.scene).unwrap_err().to_string();
    assert!(text.contains("an asset") && text.contains("room.asset"), "{text}");
    assert!(Asset::load(&world.scene).is_ok());
    assert!(!world.scene.join("frames").exists() && !world.scene.join("run.json").exists());
    // A placement that is kept with its scene is no trouble, unless it would replace one of the asset's files.
    let kept = world.scene.join("cow.json");
    place_at(&world, &kept, 0.0).unwrap();
    place_at(&world, &kept, 0.1).unwrap();
    for own in ["asset.json", "surfels.ply", "cameras.json"] {
        let text = place_at(&world, &world.scene.join(own), 0.0).unwrap_err().to_string();
        assert!(text.contains(own), "{text}");
    }
    assert!(Asset::load(&world.scene).is_ok());
}

/// Goal: a placement and a light of one stem do not remove one another's files, whichever runs again; two lights in one
/// folder have pictures of their own.
#[test]
fn files_of_one_stem_live_together() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let (json, exr) = (root.path().join("foo.json"), root.path().join("foo.exr"));
    place_at(&world, &json, 0.0).unwrap();
    let foo = light_at(&world, &exr, 0.4).unwrap();
    assert!(json.is_file(), "light removed the placement");
    place_at(&world, &json, 0.2).unwrap();
    assert!(exr.is_file() && foo.pictures.sweep.is_file(), "place removed the light");
    let bar = light_at(&world, &root.path().join("bar.hdr"), 0.9).unwrap();
    for picture in
        [&foo.pictures.environment, &foo.pictures.sweep, &foo.pictures.alpha, &bar.pictures.environment]
    {
        assert!(picture.is_file(), "{}", picture.display());
    }
    assert_ne!(foo.pictures.sweep, bar.pictures.sweep);
    let map = comgs_image::read(&bar.environment).unwrap();
    assert_eq!((map.color.width, map.encoding), (16, comgs_image::Encoding::Linear));
    assert!(light_at(&world, &exr, 0.4).unwrap().reused, "the other light is not in the way");
}

/// Goal: a rendering and a composition in one folder: each has its record, and a second run of either removes nothing of
/// the other's.
#[test]
fn stages_share_a_folder() {
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let (transform, out) = (root.path().join("t.json"), root.path().join("out"));
    place_at(&world, &transform, 0.0).unwrap();
    render_to(&world, &out).unwrap();
    let mut input = compose::Input {
        scene: world.scene.clone(),
        objects: vec![world.object.clone()],
        transform,
        cameras: root.path().join("two.json"),
        light: None,
        truth: None,
        output: out.clone(),
    };
    let cameras = comgs_scene::read_cameras(&world.cameras).unwrap();
    comgs_scene::write_cameras(&input.cameras, &cameras[..2]).unwrap();
    let config = compose::Config { shadow_rays: 4, ..compose::Config::default() };
    compose::run(&input, &config, &Context::silent()).unwrap();
    for file in ["layers/00000.exr", "layers/00002.exr", "frames/00002.png"] {
        assert!(out.join(file).is_file(), "compose removed {file} of render");
    }
    assert_eq!(read_record(&out.join("run.json")).unwrap().stage, "render");
    let record = out.join("compose.run.json");
    assert_eq!(read_record(&record).unwrap().stage, "compose");
    assert!(info::run(&record).unwrap().to_text().contains("compose"));
    assert!(compose::run(&input, &config, &Context::silent()).unwrap().reused);
    render_to(&world, &out).unwrap();
    for file in ["composition.json", "report.html", "empty/00001.png", "env.exr"] {
        assert!(out.join(file).is_file(), "render removed {file} of compose");
    }
    // An input is not an output.
    input.output = world.object.clone();
    assert!(compose::run(&input, &config, &Context::silent()).is_err());
    assert!(Asset::load(&world.object).is_ok());
}

/// Goal (hard case 36): an output that cannot be written is told in a sentence with the folder, before anything is loaded
/// or computed, and leaves nothing behind.
#[test]
fn unwritable_outputs_are_told_before_the_work() {
    let root = tempfile::tempdir().unwrap();
    let mut world = world(root.path());
    let file = root.path().join("file");
    std::fs::write(&file, b"x").unwrap();
    // Surfels that cannot be loaded: whoever complains about them has begun to work.
    let surfels = world.scene.join("surfels.ply");
    let bytes = std::fs::read(&surfels).unwrap();
    std::fs::write(&surfels, &bytes[..bytes.len() / 2]).unwrap();
    let start = format!("cannot create the output folder {}", file.display());
    let json = Some(file.join("scores.json"));
    let (subject, against) = (world.scene.clone(), root.path().join("nothing"));
    let eval_input = eval::Input { subject, against, relit: None, json };
    let export_input = export::Input { asset: world.scene.clone(), output: file.join("a.ply") };
    for error in [
        place_at(&world, &file.join("t.json"), 0.0).unwrap_err(),
        light_at(&world, &file.join("env.exr"), 0.4).unwrap_err(),
        render_to(&world, &file.join("out")).unwrap_err(),
        render_to(&world, &file).unwrap_err(),
        eval::run(&eval_input, &Context::silent()).unwrap_err(),
        export::run(&export_input, &export::Config::default(), &Context::silent()).unwrap_err(),
    ] {
        assert!(matches!(error, PipelineError::Output { .. }), "{error}");
        assert!(error.to_string().starts_with(&start), "{error}");
    }
    assert!(render_to(&world, &root.path().join("new/out")).is_err());
    assert!(!root.path().join("new").exists(), "a failed run leaves no folder");
    assert_eq!(std::fs::read(&file).unwrap(), b"x");
    // Radiance does not fit into a picture, and no angle is infinite.
    world.scene = root.path().join("none");
    let text = light_at(&world, &root.path().join("l.png"), 0.4).unwrap_err().to_string();
    assert!(text.contains(".exr or .hdr") && text.ends_with("l.png"), "{text}");
    for yaw_deg in [f64::INFINITY, f64::NAN] {
        let config = place::Config { at: place::At::Point([0.0; 3]), size: None, yaw_deg };
        let input = place::Input {
            scene: world.scene.clone(),
            object: world.object.clone(),
            cameras: None,
            output: root.path().join("t.json"),
        };
        let text = place::run(&input, &config, &Context::silent()).unwrap_err().to_string();
        assert!(text.contains("--yaw"), "{text}");
    }
}

/// Goal: an asset is exported as it is and for viewers, the second time for nothing; other names and the input itself are
/// refused.
#[test]
fn an_asset_is_exported() {
    use comgs_surfel::ply::{read_header, read_surfels};
    let root = tempfile::tempdir().unwrap();
    let world = world(root.path());
    let asset = Asset::load(&world.object).unwrap();
    let run = |input: &Path, name: &str, viewer: bool| {
        let input = export::Input { asset: input.to_owned(), output: root.path().join(name) };
        export::run(&input, &export::Config { viewer }, &Context::silent())
    };
    let plain = run(&world.object, "ball.ply", false).unwrap();
    assert_eq!(read_surfels(&plain.ply).unwrap().0.positions, asset.surfels.positions);
    let viewer = run(&world.object, "view.ply", true).unwrap();
    let header = read_header(&viewer.ply).unwrap();
    assert!(header.elements[0].properties.iter().any(|p| p.name == "scale_2"));
    assert_eq!(read_surfels(&viewer.ply).unwrap().0.len(), asset.surfels.len());
    assert!(run(&world.object, "view.ply", true).unwrap().reused);
    assert!(run(&world.object, "ball.obj", false).unwrap_err().to_string().contains(".ply"));
    assert!(run(&plain.ply, "ball.ply", true).unwrap_err().to_string().contains("other than the input"));
    assert_eq!(read_surfels(&plain.ply).unwrap().0.positions, asset.surfels.positions);
}
