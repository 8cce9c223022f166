//! Where up is in a photo: its straight edges vote for three directions that are square to each other, one of them up (a
//! "Manhattan" place: Coughlan and Yuille 1999). The focal length is known, so that a direction is a point of the sphere.
//!
//! An edge from p to q is the plane of normal `n = K⁻¹p × K⁻¹q` through the camera; it may be an edge along the direction v when n
//! and v are square to each other. Seen from its middle m, an edge is off v by the angle of sine `|n · v| / |m × v|`.

mod segments;

pub use segments::{Segment, segments};

use comgs_geom::Camera;
use comgs_image::Image;
use glam::{DMat3, DVec3};
use serde::Serialize;

/// What the edges of a photo tell of up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Upright {
    /// Up in camera space (x right, y down, z forward), unit: the normal of a level ground.
    pub normal: [f64; 3],
    /// Edges that were found.
    pub edges: usize,
    /// Edges along up.
    pub vertical: usize,
    /// Edges along the two level directions.
    pub level: usize,
    /// Share of the edges' length along one of the three.
    pub explained: f64,
    /// Standard error of the normal by the edges' scatter, degrees. It says nothing of a wrong choice of directions.
    pub error_deg: f64,
}

impl Upright {
    /// Whether the edges say enough to be believed.
    #[must_use]
    pub fn is_sure(&self) -> bool {
        self.explained >= LEAST_EXPLAINED
            && self.vertical + self.level >= FEWEST_EDGES
            && self.error_deg <= MOST_ERROR_DEG
    }
}

/// Pixels of the longer side while edges are looked for: finer edges are texture.
const LONGER_SIDE: usize = 640;
/// Shortest edge as a share of the longer side.
const SHORTEST: f64 = 0.03;
/// Most edges that vote, the longest.
const MOST_EDGES: usize = 400;
/// How far up may be off the picture's upright: pitch down and up, roll; degrees. Three directions that are square to each other tell
/// not which of them is up: of a camera that looks 25° down, the direction ahead would be up for one that looks 65° up. Photos of a
/// ground look down more than up.
const PITCH_DEG: [i32; 2] = [-70, 35];
const ROLL_DEG: i32 = 30;
/// Step of the first look, degrees.
const STEP_DEG: i32 = 3;
/// An edge's share of belonging falls with the square of its angle off a direction: scale of the first look, and those of the
/// refinements after it, degrees.
const FIRST_DEG: f64 = 2.5;
const REFINED_DEG: [f64; 3] = [2.5, 1.5, 1.0];
/// First looks that are refined.
const CANDIDATES: usize = 24;
/// Cells of the azimuth's histogram over its quarter turn.
const AZIMUTHS: usize = 45;
/// Share of the votes that a camera loses which is rolled, or tilted, as far as may be: between looks that explain as much.
const ROLL_PENALTY: f64 = 0.1;
const PITCH_PENALTY: f64 = 0.05;

/// What [`Upright::is_sure`] asks for. Of 24 photos of a room and a garden whose cameras are known, answers that were wrong by more than
/// 3° explained at most 36 % of their edges' length, and all but one that explained more than 42 % were right to 1.2°.
const LEAST_EXPLAINED: f64 = 0.42;
const FEWEST_EDGES: usize = 12;
const MOST_ERROR_DEG: f64 = 1.0;

/// An edge as it votes.
struct Vote {
    /// Normal of the plane through the camera.
    normal: DVec3,
    /// Direction to its middle.
    middle: DVec3,
    /// Its length in pixels.
    weight: f64,
}

impl Vote {
    /// Sine of the angle by which it is off a direction.
    fn off(&self, direction: DVec3) -> f64 {
        self.normal.dot(direction).abs() / self.middle.cross(direction).length().max(1e-3)
    }
}

/// How much an edge belongs to a direction, from 0 to 1 (Cauchy's weight).
fn belongs(off: f64, scale: f64) -> f64 {
    1.0 / (1.0 + (off / scale).powi(2))
}

/// Up of a photo by its edges. `None` where there are too few to ask at all.
///
/// * `photo`: linear, one or three channels
/// * `intrinsics`: of the photo's size; its pose is ignored
#[must_use]
pub fn upright(photo: &Image, intrinsics: &Camera) -> Option<Upright> {
    let longer = photo.width.max(photo.height);
    let (w, h) = if longer > LONGER_SIDE {
        let scaled = |n: usize| (n * LONGER_SIDE).div_ceil(longer).max(1);
        (scaled(photo.width), scaled(photo.height))
    } else {
        (photo.width, photo.height)
    };
    let camera = intrinsics.resized(w, h);
    let edges = segments(&photo.resized(w, h), SHORTEST * w.max(h) as f64);
    upright_of(&edges, &camera)
}

/// The same of edges that are known.
#[must_use]
pub fn upright_of(edges: &[Segment], camera: &Camera) -> Option<Upright> {
    let ray = |p: glam::DVec2| camera.ray_camera(p.x, p.y);
    let mut votes: Vec<Vote> = edges
        .iter()
        .map(|s| Vote {
            normal: ray(s.from).cross(ray(s.to)).normalize_or_zero(),
            middle: ray(s.middle()).normalize(),
            weight: s.length(),
        })
        .filter(|v| v.normal != DVec3::ZERO)
        .collect();
    votes.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    votes.truncate(MOST_EDGES);
    if votes.len() < FEWEST_EDGES {
        return None;
    }
    let mut looks: Vec<(f64, DMat3)> = Vec::new();
    let steps =
        |low: i32, high: i32| (low..=high).step_by(STEP_DEG as usize).map(|d| f64::from(d).to_radians());
    for pitch in steps(PITCH_DEG[0], PITCH_DEG[1]) {
        for roll in steps(-ROLL_DEG, ROLL_DEG) {
            let up = up_of(pitch, roll);
            let (votes, azimuth) = first_look(&votes, up);
            looks.push((votes * upright_bonus(up), frame(up, azimuth)));
        }
    }
    looks.sort_by(|a, b| b.0.total_cmp(&a.0));
    let best = looks
        .iter()
        .take(CANDIDATES)
        .map(|(_, axes)| REFINED_DEG.iter().fold(*axes, |axes, d| refined(&votes, axes, d.to_radians())))
        .filter(|axes| may_be_up(axes.z_axis))
        .map(|axes| {
            let sum: f64 = votes
                .iter()
                .map(|v| v.weight * belongs(nearest(v, &axes).1, REFINED_DEG[2].to_radians()))
                .sum();
            (sum * upright_bonus(axes.z_axis), axes)
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))?
        .1;
    Some(told(&votes, &best))
}

/// Up for a camera that looks `pitch` above the horizon and is turned about its axis by `roll`.
fn up_of(pitch: f64, roll: f64) -> DVec3 {
    let (s, c) = pitch.sin_cos();
    DMat3::from_rotation_z(roll) * DVec3::new(0.0, -c, s)
}

/// Pitch and roll of the camera whose up it is, each as a share of the most there may be.
fn tilt(up: DVec3) -> [f64; 2] {
    let pitch = up.z.clamp(-1.0, 1.0).asin().to_degrees();
    let most = f64::from(if pitch < 0.0 { PITCH_DEG[0] } else { PITCH_DEG[1] }).abs();
    [pitch.abs() / most, up.x.atan2(-up.y).to_degrees().abs() / f64::from(ROLL_DEG)]
}

/// Whether a direction that was refined is still one that up may have.
fn may_be_up(up: DVec3) -> bool {
    tilt(up).iter().all(|share| *share <= 1.1)
}

/// Prefers less tilt between looks that explain as much.
fn upright_bonus(up: DVec3) -> f64 {
    let [pitch, roll] = tilt(up);
    1.0 - PITCH_PENALTY * pitch * pitch - ROLL_PENALTY * roll * roll
}

/// Axes: two level directions, `azimuth` from where the camera looks, and up.
fn frame(up: DVec3, azimuth: f64) -> DMat3 {
    let ahead = (DVec3::Z - up * up.z).try_normalize().unwrap_or(DVec3::NEG_Y);
    let (s, c) = azimuth.sin_cos();
    let x = ahead * c + up.cross(ahead) * s;
    DMat3::from_cols(x, up.cross(x), up)
}

/// Length that up and the best pair of level directions explain, and that pair's azimuth: what is not along up meets the
/// horizon at a direction of the level plane, whose azimuth within a quarter turn is counted.
fn first_look(votes: &[Vote], up: DVec3) -> (f64, f64) {
    let scale = FIRST_DEG.to_radians();
    let axes = frame(up, 0.0);
    let mut cells = [0.0; AZIMUTHS];
    let mut sum = 0.0;
    let quarter = std::f64::consts::FRAC_PI_2;
    for vote in votes {
        let along_up = belongs(vote.off(up), scale);
        sum += vote.weight * along_up;
        let level = vote.normal.cross(up);
        // The horizon itself has no azimuth: it is an edge along any level direction.
        let sharp = level.length();
        if sharp > 0.05 {
            let azimuth = level.dot(axes.y_axis).atan2(level.dot(axes.x_axis)).rem_euclid(quarter);
            let cell = azimuth / quarter * AZIMUTHS as f64;
            let low = cell.floor();
            for (k, share) in [(low, 1.0 - (cell - low)), (low + 1.0, cell - low)] {
                cells[k as usize % AZIMUTHS] += vote.weight * (1.0 - along_up) * share;
            }
        } else {
            sum += vote.weight * (1.0 - along_up);
        }
    }
    let pair =
        |k: usize| 0.5 * cells[(k + AZIMUTHS - 1) % AZIMUTHS] + cells[k] + 0.5 * cells[(k + 1) % AZIMUTHS];
    let best = (0..AZIMUTHS).max_by(|a, b| pair(*a).total_cmp(&pair(*b))).unwrap_or(0);
    (sum + pair(best), best as f64 / AZIMUTHS as f64 * quarter)
}

/// The axis that an edge is least off, and by how much.
fn nearest(vote: &Vote, axes: &DMat3) -> (usize, f64) {
    let off = [0, 1, 2].map(|k| vote.off(axes.col(k)));
    let k = (0..3).min_by(|a, b| off[*a].total_cmp(&off[*b])).unwrap_or(0);
    (k, off[k])
}

/// Normal equations of a small turn ω of all axes: an edge's sine changes by `ω · (v × n) / |m × v|`.
fn equations(votes: &[Vote], axes: &DMat3, scale: f64) -> (DMat3, DVec3, f64, f64) {
    let (mut square, mut right, mut errors, mut total) = (DMat3::ZERO, DVec3::ZERO, 0.0, 0.0);
    for vote in votes {
        let (k, off) = nearest(vote, axes);
        let v = axes.col(k);
        let reach = vote.middle.cross(v).length().max(1e-3);
        // Twice: the second factor makes Cauchy's weight fall fast enough for clutter.
        let w = vote.weight * belongs(off, scale).powi(2);
        let slope = v.cross(vote.normal) / reach;
        let residual = vote.normal.dot(v) / reach;
        square += DMat3::from_cols(slope * slope.x, slope * slope.y, slope * slope.z) * w;
        right -= slope * (w * residual);
        errors += w * residual * residual;
        total += w;
    }
    (square, right, errors, total)
}

/// Axes turned to where edges that belong to them lie best.
fn refined(votes: &[Vote], mut axes: DMat3, scale: f64) -> DMat3 {
    for _ in 0..12 {
        let (square, right, _, total) = equations(votes, &axes, scale);
        let held = square + DMat3::IDENTITY * (1e-6 * total.max(1e-12));
        let turn = held.inverse() * right;
        let angle = turn.length().min(scale);
        if !(angle > 1e-9) {
            break;
        }
        axes = DMat3::from_axis_angle(turn.normalize(), angle) * axes;
    }
    axes
}

fn told(votes: &[Vote], axes: &DMat3) -> Upright {
    let scale = REFINED_DEG[2].to_radians();
    let (mut counts, mut explained, mut total) = ([0; 3], 0.0, 0.0);
    for vote in votes {
        let (k, off) = nearest(vote, axes);
        total += vote.weight;
        if off < 2.0 * scale {
            counts[k] += 1;
            explained += vote.weight;
        }
    }
    let (square, _, errors, weight) = equations(votes, axes, scale);
    let count = (counts[0] + counts[1] + counts[2]) as f64;
    // Covariance of the turn: mean square residual of an edge times the inverse of the equations of `count` edges.
    let held = square * (count / weight.max(1e-12)) + DMat3::IDENTITY * 1e-9;
    let covariance = held.inverse() * (errors / weight.max(1e-12));
    let up = axes.z_axis;
    // A turn about up itself does not move it.
    let variance = [axes.x_axis, axes.y_axis].map(|a| a.dot(covariance * a)).iter().sum::<f64>();
    Upright {
        normal: up.to_array(),
        edges: votes.len(),
        vertical: counts[2],
        level: counts[0] + counts[1],
        explained: explained / total.max(1e-12),
        error_deg: variance.max(0.0).sqrt().to_degrees(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comgs_geom::Rng;
    use glam::DVec2;

    /// A camera of a pitch and roll, 66° wide, and edges along the axes of a room that it sees, with clutter.
    fn room(pitch: f64, roll: f64, clutter: usize, seed: u64) -> (Camera, Vec<Segment>, DVec3) {
        let mut rng = Rng::new(seed);
        let camera = Camera::look_at("photo", 640, 480, 1.15, DVec3::ZERO, DVec3::X, DVec3::Z);
        let up = up_of(pitch, roll);
        let axes = frame(up, f64::from(rng.range(0.0, 1.5)));
        let mut edges = Vec::new();
        let jitter =
            |p: DVec2, rng: &mut Rng| p + DVec2::new(f64::from(rng.normal()), f64::from(rng.normal())) * 0.5;
        while edges.len() < 60 {
            let p = DVec2::new(f64::from(rng.range(20.0, 620.0)), f64::from(rng.range(20.0, 460.0)));
            let depth = f64::from(rng.range(2.0, 6.0));
            let from = camera.ray_camera(p.x, p.y) * depth;
            let to = from + axes.col(edges.len() % 3) * f64::from(rng.range(0.3, 1.2));
            if to.z > 0.5 {
                let q = DVec2::new(camera.cx + camera.fx * to.x / to.z, camera.cy + camera.fy * to.y / to.z);
                if (0.0..640.0).contains(&q.x) && (0.0..480.0).contains(&q.y) && p.distance(q) > 25.0 {
                    edges.push(Segment { from: jitter(p, &mut rng), to: jitter(q, &mut rng) });
                }
            }
        }
        for _ in 0..clutter {
            let p = DVec2::new(f64::from(rng.range(80.0, 560.0)), f64::from(rng.range(80.0, 400.0)));
            let d = DVec2::from_angle(f64::from(rng.range(0.0, 6.3))) * f64::from(rng.range(20.0, 70.0));
            edges.push(Segment { from: p, to: p + d });
        }
        (camera, edges, up)
    }

    /// Goal: up is found to a degree from noisy edges among half as many wrong ones, for level, tilted and rolled cameras, and the
    /// stated error is of the size of the true one.
    #[test]
    fn up_of_known_rooms() {
        let (mut sum, mut stated, mut worst) = (0.0, 0.0, 0.0f64);
        let mut count = 0.0;
        for (pitch, roll) in [(0.0, 0.0), (-25.0, 4.0), (-50.0, -3.0), (12.0, -10.0), (-8.0, 17.0)] {
            for seed in 0..4 {
                let (camera, edges, up) = room(f64::to_radians(pitch), f64::to_radians(roll), 30, seed);
                let found = upright_of(&edges, &camera).unwrap();
                let error = DVec3::from_array(found.normal).angle_between(up).to_degrees();
                assert!(found.is_sure() && error < 1.0, "{pitch} {roll} {seed}: {error:.2}° {found:?}");
                (sum, stated, worst) =
                    (sum + error * error, stated + found.error_deg.powi(2), worst.max(error));
                count += 1.0;
            }
        }
        let ratio = f64::sqrt(sum / stated);
        let text = format!(
            "worst {worst:.2}°, root mean square {:.2}°, stated × {ratio:.2}",
            f64::sqrt(sum / count)
        );
        assert!((0.3..3.0).contains(&ratio), "{text}");
    }

    /// Goal: edges of no order are not believed, and a handful is not asked.
    #[test]
    fn clutter_has_no_up() {
        for seed in 0..6 {
            let (camera, edges, _) = room(0.0, 0.0, 150, seed);
            let found = upright_of(&edges[60..], &camera).unwrap();
            assert!(!found.is_sure(), "{found:?}");
            assert!(upright_of(&edges[..FEWEST_EDGES - 1], &camera).is_none());
        }
    }
}
