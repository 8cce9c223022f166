//! Seeded random streams. Every random number in the workspace comes from here, so that the same seed gives the
//! same bytes at any thread count: a parallel loop derives one stream per item with [`Rng::stream`].

/// A PCG-XSH-RR 64/32 generator (O'Neill 2014).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rng {
    state: u64,
    increment: u64,
}

const MULTIPLIER: u64 = 6_364_136_223_846_793_005;

/// The finaliser of SplitMix64: spreads consecutive seeds over all bits.
fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Rng {
    /// The first stream of a seed.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self::stream(seed, 0)
    }

    /// Stream number `stream` of a seed; streams are independent of one another.
    #[must_use]
    pub fn stream(seed: u64, stream: u64) -> Self {
        let mut rng = Self { state: 0, increment: mix(mix(stream) ^ seed.rotate_left(17)) | 1 };
        rng.next_u32();
        rng.state = rng.state.wrapping_add(mix(seed));
        rng.next_u32();
        rng
    }

    /// State for a checkpoint; [`Rng::from_state`] continues where it left off.
    #[must_use]
    pub fn state(&self) -> [u64; 2] {
        [self.state, self.increment]
    }

    /// A generator that continues from [`Rng::state`].
    #[must_use]
    pub fn from_state(state: [u64; 2]) -> Self {
        Self { state: state[0], increment: state[1] | 1 }
    }

    /// Uniform in `0..=u32::MAX`.
    pub fn next_u32(&mut self) -> u32 {
        let old = self.state;
        self.state = old.wrapping_mul(MULTIPLIER).wrapping_add(self.increment);
        let shifted = (((old >> 18) ^ old) >> 27) as u32;
        shifted.rotate_right((old >> 59) as u32)
    }

    /// Uniform in `[0, 1)`, 24 bits.
    pub fn uniform(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }

    /// Uniform in `[low, high)`.
    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.uniform()
    }

    /// Uniform in `0..n`; 0 when `n` is 0. Bias below 2⁻³² · n.
    pub fn below(&mut self, n: usize) -> usize {
        ((u64::from(self.next_u32()) * n as u64) >> 32) as usize
    }

    /// Standard normal (Box–Muller).
    pub fn normal(&mut self) -> f32 {
        let u = (self.next_u32() as f32 + 1.0) * (1.0 / 4_294_967_808.0);
        let angle = 2.0 * std::f32::consts::PI * self.uniform();
        (-2.0 * u.ln()).max(0.0).sqrt() * angle.cos()
    }

    /// Fisher–Yates shuffle.
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: moments of the uniform and normal streams are right, streams differ, and state resumes.
    #[test]
    fn moments_and_resume() {
        let mut rng = Rng::new(7);
        let n = 200_000;
        let (mut sum, mut square, mut sum_u) = (0.0f64, 0.0f64, 0.0f64);
        for _ in 0..n {
            let x = f64::from(rng.normal());
            sum += x;
            square += x * x;
            sum_u += f64::from(rng.uniform());
        }
        assert!((sum / f64::from(n)).abs() < 0.01);
        assert!((square / f64::from(n) - 1.0).abs() < 0.015);
        assert!((sum_u / f64::from(n) - 0.5).abs() < 0.005);
        assert_ne!(Rng::stream(7, 1).next_u32(), Rng::stream(7, 2).next_u32());
        let mut resumed = Rng::from_state(rng.state());
        assert_eq!(resumed.next_u32(), rng.next_u32());
    }
}
