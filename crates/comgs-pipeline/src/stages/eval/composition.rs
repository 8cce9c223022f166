//! Composed frames against a composition's pictures, region by region, with empty scenes as baselines.

use crate::stages::eval::table::{Column, Section, Table};
use crate::stages::eval::{Evaluation, frames_folder, pngs};
use crate::{Context, PipelineError, Status};
use comgs_image::Image;
use comgs_metrics::{MetricError, RegionScores, Regions, Scores, ShadowRule, score, score_regions};
use std::path::{Path, PathBuf};

const WHOLE: [Column; 3] = [
    Column { key: "psnr_db", label: "PSNR dB", digits: 2 },
    Column { key: "ssim", label: "SSIM", digits: 4 },
    Column { key: "flip", label: "ꟻLIP", digits: 4 },
];

const REGIONS: [Column; 9] = [
    Column { key: "whole.psnr_db", label: "whole dB", digits: 2 },
    Column { key: "whole.ssim", label: "SSIM", digits: 4 },
    Column { key: "whole.flip", label: "ꟻLIP", digits: 4 },
    Column { key: "object.psnr_db", label: "object dB", digits: 2 },
    Column { key: "object.flip", label: "ꟻLIP", digits: 4 },
    Column { key: "shadow.psnr_db", label: "shadow dB", digits: 2 },
    Column { key: "shadow.flip", label: "ꟻLIP", digits: 4 },
    Column { key: "elsewhere.psnr_db", label: "elsewhere dB", digits: 2 },
    Column { key: "elsewhere.flip", label: "ꟻLIP", digits: 4 },
];

/// Ground truth of one composed view.
struct Truth {
    image: Image,
    empty: Option<Image>,
    regions: Option<Regions>,
}

/// Ground truth of composed frames, read once a frame that is asked for.
pub(crate) struct TruthFrames {
    root: PathBuf,
}

impl TruthFrames {
    /// # Errors
    /// [`PipelineError::Input`] for a folder without pictures.
    pub fn new(against: &Path) -> Result<Self, PipelineError> {
        Ok(Self { root: truth_root(against)? })
    }

    /// Scores by region of a linear frame as it would be written; `None` without a picture of that name.
    ///
    /// # Errors
    /// [`PipelineError`] for pictures that do not compare.
    pub fn judge(&self, name: &str, frame: &Image) -> Result<Option<RegionScores>, PipelineError> {
        let Some(truth) = load_truth(&self.root, name)? else { return Ok(None) };
        let scores = judge(frame, &truth).map_err(|e: MetricError| {
            PipelineError::input(format!("frame {name}"), "pictures that compare", e.to_string())
        })?;
        Ok(Some(scores))
    }
}

/// Compares frames by name with the pictures of a composition or capture.
///
/// With `mask/` and `empty/` in the truth, scores are by region, and two baselines come along: the frames' own empty
/// scene (what composing gained), and the truth's (what a perfect scene without the object would score).
pub(super) fn evaluate(
    subject: &Path,
    against: &Path,
    context: &Context<'_>,
) -> Result<Evaluation, PipelineError> {
    let frames = frames_folder(subject)
        .ok_or_else(|| PipelineError::input(subject.display().to_string(), "PNG frames", "none"))?;
    let root = truth_root(against)?;
    let names = pngs(&frames);
    let own_empty = subject.join("empty");
    let mut composed = Vec::new();
    let mut without = Vec::new();
    let mut perfect = Vec::new();
    let mut remarks = Vec::new();
    let mut by_region = true;
    for (i, name) in names.iter().enumerate() {
        context.check()?;
        let message = format!("frame {name}");
        context.progress.update(&Status {
            fraction: Some(i as f64 / names.len() as f64),
            message,
            remaining: None,
        });
        let Some(truth) = load_truth(&root, name)? else {
            remarks.push(format!("frame {name} has no ground truth; left out"));
            continue;
        };
        by_region &= truth.regions.is_some();
        let failed = |e: MetricError| {
            PipelineError::input(format!("frame {name}"), "pictures that compare", e.to_string())
        };
        let judge = |image: &Image| judge(image, &truth).map_err(failed);
        composed.push((name.clone(), judge(&comgs_image::read(&frames.join(format!("{name}.png")))?.color)?));
        let own = own_empty.join(format!("{name}.png"));
        if own.is_file() {
            without.push((name.clone(), judge(&comgs_image::read(&own)?.color)?));
        }
        if let Some(empty) = &truth.empty {
            perfect.push((name.clone(), judge(empty)?));
        }
    }
    if composed.is_empty() {
        let got = format!("none of {}", names.iter().take(5).cloned().collect::<Vec<_>>().join(", "));
        return Err(PipelineError::input(
            root.display().to_string(),
            "pictures named as the frames are (images/<name>.png)",
            got,
        ));
    }
    let section = |name: &str, what: &str, rows| Section {
        name: name.into(),
        what: what.into(),
        table: to_table(rows, by_region),
    };
    let mut sections = vec![section("composed", "the frames, sRGB clipped to [0, 1]", composed)];
    if !without.is_empty() {
        let what = "baseline: the reconstructed scene without object and shadow";
        sections.push(section("empty", what, without));
    }
    if !perfect.is_empty() {
        let what = "baseline: the true scene without object and shadow";
        sections.push(section("true empty", what, perfect));
    }
    Ok(Evaluation {
        subject: subject.display().to_string(),
        against: against.display().to_string(),
        sections,
        remarks,
    })
}

/// The folder with `images/`: the one given, or its test split.
fn truth_root(against: &Path) -> Result<PathBuf, PipelineError> {
    [against.to_owned(), against.join("test")]
        .into_iter()
        .find(|root| root.join("images").is_dir())
        .ok_or_else(|| {
            let looked = format!("neither {0}/images nor {0}/test/images", against.display());
            PipelineError::input("ground truth", "a composition or capture with images/", looked)
        })
}

fn load_truth(root: &Path, name: &str) -> Result<Option<Truth>, PipelineError> {
    let read = |folder: &str, extension: &str| -> Result<Option<Image>, PipelineError> {
        let path = root.join(folder).join(format!("{name}.{extension}"));
        if !path.is_file() {
            return Ok(None);
        }
        let loaded = comgs_image::read(&path)?;
        let mut color = loaded.color;
        if let Some(alpha) = loaded.alpha {
            for (pixel, a) in color.data.chunks_exact_mut(3).zip(&alpha.data) {
                pixel.iter_mut().for_each(|v| *v *= a);
            }
        }
        Ok(Some(color))
    };
    let first = |a: Option<Image>, b: Option<Image>| a.or(b);
    let Some(image) = first(read("images", "png")?, first(read("images", "exr")?, read("images", "jpg")?))
    else {
        return Ok(None);
    };
    let empty = first(read("empty", "png")?, read("empty", "exr")?);
    let mask_path = root.join("mask").join(format!("{name}.png"));
    let regions = match (&empty, mask_path.is_file()) {
        (Some(empty), true) => {
            // Linear pictures say more about shadows than clipped 8-bit ones.
            let linear = (read("images_linear", "exr")?, read("empty_linear", "exr")?);
            let mask = comgs_image::read(&mask_path)?;
            let coverage = stored_coverage(&mask);
            let (with, without) = match &linear {
                (Some(with), Some(without)) => (with, without),
                _ => (&image, empty),
            };
            let regions = Regions::from_truth(with, without, &coverage, &ShadowRule::default());
            Some(regions.map_err(|e| {
                PipelineError::input(
                    mask_path.display().to_string(),
                    "a mask of the picture's size",
                    e.to_string(),
                )
            })?)
        }
        _ => None,
    };
    Ok(Some(Truth { image, empty, regions }))
}

/// A coverage mask as stored: the reader has taken its 8-bit grey for sRGB, which is undone.
fn stored_coverage(mask: &comgs_image::Loaded) -> Image {
    let grey = mask.color.select(&[0]);
    match mask.encoding {
        comgs_image::Encoding::Srgb => grey.map(comgs_image::transfer::srgb_from_linear),
        comgs_image::Encoding::Linear => grey,
    }
}

fn judge(image: &Image, truth: &Truth) -> Result<RegionScores, MetricError> {
    match &truth.regions {
        Some(regions) => score_regions(image, &truth.image, regions),
        None => {
            let whole = score(image, &truth.image, None)?;
            Ok(RegionScores { whole, object: None, shadow: None, elsewhere: None })
        }
    }
}

fn to_table(rows: Vec<(String, RegionScores)>, by_region: bool) -> Table {
    let columns = if by_region { REGIONS.to_vec() } else { WHOLE.to_vec() };
    let rows = rows
        .into_iter()
        .map(|(name, s)| {
            let mut row = vec![Some(s.whole.psnr_db), s.whole.ssim, Some(s.whole.flip)];
            if by_region {
                for region in [s.object, s.shadow, s.elsewhere] {
                    row.push(region.map(|r: Scores| r.psnr_db));
                    row.push(region.map(|r: Scores| r.flip));
                }
            }
            (name, row)
        })
        .collect();
    Table { columns, rows }
}
