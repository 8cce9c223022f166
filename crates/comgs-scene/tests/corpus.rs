//! The fuzz corpora in the ordinary tests: every file, and thousands of seeded mutations of each family, go through the
//! parsers without a panic and without wild allocation (hard case 34).

use comgs_geom::Rng;
use comgs_scene::probe;
use std::path::PathBuf;

const FAMILIES: [(&str, fn(&[u8])); 6] = [
    ("ply", probe::ply),
    ("colmap", probe::colmap),
    ("transforms", probe::transforms),
    ("syncom", probe::syncom),
    ("asset", probe::asset),
    ("image", probe::image),
];

/// Mutations of each family.
const MUTATIONS: usize = 4000;

/// The process may grow by this much over all mutations; a believed made-up count would take gigabytes.
const GROWTH_LIMIT_KIB: u64 = 200 << 10;

fn corpus(family: &str) -> Vec<(PathBuf, Vec<u8>)> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../fuzz/corpus").join(family);
    let mut paths: Vec<PathBuf> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths.into_iter().map(|path| (path.clone(), std::fs::read(path).unwrap())).collect()
}

/// Peak resident memory of this process, where the system tells.
fn peak_kib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find(|l| l.starts_with("VmHWM:"))?.split_whitespace().nth(1)?.parse().ok()
}

/// One of: bits flipped, a run overwritten with 0x00 or 0xff, cut off, a piece repeated, a digit changed, a piece of
/// another file put in.
fn mutate(rng: &mut Rng, files: &[(PathBuf, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = files[rng.below(files.len())].1.clone();
    for _ in 0..1 + rng.below(4) {
        let n = bytes.len().max(1);
        let at = rng.below(n).min(bytes.len());
        let end = (at + 1 + rng.below(16)).min(bytes.len());
        match rng.below(6) {
            0 => bytes[at..end].iter_mut().for_each(|b| *b ^= 1 << rng.below(8)),
            1 => bytes[at..end].fill(if rng.below(2) == 0 { 0 } else { 0xff }),
            2 => bytes.truncate(at),
            3 => {
                let piece = bytes[at..end].to_vec();
                let times = 1 + rng.below(8);
                bytes.splice(at..at, piece.repeat(times));
            }
            4 => {
                let digits: Vec<usize> = (0..bytes.len()).filter(|&i| bytes[i].is_ascii_digit()).collect();
                if !digits.is_empty() {
                    bytes[digits[rng.below(digits.len())]] = b"0123456789-e."[rng.below(13)];
                }
            }
            _ => {
                let other = &files[rng.below(files.len())].1;
                let from = rng.below(other.len().max(1)).min(other.len());
                let to = (from + rng.below(64)).min(other.len());
                bytes.splice(at..end, other[from..to].iter().copied());
            }
        }
    }
    bytes
}

/// Goal: no file of the corpora and no mutation of one makes a parser panic, and memory stays bounded.
#[test]
fn corpora_and_mutations() {
    for (family, parse) in FAMILIES {
        let files = corpus(family);
        assert!(files.len() >= 4, "the corpus of {family} is there");
        let before = peak_kib();
        for (_, bytes) in &files {
            parse(bytes);
            for cut in (0..bytes.len()).step_by(1 + bytes.len() / 200) {
                parse(&bytes[..cut]);
            }
        }
        for i in 0..MUTATIONS {
            let mut rng = Rng::stream(34, i as u64);
            parse(&mutate(&mut rng, &files));
        }
        if let (Some(before), Some(after)) = (before, peak_kib()) {
            let grown = after - before;
            assert!(grown < GROWTH_LIMIT_KIB, "{family}: memory grew by {grown} KiB");
        }
    }
}

/// Goal: images and cameras have the same limit.
#[test]
fn one_limit_for_images_and_cameras() {
    assert_eq!(comgs_image::read::MAX_PIXELS, comgs_geom::camera::MAX_PIXELS);
}

/// Goal: the corpus holds what its names say: files that are accepted and files that are refused.
#[test]
fn the_corpus_is_what_it_says() {
    use comgs_surfel::ply::{PlyDialect, parse_points, parse_surfels};
    for (path, bytes) in corpus("ply") {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let dialect = parse_surfels(&bytes, &path).map(|(_, report)| report.dialect).ok();
        let expected = match name {
            "comgs_material_degree1" => Some(PlyDialect::Comgs),
            "three_dgs_degree3" => Some(PlyDialect::ThreeDgs),
            "two_dgs_degree0_ascii" | "not_finite_ascii" => Some(PlyDialect::TwoDgs),
            "published_big_endian" => Some(PlyDialect::ComgsPublished),
            "r3dg_with_light" => Some(PlyDialect::R3dg),
            "irgs_degree1_ascii" => Some(PlyDialect::Irgs),
            "gs_ir_big_endian" => Some(PlyDialect::GsIr),
            _ => None,
        };
        assert_eq!(dialect, expected, "{name}");
        assert_eq!(parse_points(&bytes, &path).is_ok(), name != "giant_count", "{name}");
    }
    for (path, bytes) in corpus("image") {
        let refused = ["giant_header.png", "large_promise.png"].iter().any(|name| path.ends_with(name));
        let decoded = comgs_image::read::decode(&bytes, &path);
        assert_eq!(decoded.is_err(), refused, "{path:?}: {:?}", decoded.err());
    }
    for (path, bytes) in corpus("transforms") {
        let listing = comgs_scene::capture::transforms::parse(&bytes, &path).unwrap();
        let broken = path.ends_with("broken_frames.json");
        assert_eq!((listing.frames.is_empty(), listing.faults.is_empty()), (broken, !broken), "{path:?}");
    }
    for (path, bytes) in corpus("syncom") {
        let cameras = comgs_scene::capture::syncom::parse(&bytes, &path).is_ok();
        let transform = comgs_scene::TransformFile::parse(&bytes, &path).is_ok();
        let is_transform = path.file_name().unwrap().to_str().unwrap().starts_with("transform");
        assert_eq!((cameras, transform), (!is_transform, is_transform), "{path:?}");
    }
}
