//! Gradient noise in space, seeded.

use comgs_geom::Rng;
use glam::Vec3;

/// Perlin's gradient noise over a shuffled table of 256 entries, stored twice so that a sum of two entries needs no
/// wrapping.
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    table: Box<[u8; 512]>,
}

/// The twelve edge directions of a cube, four of them twice (Perlin 2002): a table costs half of what branches do.
const GRADIENTS: [Vec3; 16] = {
    const fn v(x: f32, y: f32, z: f32) -> Vec3 {
        Vec3::new(x, y, z)
    }
    [
        v(1.0, 1.0, 0.0),
        v(-1.0, 1.0, 0.0),
        v(1.0, -1.0, 0.0),
        v(-1.0, -1.0, 0.0),
        v(1.0, 0.0, 1.0),
        v(-1.0, 0.0, 1.0),
        v(1.0, 0.0, -1.0),
        v(-1.0, 0.0, -1.0),
        v(0.0, 1.0, 1.0),
        v(0.0, -1.0, 1.0),
        v(0.0, 1.0, -1.0),
        v(0.0, -1.0, -1.0),
        v(1.0, 1.0, 0.0),
        v(-1.0, 1.0, 0.0),
        v(0.0, -1.0, 1.0),
        v(0.0, -1.0, -1.0),
    ]
};

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        let mut once: Vec<u8> = (0..=255).collect();
        Rng::stream(seed, 0x006e_6f69_7365).shuffle(&mut once);
        let mut table = Box::new([0; 512]);
        table[..256].copy_from_slice(&once);
        table[256..].copy_from_slice(&once);
        Self { table }
    }

    fn entry(&self, at: u8, step: i32) -> u8 {
        self.table[usize::from(at) + (step & 255) as usize]
    }

    /// A number in `[0, 1)` that belongs to a cell of the integer lattice.
    pub(crate) fn cell(&self, [x, y, z]: [i32; 3]) -> f32 {
        let i = self.entry(self.entry(self.entry(0, x), y), z);
        f32::from(u16::from(i) << 8 | u16::from(self.entry(i, 91))) / 65536.0
    }

    /// Smooth noise with mean 0, within about ±1, features of size 1.
    pub(crate) fn smooth(&self, p: Vec3) -> f32 {
        let floor = p.floor();
        let f = p - floor;
        let (x, y, z) = (floor.x as i32, floor.y as i32, floor.z as i32);
        let fade = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
        let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let mut planes = [0.0; 4];
        for (k, plane) in planes.iter_mut().enumerate() {
            let (dx, dy) = (k & 1, k >> 1);
            let column = self.entry(self.entry(0, x.wrapping_add(dx as i32)), y.wrapping_add(dy as i32));
            let d = f - Vec3::new(dx as f32, dy as f32, 0.0);
            let near = GRADIENTS[usize::from(self.entry(column, z) & 15)].dot(d);
            let far = GRADIENTS[usize::from(self.entry(column, z.wrapping_add(1)) & 15)].dot(d - Vec3::Z);
            *plane = mix(near, far, fade.z);
        }
        mix(mix(planes[0], planes[1], fade.x), mix(planes[2], planes[3], fade.x), fade.y)
    }

    /// Several octaves of [`Noise::smooth`], each of half the size and half the strength.
    pub(crate) fn fractal(&self, p: Vec3, octaves: u32) -> f32 {
        let (mut sum, mut amplitude, mut p) = (0.0, 1.0, p);
        for _ in 0..octaves {
            sum += amplitude * self.smooth(p);
            amplitude *= 0.5;
            // The offset keeps the lattices of the octaves apart.
            p = p * 2.0 + Vec3::new(19.1, 7.7, 31.3);
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: noise is zero on the lattice, continuous across cells, centred, and follows its seed.
    #[test]
    fn smooth_and_seeded() {
        let noise = Noise::new(5);
        assert_eq!(noise.smooth(Vec3::new(3.0, -2.0, 7.0)), 0.0);
        let (mut sum, mut largest_step) = (0.0, 0.0f32);
        let mut last = noise.smooth(Vec3::new(-20.0, 0.3, 0.7));
        for i in 0..40_000 {
            let v = noise.smooth(Vec3::new(-20.0 + i as f32 * 1e-3, 0.3, 0.7));
            largest_step = largest_step.max((v - last).abs());
            sum += v;
            last = v;
        }
        assert!(largest_step < 0.01);
        assert!((sum / 40_000.0).abs() < 0.15);
        let p = Vec3::new(0.4, 0.3, 0.2);
        assert_eq!(noise.fractal(p, 3), Noise::new(5).fractal(p, 3));
        assert_ne!(noise.fractal(p, 3), Noise::new(6).fractal(p, 3));
    }
}
