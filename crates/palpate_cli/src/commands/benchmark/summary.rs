//! `summary.md`: means, medians, worst cases and intervals that a person can read.

use super::results::Row;
use palpate::metrics::{Summary, summarize};
use std::fmt::Write as _;
use std::path::Path;

/// Thin shells: finer than the cells of any of the methods.
const SHELLS: [&str; 2] = ["024_bowl", "029_plate"];
/// Objects that the constants were chosen on.
const DEVELOPMENT: [&str; 15] = [
    "004_sugar_box",
    "005_tomato_soup_can",
    "006_mustard_bottle",
    "008_pudding_box",
    "009_gelatin_box",
    "011_banana",
    "024_bowl",
    "025_mug",
    "029_plate",
    "035_power_drill",
    "037_scissors",
    "042_adjustable_wrench",
    "048_hammer",
    "055_baseball",
    "072-a_toy_airplane",
];

/// A number of the tables: column of the results, title, whether larger is better.
pub(super) struct Quantity {
    pub(super) column: &'static str,
    pub(super) title: &'static str,
    pub(super) larger_is_better: bool,
}

/// What the tables and plots show.
pub(super) const QUANTITIES: [Quantity; 4] = [
    Quantity { column: "volumetric_iou", title: "Volumetric IoU", larger_is_better: true },
    Quantity { column: "chamfer_mean_mm", title: "Chamfer mean, mm", larger_is_better: false },
    Quantity { column: "f_score_5mm", title: "F-score at 5 mm", larger_is_better: true },
    Quantity { column: "hidden_chamfer_mean_mm", title: "Hidden side: Chamfer mean, mm", larger_is_better: false },
];

/// Runs with the same method, source of symmetry and number of touches.
pub(super) struct Series<'a> {
    pub(super) label: String,
    pub(super) touches: usize,
    pub(super) rows: Vec<&'a Row>,
}

/// Groups rows by method and source of symmetry, then touches, in this order.
pub(super) fn series(rows: &[Row]) -> Vec<Series<'_>> {
    let mut sorted: Vec<&Row> = rows.iter().collect();
    let group = |row: &Row| (row.key.method.clone(), row.key.symmetry.clone(), row.key.touches);
    sorted.sort_by_key(|row| (group(row), row.key.clone()));
    let mixed = rows.iter().any(|row| row.key.symmetry != rows[0].key.symmetry);
    sorted
        .chunk_by(|a, b| group(a) == group(b))
        .map(|chunk| {
            let key = &chunk[0].key;
            let plain = key.symmetry == "estimated" && !mixed;
            let label = if plain { key.method.clone() } else { format!("{}, {} symmetry", key.method, key.symmetry) };
            Series { label, touches: key.touches, rows: chunk.to_vec() }
        })
        .collect()
}

/// The value of a run. No mesh, or an open one, encloses nothing: its IoU counts as 0; distances it has none.
pub(super) fn value(row: &Row, column: &str) -> Option<f64> {
    row.metric(column).or((column == "volumetric_iou").then_some(0.0))
}

/// Sums up one column over runs; the views of an object make one bootstrap group.
pub(super) fn summary_of(rows: &[&Row], column: &str) -> Option<Summary> {
    let groups: Vec<Vec<f64>> = rows
        .chunk_by(|a, b| a.key.object == b.key.object)
        .map(|views| views.iter().filter_map(|row| value(row, column)).collect())
        .collect();
    summarize(&groups, 0)
}

/// Writes `summary.md` into the folder.
pub(super) fn write(folder: &Path, rows: &[Row]) -> anyhow::Result<()> {
    let text = markdown(rows);
    palpate::io::atomic_write(folder.join("summary.md"), |file| std::io::Write::write_all(file, text.as_bytes()))?;
    Ok(())
}

fn markdown(rows: &[Row]) -> String {
    let is_in = |names: &[&str], row: &Row| names.contains(&row.key.object.as_str());
    let mut text = String::from("# Shape benchmark\n\n");
    let objects = count_objects(rows);
    let _ = writeln!(
        text,
        "{} runs on {objects} objects. Chamfer mean = half the sum of the two mean distances, mm; nothing is aligned. \
         \"Hidden side\" is what the camera does not see. Intervals: 95 % bootstrap of the mean over objects. A run without \
         a mesh, or with an open one, counts as IoU 0 and has no part in the distances if there is no mesh. Times are wall \
         time of one run while others ran beside it.\n",
        rows.len()
    );
    let _ = writeln!(text, "## All objects\n\n{}", overview(&series(rows)));
    for quantity in &QUANTITIES {
        let _ = writeln!(text, "### {}\n\n{}", quantity.title, details(&series(rows), quantity));
    }
    let splits: [(&str, Box<dyn Fn(&Row) -> bool>); 4] = [
        ("Without bowl and plate", Box::new(|row| !is_in(&SHELLS, row))),
        ("Bowl and plate (shells of about 1 mm)", Box::new(|row| is_in(&SHELLS, row))),
        ("Development objects (constants were chosen on them)", Box::new(|row| is_in(&DEVELOPMENT, row))),
        ("Other objects", Box::new(|row| !is_in(&DEVELOPMENT, row))),
    ];
    for (title, keep) in &splits {
        let part: Vec<Row> = rows.iter().filter(|row| keep(row)).cloned().collect();
        if !part.is_empty() && part.len() < rows.len() {
            let _ = writeln!(text, "## {title}: {}\n\n{}", count_objects(&part), overview(&series(&part)));
        }
    }
    for quantity in &QUANTITIES[..2] {
        let _ = writeln!(text, "## By object: {}, mean over views\n\n{}", quantity.title, by_object(rows, quantity));
    }
    text + &failures(rows)
}

fn count_objects(rows: &[Row]) -> usize {
    let mut names: Vec<&str> = rows.iter().map(|row| row.key.object.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    names.len()
}

fn overview(series: &[Series]) -> String {
    let mut text = String::from(
        "| method | touches | runs | failed | closed | IoU | Chamfer mean, mm | F@5 mm | hidden Chamfer mean, mm | s |\n\
         |---|---|---|---|---|---|---|---|---|---|\n",
    );
    for s in series {
        let mean = |column: &str, digits: usize| {
            summary_of(&s.rows, column).map_or_else(|| "–".to_owned(), |v| format!("{:.digits$}", v.mean))
        };
        let ok: Vec<&&Row> = s.rows.iter().filter(|row| row.error.is_empty()).collect();
        let closed = ok.iter().filter(|row| row.watertight).count();
        let seconds = ok.iter().map(|row| row.seconds).sum::<f64>() / ok.len().max(1) as f64;
        let _ = writeln!(
            text,
            "| {} | {} | {} | {} | {closed} | {} | {} | {} | {} | {seconds:.2} |",
            s.label,
            s.touches,
            s.rows.len(),
            s.rows.len() - ok.len(),
            mean("volumetric_iou", 3),
            mean("chamfer_mean_mm", 2),
            mean("f_score_5mm", 3),
            mean("hidden_chamfer_mean_mm", 2),
        );
    }
    text
}

fn details(series: &[Series], quantity: &Quantity) -> String {
    let mut text = String::from("| method | touches | n | mean | 95 % interval | median | worst | worst object |\n");
    text += "|---|---|---|---|---|---|---|---|\n";
    for s in series {
        let Some(v) = summary_of(&s.rows, quantity.column) else { continue };
        let worst = if quantity.larger_is_better { v.min } else { v.max };
        let object = s.rows.iter().find(|row| value(row, quantity.column) == Some(worst));
        let _ = writeln!(
            text,
            "| {} | {} | {} | {:.3} | {:.3} – {:.3} | {:.3} | {worst:.3} | {} |",
            s.label,
            s.touches,
            v.count,
            v.mean,
            v.interval.low,
            v.interval.high,
            v.median,
            object.map_or("", |row| row.key.object.as_str()),
        );
    }
    text
}

fn by_object(rows: &[Row], quantity: &Quantity) -> String {
    let all = series(rows);
    let mut objects: Vec<&str> = rows.iter().map(|row| row.key.object.as_str()).collect();
    objects.sort_unstable();
    objects.dedup();
    let mut text = String::from("| object |");
    for s in &all {
        let _ = write!(text, " {} @{} |", s.label, s.touches);
    }
    let _ = write!(text, "\n|---|{}", "---|".repeat(all.len()));
    for object in objects {
        let star = if DEVELOPMENT.contains(&object) { "\\*" } else { "" };
        let _ = write!(text, "\n| {object}{star} |");
        for s in &all {
            let values: Vec<f64> = s
                .rows
                .iter()
                .filter(|row| row.key.object == object)
                .filter_map(|row| value(row, quantity.column))
                .collect();
            let _ = if values.is_empty() {
                write!(text, " – |")
            } else {
                write!(text, " {:.3} |", values.iter().sum::<f64>() / values.len() as f64)
            };
        }
    }
    text + "\n\n\\* development object\n"
}

fn failures(rows: &[Row]) -> String {
    let failed: Vec<&Row> = rows.iter().filter(|row| !row.error.is_empty()).collect();
    if failed.is_empty() {
        return String::new();
    }
    let mut text = format!("## Failed runs: {}\n\n", failed.len());
    for row in failed.iter().take(50) {
        let key = &row.key;
        let _ = writeln!(
            text,
            "- {} view {}, {} touches, {}: {}",
            key.object, key.view, key.touches, key.method, row.error
        );
    }
    if failed.len() > 50 {
        let _ = writeln!(text, "- and {} more in results.csv", failed.len() - 50);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::row;
    use super::*;

    #[test]
    fn means_splits_and_failures_are_told() {
        let mut failed = row("024_bowl", 0, "paper-psr", 0.0);
        failed.metrics.fill(None);
        failed.error = "no plane".to_owned();
        let rows = [
            row("003_cracker_box", 0, "fused", 0.9),
            row("024_bowl", 0, "fused", 0.2),
            row("003_cracker_box", 0, "paper-psr", 0.7),
            failed,
        ];
        let text = markdown(&rows);
        // Mean IoU 0.55; Chamfer of the stand-in rows is 2 − IoU.
        assert!(text.contains("| fused | 0 | 2 | 0 | 0 | 0.550 | 1.45 |"), "{text}");
        assert!(text.contains("| paper-psr | 0 | 2 | 1 | 0 | 0.350 | 1.30 |"), "{text}");
        assert!(text.contains("## Without bowl and plate: 1\n"));
        assert!(text.contains("| 024_bowl\\* | 0.200 | 0.000 |"));
        assert!(text.contains("- 024_bowl view 0, 0 touches, paper-psr: no plane"));
        assert!(text.contains("| fused | 0 | 2 | 0.550 | 0.200 – 0.900 | 0.550 | 0.200 | 024_bowl |"), "{text}");
    }
}
