//! Two maps on their way to one (DiPIR Eq. 10–14, 17–18): each of object and shadow has a map of its own at first, because
//! their wishes conflict early on.

use crate::light::LightMap;

/// Luminance of linear Rec.709.
const LUMINANCE: [f32; 3] = [0.2126, 0.7152, 0.0722];

/// Luminance below which a texel is black.
const BLACK: f32 = 1e-8;

/// Both maps and what they are fused to.
#[derive(Clone, Debug)]
pub struct Fusion {
    /// L_fused.
    pub map: LightMap,
    /// `L_fused / L_fg`, by texel.
    factor: Vec<f32>,
    foreground: Vec<f32>,
    shadow: Vec<f32>,
    brightest: usize,
}

/// The fused map (Eq. 12–14): the foreground's colours with a luminance that leans to the shadow's where it is bright.
///
/// With a and b the luminances of foreground and shadow and M the largest a, the equations reduce to
///
/// ```text
/// L_fused = L_fg · (1 + b (b − a) / (M (a + b)))
/// ```
///
/// Gradient: [`Fusion::vjp`]. Kinks where another texel becomes the brightest.
#[must_use]
pub fn fuse(foreground: &LightMap, shadow: &LightMap) -> Fusion {
    let (a, b) = (foreground.luminance(), shadow.luminance());
    let brightest = (0..a.len()).max_by(|&i, &j| a[i].total_cmp(&a[j])).unwrap_or(0);
    let most = a[brightest].max(BLACK);
    let factor: Vec<f32> = a
        .iter()
        .zip(&b)
        .map(|(&a, &b)| if a + b > BLACK { 1.0 + b * (b - a) / (most * (a + b)) } else { 1.0 })
        .collect();
    let mut map = foreground.clone();
    let n = map.texels();
    for (i, v) in map.data.iter_mut().enumerate() {
        *v *= factor[i % n];
    }
    Fusion { map, factor, foreground: a, shadow: b, brightest }
}

impl Fusion {
    /// Gradients with respect to both maps for `grad` with respect to the fused one, added to `by_foreground` and
    /// `by_shadow`. `foreground` is the map that was fused.
    pub fn vjp(
        &self,
        foreground: &LightMap,
        grad: &LightMap,
        by_foreground: &mut LightMap,
        by_shadow: &mut LightMap,
    ) {
        let n = grad.texels();
        let most = self.foreground[self.brightest].max(BLACK);
        let mut by_most = 0.0f32;
        for i in 0..n {
            let mut by_factor = 0.0;
            for c in 0..3 {
                let g = grad.data[c * n + i];
                by_foreground.data[c * n + i] += g * self.factor[i];
                by_factor += g * foreground.data[c * n + i];
            }
            let (a, b) = (self.foreground[i], self.shadow[i]);
            if a + b <= BLACK {
                continue;
            }
            let over = most * (a + b);
            let common = b * (b - a) / (over * (a + b));
            let by_a = by_factor * (-b / over - common);
            let by_b = by_factor * ((2.0 * b - a) / over - common);
            by_most -= by_factor * b * (b - a) / (over * most);
            for c in 0..3 {
                by_foreground.data[c * n + i] += by_a * LUMINANCE[c];
                by_shadow.data[c * n + i] += by_b * LUMINANCE[c];
            }
        }
        if self.foreground[self.brightest] > BLACK {
            for c in 0..3 {
                by_foreground.data[c * n + self.brightest] += by_most * LUMINANCE[c];
            }
        }
    }
}

/// `s · fused + (1 − s) · own` (Eq. 17–18).
#[must_use]
pub fn blend(own: &LightMap, fused: &LightMap, s: f32) -> LightMap {
    let data = own.data.iter().zip(&fused.data).map(|(o, f)| s * f + (1.0 - s) * o).collect();
    LightMap { height: own.height, data }
}

/// The consistency of the two maps (Eq. 10): the cross entropy of their luminances, each normalised to integrate to 1, with
/// the shadow's taken as given. Adds `weight` times its gradient to `by_foreground`; returns `weight` times the loss.
pub fn consistency(
    foreground: &LightMap,
    shadow: &LightMap,
    weight: f32,
    by_foreground: &mut LightMap,
) -> f32 {
    let (a, b) = (foreground.luminance(), shadow.luminance());
    let omega = foreground.solid_angles();
    let total = |l: &[f32]| -> f64 {
        l.iter().zip(&omega).map(|(l, w)| f64::from(l.max(BLACK)) * f64::from(*w)).sum()
    };
    let (all_a, all_b) = (total(&a), total(&b));
    let n = a.len();
    let mut loss = 0.0f64;
    for i in 0..n {
        let (w, p) = (f64::from(omega[i]), f64::from(b[i].max(BLACK)) / all_b);
        let l = f64::from(a[i].max(BLACK));
        loss -= p * (l / all_a).ln() * w;
        if a[i] > BLACK {
            let g = weight * (w * (1.0 / all_a - p / l)) as f32;
            for c in 0..3 {
                by_foreground.data[c * n + i] += g * LUMINANCE[c];
            }
        }
    }
    weight * loss as f32
}

/// The concentration of the shadow's map (Eq. 11), `Σ log(1 + 2 L²) ΔΩ`. Adds `weight` times its gradient to `by_shadow`;
/// returns `weight` times the loss.
pub fn concentration(shadow: &LightMap, weight: f32, by_shadow: &mut LightMap) -> f32 {
    let omega = shadow.solid_angles();
    let n = omega.len();
    let mut loss = 0.0f64;
    for (i, (l, g)) in shadow.data.iter().zip(&mut by_shadow.data).enumerate() {
        let w = omega[i % n];
        loss += f64::from(w) * (2.0 * f64::from(*l) * f64::from(*l)).ln_1p();
        *g += weight * w * 4.0 * l / (1.0 + 2.0 * l * l);
    }
    weight * loss as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference;
    use comgs_geom::Rng;
    use glam::Vec3;

    const HEIGHT: usize = 4;

    fn random(rng: &mut Rng) -> LightMap {
        let mut map = LightMap::zeros(HEIGHT);
        map.data.iter_mut().for_each(|v| *v = rng.range(0.1, 2.0));
        map
    }

    fn both(a: &LightMap, b: &LightMap) -> Vec<f64> {
        a.data.iter().chain(&b.data).map(|&v| f64::from(v)).collect()
    }

    /// Goal: the fused map is Eq. 12–14 as printed, and its gradient that of differences in both maps, the brightest texel's
    /// part included.
    #[test]
    fn fused_as_printed() {
        let mut rng = Rng::new(21);
        let (a, b) = (random(&mut rng), random(&mut rng));
        let fusion = fuse(&a, &b);
        let n = 3 * a.texels();
        let x = both(&a, &b);
        let truth = reference::fuse(&x[..n], &x[n..]);
        for (ours, truth) in fusion.map.data.iter().zip(&truth) {
            assert!((f64::from(*ours) - truth).abs() < 1e-5);
        }
        let grad = random(&mut rng);
        let (mut by_a, mut by_b) = (LightMap::zeros(HEIGHT), LightMap::zeros(HEIGHT));
        fusion.vjp(&a, &grad, &mut by_a, &mut by_b);
        let gradient: Vec<f32> = by_a.data.into_iter().chain(by_b.data).collect();
        let loss = |x: &[f64]| {
            reference::fuse(&x[..n], &x[n..]).iter().zip(&grad.data).map(|(l, g)| l * f64::from(*g)).sum()
        };
        reference::assert_gradient(&x, &gradient, loss, 1e-3);
    }

    /// Goal: equal maps fuse to themselves, a black one leaves the other, and two black ones are black.
    #[test]
    fn ends_of_the_fusion() {
        let map = random(&mut Rng::new(22));
        let black = LightMap::zeros(HEIGHT);
        for (ours, own) in fuse(&map, &map).map.data.iter().zip(&map.data) {
            assert!((ours - own).abs() < 1e-6);
        }
        assert_eq!(fuse(&map, &black).map, map);
        assert_eq!(fuse(&black, &black).map, black);
        assert!(fuse(&black, &map).map.data.iter().all(|v| v.is_finite()));
        assert_eq!(blend(&map, &black, 0.0), map);
        assert_eq!(blend(&map, &black, 1.0), black);
    }

    /// Goal: both regularisers have the gradients of differences; consistency is least where the maps agree up to scale.
    #[test]
    fn regularisers() {
        let mut rng = Rng::new(23);
        let (a, b) = (random(&mut rng), random(&mut rng));
        let omega: Vec<f64> = a.solid_angles().iter().map(|&w| f64::from(w)).collect();
        let mut grad = LightMap::zeros(HEIGHT);
        let value = consistency(&a, &b, 0.3, &mut grad);
        let n = 3 * a.texels();
        let x = both(&a, &b);
        let loss = |fg: &[f64]| 0.3 * reference::consistency(fg, &x[n..], &omega);
        assert!((f64::from(value) - loss(&x[..n])).abs() < 1e-5);
        reference::assert_gradient(&x[..n], &grad.data, loss, 1e-3);

        let mut scaled = b.clone();
        scaled.data.iter_mut().for_each(|v| *v *= 7.0);
        let mut flat = LightMap::zeros(HEIGHT);
        let least = consistency(&scaled, &b, 0.3, &mut flat);
        assert!(least < value && flat.data.iter().all(|g| g.abs() < 1e-6));

        let mut grad = LightMap::zeros(HEIGHT);
        concentration(&b, 0.2, &mut grad);
        let loss = |l: &[f64]| -> f64 {
            0.2 * l
                .iter()
                .enumerate()
                .map(|(i, l)| (1.0 + 2.0 * l * l).ln() * omega[i % omega.len()])
                .sum::<f64>()
        };
        reference::assert_gradient(&x[n..], &grad.data, loss, 1e-3);
        assert_eq!(concentration(&LightMap::constant(HEIGHT, Vec3::ZERO), 1.0, &mut grad), 0.0);
    }
}
