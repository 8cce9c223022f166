//! Arguments of the insertion into one photo.

use crate::values::{number, positive};
use clap::{Args, ValueEnum};
use comgs_insert::material::Property;
use std::path::PathBuf;

/// Insert an object into one photo
///
/// Finds the light that the photo tells of, lights the object with it, casts its shadow on the ground, and composes both.
/// The object is a mesh (glTF, GLB, OBJ) or a decomposed asset. Look at preview.png first (--preview): the grid lies on the
/// ground when camera and plane are right.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs insert --image photo.jpg --object car.glb --preview -o out
  comgs insert --image photo.jpg --object car.glb --camera fov=50 --plane horizon=210,1.6 --pixel 300,400 -o out
  comgs insert --image photo.jpg --object car.glb --plane 'corners=120,400;310,395;420,460;60,470;1.2' -o out
  comgs insert --image photo.jpg --object kettle.asset --scale 0.3 --guidance reference=painted.png -o out
  comgs insert --image photo.jpg --object car.glb --guidance reference=painted.png --material paint:albedo,roughness -o out
  comgs insert --image photo.jpg --object car.glb --guidance lds --model bundle -o out
  comgs insert --image photo.jpg --object chair.obj --guidance none --light env.exr -o out")]
pub(crate) struct Insert {
    /// The photo
    #[arg(long, value_name = "FILE")]
    pub image: PathBuf,

    /// Mesh (.glb, .gltf, .obj) or decomposed asset
    #[arg(long, value_name = "FILE")]
    pub object: PathBuf,

    /// Camera: `fov=DEG` (horizontal) or a camera file; the photo's EXIF when absent
    #[arg(long, value_name = "fov=DEG|FILE", value_parser = camera)]
    pub camera: Option<CameraArgument>,

    /// Ground: `auto[=HEIGHT]` (up by the photo's edges, a level camera where they do not tell; 1.6 m above), `level=HEIGHT`,
    /// `horizon=ROW,HEIGHT`, `corners=X,Y;X,Y;X,Y;X,Y[;SIDE]` (a rectangle of the ground in order around it, with the length of its
    /// first side), `points=X,Y,DEPTH;X,Y,DEPTH;X,Y,DEPTH`, or `nx,ny,nz,d` (camera space, y down)
    #[arg(long, value_name = "PLANE", default_value = "auto", value_parser = plane, allow_hyphen_values = true)]
    pub plane: Plane,

    /// Where it stands on the ground: metres ahead of the camera's foot, and to the left
    #[arg(long, value_name = "X,Y", value_parser = pair, allow_hyphen_values = true, conflicts_with = "pixel")]
    pub at: Option<[f64; 2]>,

    /// Where it stands: a pixel of the photo (x right, y down)
    #[arg(long, value_name = "X,Y", value_parser = pair)]
    pub pixel: Option<[f64; 2]>,

    /// Factor on the object's size; 1 when absent and its unit is the metre
    #[arg(long, value_name = "S", value_parser = positive, allow_hyphen_values = true)]
    pub scale: Option<f64>,

    /// Turn about up, counter-clockwise seen from above
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_hyphen_values = true, value_parser = number)]
    pub yaw: f64,

    /// Which axis of an OBJ points up
    #[arg(long, value_enum, default_value = "y")]
    pub obj_up: ObjUp,

    /// What says how it should look: `panorama` (the photo, completed), `reference=IMAGE` (a composite to match),
    /// `lds` (the denoisers of --model), `none`
    #[arg(long, value_name = "GUIDANCE", default_value = "panorama", value_parser = guidance)]
    pub guidance: GuidanceArgument,

    /// Light for `--guidance none`; even light of the photo's mean when absent. Beside `reference` or `lds` it is kept, and
    /// only tone and material are optimised
    #[arg(long, value_name = "FILE")]
    pub light: Option<PathBuf>,

    /// Guidance bundle for `--guidance lds`: a folder with model.json (scripts/insert makes them)
    #[arg(long, value_name = "DIR")]
    pub model: Option<PathBuf>,

    /// What the personalised model is told: one of the prompts that its bundle was exported with
    #[arg(long, value_name = "TEXT", requires = "model")]
    pub prompt: Option<String>,

    /// Optimise the material too, with `reference` or `lds`: albedo, roughness, metallic, emission, with commas, of a part of
    /// the mesh by its material's name (not needed when there is one)
    #[arg(long, value_name = "[PART:]PROPERTIES", value_parser = material)]
    pub material: Option<MaterialArgument>,

    /// What fills the sphere around the photo for `--guidance panorama`
    #[arg(long, value_enum, default_value = "harmonic")]
    pub completion: FillArgument,

    /// Spherical Gaussians that the light is made of
    #[arg(long, default_value_t = comgs_pipeline::stages::insert::LOBES, conflicts_with = "free_texels")]
    pub lobes: usize,

    /// Light of free texels with a smoothness prior instead of Gaussians
    #[arg(long)]
    pub free_texels: bool,

    /// Camera's response to the object's radiance, before the learnt correction
    #[arg(long, value_enum, default_value = "reinhard")]
    pub response: ResponseArgument,

    /// Keep the tone curves as they are
    #[arg(long)]
    pub fixed_tone: bool,

    /// Iterations of the optimisation
    #[arg(long, default_value_t = 600)]
    pub iterations: usize,

    /// Width of the picture that is optimised over; the result has the photo's size
    #[arg(long, value_name = "PIXELS", default_value_t = 384)]
    pub width: usize,

    /// Rows of the map of light; it is twice as wide
    #[arg(long, value_name = "ROWS", default_value_t = 32)]
    pub light_height: usize,

    /// Memory for the matrix of transport in MiB; the map is made coarser where it would take more
    #[arg(long, value_name = "MIB", default_value_t = 2048)]
    pub memory: usize,

    /// Samples a pixel of the final picture
    #[arg(long, default_value_t = 128)]
    pub samples: usize,

    /// Only draw the ground as a grid, with the object on it
    #[arg(long)]
    pub preview: bool,

    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,

    /// Output folder
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
}

/// Where the camera comes from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum CameraArgument {
    Fov(f64),
    File(PathBuf),
}

fn camera(text: &str) -> Result<CameraArgument, String> {
    match text.strip_prefix("fov=") {
        Some(degrees) => Ok(CameraArgument::Fov(positive(degrees)?)),
        None => Ok(CameraArgument::File(text.into())),
    }
}

/// The ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Plane {
    /// By the photo, at a height.
    Auto(f64),
    Level(f64),
    Normal([f64; 4]),
    Horizon([f64; 2]),
    Points([[f64; 3]; 3]),
    /// With the length of the first side.
    Corners([[f64; 2]; 4], Option<f64>),
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let found: Vec<f64> = text.split(',').map(number).collect::<Result<_, _>>()?;
    <[f64; N]>::try_from(found).map_err(|n| format!("expected {N} numbers with commas, got {}", n.len()))
}

fn pair(text: &str) -> Result<[f64; 2], String> {
    numbers(text)
}

fn plane(text: &str) -> Result<Plane, String> {
    if text == "auto" {
        return Ok(Plane::Auto(comgs_pipeline::stages::insert::HEIGHT));
    }
    if let Some(rest) = text.strip_prefix("auto=") {
        return Ok(Plane::Auto(positive(rest)?));
    }
    if let Some(rest) = text.strip_prefix("level=") {
        return Ok(Plane::Level(positive(rest)?));
    }
    if let Some(rest) = text.strip_prefix("corners=") {
        let parts: Vec<&str> = rest.split(';').collect();
        let (corners, side) = match parts.as_slice() {
            [corners @ .., side] if corners.len() == 4 => (corners, Some(positive(side)?)),
            corners if corners.len() == 4 => (corners, None),
            other => {
                return Err(format!(
                    "expected four corners with semicolons, perhaps the first side's length after them, got {} parts",
                    other.len()
                ));
            }
        };
        let mut out = [[0.0; 2]; 4];
        for (to, corner) in out.iter_mut().zip(corners) {
            *to = numbers(corner)?;
        }
        return Ok(Plane::Corners(out, side));
    }
    if let Some(rest) = text.strip_prefix("horizon=") {
        return Ok(Plane::Horizon(numbers(rest)?));
    }
    if let Some(rest) = text.strip_prefix("points=") {
        let points: Vec<[f64; 3]> = rest.split(';').map(numbers).collect::<Result<_, _>>()?;
        let three = <[[f64; 3]; 3]>::try_from(points);
        return three
            .map(Plane::Points)
            .map_err(|p| format!("expected three points with semicolons, got {}", p.len()));
    }
    numbers(text).map(Plane::Normal)
}

/// What guides.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum GuidanceArgument {
    Panorama,
    Reference(PathBuf),
    Lds,
    None,
}

/// A part, if it was named, and what of its material is optimised.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct MaterialArgument {
    pub part: Option<String>,
    pub free: Vec<Property>,
}

fn material(text: &str) -> Result<MaterialArgument, String> {
    let (part, list) = match text.rsplit_once(':') {
        Some((part, list)) => (Some(part.to_owned()), list),
        None => (None, text),
    };
    let property = |name: &str| match name {
        "albedo" => Ok(Property::Albedo),
        "roughness" => Ok(Property::Roughness),
        "metallic" => Ok(Property::Metallic),
        "emission" => Ok(Property::Emission),
        other => Err(format!("expected albedo, roughness, metallic or emission, got {other:?}")),
    };
    let mut free: Vec<Property> = list.split(',').map(property).collect::<Result<_, _>>()?;
    free.sort();
    free.dedup();
    Ok(MaterialArgument { part, free })
}

/// A completer.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum FillArgument {
    /// The smoothest light that agrees with the photo
    Harmonic,
    /// The model that ships with comgs
    Learned,
}

fn guidance(text: &str) -> Result<GuidanceArgument, String> {
    match text {
        "panorama" => Ok(GuidanceArgument::Panorama),
        "lds" => Ok(GuidanceArgument::Lds),
        "none" => Ok(GuidanceArgument::None),
        _ => match text.strip_prefix("reference=") {
            Some(path) if !path.is_empty() => Ok(GuidanceArgument::Reference(path.into())),
            _ => Err("expected panorama, reference=IMAGE, lds or none".into()),
        },
    }
}

/// An axis of an OBJ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum ObjUp {
    /// As most programs write it
    Y,
    /// As CAD programs write it
    Z,
}

/// A camera's response.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub(crate) enum ResponseArgument {
    /// x / (1 + x)
    Reinhard,
    /// Linear, cut off at white
    Clip,
}

/// Measure how well light is found from one photo
///
/// Cuts a photo out of each environment map, puts an object on a known ground, and compares insertions under the light that
/// each method finds with the insertion under the map itself (the benchmark of DiPIR's Table 2). Every result is kept as it is
/// made: a run that was stopped goes on with the same command, and one with --model adds the row of score distillation. Maps that
/// the shipped completer never saw are marked and have a table of their own.
#[derive(Debug, Args)]
#[command(after_help = "\
Examples:
  comgs insert-eval hdri -o out/insert_eval
  comgs insert-eval hdri --model bundle -o out/insert_eval
  comgs insert-eval hdri/sky.exr -o out/sky")]
pub(crate) struct InsertEval {
    /// Folder of environment maps (.exr, .hdr), or one map
    pub maps: PathBuf,

    /// Maps taken, evenly spread over the folder
    #[arg(long, default_value_t = 11)]
    pub count: usize,

    /// Further maps at most, of those that the shipped completer never saw
    #[arg(long, default_value_t = 11)]
    pub unseen: usize,

    /// Guidance bundle, for a row of score distillation
    #[arg(long, value_name = "DIR")]
    pub model: Option<PathBuf>,

    /// Iterations of a fit
    #[arg(long, default_value_t = 600)]
    pub iterations: usize,

    /// Seed
    #[arg(long, default_value_t = 0)]
    pub seed: u64,

    /// Output folder
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: every way to give the ground is read, and what is none is refused by what is expected.
    #[test]
    fn planes_are_read() {
        let corners = [[1.0, 2.0], [3.0, 4.0], [5.0, 6.0], [7.0, 8.0]];
        let read = [
            ("auto", Plane::Auto(comgs_pipeline::stages::insert::HEIGHT)),
            ("auto=1.2", Plane::Auto(1.2)),
            ("level=2", Plane::Level(2.0)),
            ("horizon=210,1.6", Plane::Horizon([210.0, 1.6])),
            ("corners=1,2;3,4;5,6;7,8", Plane::Corners(corners, None)),
            ("corners=1,2;3,4;5,6;7,8;0.3", Plane::Corners(corners, Some(0.3))),
            ("0,-1,0,1.5", Plane::Normal([0.0, -1.0, 0.0, 1.5])),
        ];
        for (text, expected) in read {
            assert_eq!(plane(text), Ok(expected), "{text}");
        }
        for (text, word) in [
            ("corners=1,2;3,4;5,6", "four corners"),
            ("corners=1,2;3,4;5,6;7", "2 numbers"),
            ("corners=1,2;3,4;5,6;7,8;0", "0"),
            ("level=-1", "-1"),
            ("points=1,2,3;4,5,6", "three points"),
            ("flat", "flat"),
        ] {
            let error = plane(text).unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }
}
