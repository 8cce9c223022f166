//! The checks that every metric begins with.

use crate::MetricError;
use comgs_image::Image;

/// Whether pixel `i` counts under a mask.
pub(crate) fn counts(mask: Option<&Image>, i: usize) -> bool {
    mask.is_none_or(|m| m.data[i] >= 0.5)
}

pub(crate) fn same_size(what: &'static str, image: &Image, reference: &Image) -> Result<(), MetricError> {
    let (expected, got) = ((reference.width, reference.height), (image.width, image.height));
    if expected == got { Ok(()) } else { Err(MetricError::Size { what, expected, got }) }
}

pub(crate) fn finite(what: &'static str, image: &Image) -> Result<(), MetricError> {
    match image.non_finite() {
        0 => Ok(()),
        count => Err(MetricError::NonFinite { what, count }),
    }
}

/// One channel of the reference's size, finite.
pub(crate) fn plane(what: &'static str, image: &Image, reference: &Image) -> Result<(), MetricError> {
    same_size(what, image, reference)?;
    if image.channels != 1 {
        return Err(MetricError::Channels { what, expected: "1", got: image.channels });
    }
    finite(what, image)
}

pub(crate) fn mask(mask: Option<&Image>, reference: &Image) -> Result<(), MetricError> {
    mask.map_or(Ok(()), |m| plane("mask", m, reference))
}

/// Two colour images of one shape (1 or 3 channels), finite, not empty.
pub(crate) fn colors(image: &Image, truth: &Image, metric: &'static str) -> Result<(), MetricError> {
    same_size("image against ground truth", image, truth)?;
    for (what, im) in [("image", image), ("ground truth", truth)] {
        if im.channels != 1 && im.channels != 3 {
            return Err(MetricError::Channels { what, expected: "1 or 3", got: im.channels });
        }
    }
    if image.channels != truth.channels {
        let expected =
            if truth.channels == 1 { "1, as the ground truth has" } else { "3, as the ground truth has" };
        return Err(MetricError::Channels { what: "image", expected, got: image.channels });
    }
    finite("image", image)?;
    finite("ground truth", truth)?;
    if image.pixels() == 0 { Err(MetricError::NothingToMeasure { metric }) } else { Ok(()) }
}
