//! Reconstruction as a stage: what is written, reuse, interruption, refusals. How good it is, `comgs-inverse` tests.

mod common;

use comgs_inverse::{Kind, Quality};
use comgs_pipeline::stages::{info, reconstruct};
use comgs_pipeline::{CancelToken, Context, PipelineError, Progress, Status, record::read_record};
use comgs_scene::{Asset, AssetKind};
use std::path::Path;

fn capture(root: &Path) -> reconstruct::Input {
    let cameras = common::ring(10, 2.2, 0.8, (40, 40), 0.6);
    let capture = root.join("ball");
    common::write_capture(&capture, &common::object_cloud(), AssetKind::Object, &cameras);
    reconstruct::Input { capture, output: root.join("ball.asset") }
}

fn quick() -> reconstruct::Config {
    reconstruct::Config {
        quality: Quality::Draft,
        max_surfels: Some(400),
        time_budget_s: Some(3.0),
        ..reconstruct::Config::default()
    }
}

/// Goal: a capture with masks becomes an object asset with provenance, cameras, preview and record, within its time; the
/// second run does nothing; a changed photo runs again.
#[test]
fn a_capture_becomes_an_asset_once() {
    let root = tempfile::tempdir().unwrap();
    let input = capture(root.path());
    let start = std::time::Instant::now();
    let made = reconstruct::run(&input, &quick(), &Context::silent()).unwrap();
    assert!(!made.reused);
    // Three seconds of budget; saving and a slow machine's last step come on top.
    assert!(start.elapsed().as_secs_f64() < 10.0, "{:?}", start.elapsed());
    let asset = Asset::load(&input.output).unwrap();
    assert_eq!(asset.record.kind, AssetKind::Object);
    let provenance = asset.record.capture.clone().unwrap();
    assert_eq!((provenance.name.as_str(), provenance.views, provenance.hdr), ("ball", 10, true));
    assert!(asset.record.training.unwrap().metrics["train_psnr_db"] > 10.0);
    assert!(asset.surfels.len() > 50 && asset.surfels.len() <= 400);
    assert_eq!(comgs_scene::read_cameras(&input.output).unwrap().len(), 12);
    assert!(input.output.join("preview.png").is_file());
    assert!(info::run(&input.output).unwrap().to_text().contains("10 views of 40×40, HDR"));
    assert_eq!(read_record(&input.output.join("run.json")).unwrap().results["kind"], "object");

    assert!(reconstruct::run(&input, &quick(), &Context::silent()).unwrap().reused);
    let photo = input.capture.join("train/images/00004.exr");
    let other = input.capture.join("train/images/00005.exr");
    std::fs::copy(other, photo).unwrap();
    assert!(!reconstruct::run(&input, &quick(), &Context::silent()).unwrap().reused);
}

/// Goal: a budget that is over before the first step is warned of, and no PSNR of 0 dB is claimed.
#[test]
fn a_budget_without_a_step_is_told() {
    let root = tempfile::tempdir().unwrap();
    let input = capture(root.path());
    let config = reconstruct::Config { time_budget_s: Some(0.001), ..quick() };
    let made = reconstruct::run(&input, &config, &Context::silent()).unwrap();
    assert_eq!(made.record.results["training"]["iterations"], 0);
    assert!(made.record.warnings.iter().any(|w| w.contains("no training step")), "{:?}", made.record);
    let asset = Asset::load(&input.output).unwrap();
    assert!(!asset.surfels.is_empty());
    assert!(!asset.record.training.unwrap().metrics.contains_key("train_psnr_db"));
    assert!(!info::run(&input.output).unwrap().to_text().contains("psnr"));
}

/// Cancels when training has begun.
struct StopInTraining(CancelToken);

impl Progress for StopInTraining {
    fn begin(&self, _: &str) {}
    fn update(&self, status: &Status) {
        if status.message.contains("step ") {
            self.0.cancel();
        }
    }
    fn end(&self, _: &str) {}
    fn note(&self, _: &str) {}
    fn warn(&self, _: &str) {}
}

/// Goal: a stopped reconstruction says how to go on and leaves no asset; resumed, it ends with the bytes of one that was
/// never stopped (hard case 15, through the files).
#[test]
fn a_stopped_reconstruction_resumes_to_the_same_bytes() {
    let root = tempfile::tempdir().unwrap();
    let input = capture(root.path());
    let config = reconstruct::Config { time_budget_s: None, max_surfels: Some(150), ..quick() };
    let cancel = CancelToken::default();
    let stop = StopInTraining(cancel.clone());
    let error = reconstruct::run(&input, &config, &Context { progress: &stop, cancel }).unwrap_err();
    assert!(matches!(&error, PipelineError::Cancelled { kept: Some(_) }), "{error}");
    assert!(error.to_string().contains("--resume"), "{error}");
    assert!(!Asset::is_asset(&input.output) && !input.output.join("run.json").exists());
    let resumed = reconstruct::Config { resume: reconstruct::Resume::Expected, ..config.clone() };
    reconstruct::run(&input, &resumed, &Context::silent()).unwrap();
    let whole = reconstruct::Input { output: root.path().join("whole.asset"), ..input.clone() };
    reconstruct::run(&whole, &config, &Context::silent()).unwrap();
    let surfels = |folder: &Path| std::fs::read(folder.join("surfels.ply")).unwrap();
    assert!(surfels(&input.output) == surfels(&whole.output), "resumed and uninterrupted runs differ");
}

/// Goal: captures that cannot work are refused with the reason and leave nothing behind; an old asset survives.
#[test]
fn unusable_captures_are_refused() {
    let root = tempfile::tempdir().unwrap();
    capture(root.path());
    let refuse = |input: &reconstruct::Input, config: &reconstruct::Config| {
        let error = reconstruct::run(input, config, &Context::silent()).unwrap_err();
        let mut text = error.to_string();
        let mut source = std::error::Error::source(&error);
        while let Some(cause) = source {
            text.push_str(&format!(": {cause}"));
            source = cause.source();
        }
        text
    };
    let empty = root.path().join("empty");
    std::fs::create_dir_all(&empty).unwrap();
    let nothing = reconstruct::Input { capture: empty, output: root.path().join("x.asset") };
    let text = refuse(&nothing, &quick());
    assert!(text.contains("looked for"), "{text}");
    assert!(!nothing.output.exists());

    // A scene without masks, called an object.
    let scene = root.path().join("room");
    let cameras = common::ring(5, 2.6, 1.5, (32, 24), 0.9);
    common::write_capture(&scene, &common::scene_cloud(), AssetKind::Scene, &cameras);
    let unmasked = reconstruct::Input { capture: scene, output: root.path().join("y.asset") };
    let text = refuse(&unmasked, &reconstruct::Config { kind: Some(Kind::Object), ..quick() });
    assert!(text.contains("mask"), "{text}");
    assert!(!Asset::is_asset(&unmasked.output));
}
