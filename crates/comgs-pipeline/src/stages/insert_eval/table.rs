//! Scores and how they are written down.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

/// How far an insertion is from its reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// Name of the map.
    pub map: String,
    /// Whether the shipped completer has never seen the map.
    pub unseen: bool,
    /// The object.
    pub object: String,
    /// The method.
    pub method: String,
    /// Seconds that finding the light took, without rendering.
    pub seconds: f64,
    /// Over the whole photo.
    pub whole: Scores,
    /// Over the box around object and shadow.
    pub touched: Scores,
}

/// Maps by whether the shipped completer knows them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Group {
    All,
    Seen,
    Unseen,
}

impl Group {
    const ALL: [Self; 3] = [Self::All, Self::Seen, Self::Unseen];

    fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Seen => "seen",
            Self::Unseen => "unseen",
        }
    }

    /// What its table is of.
    fn title(self) -> &'static str {
        match self {
            Self::All => "all maps",
            Self::Seen => "maps that the shipped completer was trained on or validated with",
            Self::Unseen => "maps that it never saw",
        }
    }

    fn of(self, rows: &[Row]) -> Vec<&Row> {
        rows.iter().filter(|r| self == Self::All || r.unseen == (self == Self::Unseen)).collect()
    }
}

/// Mean values of a method: the five of the whole photo, the five of the box, seconds.
fn mean(rows: &[&Row], method: &str) -> Option<[f64; 11]> {
    let own: Vec<&&Row> = rows.iter().filter(|r| r.method == method).collect();
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

/// Means by group of maps and by method, for the record.
pub(super) fn means(rows: &[Row], methods: &[&str]) -> Value {
    let columns = ["rmse_srgb", "ssim", "si_rmse_srgb", "rmse_linear", "si_rmse_linear"];
    let of_group = |group: Group| -> Value {
        let rows = group.of(rows);
        let mut out = serde_json::Map::new();
        for method in methods {
            if let Some(mean) = mean(&rows, method) {
                let part = |from: usize| -> Value {
                    columns
                        .iter()
                        .enumerate()
                        .map(|(k, c)| ((*c).to_owned(), json!(mean[from + k])))
                        .collect()
                };
                let value = json!({"whole": part(0), "touched": part(5), "seconds": mean[10]});
                out.insert((*method).to_owned(), value);
            }
        }
        Value::Object(out)
    };
    Group::ALL.iter().map(|g| (g.name().to_owned(), of_group(*g))).collect()
}

/// The tables of means as Markdown: all maps, those that the completer has seen, those that it has not. A group without maps
/// has none, nor has one that is the same as all.
#[must_use]
pub fn markdown(rows: &[Row], methods: &[&str], command: &str) -> String {
    let mut out = format!(
        "`{command}`. RMSE and si-RMSE of sRGB values, then of linear ones; SSIM of sRGB values. First the whole photo, then \
         the box around object and shadow.\n"
    );
    for group in Group::ALL {
        let own = group.of(rows);
        if own.is_empty() || (group != Group::All && own.len() == rows.len()) {
            continue;
        }
        let maps: std::collections::BTreeSet<&str> = own.iter().map(|r| r.map.as_str()).collect();
        out.push_str(&format!(
            "\nMeans over {} maps: {}.\n\n\
             | method | RMSE ↓ | SSIM ↑ | si-RMSE ↓ | RMSE lin ↓ | si-RMSE lin ↓ | box: RMSE ↓ | SSIM ↑ | si-RMSE ↓ | \
             RMSE lin ↓ | si-RMSE lin ↓ | light found in |\n|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n",
            maps.len(),
            group.title()
        ));
        for method in methods {
            if let Some(mean) = mean(&own, method) {
                out.push_str(&format!("| {method} |"));
                for v in &mean[..10] {
                    out.push_str(&format!(" {v:.4} |"));
                }
                out.push_str(&format!(" {:.2} s |\n", mean[10]));
            }
        }
    }
    out
}

/// Every row as CSV.
pub(super) fn csv(rows: &[Row]) -> String {
    let columns = "rmse_srgb,ssim,si_rmse_srgb,rmse_linear,si_rmse_linear";
    let boxed: Vec<String> = columns.split(',').map(|c| format!("box_{c}")).collect();
    let mut out = format!("map,unseen,object,method,{columns},{},seconds\n", boxed.join(","));
    for r in rows {
        let numbers: Vec<String> = r
            .whole
            .values()
            .into_iter()
            .chain(r.touched.values())
            .chain([r.seconds])
            .map(|v| format!("{v:.6}"))
            .collect();
        out.push_str(&format!(
            "{},{},\"{}\",\"{}\",{}\n",
            r.map,
            r.unseen,
            r.object,
            r.method,
            numbers.join(",")
        ));
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
        let row = |map: &str, unseen, method: &str, v| Row {
            map: map.into(),
            unseen,
            object: "a, b".into(),
            method: method.into(),
            seconds: 1.0,
            whole: scores(v),
            touched: scores(2.0 * v),
        };
        let rows = [row("x", false, "m", 0.1), row("y", true, "m", 0.3), row("x", false, "n", 0.5)];
        let mean = mean(&Group::All.of(&rows), "m").unwrap();
        assert!(
            (mean[0] - 0.2).abs() < 1e-12 && (mean[1] - 0.8).abs() < 1e-12 && (mean[5] - 0.4).abs() < 1e-12
        );
        let text = markdown(&rows, &["m", "n", "absent"], "cmd");
        assert!(
            text.contains("over 2 maps: all") && text.contains("| m | 0.2000 |") && !text.contains("absent")
        );
        let unseen = text.split("that it never saw").nth(1).unwrap();
        assert!(unseen.contains("| m | 0.3000 |") && !unseen.contains("| n |"), "{text}");
        assert_eq!(markdown(&rows[1..2], &["m"], "cmd").matches("Means over").count(), 1);
        assert_eq!(csv(&rows).lines().count(), 4);
        let means = means(&rows, &["m"]);
        assert_eq!(means["seen"]["m"]["touched"]["rmse_srgb"], 0.2);
        assert!(means["all"]["m"]["seconds"].is_number() && means["unseen"]["n"].is_null());
    }
}
