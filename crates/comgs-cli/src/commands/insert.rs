//! The insertion into one photo.

use crate::args::{self, CameraArgument, GuidanceArgument, Plane};
use crate::output::say;
use comgs_insert::ground::{Ground, Size};
use comgs_insert::optimise::Curves;
use comgs_insert::render::Samples;
use comgs_insert::session::LightKind;
use comgs_insert::tone::Response;
use comgs_pipeline::Context;
use comgs_pipeline::stages::insert::{self, At, CameraFrom, Filled, GroundFrom, GuidedBy, MaterialChoice};

impl From<args::ResponseArgument> for Response {
    fn from(response: args::ResponseArgument) -> Self {
        match response {
            args::ResponseArgument::Reinhard => Self::Reinhard,
            args::ResponseArgument::Clip => Self::Clip,
        }
    }
}

pub(super) fn run(a: &args::Insert, context: &Context<'_>) -> anyhow::Result<()> {
    let (camera, camera_file) = match &a.camera {
        None => (CameraFrom::Photo, None),
        Some(CameraArgument::Fov(degrees)) => (CameraFrom::Fov(*degrees), None),
        Some(CameraArgument::File(path)) => (CameraFrom::File, Some(path.clone())),
    };
    let ground = match a.plane {
        Plane::Auto(height) => GroundFrom::Photo { height },
        Plane::Level(height) => GroundFrom::Given(Ground::Level { height }),
        Plane::Normal([x, y, z, d]) => GroundFrom::Given(Ground::Plane { normal: [x, y, z], distance: d }),
        Plane::Horizon([row, height]) => GroundFrom::Given(Ground::Horizon { row, height }),
        Plane::Points(points) => GroundFrom::Given(Ground::Points(points)),
        Plane::Corners(corners, side) => {
            let size = side.map_or(Size::Height(insert::HEIGHT), Size::Side);
            GroundFrom::Given(Ground::Rectangle { corners, size })
        }
    };
    let (guidance, reference) = match &a.guidance {
        GuidanceArgument::Panorama => (GuidedBy::Panorama, None),
        GuidanceArgument::Reference(path) => (GuidedBy::Reference, Some(path.clone())),
        GuidanceArgument::Lds => (GuidedBy::Lds, None),
        GuidanceArgument::None => (GuidedBy::None, None),
    };
    let at = match (a.at, a.pixel) {
        (Some(at), _) => At::Ground(at),
        (None, Some(pixel)) => At::Pixel(pixel),
        (None, None) => At::Auto,
    };
    let config = insert::Config {
        camera,
        ground,
        at,
        scale: a.scale,
        yaw_deg: a.yaw,
        obj_z_up: a.obj_up == args::ObjUp::Z,
        guidance,
        prompt: a.prompt.clone(),
        material: a.material.as_ref().map(|m| MaterialChoice { part: m.part.clone(), free: m.free.clone() }),
        fill: match a.completion {
            args::FillArgument::Harmonic => Filled::Harmonic,
            args::FillArgument::Learned => Filled::Learned,
        },
        light: if a.free_texels { LightKind::Texels } else { LightKind::Gaussians(a.lobes) },
        response: a.response.into(),
        iterations: a.iterations,
        curves: if a.fixed_tone { Curves::Fixed } else { Curves::Free },
        width: a.width,
        light_height: a.light_height,
        memory: a.memory << 20,
        samples: Samples { light: a.samples, shadow: a.samples, ..Samples::default() },
        preview_only: a.preview,
        seed: a.seed,
    };
    let input = insert::Input {
        image: a.image.clone(),
        object: a.object.clone(),
        camera: camera_file,
        reference,
        light: a.light.clone(),
        model: a.model.clone(),
        output: a.output.clone(),
    };
    let made = insert::run(&input, &config, context)?;
    say!("{}", made.composite.display());
    Ok(())
}
