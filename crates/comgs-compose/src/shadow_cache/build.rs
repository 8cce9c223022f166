//! Covering receivers with cells.

use super::cells::{Cell, Cells, Key, Lattice, MAX_LEVEL, class_of};
use super::{CacheConfig, CacheStatistics, ReceiverCloud, ShadowCache};
use crate::field_shadow::{ShadowRatios, StrongFrom};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Range of the ratio over a cell's corners, in tolerances, from which on it is cut even where its middle is right: an edge
/// that runs through a corner.
const RANGE: f32 = 10.0;
/// Cells near an object and in the tube of its sharp shadow are at most this many radii large, so that no shadow falls
/// between the corners of a cell.
const NEAR_CELL: f32 = 0.25;
/// What is near, in radii.
const NEAR: f32 = 2.5;

/// A cell that may be cut, with the points in it.
struct Candidate {
    key: Key,
    points: Vec<u32>,
    /// Means over its points.
    middle: Vec3,
    normal: Vec3,
}

impl ShadowCache {
    /// Works out the ratios for what the cameras of `receivers` see. Zero points give an empty cache. Deterministic at any
    /// thread count.
    ///
    /// # Panics
    /// When the configuration is out of range ([`CacheConfig::check`]).
    #[must_use]
    pub fn build(receivers: &ReceiverCloud, exact: &dyn ShadowRatios, config: &CacheConfig) -> Self {
        let problems = config.check();
        assert!(problems.is_empty(), "unusable shadow cache: {}", problems.join("; "));
        let start = std::time::Instant::now();
        let spheres = exact.spheres();
        let Some(&(origin, _)) = spheres.first() else {
            return Self {
                cells: Cells::default(),
                ratios: Vec::new(),
                statistics: CacheStatistics::default(),
            };
        };
        let radius = spheres.iter().map(|s| s.1).fold(f32::INFINITY, f32::min);
        let lattice = Lattice { origin, largest: config.largest * radius };
        let mut builder = Builder {
            receivers,
            exact,
            config,
            strong: exact.strong(),
            spheres,
            cells: Cells::new(lattice),
            ratios: Vec::new(),
            corners: HashMap::new(),
            evaluated: 0,
        };
        let all: Vec<u32> = (0..receivers.len() as u32).collect();
        let mut level = builder.candidates(0, &[all]);
        for depth in 0..=MAX_LEVEL {
            if level.is_empty() {
                break;
            }
            let cut = builder.cover(level);
            level = if depth < MAX_LEVEL { builder.candidates(depth + 1, &cut) } else { Vec::new() };
        }
        let Builder { cells, ratios, evaluated, .. } = builder;
        let statistics = CacheStatistics {
            points: receivers.len(),
            cells: cells.len(),
            evaluated,
            bytes: cells.bytes() + size_of_val(&ratios[..]),
            seconds: start.elapsed().as_secs_f64(),
        };
        Self { cells, ratios, statistics }
    }
}

struct Builder<'a> {
    receivers: &'a ReceiverCloud,
    exact: &'a dyn ShadowRatios,
    config: &'a CacheConfig,
    strong: Vec<StrongFrom>,
    spheres: Vec<(Vec3, f32)>,
    cells: Cells,
    ratios: Vec<Vec3>,
    /// Corners by level, class, place and height.
    corners: HashMap<(u32, u32, [i32; 3]), u32>,
    evaluated: usize,
}

impl Builder<'_> {
    /// The cells of a level that hold the points of the groups, in order of their keys.
    fn candidates(&self, level: u32, groups: &[Vec<u32>]) -> Vec<Candidate> {
        let lattice = self.cells.lattice;
        let split = |points: &Vec<u32>| {
            let mut keyed: Vec<(Key, u32)> = points
                .iter()
                .filter_map(|&i| {
                    let normal = self.receivers.normals[i as usize];
                    let point = self.receivers.points[i as usize];
                    lattice.key(level, class_of(normal), point).map(|key| (key, i))
                })
                .collect();
            keyed.sort_unstable();
            keyed
                .chunk_by(|a, b| a.0 == b.0)
                .map(|chunk| {
                    let points: Vec<u32> = chunk.iter().map(|c| c.1).collect();
                    let mean = |of: &[Vec3]| {
                        points.iter().map(|&i| of[i as usize]).sum::<Vec3>() / points.len() as f32
                    };
                    let (middle, normal) = (mean(&self.receivers.points), mean(&self.receivers.normals));
                    // Normals of one class have a common positive component, so their mean has a length.
                    Candidate { key: chunk[0].0, middle, normal: normal.normalize_or_zero(), points }
                })
                .collect::<Vec<_>>()
        };
        groups.par_iter().map(split).collect::<Vec<_>>().into_iter().flatten().collect()
    }

    /// Makes cells of the candidates that are good enough; returns the points of those that are cut.
    fn cover(&mut self, candidates: Vec<Candidate>) -> Vec<Vec<u32>> {
        let (cuttable, forced): (Vec<bool>, Vec<bool>) =
            candidates.par_iter().map(|c| (self.may_be_cut(c), self.must_be_cut(c))).unzip();
        // Corners of the cells that are not cut at sight.
        let mut points = Vec::new();
        let mut normals = Vec::new();
        let first = self.ratios.len();
        let mut corners = vec![[0u32; 4]; candidates.len()];
        for (i, candidate) in candidates.iter().enumerate() {
            if cuttable[i] && forced[i] {
                continue;
            }
            for k in 0..4 {
                let (place, point) = self.corner(candidate, k);
                let next = (first + points.len()) as u32;
                corners[i][k] = *self.corners.entry(place).or_insert_with(|| {
                    points.push(point);
                    normals.push(candidate.normal);
                    next
                });
            }
        }
        // Trials in the middle of those that may be cut.
        let trials: Vec<usize> = (0..candidates.len()).filter(|&i| cuttable[i] && !forced[i]).collect();
        let corner_count = points.len();
        points.extend(trials.iter().map(|&i| candidates[i].middle));
        normals.extend(trials.iter().map(|&i| candidates[i].normal));
        let mut values = self.exact.ratios(&points, &normals);
        self.evaluated += values.len();
        let tried = values.split_off(corner_count);
        self.ratios.extend(values);
        let mut bad = forced.iter().zip(&cuttable).map(|(f, c)| *f && *c).collect::<Vec<bool>>();
        for (&i, truth) in trials.iter().zip(&tried) {
            let cell = Cell::new(candidates[i].key, &self.cells.lattice, corners[i]);
            let error = (cell.interpolate(candidates[i].middle, &self.ratios) - *truth).abs().max_element();
            let values = corners[i].map(|c| self.ratios[c as usize]);
            let low = values.into_iter().reduce(Vec3::min).unwrap_or_default();
            let high = values.into_iter().reduce(Vec3::max).unwrap_or_default();
            let range = (high - low).max_element();
            bad[i] = error > self.config.tolerance || range > RANGE * self.config.tolerance;
        }
        let mut cut = Vec::new();
        for (i, candidate) in candidates.into_iter().enumerate() {
            if bad[i] {
                self.cells.cut(candidate.key);
                cut.push(candidate.points);
            } else {
                self.cells.insert(candidate.key, corners[i]);
            }
        }
        cut
    }

    /// A corner of a cell: what it is shared by, and the point of the cell's plane over it.
    fn corner(&self, candidate: &Candidate, k: usize) -> ((u32, u32, [i32; 3]), Vec3) {
        let key = candidate.key;
        let lattice = &self.cells.lattice;
        let size = lattice.size(key.level);
        let [a, b] = key.flat_axes();
        let steep = key.steep_axis();
        let mut at = key.at;
        at[a] += (k & 1) as i32;
        at[b] += (k >> 1) as i32;
        let mut point = lattice.origin + Vec3::from_array(at.map(|v| v as f32)) * size;
        let offset = point - candidate.middle;
        let n = candidate.normal;
        let height = -(n[a] * offset[a] + n[b] * offset[b]) / n[steep];
        // The largest component of a unit normal is at least 0.577; a mean of many may be turned, never to nothing.
        let height = if height.is_finite() { height.clamp(-size, size) } else { 0.0 };
        point[steep] = candidate.middle[steep] + height;
        at[steep] = ((point[steep] - lattice.origin[steep]) / (0.5 * size)).round() as i32;
        ((key.level, key.class, at), point)
    }

    fn may_be_cut(&self, candidate: &Candidate) -> bool {
        let finest = candidate
            .points
            .iter()
            .map(|&i| self.receivers.footprints[i as usize])
            .fold(f32::INFINITY, f32::min);
        candidate.key.level < MAX_LEVEL
            && self.cells.lattice.size(candidate.key.level) > self.config.pixels * finest
    }

    fn must_be_cut(&self, candidate: &Candidate) -> bool {
        let size = self.cells.lattice.size(candidate.key.level);
        self.spheres.iter().any(|&(centre, radius)| {
            if size <= NEAR_CELL * radius {
                return false;
            }
            let to_centre = centre - candidate.middle;
            let reach = radius + size;
            let shaded = |from: &StrongFrom| {
                let towards = match from {
                    StrongFrom::Direction(d) => *d,
                    StrongFrom::Position(p) => (*p - candidate.middle).normalize_or_zero(),
                };
                to_centre.dot(towards) > -reach && to_centre.reject_from(towards).length() < reach
            };
            to_centre.length() < NEAR * radius + size || self.strong.iter().any(shaded)
        })
    }
}
