//! Tables of scores: one row a view, one column a metric, means at the bottom.

use serde::{Serialize, Serializer, ser::SerializeMap};

/// A column.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Key in JSON, dotted (`shadow.psnr_db`).
    pub key: &'static str,
    /// Heading.
    pub label: &'static str,
    /// Digits after the point.
    pub digits: usize,
}

/// A table. Values may be missing (a region without pixels, no ground truth for the view).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Metrics.
    pub columns: Vec<Column>,
    /// Names of the views and their values, one a column.
    pub rows: Vec<(String, Vec<Option<f64>>)>,
}

/// A named table.
#[derive(Clone, Debug, Serialize)]
pub struct Section {
    /// Short name (`composed`, `empty`).
    pub name: String,
    /// What it says, in a sentence.
    pub what: String,
    /// The scores.
    #[serde(flatten)]
    pub table: Table,
}

impl Table {
    /// Mean of every column over the views that have a value; `None` where no view has one.
    #[must_use]
    pub fn means(&self) -> Vec<Option<f64>> {
        (0..self.columns.len())
            .map(|c| {
                let values: Vec<f64> = self.rows.iter().filter_map(|(_, row)| row[c]).collect();
                (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
            })
            .collect()
    }

    /// Mean of a column by its key.
    #[must_use]
    pub fn mean(&self, key: &str) -> Option<f64> {
        let c = self.columns.iter().position(|c| c.key == key)?;
        self.means()[c]
    }

    /// Removes columns in which no view has a value.
    #[must_use]
    pub fn without_empty_columns(mut self) -> Self {
        let keep: Vec<bool> = self.means().iter().map(Option::is_some).collect();
        let mut i = 0;
        self.columns.retain(|_| {
            i += 1;
            keep[i - 1]
        });
        for (_, row) in &mut self.rows {
            let mut i = 0;
            row.retain(|_| {
                i += 1;
                keep[i - 1]
            });
        }
        self
    }

    /// One value as people read it.
    #[must_use]
    pub fn cell(&self, column: usize, value: Option<f64>) -> String {
        match value {
            None => "–".to_owned(),
            Some(v) if v.is_infinite() => "∞".to_owned(),
            Some(v) => format!("{v:.*}", self.columns[column].digits),
        }
    }

    /// As aligned text.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut lines: Vec<Vec<String>> = vec![vec!["view".to_owned()]];
        lines[0].extend(self.columns.iter().map(|c| c.label.to_owned()));
        let cells = |name: &str, row: &[Option<f64>]| {
            let mut cells = vec![name.to_owned()];
            cells.extend(row.iter().enumerate().map(|(c, v)| self.cell(c, *v)));
            cells
        };
        lines.extend(self.rows.iter().map(|(name, row)| cells(name, row)));
        lines.push(cells("mean", &self.means()));
        let width = |c: usize| lines.iter().map(|l| l[c].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..=self.columns.len()).map(width).collect();
        let mut text = String::new();
        for (i, line) in lines.iter().enumerate() {
            if i == lines.len() - 1 {
                text.push_str(&"-".repeat(widths.iter().sum::<usize>() + 2 * widths.len() - 2));
                text.push('\n');
            }
            for (c, cell) in line.iter().enumerate() {
                let padding = " ".repeat(widths[c] - cell.chars().count());
                let gap = if c == 0 { "" } else { "  " };
                // Names on the left, numbers on the right.
                let padded =
                    if c == 0 { format!("{cell}{padding}") } else { format!("{gap}{padding}{cell}") };
                text.push_str(&padded);
            }
            text.push('\n');
        }
        text
    }
}

impl Serialize for Table {
    /// `{"mean": {key: value}, "views": {name: {key: value}}}`; infinite values are null, as JSON has none.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let values = |row: &[Option<f64>]| -> serde_json::Map<String, serde_json::Value> {
            self.columns.iter().zip(row).map(|(c, v)| (c.key.to_owned(), serde_json::json!(v))).collect()
        };
        let mut map = serializer.serialize_map(Some(2))?;
        map.serialize_entry("mean", &values(&self.means()))?;
        let views: serde_json::Map<String, serde_json::Value> = self
            .rows
            .iter()
            .map(|(name, row)| (name.clone(), serde_json::Value::Object(values(row))))
            .collect();
        map.serialize_entry("views", &views)?;
        map.end()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Goal: means skip missing values, columns line up, infinities are readable in text and null in JSON.
    #[test]
    fn text_and_json() {
        let table = Table {
            columns: vec![
                Column { key: "psnr_db", label: "PSNR", digits: 2 },
                Column { key: "x", label: "ꟻLIP", digits: 3 },
                Column { key: "none", label: "none", digits: 1 },
            ],
            rows: vec![
                ("00000".into(), vec![Some(30.0), Some(f64::INFINITY), None]),
                ("1".into(), vec![Some(20.0), None, None]),
            ],
        };
        assert_eq!(table.mean("psnr_db"), Some(25.0));
        assert_eq!(table.mean("none"), None);
        let table = table.without_empty_columns();
        assert_eq!(table.columns.len(), 2);
        let text = table.to_text();
        let widths: Vec<usize> = text.lines().map(|l| l.chars().count()).collect();
        assert!(widths.iter().all(|w| *w == widths[0]), "{text}");
        assert!(text.contains("∞") && text.contains("–") && text.contains("25.00"), "{text}");
        let json = serde_json::to_value(&table).unwrap();
        assert_eq!(json["mean"]["psnr_db"], 25.0);
        assert!(json["views"]["00000"]["x"].is_null());
    }
}
