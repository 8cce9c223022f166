//! Scores and how they are written down.

use serde::Serialize;
use serde_json::{Value, json};

/// How far an insertion is from its reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Scores {
    /// Root mean square difference of sRGB values in [0, 1].
    pub rmse_srgb: f64,
    /// The same after the one factor on the estimate that makes it least.
    pub si_rmse_srgb: f64,
    /// Root mean square difference of linear values.
    pub rmse_linear: f64,
    /// The same after the one factor.
    pub si_rmse_linear: f64,
    /// SSIM of sRGB values, 11×11 windows that lie inside.
    pub ssim: f64,
}

impl Scores {
    fn values(&self) -> [f64; 5] {
        [self.rmse_srgb, self.ssim, self.si_rmse_srgb, self.rmse_linear, self.si_rmse_linear]
    }
}

/// One method on one map.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Name of the map.
    pub map: String,
    /// The object.
    pub object: &'static str,
    /// The method.
    pub method: &'static str,
    /// Seconds that finding the light took, without rendering.
    pub seconds: f64,
    /// Over the whole photo.
    pub whole: Scores,
    /// Over the box around object and shadow.
    pub touched: Scores,
}

/// Mean values of a method: the five of the whole photo, the five of the box, seconds.
fn mean(rows: &[Row], method: &str) -> Option<[f64; 11]> {
    let own: Vec<&Row> = rows.iter().filter(|r| r.method == method).collect();
    let mut out = [0.0; 11];
    for row in &own {
        for k in 0..5 {
            out[k] += row.whole.values()[k];
            out[5 + k] += row.touched.values()[k];
        }
        out[10] += row.seconds;
    }
    (!own.is_empty()).then(|| out.map(|v| v / own.len() as f64))
}

/// Means by method, for the record.
pub(super) fn means(rows: &[Row], methods: &[&str]) -> Value {
    let columns = ["rmse_srgb", "ssim", "si_rmse_srgb", "rmse_linear", "si_rmse_linear"];
    let mut out = serde_json::Map::new();
    for method in methods {
        if let Some(mean) = mean(rows, method) {
            let part = |from: usize| -> Value {
                columns.iter().enumerate().map(|(k, c)| ((*c).to_owned(), json!(mean[from + k]))).collect()
            };
            let value = json!({"whole": part(0), "touched": part(5), "seconds": mean[10]});
            out.insert((*method).to_owned(), value);
        }
    }
    Value::Object(out)
}

/// The table of means as Markdown.
#[must_use]
pub fn markdown(rows: &[Row], methods: &[&str], command: &str) -> String {
    let maps = rows.iter().map(|r| &r.map).collect::<std::collections::BTreeSet<_>>().len();
    let mut out = format!(
        "Means over {maps} maps, `{command}`. RMSE and si-RMSE of sRGB values, then of linear ones; SSIM of sRGB values. \
         First the whole photo, then the box around object and shadow.\n\n\
         | method | RMSE ↓ | SSIM ↑ | si-RMSE ↓ | RMSE lin ↓ | si-RMSE lin ↓ | box: RMSE ↓ | SSIM ↑ | si-RMSE ↓ | \
         RMSE lin ↓ | si-RMSE lin ↓ | light found in |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n"
    );
    for method in methods {
        if let Some(mean) = mean(rows, method) {
            out.push_str(&format!("| {method} |"));
            for v in &mean[..10] {
                out.push_str(&format!(" {v:.4} |"));
            }
            out.push_str(&format!(" {:.2} s |\n", mean[10]));
        }
    }
    out
}

/// Every row as CSV.
pub(super) fn csv(rows: &[Row]) -> String {
    let columns = "rmse_srgb,ssim,si_rmse_srgb,rmse_linear,si_rmse_linear";
    let boxed: Vec<String> = columns.split(',').map(|c| format!("box_{c}")).collect();
    let mut out = format!("map,object,method,{columns},{},seconds\n", boxed.join(","));
    for r in rows {
        let numbers: Vec<String> = r
            .whole
            .values()
            .into_iter()
            .chain(r.touched.values())
            .chain([r.seconds])
            .map(|v| format!("{v:.6}"))
            .collect();
        out.push_str(&format!("{},\"{}\",\"{}\",{}\n", r.map, r.object, r.method, numbers.join(",")));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: means are those of the rows of the method, and both files hold one line each for what they list.
    #[test]
    fn means_and_files() {
        let scores = |v: f64| Scores {
            rmse_srgb: v,
            si_rmse_srgb: v,
            rmse_linear: v,
            si_rmse_linear: v,
            ssim: 1.0 - v,
        };
        let row = |map: &str, method, v| Row {
            map: map.into(),
            object: "a, b",
            method,
            seconds: 1.0,
            whole: scores(v),
            touched: scores(2.0 * v),
        };
        let rows = [row("x", "m", 0.1), row("y", "m", 0.3), row("x", "n", 0.5)];
        let mean = mean(&rows, "m").unwrap();
        assert!(
            (mean[0] - 0.2).abs() < 1e-12 && (mean[1] - 0.8).abs() < 1e-12 && (mean[5] - 0.4).abs() < 1e-12
        );
        let text = markdown(&rows, &["m", "n", "absent"], "cmd");
        assert!(text.contains("over 2 maps") && text.contains("| m | 0.2000 |") && !text.contains("absent"));
        assert_eq!(csv(&rows).lines().count(), 4);
        assert!(means(&rows, &["m"])["m"]["touched"]["rmse_srgb"].is_number());
    }
}
