//! From files and arguments to the virtual scene.

use super::{Config, Input, Scene};
use crate::{PipelineError, source};
use comgs_geom::{Camera, Similarity};
use comgs_image::Image;
use comgs_insert::ground::{self, Ground};
use comgs_insert::horizon::{Upright, upright};
use comgs_insert::object::{Object, stand};
use comgs_scene::mesh::{Up, is_mesh};
use comgs_scene::{AssetKind, Mesh, asset::Unit};
use comgs_surfel::SurfelCloud;
use glam::{DQuat, DVec2, DVec3, Vec3};
use serde::Serialize;
use std::path::Path;

/// Where the field of view comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraFrom {
    /// The photo's EXIF; a guess of 60° where it says nothing.
    Photo,
    /// Given, horizontal, in degrees.
    Fov(f64),
    /// The first camera of a file; its pose is not used.
    File,
}

/// Where the ground comes from.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum GroundFrom {
    /// The photo's own edges ([`comgs_insert::horizon`]); a level camera where they do not tell.
    Photo {
        /// Of the camera above it, which no photo tells.
        height: f64,
    },
    /// Given.
    Given(Ground),
}

/// Where the object stands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum At {
    /// In the middle column, between horizon and lower edge.
    Auto,
    /// On the ground: ahead of the camera's foot and to its left, in metres.
    Ground([f64; 2]),
    /// What a pixel position shows.
    Pixel([f64; 2]),
}

/// Field of view of a photo that does not tell its own, in degrees: a phone's main camera.
const GUESSED_FOV_DEG: f64 = 60.0;

/// Where the object stands by default, from the horizon (0) to the lower edge (1).
const AUTO_ROW: f64 = 0.5;

/// Largest extent of an object of unknown unit, as a share of its distance.
const AUTO_SIZE: f64 = 0.25;

/// What was decided about the scene, for records and reports.
#[derive(Clone, Debug, Serialize)]
pub struct Facts {
    /// Horizontal field of view in degrees.
    pub fov_deg: f64,
    /// Camera above the ground, metres.
    pub height: f64,
    /// Row of the horizon in the middle column.
    pub horizon: f64,
    /// What the photo's edges told of up, where they were asked.
    pub upright: Option<Upright>,
    /// Where the object stands on the ground.
    pub at: [f64; 2],
    /// Factor on its size.
    pub scale: f64,
    /// Its extents, metres.
    pub size: [f32; 3],
    /// What was guessed or is not modelled.
    #[serde(skip)]
    pub remarks: Vec<String>,
}

impl Facts {
    /// One line.
    pub fn summary(&self) -> String {
        let [x, y, z] = self.size;
        format!(
            "{x:.2} × {y:.2} × {z:.2} m at ({:.2}, {:.2}), camera {:.2} m up, {:.0}° wide",
            self.at[0], self.at[1], self.height, self.fov_deg
        )
    }
}

/// A photo: linear, three channels, finite.
pub(crate) fn read_photo(path: &Path) -> Result<Image, PipelineError> {
    let loaded = comgs_image::read(path)?;
    let image = match loaded.color.channels {
        1 => loaded.color.select(&[0, 0, 0]),
        _ => loaded.color,
    };
    let broken = image.data.iter().filter(|v| !v.is_finite()).count();
    let negative = image.data.iter().filter(|v| **v < 0.0).count();
    if broken + negative > 0 {
        return Err(PipelineError::input(
            path.display().to_string(),
            "finite values that are not negative",
            format!("{broken} NaN or infinite, {negative} negative of {} values", image.data.len()),
        ));
    }
    Ok(image)
}

/// Size of the picture that is optimised over: at most `width` wide, never larger than the photo.
pub(crate) fn working_size(photo: &Image, width: usize) -> (usize, usize) {
    let w = width.min(photo.width);
    (w, (photo.height * w).div_ceil(photo.width).max(1))
}

/// What is to be placed.
enum Thing {
    Mesh(Mesh),
    Surfels(SurfelCloud),
}

/// Loads everything and places the object.
pub(super) fn scene(input: &Input, config: &Config) -> Result<Scene, PipelineError> {
    let bytes = std::fs::read(&input.image).map_err(|e| PipelineError::io(&input.image, e))?;
    let photo = read_photo(&input.image)?;
    let mut remarks = Vec::new();
    let intrinsics = intrinsics(input, config, &photo, &bytes, &mut remarks)?;
    let (ground, upright) = plane(config.ground, &photo, &intrinsics, &mut remarks)?;
    let camera = ground::above(&intrinsics, &ground).map_err(comgs_insert::InsertError::from)?;
    let horizon = ground::horizon_row(&camera, camera.cx);
    let at = match config.at {
        At::Ground(at) => DVec2::from_array(at),
        At::Pixel([x, y]) => point(&camera, x, y)?,
        At::Auto => {
            let top = horizon.clamp(0.0, camera.height as f64);
            point(&camera, 0.5 * camera.width as f64, top + AUTO_ROW * (camera.height as f64 - top))?
        }
    };
    if !(at.is_finite() && config.yaw_deg.is_finite()) {
        return Err(PipelineError::input(
            "--at, --yaw",
            "finite numbers",
            format!("{at}, {}", config.yaw_deg),
        ));
    }
    let (thing, known_unit) = load(input, config, &mut remarks)?;
    let bounds = match &thing {
        Thing::Mesh(mesh) => mesh.bounds(),
        Thing::Surfels(cloud) => cloud.bounds(),
    };
    let bounds = bounds.ok_or_else(|| {
        PipelineError::input(input.object.display().to_string(), "an object with some extent", "nothing")
    })?;
    let extent = f64::from((bounds.1 - bounds.0).max_element());
    let distance = camera.centre().distance(at.extend(0.0));
    let scale = match config.scale {
        Some(scale) if scale > 0.0 && scale.is_finite() => scale,
        Some(scale) => return Err(PipelineError::input("--scale", "a positive number", scale.to_string())),
        None if known_unit => 1.0,
        None => {
            remarks.push(format!(
                "the object's unit is unknown: it is made {:.0} % of its distance large; --scale says better",
                100.0 * AUTO_SIZE
            ));
            AUTO_SIZE * distance / extent.max(1e-12)
        }
    };
    let transform = stand(bounds, at.to_array(), scale, config.yaw_deg.to_radians());
    let object = match &thing {
        Thing::Mesh(mesh) => Object::mesh(mesh, &transform),
        Thing::Surfels(cloud) => Object::surfels(cloud, &transform),
    };
    let object = object.ok_or_else(|| {
        PipelineError::input(
            input.object.display().to_string(),
            "a mesh, or surfels with material (run `comgs decompose` first)",
            "none",
        )
    })?;
    in_frame(&object, &camera)?;
    let facts = Facts {
        fov_deg: 2.0 * (0.5 * camera.width as f64 / camera.fx).atan().to_degrees(),
        height: camera.centre().z,
        horizon,
        upright,
        at: at.to_array(),
        scale,
        size: (object.bounds.1 - object.bounds.0).to_array(),
        remarks,
    };
    Ok(Scene { photo, camera, object, facts })
}

/// Sides of a rectangle that are this far from square, in degrees, are remarked on.
const SQUARE_DEG: f64 = 5.0;

/// The ground, and what the photo's edges told of it where they were asked.
fn plane(
    from: GroundFrom,
    photo: &Image,
    intrinsics: &Camera,
    remarks: &mut Vec<String>,
) -> Result<(Ground, Option<Upright>), PipelineError> {
    let height = match from {
        GroundFrom::Given(ground) => {
            if let Ground::Rectangle { corners, .. } = ground {
                let found =
                    ground::rectangle(intrinsics, &corners).map_err(comgs_insert::InsertError::from)?;
                if (found.angle_deg - 90.0).abs() > SQUARE_DEG {
                    remarks.push(format!(
                        "the sides of --plane corners meet at {:.0}° instead of 90°: the field of view is wrong (--camera fov=DEG), or \
                         the corners are",
                        found.angle_deg
                    ));
                }
            }
            return Ok((ground, None));
        }
        GroundFrom::Photo { height } => height,
    };
    let found = upright(photo, intrinsics);
    Ok(match found.filter(Upright::is_sure) {
        Some(up) => {
            remarks.push(format!(
                "the ground's direction is from the photo's edges ({} upright, {} level, {:.0} % of their length), its distance \
                 a guess: a camera {height} m above it; preview.png shows it, --plane says better",
                up.vertical,
                up.level,
                100.0 * up.explained
            ));
            (Ground::Plane { normal: up.normal, distance: height }, found)
        }
        None => {
            remarks.push(format!(
                "the ground is a guess: a level camera {height} m above it; the photo's edges do not tell its direction; --plane says \
                 better, preview.png shows it"
            ));
            (Ground::Level { height }, found)
        }
    })
}

fn point(camera: &Camera, x: f64, y: f64) -> Result<DVec2, PipelineError> {
    if !(x >= 0.0 && y >= 0.0 && x <= camera.width as f64 && y <= camera.height as f64) {
        let expected = format!("a position in the photo ({}×{})", camera.width, camera.height);
        return Err(PipelineError::input("--pixel", expected, format!("({x}, {y})")));
    }
    Ok(ground::point_at(camera, x, y).map_err(comgs_insert::InsertError::from)?)
}

fn intrinsics(
    input: &Input,
    config: &Config,
    photo: &Image,
    bytes: &[u8],
    remarks: &mut Vec<String>,
) -> Result<Camera, PipelineError> {
    let (w, h) = (photo.width, photo.height);
    let from_fov = |fov: f64| Camera::look_at("photo", w, h, fov, DVec3::ZERO, DVec3::X, DVec3::Z);
    match config.camera {
        CameraFrom::Fov(degrees) if degrees > 1.0 && degrees < 170.0 => Ok(from_fov(degrees.to_radians())),
        CameraFrom::Fov(degrees) => {
            Err(PipelineError::input("--camera fov", "between 1 and 170 degrees", degrees.to_string()))
        }
        CameraFrom::Photo => Ok(from_fov(comgs_scene::photo::field_of_view(bytes, w, h).unwrap_or_else(|| {
            remarks.push(format!(
                "the photo does not tell its focal length: {GUESSED_FOV_DEG}° are assumed; --camera fov=DEG says better"
            ));
            GUESSED_FOV_DEG.to_radians()
        }))),
        CameraFrom::File => {
            let path = input.camera.as_deref().unwrap_or(Path::new(""));
            let cameras = crate::stages::frames::read_cameras(path)?;
            Ok(cameras[0].resized(w, h))
        }
    }
}

/// The object in its own space, z up, and whether its unit is the metre.
fn load(input: &Input, config: &Config, remarks: &mut Vec<String>) -> Result<(Thing, bool), PipelineError> {
    if is_mesh(&input.object) {
        let up = if config.obj_z_up { Up::Z } else { Up::Y };
        let mesh = comgs_scene::read_mesh(&input.object, up)?;
        remarks.extend(mesh.remarks.iter().cloned());
        // glTF's unit is the metre; an OBJ has none, but is usually meant so.
        return Ok((Thing::Mesh(mesh), true));
    }
    let asset = source::load_surfels(&input.object, AssetKind::Object)?;
    let up = DVec3::from_array(asset.record.up).normalize_or(DVec3::Z);
    let rotation = DQuat::from_rotation_arc(up, DVec3::Z);
    let turn = Similarity { rotation, ..Similarity::IDENTITY };
    let cloud = asset.surfels.transformed(&turn);
    Ok((Thing::Surfels(cloud), asset.record.unit == Unit::Metre))
}

/// Refuses an object of which no corner of its box, nor its middle, is in the frame.
fn in_frame(object: &Object, camera: &Camera) -> Result<(), PipelineError> {
    let (low, high) = object.bounds;
    let inside = (0..9).any(|k| {
        let pick = |bit: usize, a: f32, b: f32| if k >> bit & 1 == 0 { a } else { b };
        let p = if k == 8 {
            object.centre
        } else {
            Vec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
        };
        camera.project(p.as_dvec3()).is_some_and(|(pixel, _)| {
            (0.0..camera.width as f64).contains(&pixel.x) && (0.0..camera.height as f64).contains(&pixel.y)
        })
    });
    // A box that fills the frame has all corners outside; its middle decides, or a ray through the image's middle.
    let middle =
        camera.ray_world(0.5 * camera.width as f64, 0.5 * camera.height as f64).normalize().as_vec3();
    if inside || object.may_meet(camera.centre().as_vec3(), middle, 0.0) {
        Ok(())
    } else {
        Err(comgs_insert::session::out_of_frame(object, camera).into())
    }
}
