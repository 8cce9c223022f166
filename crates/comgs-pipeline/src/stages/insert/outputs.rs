//! The files of an insertion.

use super::{Config, Found, Scene, shown};
use crate::record::write_json;
use crate::report::{self, Picture, Report, ReportFrame, base64};
use crate::{PipelineError, Run};
use comgs_image::{Image, Layer, write_exr, write_layers, write_png};
use comgs_insert::preview::spacing;
use comgs_insert::render::Layers;
use comgs_insert::tone::{Spline, Tone};
use serde_json::{Value, json};
use std::path::Path;

/// Everything that was made.
pub(super) struct Made<'a> {
    pub scene: &'a Scene,
    pub found: &'a Found,
    pub layers: &'a Layers,
    pub composite: &'a Image,
    pub preview: &'a Image,
}

/// Writes everything; the record says what.
pub(super) fn write(
    folder: &Path,
    title: &str,
    config: &Config,
    made: &Made<'_>,
    run: &mut Run,
) -> Result<(), PipelineError> {
    let Made { scene, found, layers, composite, preview } = *made;
    let path = |name: &str| folder.join(name);
    run.time("write", || {
        write_png(&path("composite.png"), composite)?;
        write_png(&path("preview.png"), preview)?;
        write_exr(&path("env.exr"), found.light.image())?;
        write_png(&path("env.png"), &shown(&found.light))?;
        write_frame_layers(&path("layers.exr"), composite, scene, layers, &found.tone)?;
        write_json(&path("tone.json"), &tone_json(&found.tone))?;
        write_text(&path("tone.svg"), &tone_svg(&found.tone))?;
        comgs_scene::write_cameras(path("camera.json"), std::slice::from_ref(&scene.camera))?;
        write_json(
            &path("plane.json"),
            &json!({
                "normal": [0.0, 0.0, 1.0], "distance": 0.0, "camera_height_m": scene.facts.height,
                "horizon_row": scene.facts.horizon,
            }),
        )?;
        write_json(&path("scene.gltf"), &scene_gltf(scene))?;
        Ok::<_, PipelineError>(())
    })?;
    let losses = &found.losses;
    run.results(json!({
        "scene": scene.facts,
        "first_loss": losses.first(),
        "last_loss": losses.last(),
        "material": found.material,
        "object_pixels": layers.coverage.data.iter().filter(|v| **v > 0.0).count(),
        "darkest_shadow": layers.ratio.data.iter().copied().fold(1.0f32, f32::min),
    }));
    let mut light = vec![Picture {
        caption: "the light, mean brought to middle grey".into(),
        image: shown(&found.light),
    }];
    if let Some(partial) = &found.partial {
        let mut seen = partial.rgb.clone();
        for (pixel, a) in seen.data.chunks_exact_mut(3).zip(&partial.alpha.data) {
            pixel.iter_mut().for_each(|v| *v *= a);
        }
        light.push(Picture { caption: "what the photo shows of it".into(), image: seen });
    }
    light.push(Picture {
        caption: format!("the ground, lines {} m apart", spacing(&scene.object)),
        image: preview.clone(),
    });
    let text = serde_json::to_string_pretty(config).map_err(|e| PipelineError::Internal(e.to_string()))?;
    report::write(
        &path("report.html"),
        &Report {
            title: title.to_owned(),
            summary: scene.facts.summary(),
            frames: vec![ReportFrame {
                name: "photo".into(),
                before: scene.photo.clone(),
                after: composite.clone(),
            }],
            all_frames: 1,
            light,
            evaluation: None,
            timings: run.timings().to_vec(),
            peak_memory_bytes: crate::record::peak_memory_bytes(),
            warnings: run.warnings().to_vec(),
            config: text,
        },
    )?;
    for name in [
        "composite.png",
        "preview.png",
        "env.exr",
        "env.png",
        "layers.exr",
        "tone.json",
        "tone.svg",
        "camera.json",
        "plane.json",
        "scene.gltf",
        "report.html",
    ] {
        run.output(&path(name))?;
    }
    Ok(())
}

fn write_text(path: &Path, text: &str) -> Result<(), PipelineError> {
    comgs_image::atomic::write_file(path, |w| w.write_all(text.as_bytes()))
        .map_err(|e| PipelineError::io(path, e))
}

/// One multilayer EXR, linear. `beauty = object + photo · shadow · (1 − mask)`, where `object` is premultiplied and after
/// tone and `shadow` is to be multiplied, never clamped; `radiance` is the object before tone.
fn write_frame_layers(
    path: &Path,
    composite: &Image,
    scene: &Scene,
    layers: &Layers,
    tone: &Tone,
) -> Result<(), PipelineError> {
    let curves = tone.curves();
    let (w, h) = (composite.width, composite.height);
    let mut object = Image::zeros(w, h, 4);
    let mut shadow = layers.ratio.clone();
    for (i, &v) in layers.coverage.data.iter().enumerate() {
        for c in 0..3 {
            object.data[4 * i + c] =
                v * if v > 0.0 { curves.object(layers.radiance.data[3 * i + c]) } else { 0.0 };
            shadow.data[3 * i + c] = curves.ratio(c, layers.ratio.data[3 * i + c]);
        }
        object.data[4 * i + 3] = v;
    }
    let rgb: &[&str] = &["R", "G", "B"];
    let half = |name, channels, image| Layer { name, channels, image, full_float: false };
    let full = |name, channels, image| Layer { name, channels, image, full_float: true };
    write_layers(
        path,
        &[
            half("", rgb, composite),
            half("photo", rgb, &scene.photo),
            half("object", &["R", "G", "B", "A"], &object),
            half("radiance", rgb, &layers.radiance),
            full("shadow", rgb, &shadow),
            half("mask", &["Y"], &layers.coverage),
            full("depth", &["Z"], &layers.depth),
            half("normal", &["X", "Y", "Z"], &layers.normal),
            half("albedo", rgb, &layers.albedo),
        ],
    )?;
    Ok(())
}

/// Points of a curve that are written.
const CURVE_POINTS: usize = 32;

fn curve_json(curve: &Spline) -> Value {
    let points: Vec<[f32; 2]> =
        (0..=CURVE_POINTS).map(|k| k as f32 / CURVE_POINTS as f32).map(|x| [x, curve.value(x)]).collect();
    json!({"knots_x": curve.x, "knots_y": curve.y, "slopes": curve.slope, "points": points})
}

fn tone_json(tone: &Tone) -> Value {
    let curves = tone.curves();
    json!({
        "response": tone.response,
        "spline": "monotonic rational-quadratic (Gregory & Delbourgo 1982) on [0, 1], after the response",
        "object": curve_json(&curves.foreground),
        "shadow": {
            "r": curve_json(&curves.shadow[0]),
            "g": curve_json(&curves.shadow[1]),
            "b": curve_json(&curves.shadow[2]),
        },
    })
}

/// The four curves over [0, 1]².
fn tone_svg(tone: &Tone) -> String {
    let curves = tone.curves();
    let line = |curve: &Spline, color: &str| {
        let points: Vec<String> = (0..=2 * CURVE_POINTS)
            .map(|k| k as f32 / (2 * CURVE_POINTS) as f32)
            .map(|x| format!("{:.1},{:.1}", 20.0 + 200.0 * x, 220.0 - 200.0 * curve.value(x)))
            .collect();
        format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"/>",
            points.join(" ")
        )
    };
    let [r, g, b] = &curves.shadow;
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 240 240\"><rect width=\"240\" height=\"240\" \
         fill=\"#fff\"/><rect x=\"20\" y=\"20\" width=\"200\" height=\"200\" fill=\"none\" stroke=\"#999\"/>{}{}{}{}\
         </svg>\n",
        line(r, "#c33"),
        line(g, "#393"),
        line(b, "#36c"),
        line(&curves.foreground, "#000")
    )
}

/// Camera and ground as glTF 2.0 (y up): a perspective camera and a square on the plane.
fn scene_gltf(scene: &Scene) -> Value {
    let camera = &scene.camera;
    let (w, h) = (camera.width as f64, camera.height as f64);
    let half = 4.0 * scene.object.radius.max(0.1);
    let c = scene.object.centre;
    let corners = [(-half, -half), (half, -half), (half, half), (-half, half)];
    let mut bytes: Vec<u8> = Vec::new();
    // z up to y up: (x, y, z) → (x, z, −y).
    for (dx, dy) in corners {
        bytes.extend([c.x + dx, 0.0, -(c.y + dy)].iter().flat_map(|v| v.to_le_bytes()));
    }
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
    let y_up = glam::DMat4::from_cols_array(&[
        1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0,
    ]);
    // glTF's cameras look along −z with y up.
    let pose = glam::DAffine3 {
        matrix3: camera.world_from_camera.matrix3
            * glam::DMat3::from_diagonal(glam::DVec3::new(1.0, -1.0, -1.0)),
        translation: camera.centre(),
    };
    let matrix = (y_up * glam::DMat4::from(pose)).to_cols_array();
    json!({
        "asset": {"version": "2.0", "generator": format!("comgs {}", crate::VERSION)},
        "scene": 0,
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [
            {"name": "camera", "camera": 0, "matrix": matrix},
            {"name": "ground", "mesh": 0},
        ],
        "cameras": [{"type": "perspective", "perspective": {
            "aspectRatio": w / h, "yfov": 2.0 * (0.5 * h / camera.fy).atan(), "znear": 0.01,
        }}],
        "meshes": [{"name": "ground", "primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{
            "byteLength": bytes.len(),
            "uri": format!("data:application/octet-stream;base64,{}", base64(&bytes)),
        }],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 12},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": [c.x - half, 0.0, -(c.y + half)], "max": [c.x + half, 0.0, -(c.y - half)]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    })
}
