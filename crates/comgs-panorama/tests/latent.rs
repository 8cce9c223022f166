//! Latent models: two tiny bundles of the full shape of Stable Diffusion, judged by `diffusers`
//! (`scripts/panorama/tiny_latent.py` made both), and what must hold whatever the weights.

use comgs_image::Image;
use comgs_panorama::learned::{Latent, Shown};
use comgs_panorama::partial::roll;
use comgs_panorama::{Bundle, Completer, Learned, ModelError, Partial, Runtime};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/latent").join(name)
}

fn bundle(name: &str, edit: impl Fn(&mut serde_json::Value)) -> Result<Bundle, ModelError> {
    let path = folder(name).join("model.json");
    let mut manifest: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    edit(&mut manifest);
    Bundle::from_parts(manifest.to_string().as_bytes(), &path, &|file| std::fs::read(folder(name).join(file)))
}

fn runtimes() -> Vec<Runtime> {
    let native = std::env::var_os("ORT_DYLIB_PATH").map(|p| Runtime::Native(p.into()));
    std::iter::once(Runtime::Embedded).chain(native).collect()
}

/// What `diffusers` computed.
fn expected() -> BTreeMap<String, Vec<f32>> {
    let bytes = std::fs::read(folder("expected.safetensors")).unwrap();
    let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
    let floats =
        |data: &[u8]| data.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    file.tensors().iter().map(|(name, t)| (name.clone(), floats(t.data()))).collect()
}

fn shown(expected: &BTreeMap<String, Vec<f32>>) -> Shown {
    Shown {
        picture: expected["picture"].clone(),
        known: expected["known"].iter().map(|&v| v > 0.5).collect(),
        normal: expected["normal"].clone(),
    }
}

fn close(what: &str, got: impl Iterator<Item = f64>, expected: &[f32]) {
    let (mut n, mut worst) = (0, 0.0f64);
    for (a, &b) in got.zip(expected) {
        worst = worst.max((a - f64::from(b)).abs());
        n += 1;
    }
    assert_eq!(n, expected.len(), "{what}");
    assert!(worst < 1e-3, "{what}: off by {worst}");
}

/// Goal: a model laid out as in the ComGS paper (text, classifier-free guidance, prompts interpolated by exposure, 1 = to
/// paint) gives the latents and the picture that `diffusers` gives, to 1e-3, in every runtime at hand.
#[test]
fn as_diffusers_with_prompts() {
    let expected = expected();
    let noise: Vec<f64> = expected["noise"].iter().map(|&v| f64::from(v)).collect();
    for runtime in runtimes() {
        let model = Latent::load(&bundle("prompt", |_| ()).unwrap(), &runtime, 0).unwrap();
        close("encoder", model.encode(&expected["picture"]).unwrap().into_iter(), &expected["encoded"]);
        for exposure in 0..3 {
            let latent = model.denoise(&shown(&expected), exposure, 4, &noise, None).unwrap();
            let name = format!("prompt_{exposure}");
            close(&name, latent.iter().copied(), &expected[&name]);
            if exposure == 0 {
                let picture = model.decode(&latent).unwrap();
                let n = picture.pixels();
                let planes = (0..3 * n).map(|k| f64::from(picture.data[k % n * 3 + k / n]));
                close("decoder", planes, &expected["prompt_picture"]);
            }
        }
    }
}

/// Goal: the same for the layout that the paper's authors released: 12 channels in another order, 1 = known, a network and an
/// adapter at full size for each exposure.
#[test]
fn as_diffusers_with_a_network_for_each_exposure() {
    let expected = expected();
    let noise: Vec<f64> = expected["noise"].iter().map(|&v| f64::from(v)).collect();
    for runtime in runtimes() {
        let model = Latent::load(&bundle("networks", |_| ()).unwrap(), &runtime, 0).unwrap();
        for exposure in 0..2 {
            let latent = model.denoise(&shown(&expected), exposure, 4, &noise, None).unwrap();
            let name = format!("networks_{exposure}");
            close(&name, latent.iter().copied(), &expected[&name]);
        }
    }
}

/// A room, brighter to one side, whose upper half is unknown.
fn partial() -> Partial {
    let (width, height) = (128, 64);
    let (mut rgb, mut alpha) = (Image::zeros(width, height, 3), Image::zeros(width, height, 1));
    let mut normal = Image::zeros(width, height, 3);
    for y in 0..height {
        for x in 0..width {
            let d = comgs_geom::equirect::texel_direction(x, y, width, height);
            let light = 0.3 + if d.x > 0.8 { 4.0 } else { 0.2 * d.x + 0.1 * d.y };
            rgb.pixel_mut(x, y).copy_from_slice(&[light, 0.9 * light, 0.7 * light]);
            normal.pixel_mut(x, y).copy_from_slice(&(-d).to_array());
            alpha.data[y * width + x] = f32::from(u8::from(d.z < 0.3));
        }
    }
    Partial { normal: Some(normal), ..Partial::new(rgb, alpha).unwrap() }
}

fn largest_difference(a: &Image, b: &Image) -> f32 {
    a.data.iter().zip(&b.data).fold(0.0, |m, (a, b)| m.max((a - b).abs() / (0.1 + b.abs())))
}

/// Goal: also a network that knows no sphere has no preferred yaw here. The input turned by any number of texels gives the same
/// panorama turned; a brighter input a brighter output; the same seed the same bytes; what is known stays.
#[test]
fn what_holds_whatever_the_weights() {
    for name in ["prompt", "networks"] {
        let bundle = bundle(name, |_| ()).unwrap();
        let model = Learned::new(&bundle, &Runtime::Embedded, Some(2), 0).unwrap();
        let partial = partial();
        let straight = model.complete(&partial, 3).unwrap();
        assert_eq!(straight, model.complete(&partial, 3).unwrap());
        assert!(largest_difference(&straight, &model.complete(&partial, 4).unwrap()) > 0.01);
        for (i, &a) in partial.alpha.data.iter().enumerate() {
            let (new, old) = (&straight.data[3 * i..3 * i + 3], &partial.rgb.data[3 * i..3 * i + 3]);
            assert!(if a == 1.0 { new == old } else { new.iter().all(|v| v.is_finite() && *v >= 0.0) });
        }
        for texels in [1, 8, 61, 127] {
            let turned = model.complete(&partial.rolled(texels), 3).unwrap();
            let off = largest_difference(&turned, &roll(&straight, texels));
            assert!(off < 5e-3, "{name} turned by {texels}: off by {off}");
        }
        let brighter = Partial { rgb: partial.rgb.map(|v| 8.0 * v), ..partial.clone() };
        let off = largest_difference(&model.complete(&brighter, 3).unwrap(), &straight.map(|v| 8.0 * v));
        assert!(off < 5e-3, "{name} brighter: off by {off}");
    }
}

/// Goal: where the picture ends there is no seam. The decoder alone pads with zeros there; decoded twice half a turn apart, the columns
/// at the edge are those that the decoder gives when they are in the middle, and no column steps more than in either picture.
#[test]
fn decoding_leaves_no_seam() {
    let model = Latent::load(&bundle("prompt", |_| ()).unwrap(), &Runtime::Embedded, 0).unwrap();
    // A latent that is smooth around the azimuth.
    let latent = |turn: usize| -> Vec<f64> {
        let angle = |i: usize| ((i % 16 + 16 - turn) % 16) as f64 / 16.0 * std::f64::consts::TAU;
        (0..model.latent_len()).map(|i| (i / 128) as f64 * 0.2 + 0.3 * angle(i).sin()).collect()
    };
    let (plain, round) = (model.decode(&latent(0)).unwrap(), model.decode_round(&latent(0)).unwrap());
    let middle = roll(&model.decode(&latent(8)).unwrap(), 64);
    let off = |a: &Image, b: &Image, x: usize| {
        (0..64).map(|y| (a.pixel(x, y)[0] - b.pixel(x, y)[0]).abs()).fold(0.0, f32::max)
    };
    for x in [0, 127] {
        assert!(off(&plain, &middle, x) > 0.05, "the decoder has no seam: {}", off(&plain, &middle, x));
        assert!(off(&round, &middle, x) < 1e-3, "column {x}: {}", off(&round, &middle, x));
    }
    assert!(off(&round, &plain, 63) < 1e-3);
    let step = |image: &Image, x: usize| off(image, &roll(image, 127), x);
    let largest =
        |image: &Image, columns: std::ops::Range<usize>| columns.map(|x| step(image, x)).fold(0.0, f32::max);
    let (inner, outer) = (largest(&plain, 8..120), largest(&middle, 0..128));
    assert!(largest(&round, 0..128) <= 1.05 * inner.max(outer));
}

/// Goal: what a latent manifest gets wrong is listed together, each with its field.
#[test]
fn problems_of_a_latent_manifest() {
    let message = |edit: fn(&mut serde_json::Value)| {
        let loaded = bundle("prompt", edit).and_then(|b| Latent::load(&b, &Runtime::Embedded, 1).map(|_| ()));
        loaded.err().map_or("fine".into(), |e| e.to_string())
    };
    assert_eq!(message(|_| ()), "fine");
    let text = message(|m| {
        let space = &mut m["space"];
        space["normal_axes"] = serde_json::json!([1, 1, 3]);
        space["condition"] = serde_json::json!(["masked_latent", "mask"]);
        space["factor"] = 7.into();
        space["exposures"]["ev"] = serde_json::json!([0.0, -2.0, -1.0]);
        space["prompts"]["unconditional"] = serde_json::Value::Null;
        m["graphs"].as_object_mut().unwrap().remove("encoder");
    });
    for part in [
        "normal_axes",
        "condition: expected \"sample\" once",
        "factor",
        "exposures.ev",
        "guidance_scale",
        "graphs.encoder",
    ] {
        assert!(text.contains(part), "{part} is not in: {text}");
    }
    let text = message(|m| m["space"]["exposures"]["by"]["dark"] = "night".into());
    assert!(text.contains("no embedding \"night\"") && text.contains("bright"), "{text}");
    let text = message(|m| m["space"]["prompts"]["blake3"] = "00".into());
    assert!(text.contains("checksum of prompts.safetensors"), "{text}");
    let other = Latent::load(&Bundle::shipped().unwrap(), &Runtime::Embedded, 1).err().unwrap().to_string();
    assert!(other.contains("expected the kind \"latent\""), "{other}");
    let text = message(|m| m["space"]["condition"] = serde_json::json!(["sample", "mask"]));
    assert!(text.contains("graphs.denoiser.inputs.sample.shape: expected [1, 5, 8, 16]"), "{text}");
}
