//! errors.csv: one row per object, policy, seed and number of touches; written anew after each run, so that it is whole at any time.

use anyhow::{Context as _, bail, ensure};
use palpate::explore::Step;
use palpate::io;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const COLUMNS: &str = "object,view,seed,policy,asked,touches,misses,chamfer_mean_mm,chamfer_squared_mm2,volumetric_iou,f_score_5mm,sensor_x_m,sensor_y_m,sensor_z_m";

/// One run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Key {
    pub(super) object: String,
    pub(super) view: usize,
    pub(super) seed: u64,
    pub(super) policy: String,
    /// Touches asked for.
    pub(super) asked: usize,
}

/// The state after a number of touches of a run.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Row {
    pub(super) key: Key,
    pub(super) touches: usize,
    pub(super) misses: usize,
    pub(super) chamfer_mean_mm: f64,
    pub(super) chamfer_squared_mm2: f64,
    pub(super) volumetric_iou: Option<f64>,
    pub(super) f_score_5mm: f64,
    sensor: Option<[f64; 3]>,
}

pub(super) struct Results {
    path: PathBuf,
    conditions: String,
    rows: Vec<Row>,
}

impl Results {
    /// Reads what an earlier run with the same parameters left.
    pub(super) fn open(path: &Path, conditions: &str) -> anyhow::Result<Self> {
        let mut results = Self { path: path.to_owned(), conditions: format!("# {conditions}"), rows: Vec::new() };
        if path.exists() {
            let text = io::read_text(path)?;
            let mut lines = text.lines();
            ensure!(
                lines.next() == Some(&results.conditions) && lines.next() == Some(COLUMNS),
                "'{}' was made with other parameters or another version; choose another folder or remove it",
                path.display()
            );
            for (i, line) in lines.enumerate() {
                results.rows.push(parse(line).with_context(|| format!("'{}' line {}", path.display(), i + 3))?);
            }
        }
        Ok(results)
    }

    pub(super) fn holds(&self, key: &Key) -> bool {
        self.rows.iter().any(|r| r.key == *key)
    }

    /// The largest number of touches of a run.
    pub(super) fn last(&self, key: &Key) -> Option<usize> {
        self.rows.iter().filter(|r| r.key == *key).map(|r| r.touches).max()
    }

    pub(super) fn rows(&self) -> &[Row] {
        &self.rows
    }

    pub(super) fn add(&mut self, key: &Key, steps: &[Step]) -> anyhow::Result<()> {
        self.rows.extend(steps.iter().map(|s| Row::new(key, s)));
        // Runs end in any order; the file does not show it.
        self.rows.sort_by(|a, b| order(a).cmp(&order(b)));
        let mut text = format!("{}\n{COLUMNS}\n", self.conditions);
        for row in &self.rows {
            writeln!(text, "{}", row.line())?;
        }
        io::write_text(&self.path, &text)?;
        Ok(())
    }
}

fn order(r: &Row) -> (&str, usize, u64, &str, usize, usize) {
    (&r.key.object, r.key.view, r.key.seed, &r.key.policy, r.key.asked, r.touches)
}

impl Row {
    fn new(key: &Key, step: &Step) -> Self {
        let d = &step.comparison.distances;
        Self {
            key: key.clone(),
            touches: step.touches,
            misses: step.misses,
            chamfer_mean_mm: d.chamfer_mean_mm,
            chamfer_squared_mm2: d.chamfer_squared_mm2,
            volumetric_iou: step.comparison.volumetric_iou,
            f_score_5mm: d.f_score_5mm,
            sensor: step.world_from_sensor.map(|p| p.translation.vector.into()),
        }
    }

    fn line(&self) -> String {
        let k = &self.key;
        let iou = self.volumetric_iou.map_or_else(String::new, |v| format!("{v:.6}"));
        let [x, y, z] = self.sensor.map_or_else(Default::default, |p| p.map(|c| format!("{c:.6}")));
        format!(
            "{},{},{},{},{},{},{},{:.6},{:.6},{iou},{:.6},{x},{y},{z}",
            k.object.replace(',', ";"),
            k.view,
            k.seed,
            k.policy,
            k.asked,
            self.touches,
            self.misses,
            self.chamfer_mean_mm,
            self.chamfer_squared_mm2,
            self.f_score_5mm
        )
    }
}

fn parse(line: &str) -> anyhow::Result<Row> {
    let fields: Vec<&str> = line.split(',').collect();
    let [object, view, seed, policy, asked, touches, misses, mean, squared, iou, f5, x, y, z] = fields[..] else {
        bail!("{} fields; 14 are needed", fields.len());
    };
    let number = |name: &str, text: &str| {
        text.parse::<f64>().ok().filter(|v| v.is_finite()).with_context(|| format!("{name} is '{text}', not a number"))
    };
    let count =
        |name: &str, text: &str| text.parse::<usize>().with_context(|| format!("{name} is '{text}', not a count"));
    let place = [number("sensor_x_m", x), number("sensor_y_m", y), number("sensor_z_m", z)];
    let sensor = if x.is_empty() { None } else { Some(place) };
    let sensor = match sensor {
        Some([x, y, z]) => Some([x?, y?, z?]),
        None => None,
    };
    Ok(Row {
        key: Key {
            object: object.to_owned(),
            view: count("view", view)?,
            seed: seed.parse().with_context(|| format!("seed is '{seed}', not a number"))?,
            policy: policy.to_owned(),
            asked: count("asked", asked)?,
        },
        touches: count("touches", touches)?,
        misses: count("misses", misses)?,
        chamfer_mean_mm: number("chamfer_mean_mm", mean)?,
        chamfer_squared_mm2: number("chamfer_squared_mm2", squared)?,
        volumetric_iou: if iou.is_empty() { None } else { Some(number("volumetric_iou", iou)?) },
        f_score_5mm: number("f_score_5mm", f5)?,
        sensor,
    })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in super::super) fn row(object: &str, policy: &str, touches: usize, error: f64) -> Row {
        let key = Key { object: object.into(), view: 0, seed: 1, policy: policy.into(), asked: 5 };
        Row {
            key,
            touches,
            misses: 1,
            chamfer_mean_mm: error,
            chamfer_squared_mm2: 2.0 * error,
            volumetric_iou: Some(0.5),
            f_score_5mm: 0.25,
            sensor: (touches > 0).then_some([0.5, -0.25, 0.125]),
        }
    }

    #[test]
    fn rows_survive_the_file_and_damaged_lines_are_named() {
        for row in [row("mug", "even", 0, 1.5), row("can", "oracle", 3, 0.5)] {
            assert_eq!(parse(&row.line()).expect("its own line"), row);
        }
        let line = row("mug", "even", 3, 1.5).line().replace("1.500000", "NaN");
        assert!(parse(&line).expect_err("NaN").to_string().contains("chamfer_mean_mm is 'NaN'"));
        assert!(parse("a,b").expect_err("short").to_string().contains("14 are needed"));
    }
}
