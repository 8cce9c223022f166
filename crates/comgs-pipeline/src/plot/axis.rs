//! Axes: the range of the data, round ticks, values to pixels.

/// How an axis is divided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scale {
    /// Equal steps are equal lengths.
    Linear,
    /// Equal ratios are equal lengths; values must be greater than zero.
    Log,
}

impl Scale {
    /// Whether the axis has a place for the value.
    #[must_use]
    pub fn shows(self, value: f64) -> bool {
        value.is_finite() && (self == Self::Linear || value > 0.0)
    }

    fn forward(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.ln(),
        }
    }

    fn backward(self, value: f64) -> f64 {
        match self {
            Self::Linear => value,
            Self::Log => value.exp(),
        }
    }
}

/// Round values within a range and how they are written.
#[derive(Debug, Clone, PartialEq)]
pub struct Ticks {
    /// Values, ascending.
    pub values: Vec<f64>,
    /// The same as text, each with as many decimals as the step needs.
    pub labels: Vec<String>,
}

/// At most `most` (at least 2) ticks at 1, 2 or 5 times a power of ten within `[low, high]`.
///
/// - Linear: multiples of the smallest such step that keeps to `most`.
/// - Log: 1, 2, 5 of every decade; where these are too many, every decade, then every second, third, …; where they are
///   fewer than three because the range is short, the linear ticks.
///
/// An empty range, or one that is not finite, has no ticks.
#[must_use]
pub fn ticks(low: f64, high: f64, scale: Scale, most: usize) -> Ticks {
    let most = most.max(2);
    if !(low.is_finite() && high.is_finite() && low < high && scale.shows(low)) {
        return Ticks { values: Vec::new(), labels: Vec::new() };
    }
    if scale == Scale::Log
        && let Some(values) = log_values(low, high, most)
    {
        let labels = values.iter().map(|&v| number(v, decimals_of(v))).collect();
        return Ticks { values, labels };
    }
    linear(low, high, most)
}

/// A range widened by a share of its length is compared to its ends with this slack, so that a tick on an end is kept.
const SLACK: f64 = 1e-9;

fn linear(low: f64, high: f64, most: usize) -> Ticks {
    let mut power = ((high - low) / most as f64).log10().floor() as i32;
    loop {
        for mantissa in [1, 2, 5] {
            // A negative power divides: 3 · 0.1 is not 0.3, but 3 / 10 is.
            let times = |n: f64| {
                let scale = 10f64.powi(power.abs());
                if power < 0 { n * f64::from(mantissa) / scale } else { n * f64::from(mantissa) * scale }
            };
            let step = times(1.0);
            let (first, last) = ((low / step - SLACK).ceil(), (high / step + SLACK).floor());
            if last - first + 1.0 <= most as f64 {
                let values: Vec<f64> =
                    (0..=(last - first).max(-1.0) as i64).map(|k| times(first + k as f64)).collect();
                let decimals = (-power).max(0) as usize;
                let labels = values.iter().map(|&v| number(v, decimals)).collect();
                return Ticks { values, labels };
            }
        }
        power += 1;
    }
}

fn log_values(low: f64, high: f64, most: usize) -> Option<Vec<f64>> {
    let decades = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let inside = |v: &f64| *v >= low * (1.0 - SLACK) && *v <= high * (1.0 + SLACK);
    let fine: Vec<f64> =
        decades.clone().flat_map(|d| [1.0, 2.0, 5.0].map(|m| m * power_of_ten(d))).filter(inside).collect();
    if fine.len() < 3 {
        return None;
    }
    if fine.len() <= most {
        return Some(fine);
    }
    let all: Vec<f64> = decades.map(power_of_ten).filter(inside).collect();
    let stride = all.len().div_ceil(most).max(1);
    Some(all.into_iter().step_by(stride).collect())
}

/// Exactly rounded, which `0.1f64.powi(3)` is not.
fn power_of_ten(exponent: i32) -> f64 {
    if exponent < 0 { 1.0 / 10f64.powi(-exponent) } else { 10f64.powi(exponent) }
}

fn decimals_of(value: f64) -> usize {
    (-(value.abs().log10() + SLACK).floor()).max(0.0) as usize
}

/// A number with thousands separated by commas and a true minus sign.
#[must_use]
pub fn number(value: f64, decimals: usize) -> String {
    let plain = format!("{:.decimals$}", value.abs());
    let (whole, fraction) = plain.split_once('.').map_or((plain.as_str(), None), |(w, f)| (w, Some(f)));
    let mut text = String::new();
    if value < 0.0 && plain.bytes().any(|b| (b'1'..=b'9').contains(&b)) {
        text.push('−');
    }
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && (whole.len() - i) % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    if let Some(fraction) = fraction {
        text.push('.');
        text.push_str(fraction);
    }
    text
}

/// An interval of values laid over an interval of pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Axis {
    pub scale: Scale,
    pub low: f64,
    pub high: f64,
    /// Pixel of `low` and of `high`.
    pub pixels: (f64, f64),
}

impl Axis {
    /// The range of `values` (at least one, all shown by `scale`) with `pad` of its length added at both ends.
    /// A linear axis of positive values reaches down to zero where that at most adds two fifths to it (`from_zero`).
    pub fn around(values: &[f64], scale: Scale, pad: f64, from_zero: bool) -> Self {
        let (mut low, mut high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &v| {
            (l.min(scale.forward(v)), h.max(scale.forward(v)))
        });
        let zero = from_zero && scale == Scale::Linear && low >= 0.0 && low <= 0.3 * high;
        if zero {
            low = 0.0;
        }
        if high - low <= 1e-9 * high.abs().max(low.abs()).max(1e-9) {
            // One value: a fifth of it on both sides, or a factor of 1.6 of a logarithmic axis.
            let half = if scale == Scale::Log { 0.5 } else { (0.2 * high.abs()).max(1e-3) };
            (low, high) = (low - half, high + half);
        }
        let extra = pad * (high - low);
        let low = if zero { low } else { low - extra };
        Self { scale, low: scale.backward(low), high: scale.backward(high + extra), pixels: (0.0, 1.0) }
    }

    pub fn pixel(&self, value: f64) -> f64 {
        let (low, high) = (self.scale.forward(self.low), self.scale.forward(self.high));
        let share = (self.scale.forward(value) - low) / (high - low);
        self.pixels.0 + share * (self.pixels.1 - self.pixels.0)
    }

    pub fn ticks(&self, most: usize) -> Ticks {
        ticks(self.low, self.high, self.scale, most)
    }
}
