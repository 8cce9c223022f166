//! `report.html`: one file that shows a composition and what it took, without anything from outside.

mod html;

use crate::record::StageTime;
use crate::stages::eval::{Evaluation, Table};
use crate::{PipelineError, progress::human_bytes, progress::human_duration};
use comgs_image::Image;
pub(crate) use html::base64;
use html::{escape, jpeg_data_url, png_data_url};
use std::path::Path;

/// A composed frame with its scene alone.
pub struct ReportFrame {
    /// Name of the camera.
    pub name: String,
    /// The scene without the object.
    pub before: Image,
    /// The composed frame.
    pub after: Image,
}

/// A picture with a caption.
pub struct Picture {
    /// Caption.
    pub caption: String,
    /// The picture; one channel is shown as grey.
    pub image: Image,
}

/// What a report shows.
pub struct Report {
    /// Heading (`cow in garden`).
    pub title: String,
    /// One paragraph.
    pub summary: String,
    /// The frames to show, at most [`MAX_FRAMES`].
    pub frames: Vec<ReportFrame>,
    /// How many frames there are in all.
    pub all_frames: usize,
    /// The light: sweep, coverage, completion.
    pub light: Vec<Picture>,
    /// Scores, where there is ground truth.
    pub evaluation: Option<Evaluation>,
    /// Seconds by stage.
    pub timings: Vec<StageTime>,
    /// Peak memory of the process.
    pub peak_memory_bytes: Option<u64>,
    /// Warnings.
    pub warnings: Vec<String>,
    /// Resolved configuration as JSON.
    pub config: String,
}

/// Frames shown at most; a report of hundreds would not open.
pub const MAX_FRAMES: usize = 24;

/// Writes the report. Pictures are inlined: frames as JPEG (quality 90), masks as PNG.
///
/// # Errors
/// [`PipelineError`] when a picture cannot be encoded or the file not be written.
pub fn write(path: &Path, report: &Report) -> Result<(), PipelineError> {
    let text = to_html(report)?;
    comgs_image::atomic::write_file(path, |w| w.write_all(text.as_bytes()))
        .map_err(|e| PipelineError::io(path, e))
}

/// The whole page.
fn to_html(report: &Report) -> Result<String, PipelineError> {
    let mut body = String::new();
    let title = escape(&report.title);
    body.push_str(&format!("<header><h1>{title}</h1><p>{}</p></header>\n", escape(&report.summary)));
    if !report.warnings.is_empty() {
        let items: String = report.warnings.iter().map(|w| format!("<li>{}</li>", escape(w))).collect();
        body.push_str(&format!("<section class=\"warnings\"><h2>Warnings</h2><ul>{items}</ul></section>\n"));
    }
    body.push_str(&frames_html(&report.frames, report.all_frames)?);
    if let Some(evaluation) = &report.evaluation {
        body.push_str(&scores_html(evaluation));
    }
    if !report.light.is_empty() {
        body.push_str("<section><h2>Light at the placement</h2><div class=\"wide\">\n");
        for picture in &report.light {
            let url = if picture.image.channels == 1 {
                png_data_url(&picture.image)?
            } else {
                jpeg_data_url(&picture.image)?
            };
            let caption = escape(&picture.caption);
            body.push_str(&format!(
                "<figure><img src=\"{url}\" alt=\"{caption}\"><figcaption>{caption}</figcaption></figure>\n"
            ));
        }
        body.push_str("</div></section>\n");
    }
    body.push_str(&timings_html(&report.timings, report.peak_memory_bytes));
    body.push_str(&format!(
        "<section><details><summary>Resolved configuration</summary><pre>{}</pre></details></section>\n",
        escape(&report.config)
    ));
    body.push_str(&format!("<footer>comgs {}</footer>\n", crate::VERSION));
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><meta name=\"color-scheme\" content=\"light dark\">\
         <title>{title}</title><style>{}</style></head><body>\n{body}<script>{}</script></body></html>\n",
        html::STYLE,
        html::SCRIPT
    ))
}

/// The slider over the first frame, and small pictures that choose the frame.
fn frames_html(frames: &[ReportFrame], all: usize) -> Result<String, PipelineError> {
    if frames.is_empty() {
        return Ok(String::new());
    }
    let shown = frames.len().min(MAX_FRAMES);
    let mut text = String::from("<section><h2>Frames</h2>\n<div class=\"frames\">\n");
    for k in 0..shown {
        let frame = &frames[k];
        let (name, hidden) = (escape(&frame.name), if k == 0 { "" } else { " hidden" });
        let (w, h) = (frame.after.width, frame.after.height);
        text.push_str(&format!(
            "<figure class=\"compare\"{hidden} style=\"--at:50%;aspect-ratio:{w}/{h};max-width:{}px\">\
             <img src=\"{}\" alt=\"{name} with the object\">\
             <img class=\"before\" src=\"{}\" alt=\"{name} without the object\">\
             <span class=\"bar\"></span><input type=\"range\" min=\"0\" max=\"100\" value=\"50\" \
             aria-label=\"before and after\"></figure>\n",
            w.max(768),
            jpeg_data_url(&frame.after)?,
            jpeg_data_url(&frame.before)?,
        ));
    }
    text.push_str(
        "</div>\n<p class=\"hint\">Left of the bar: the scene alone. Right: with the object.</p>\n",
    );
    text.push_str("<nav class=\"chooser\">\n");
    for k in 0..shown {
        let frame = &frames[k];
        let width = 128.min(frame.after.width);
        let small = frame.after.resized(width, (frame.after.height * width / frame.after.width).max(1));
        let name = escape(&frame.name);
        text.push_str(&format!(
            "<button{}><img src=\"{}\" alt=\"\"><span>{name}</span></button>\n",
            if k == 0 { " class=\"chosen\"" } else { "" },
            jpeg_data_url(&small)?
        ));
    }
    text.push_str("</nav>\n");
    if shown < all {
        text.push_str(&format!("<p class=\"hint\">{shown} of {all} frames are shown.</p>\n"));
    }
    text.push_str("</section>\n");
    Ok(text)
}

fn scores_html(evaluation: &Evaluation) -> String {
    let mut text = format!("<section><h2>Scores</h2><p>Against {}.</p>\n", escape(&evaluation.against));
    for section in &evaluation.sections {
        let heading = format!("{} – {}", section.name, section.what);
        text.push_str(&format!("<h3>{}</h3>\n{}", escape(&heading), table_html(&section.table)));
    }
    for remark in &evaluation.remarks {
        text.push_str(&format!("<p class=\"hint\">{}</p>\n", escape(remark)));
    }
    text.push_str("</section>\n");
    text
}

fn table_html(table: &Table) -> String {
    let mut text = String::from("<div class=\"scroll\"><table><thead><tr><th>view</th>");
    for column in &table.columns {
        text.push_str(&format!("<th>{}</th>", escape(column.label)));
    }
    text.push_str("</tr></thead><tbody>\n");
    let mut row = |tag: &str, name: &str, values: &[Option<f64>]| {
        text.push_str(&format!("<tr{tag}><td>{}</td>", escape(name)));
        for (c, value) in values.iter().enumerate() {
            text.push_str(&format!("<td>{}</td>", table.cell(c, *value)));
        }
        text.push_str("</tr>\n");
    };
    for (name, values) in &table.rows {
        row("", name, values);
    }
    row(" class=\"mean\"", "mean", &table.means());
    text.push_str("</tbody></table></div>\n");
    text
}

fn timings_html(timings: &[StageTime], peak_memory_bytes: Option<u64>) -> String {
    let total: f64 = timings.iter().map(|t| t.seconds).sum();
    let longest = timings.iter().map(|t| t.seconds).fold(1e-9, f64::max);
    let mut text =
        String::from("<section><h2>Time</h2><div class=\"scroll\"><table class=\"times\"><tbody>\n");
    for t in timings {
        let reused = if t.reused { " (earlier run)" } else { "" };
        text.push_str(&format!(
            "<tr><td>{}{reused}</td><td>{}</td><td class=\"bars\"><span style=\"width:{:.1}%\"></span></td></tr>\n",
            escape(&t.stage),
            human_duration(t.seconds),
            100.0 * t.seconds / longest
        ));
    }
    text.push_str(&format!(
        "<tr class=\"mean\"><td>all</td><td>{}</td><td></td></tr>\n",
        human_duration(total)
    ));
    text.push_str("</tbody></table></div>\n");
    if let Some(bytes) = peak_memory_bytes {
        text.push_str(&format!("<p class=\"hint\">Peak memory {}.</p>\n", human_bytes(bytes)));
    }
    text.push_str("</section>\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report() -> Report {
        let frame = |name: &str| ReportFrame {
            name: name.into(),
            before: Image::filled(32, 18, 3, 0.2),
            after: Image::filled(32, 18, 3, 0.6),
        };
        Report {
            title: "cow <in> garden".into(),
            summary: "two frames".into(),
            frames: vec![frame("0"), frame("1")],
            all_frames: 2,
            light: vec![
                Picture { caption: "sweep".into(), image: Image::filled(16, 8, 3, 2.0) },
                Picture { caption: "coverage".into(), image: Image::filled(16, 8, 1, 0.5) },
            ],
            evaluation: None,
            timings: vec![StageTime { stage: "sweep".into(), seconds: 1.5, reused: true }],
            peak_memory_bytes: Some(1 << 30),
            warnings: vec!["it floats".into()],
            config: "{\"a\": \"</pre><script>\"}".into(),
        }
    }

    /// Goal: the page refers to nothing outside itself, shows every part, and text cannot break out of its place.
    #[test]
    fn page_is_self_contained() {
        let text = to_html(&report()).unwrap();
        for forbidden in
            ["http://", "https://", "src=\"/", "href=", "url(", "@import", "<in>", "</pre><script>"]
        {
            assert!(!text.contains(forbidden), "{forbidden}");
        }
        for part in
            ["cow &lt;in&gt; garden", "type=\"range\"", "it floats", "sweep", "1.0 GiB", "(earlier run)"]
        {
            assert!(text.contains(part), "{part}");
        }
        assert_eq!(text.matches("data:image/jpeg;base64,").count(), 2 * 2 + 2 + 1);
        assert_eq!(text.matches("data:image/png;base64,").count(), 1);
        assert_eq!(text.matches("class=\"compare\"").count(), 2);
        assert!(text.contains("color-scheme") && text.contains("prefers-color-scheme"));
    }

    /// Goal: a report of hundreds of frames shows few and says so.
    #[test]
    fn many_frames_are_not_shown() {
        let mut many = report();
        many.frames = (0..100)
            .map(|i| ReportFrame {
                name: format!("frame{i:03}"),
                before: Image::zeros(8, 8, 3),
                after: Image::zeros(8, 8, 3),
            })
            .collect();
        many.all_frames = 100;
        let text = to_html(&many).unwrap();
        assert_eq!(text.matches("class=\"compare\"").count(), MAX_FRAMES);
        assert!(text.contains("24 of 100 frames"));
    }
}
