//! Bytes and memory.

use crate::round::fibonacci;
use comgs_geom::Rng;
use comgs_probe::{
    OrientedPoints, ProbeConfig, ProbeError, ProbeSet, VisibilityWeight, from_bytes, place, to_bytes,
};
use glam::Vec3;

fn sample_set(count: usize, resolution: usize) -> (ProbeSet, ProbeConfig) {
    let mut rng = Rng::new(1);
    let normals = fibonacci(4 * count);
    let points = OrientedPoints { positions: normals.iter().map(|n| *n * 0.37).collect(), normals };
    let config = ProbeConfig {
        count,
        resolution,
        offset: 0.1 / 3.0,
        visibility: VisibilityWeight::None,
        ..ProbeConfig::default()
    };
    let mut set = place(&points, &config, 0.74).unwrap();
    set.texels.iter_mut().for_each(|t| *t = [rng.uniform(), 1e4 * rng.uniform(), 0.0, rng.uniform()]);
    (set, config)
}

/// Goal: everything comes back bit for bit, the same set gives the same bytes, and an empty set is a set.
#[test]
fn round_trip() {
    for (count, resolution) in [(50, 16), (1, 2), (3, 9)] {
        let (set, config) = sample_set(count, resolution);
        let bytes = to_bytes(&set, &config).unwrap();
        assert_eq!(from_bytes(&bytes).unwrap(), (set.clone(), config.clone()));
        for _ in 0..8 {
            assert_eq!(to_bytes(&set, &config).unwrap(), bytes);
        }
        // Bytes at an odd address.
        let mut shifted = vec![0u8];
        shifted.extend(&bytes);
        assert_eq!(from_bytes(&shifted[1..]).unwrap().0, set);
    }
    let (mut set, config) = sample_set(2, 4);
    for column in [&mut set.positions, &mut set.normals] {
        column.clear();
    }
    set.texels.clear();
    set.moments.clear();
    assert_eq!(from_bytes(&to_bytes(&set, &config).unwrap()).unwrap().0, set);
}

/// Goal: a probe costs what its documentation says, in memory and in the file.
#[test]
fn memory_per_probe() {
    let (set, config) = sample_set(100, 16);
    assert_eq!(set.memory_bytes(), 100 * 6168);
    let file = to_bytes(&set, &config).unwrap().len();
    assert!((100 * 6168..100 * 6168 + 1024).contains(&file), "{file}");
    let (set, _) = sample_set(10, 8);
    assert_eq!(set.memory_bytes(), 10 * (24 + 24 * 64));
    // The index: 16 bytes a probe and at most 4 slots of 16 bytes.
    assert!(set.index(&config).memory_bytes() <= set.len() * 80);
}

/// Goal: every truncation, and single bytes changed anywhere in the header, give an error or a sound set, never a panic.
#[test]
fn damaged_bytes() {
    let (set, config) = sample_set(5, 4);
    let bytes = to_bytes(&set, &config).unwrap();
    for n in 0..bytes.len() {
        assert!(from_bytes(&bytes[..n]).is_err(), "{n} of {} bytes", bytes.len());
    }
    let header = 8 + u64::from_le_bytes(*bytes.first_chunk().unwrap()) as usize;
    let mut refused = 0;
    for at in 0..header {
        for value in [0, b' ', b'9', b'"', 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] = value;
            match from_bytes(&damaged) {
                Ok((set, config)) => {
                    assert!(set.problems().is_empty() && config.check().is_empty(), "byte {at}")
                }
                Err(_) => refused += 1,
            }
        }
    }
    assert!(refused > 3 * header, "{refused} of {header}");
    let mut longer = bytes.clone();
    longer.push(0);
    assert!(from_bytes(&longer).is_err());
}

/// A file with any header.
fn with_header(header: &str, data: usize) -> Vec<u8> {
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.extend(vec![0; data]);
    bytes
}

/// Goal: hostile headers are refused quickly and with bounded memory: sizes beyond the file, overflowing shapes, deep or
/// endless JSON, files of others.
#[test]
fn hostile_headers() {
    let start = std::time::Instant::now();
    let huge = u64::MAX.to_le_bytes();
    assert!(matches!(from_bytes(&huge), Err(ProbeError::Format(text)) if text.contains("header")));
    // 90 MB of zeros would pass the container's own limit.
    let endless = format!(
        "{{\"a\":{{\"dtype\":\"F32\",\"shape\":[{}1],\"data_offsets\":[0,4]}}}}",
        "1,".repeat(1 << 20)
    );
    assert!(
        matches!(from_bytes(&with_header(&endless, 4)), Err(ProbeError::Format(text)) if text.contains("at most"))
    );
    let metadata = "\"__metadata__\":{\"comgs_probes\":\"version=1 spacing=1 far_distance=1 texture=128 count=1 \
                    resolution=2 offset=0 neighbours=1 radius=1 far=1 visibility=none\"}";
    let tensor = |name: &str, shape: &str, end: u64| {
        format!("\"{name}\":{{\"dtype\":\"F32\",\"shape\":[{shape}],\"data_offsets\":[0,{end}]}}")
    };
    for header in [
        String::new(),
        "{}".into(),
        "[".repeat(10_000),
        "{\"a\":".repeat(5000),
        format!("{{{metadata}}}"),
        format!("{{{metadata},{}}}", tensor("positions", "4000000000,4000000000", 4)),
        format!("{{{metadata},{}}}", tensor("positions", "1000000000000,3", 12_000_000_000_000)),
        format!("{{{metadata},{}}}", tensor("positions", "", 4)),
        format!("{{{}}}", tensor("weight", "1", 4)),
    ] {
        assert!(matches!(from_bytes(&with_header(&header, 4)), Err(ProbeError::Format(_))), "{header:.60}");
    }
    // Generous: the point is that it does not depend on the sizes stated.
    assert!(start.elapsed().as_secs() < 5);
}

/// Goal: other versions, missing keys, other shapes, values that are not finite or out of range are named.
#[test]
fn unusable_values_are_named() {
    let (set, config) = sample_set(5, 4);
    let bytes = to_bytes(&set, &config).unwrap();
    // Replaces text of the header by text of the same length.
    let edited = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).expect("the header has it");
        let mut edited = bytes.clone();
        edited[at..at + to.len()].copy_from_slice(to.as_bytes());
        from_bytes(&edited).unwrap_err().to_string()
    };
    assert!(edited("version=1", "version=2").contains("version 2, expected 1"));
    assert!(edited("spacing=", "sparing=").contains("no spacing"));
    assert!(edited("visibility=none", "visibility=some").contains("\"some\""));
    assert!(edited("[5,3]", "[3,5]").contains("normals"));
    assert!(edited("\"moments\"", "\"mements\"").contains("moments"));
    assert!(edited("texture=4", "texture=5").contains("texels"));
    assert!(edited("texture=4", "texture=1").contains("expected 2 to"));
    assert!(edited("neighbours=8", "neighbours=0").contains("neighbours is 0"));

    let refused = |change: &dyn Fn(&mut ProbeSet)| {
        let mut bad = set.clone();
        change(&mut bad);
        let error = to_bytes(&bad, &config).unwrap_err();
        assert!(matches!(error, ProbeError::Set(_)), "{error}");
        error.to_string()
    };
    assert!(refused(&|s| s.positions[2].y = f32::NAN).contains("positions has 1"));
    assert!(refused(&|s| s.normals[2] = Vec3::splat(2.0)).contains("normals has 1"));
    assert!(refused(&|s| s.texels[7][3] = 1.01).contains("texels has 1"));
    assert!(refused(&|s| s.texels[7][0] = -0.1).contains("texels has 1"));
    assert!(refused(&|s| s.moments[7][0] = f32::INFINITY).contains("moments has 1"));
    assert!(refused(&|s| s.moments.truncate(3)).contains("expected 80"));
    assert!(refused(&|s| s.spacing = 0.0).contains("spacing"));
    // The same in the file.
    let mut damaged = bytes.clone();
    let last = damaged.len() - 4;
    damaged[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(matches!(from_bytes(&damaged), Err(ProbeError::Set(_))));

    let mut clamped = set.clone();
    clamped.texels[0] = [-1.0, f32::NAN, f32::INFINITY, 1.5];
    clamped.clamp_to_range();
    assert_eq!(clamped.texels[0], [0.0, 0.0, 0.0, 1.0]);
    assert!(to_bytes(&clamped, &config).is_ok());
}
