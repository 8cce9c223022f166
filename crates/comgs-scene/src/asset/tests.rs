//! Saving, loading, damage and interruption.

use super::*;
use comgs_geom::Rng;

fn cloud(n: usize, seed: u64) -> SurfelCloud {
    let mut rng = Rng::new(seed);
    let mut cloud = SurfelCloud::empty(1, ColorEncoding::Srgb);
    for _ in 0..n {
        cloud.positions.push([rng.normal(), rng.normal(), rng.normal()]);
        cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
        cloud.log_scales.push([-3.0, -2.0]);
        cloud.opacity_logits.push(rng.normal());
        cloud.sh.extend((0..12).map(|_| rng.normal()));
    }
    cloud
}

fn asset() -> Asset {
    let mut asset = Asset::new(AssetKind::Object, cloud(20, 1));
    asset.record.training = Some(TrainingRecord {
        program: "comgs test".into(),
        seed: 7,
        iterations: 100,
        seconds: 1.5,
        config: serde_json::json!({"a": [1, 2.5], "b": null}),
        metrics: BTreeMap::from([("train_psnr_db".into(), 31.25), ("perfect".into(), f64::INFINITY)]),
    });
    asset.record.capture = Some(CaptureRecord {
        name: "kettle".into(),
        format: Format::SynCom,
        views: 3,
        image_size: [64, 48],
        hdr: true,
        left_out: vec!["00003".into()],
    });
    asset
}

/// Goal: what is saved is what is loaded, extra files included; resaving in place keeps them.
#[test]
fn round_trip() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("deep/kettle.asset");
    let mut saved = asset();
    saved.save_with(&root, &[("env.exr", &|w: &mut dyn Write| w.write_all(b"light"))]).unwrap();
    let (loaded, report) = Asset::load_with_report(&root).unwrap();
    assert_eq!((&loaded.record, &loaded.surfels), (&saved.record, &saved.surfels));
    assert_eq!(report.count, 20);
    assert!(loaded.record.bounds.is_some());
    assert_eq!(loaded.record.training.as_ref().unwrap().metrics.len(), 1, "an infinite figure is left out");
    assert_eq!(std::fs::read(loaded.file("env.exr").unwrap()).unwrap(), b"light");
    assert!(Asset::is_asset(&root) && loaded.file("probes.safetensors").is_none());
    let mut again = loaded.clone();
    again.surfels = cloud(5, 2);
    again.save(&root).unwrap();
    assert!(Asset::load(&root).unwrap().file("env.exr").is_some());
    assert_eq!(std::fs::read_dir(&root).unwrap().count(), 3, "no temporary files are left");
}

/// Goal: the same asset gives the same bytes.
#[test]
fn saving_is_deterministic() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a"), folder.path().join("b"));
    asset().save(&a).unwrap();
    asset().save(&b).unwrap();
    for name in [ASSET_FILE, SURFELS_FILE] {
        assert_eq!(std::fs::read(a.join(name)).unwrap(), std::fs::read(b.join(name)).unwrap());
    }
}

/// Goal: every kind of damage and of nonsense in the record is refused by name and place.
#[test]
fn damage_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().to_owned();
    asset().save(&root).unwrap();
    let path = root.join(ASSET_FILE);
    let text = std::fs::read_to_string(&path).unwrap();
    let with = |from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        parse_record(text.replacen(from, to, 1).as_bytes(), &path).unwrap_err().to_string()
    };
    assert!(with("\"version\": 1", "\"version\": 9").contains("version 9, this program reads up to 1"));
    assert!(with("\"kind\": \"object\"", "\"kind\": \"spoon\"").starts_with("kind: unknown variant `spoon`"));
    assert!(with("\"views\": 3", "\"views\": -3").starts_with("capture.views: "));
    assert!(
        with("\"up\": [\n    0.0,\n    0.0,\n    1.0", "\"up\": [\n    0.0,\n    0.0,\n    0.0")
            .starts_with("up: ")
    );
    assert!(with("surfels.ply", "../surfels.ply").starts_with("files.../surfels.ply: "));
    assert!(with("surfels.ply", "other.ply").contains("surfels.ply is not listed"));
    assert!(with("\"blake3\": \"", "\"blake3\": \"x").contains("64 hexadecimal"));
    assert!(parse_record(b"{}", &path).unwrap_err().to_string().contains("version"));

    let ply = root.join(SURFELS_FILE);
    let bytes = std::fs::read(&ply).unwrap();
    let mut flipped = bytes.clone();
    *flipped.last_mut().unwrap() ^= 1;
    std::fs::write(&ply, &flipped).unwrap();
    assert!(Asset::load(&root).unwrap_err().to_string().contains("checksum"));
    std::fs::write(&ply, &bytes[..bytes.len() - 4]).unwrap();
    assert!(Asset::load(&root).unwrap_err().to_string().contains("bytes, expected"));
    std::fs::remove_file(&ply).unwrap();
    assert!(Asset::load(&root).unwrap_err().to_string().contains("missing"));
    std::fs::remove_file(&path).unwrap();
    assert!(matches!(Asset::load(&root), Err(SceneError::Io { .. })));
}

/// Goal: a disk that fills up while saving leaves the old asset as it was, and no new one where none was (hard case
/// 36).
#[test]
fn a_full_disk_leaves_the_old_asset() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("a");
    let full = |w: &mut dyn Write| {
        w.write_all(b"some")?;
        Err(io::Error::from(io::ErrorKind::StorageFull))
    };
    let error = asset().save_with(&root, &[("env.exr", &full)]).unwrap_err();
    assert!(matches!(&error, SceneError::Write { path, .. } if path.ends_with("env.exr")), "{error}");
    assert!(Asset::load(&root).is_err(), "nothing half-written loads");
    assert_eq!(std::fs::read_dir(&root).unwrap().count(), 0);

    let mut old = asset();
    old.save(&root).unwrap();
    let mut new = Asset::new(AssetKind::Scene, cloud(3, 9));
    assert!(new.save_with(&root, &[("env.exr", &full)]).is_err());
    assert_eq!(Asset::load(&root).unwrap().surfels, old.surfels);
    assert_eq!(std::fs::read_dir(&root).unwrap().count(), 2);
    new.record.up = [0.0; 3];
    assert!(matches!(new.save(&root), Err(SceneError::Json { .. })));
    assert_eq!(Asset::load(&root).unwrap().surfels, old.surfels);
    let below_a_file = root.join(SURFELS_FILE).join("b");
    assert!(matches!(asset().save(&below_a_file), Err(SceneError::Write { .. })));
    let taken: ExtraFile<'_> = ("../env.exr", &|_: &mut dyn Write| Ok(()));
    assert!(asset().save_with(&root, &[taken]).is_err());
}
