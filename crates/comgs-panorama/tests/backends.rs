//! The shipped graph on both runtimes.

use comgs_geom::Rng;
use comgs_panorama::onnx::{Data, Graph, Tensor};
use comgs_panorama::{Bundle, OnnxError, Runtime};

/// The native runtime, where the environment names its library.
fn native() -> Option<Runtime> {
    std::env::var_os("ORT_DYLIB_PATH").filter(|p| !p.is_empty()).map(|p| Runtime::Native(p.into()))
}

fn inputs(seed: u64) -> Vec<(&'static str, Tensor)> {
    let mut rng = Rng::new(seed);
    let mut noise = |n: usize| (0..n).map(|_| rng.normal()).collect::<Vec<f32>>();
    let n = 64 * 128;
    let mut condition = noise(14 * n);
    for v in &mut condition[6 * n..8 * n] {
        *v = f32::from(u8::from(*v > 0.0));
    }
    vec![
        ("noisy", Tensor::f32(&[1, 6, 64, 128], noise(6 * n))),
        ("time", Tensor::f32(&[1], vec![0.6])),
        ("condition", Tensor::f32(&[1, 14, 64, 128], condition)),
    ]
}

fn run(graph: &dyn Graph, seed: u64) -> Vec<f32> {
    graph.run(&inputs(seed), &["clean"]).unwrap()[0].to_f32()
}

/// Goal: the embedded runtime gives the same bytes twice and at any thread count; a wrong name is named.
#[test]
fn embedded_runs_the_shipped_graph() {
    let bundle = Bundle::shipped().unwrap();
    let graph = bundle.load("denoiser", &Runtime::Embedded, 1).unwrap();
    let a = run(&*graph, 1);
    assert!(a.iter().all(|v| v.is_finite()) && a.iter().any(|v| *v != a[0]));
    assert_eq!(a, run(&*graph, 1));
    assert_eq!(a, run(&*bundle.load("denoiser", &Runtime::Embedded, 2).unwrap(), 1));
    let error = graph.run(&[], &["nothing"]).unwrap_err();
    assert!(matches!(&error, OnnxError::Name { name, .. } if name == "nothing"), "{error}");
    assert!(error.to_string().contains("clean"), "{error}");
    let short = graph.run(&[("time", Tensor::f32(&[2], vec![0.0; 2]))], &["clean"]).unwrap_err();
    assert!(matches!(short, OnnxError::Run { .. }), "{short}");
}

/// Goal: ONNX Runtime agrees to 1e-4 of the outputs' size. Runs where `ORT_DYLIB_PATH` names its library; elsewhere it
/// says that it was skipped.
#[test]
fn native_agrees() {
    let Some(runtime) = native() else {
        eprintln!("skipped: ORT_DYLIB_PATH names no library of ONNX Runtime");
        return;
    };
    let bundle = Bundle::shipped().unwrap();
    let embedded = bundle.load("denoiser", &Runtime::Embedded, 0).unwrap();
    let native = bundle.load("denoiser", &runtime, 0).unwrap();
    assert_eq!(embedded.inputs().len(), native.inputs().len());
    for seed in 0..3 {
        let (a, b) = (run(&*embedded, seed), run(&*native, seed));
        let size = a.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        let off = a.iter().zip(&b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(off < 1e-4 * size, "off by {off} of {size}");
    }
}

/// Goal: a library that is none, and bytes that are no graph, are clear errors and no panic.
#[test]
fn what_cannot_be_loaded_is_said() {
    let bundle = Bundle::shipped().unwrap();
    let missing = Runtime::Native("no/such/libonnxruntime.so".into());
    if native().is_none() {
        let error = bundle.load("denoiser", &missing, 0).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("ONNX Runtime cannot be loaded") && error.contains("no/such"), "{error}");
    }
    for bytes in [&b""[..], b"no graph at all", &[0x08, 0x07, 0x12]] {
        let error = Runtime::Embedded.load(bytes, "x.onnx", 1).map(|g| g.outputs().len());
        assert!(!matches!(error, Ok(n) if n > 0), "accepted {bytes:?}");
    }
    assert!(matches!(Tensor::i64(&[1], vec![3]).data, Data::I64(_)));
}
