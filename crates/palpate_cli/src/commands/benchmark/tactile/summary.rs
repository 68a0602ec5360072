//! `summary.md` and the box plots.

use super::super::plots::COLORS;
use super::results::Row;
use kuva::backend::svg::SvgBackend;
use kuva::plot::{BoxPlot, LegendEntry, LegendShape};
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use palpate::metrics::{Summary, summarize};
use std::fmt::Write as _;
use std::path::Path;

/// Share of the pad from which a contact counts as a flat face.
const FLAT: f64 = 0.5;

/// Writes `summary.md`, `height.svg` and `mask.svg`; `notes` are paragraphs on what the rows are of.
pub(super) fn write(folder: &Path, rows: &[Row], notes: &[String]) -> anyhow::Result<()> {
    palpate::io::write_text(folder.join("summary.md"), &markdown(rows, notes))?;
    let plots = [
        ("height.svg", "rmse_px", "RMSE of the height, px of 0.0295 mm", None),
        ("mask.svg", "mask_iou", "IoU of the contact mask", Some(1.0)),
    ];
    for (name, column, title, top) in plots {
        if rows.iter().any(|row| row.value(column).is_some()) {
            palpate::io::write_text(folder.join(name), &boxes(rows, column, title, top))?;
        }
    }
    Ok(())
}

fn markdown(rows: &[Row], notes: &[String]) -> String {
    let mut text = String::from("# Tactile benchmark\n\n");
    for note in notes {
        let _ = writeln!(text, "{note}\n");
    }
    text += "Height: indentation (relaxed gel minus gel), decoded against true; whole = all of the pad, contact = inside the true mask. \
             px = 0.0295 mm. Every image counts alike; intervals are 95 % bootstraps over objects. ms = time of one image while \
             others ran beside it.\n\n";
    let is_flat = |row: &&Row| row.value("truth_share").is_some_and(|s| s > FLAT);
    let (flat, rest): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| is_flat(row));
    let _ = writeln!(text, "## All images\n\n{}", overview(&rows.iter().collect::<Vec<_>>()));
    if !flat.is_empty() {
        let _ = writeln!(text, "## Flat faces: true contact on more than half of the pad\n\n{}", overview(&flat));
        let _ = writeln!(text, "## All others\n\n{}", overview(&rest));
    }
    let _ = writeln!(text, "## By object: RMSE whole, mm / in contact, mm / mask IoU\n\n{}", by_object(rows));
    text + &failures(rows)
}

/// Names without repetition, sorted.
fn names<'a>(rows: impl IntoIterator<Item = &'a Row>, name: impl Fn(&'a Row) -> &'a str) -> Vec<&'a str> {
    let mut names: Vec<&str> = rows.into_iter().map(name).collect();
    names.sort_unstable();
    names.dedup();
    names
}

fn decoders<'a>(rows: impl IntoIterator<Item = &'a Row>) -> Vec<&'a str> {
    names(rows, |row| &row.key.decoder)
}

fn objects<'a>(rows: impl IntoIterator<Item = &'a Row>) -> Vec<&'a str> {
    names(rows, |row| &row.key.object)
}

/// Sums up a column; the images of an object make one bootstrap group. Rows are sorted by object.
fn summary_of(rows: &[&Row], column: &str) -> Option<Summary> {
    let groups: Vec<Vec<f64>> = rows
        .chunk_by(|a, b| a.key.object == b.key.object)
        .map(|images| images.iter().filter_map(|row| row.value(column)).collect())
        .collect();
    summarize(&groups, 0)
}

fn overview(rows: &[&Row]) -> String {
    let mut text = String::from(
        "| decoder | images | failed | RMSE whole, mm | 95 % | median | px | in contact, mm | px | bias, mm | normals, ° | IoU | 95 % | median | F1 | ms |\n\
         |---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for decoder in decoders(rows.iter().copied()) {
        let own: Vec<&Row> = rows.iter().copied().filter(|row| row.key.decoder == decoder).collect();
        let failed = own.iter().filter(|row| !row.error.is_empty()).count();
        let show = |column: &str, f: &dyn Fn(&Summary) -> String| {
            summary_of(&own, column).map_or_else(|| "–".to_owned(), |s| f(&s))
        };
        let mean = |column: &str, digits: usize| show(column, &|s| format!("{:.digits$}", s.mean));
        let median = |column: &str| show(column, &|s| format!("{:.3}", s.median));
        let interval = |column: &str| show(column, &|s| format!("{:.3} – {:.3}", s.interval.low, s.interval.high));
        let _ = writeln!(
            text,
            "| {decoder} | {} | {failed} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            own.len(),
            mean("rmse_mm", 3),
            interval("rmse_mm"),
            median("rmse_mm"),
            mean("rmse_px", 2),
            mean("contact_rmse_mm", 3),
            mean("contact_rmse_px", 2),
            show("contact_bias_mm", &|s| format!("{:+.3}", s.mean)),
            mean("normal_error_deg", 2),
            mean("mask_iou", 3),
            interval("mask_iou"),
            median("mask_iou"),
            mean("mask_f1", 3),
            show("seconds", &|s| format!("{:.1}", 1e3 * s.mean)),
        );
    }
    text
}

fn by_object(rows: &[Row]) -> String {
    let all = decoders(rows);
    let mut text = format!("| object | images | {} |\n|---|---|{}\n", all.join(" | "), "---|".repeat(all.len()));
    for object in objects(rows) {
        let of: Vec<&Row> = rows.iter().filter(|row| row.key.object == object).collect();
        let _ = write!(text, "| {object} | {} |", names(of.iter().copied(), |row| &row.key.press).len());
        for decoder in &all {
            let own: Vec<&Row> = of.iter().copied().filter(|row| row.key.decoder == *decoder).collect();
            let mean = |column| summary_of(&own, column).map_or_else(|| "–".to_owned(), |s| format!("{:.3}", s.mean));
            let _ = write!(text, " {} / {} / {} |", mean("rmse_mm"), mean("contact_rmse_mm"), mean("mask_iou"));
        }
        text.push('\n');
    }
    text + "\n"
}

fn failures(rows: &[Row]) -> String {
    let failed: Vec<&Row> = rows.iter().filter(|row| !row.error.is_empty()).collect();
    if failed.is_empty() {
        return String::new();
    }
    let mut text = format!("## Failed: {}\n\n", failed.len());
    for row in failed.iter().take(50) {
        let _ = writeln!(text, "- {} {}, {}: {}", row.key.object, row.key.press, row.key.decoder, row.error);
    }
    if failed.len() > 50 {
        let _ = writeln!(text, "- and {} more in the csv file", failed.len() - 50);
    }
    text
}

/// Box plots object by object, the decoders side by side.
///
/// * `top` – end of the axis, if the numbers have a largest value
fn boxes(rows: &[Row], column: &str, title: &str, top: Option<f64>) -> String {
    let has_values = |decoder: &&str| rows.iter().any(|r| r.key.decoder == *decoder && r.value(column).is_some());
    let decoders: Vec<&str> = decoders(rows).into_iter().filter(has_values).collect();
    let objects = objects(rows);
    // Each object has a place for every decoder and a gap; the decoders' plots leave each other's places empty.
    let slots = decoders.len() + 1;
    let plots: Vec<Plot> = decoders
        .iter()
        .enumerate()
        .zip(COLORS.iter().cycle())
        .map(|((own, decoder), color)| {
            let mut plot = BoxPlot::new().with_color(*color).with_width(0.8);
            for (object, slot) in objects.iter().flat_map(|o| (0..slots).map(move |slot| (*o, slot))) {
                let is_own = |row: &&Row| slot == own && row.key.object == object && row.key.decoder == *decoder;
                let values: Vec<f64> = rows.iter().filter(is_own).filter_map(|row| row.value(column)).collect();
                let label = if slot == decoders.len() / 2 { short(object) } else { "" };
                plot = plot.with_group(label, values);
            }
            Plot::Box(plot)
        })
        .collect();
    let legend = decoders.iter().zip(COLORS.iter().cycle()).map(|(decoder, color)| LegendEntry {
        label: (*decoder).to_owned(),
        color: (*color).to_owned(),
        shape: LegendShape::Rect,
        dasharray: None,
    });
    let layout = Layout::auto_from_plots(&plots)
        .with_legend_entries(legend.collect())
        .with_title(title)
        .with_y_label(title)
        .with_y_axis_min(0.0)
        .with_x_tick_rotate(-60.0)
        .with_width(220.0 + (16 * slots * objects.len()).max(300) as f64)
        .with_height(420.0);
    let layout = match top {
        Some(top) => layout.with_y_axis_max(top),
        None => layout,
    };
    SvgBackend.render_scene(&kuva::render::render::render_multiple(plots, layout))
}

/// The number of an object of the YCB set, or its whole name.
fn short(object: &str) -> &str {
    object.split_once('_').map_or(object, |(number, _)| number)
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::row;
    use super::super::results::{Key, Row};
    use super::*;

    #[test]
    fn tables_and_plots_name_what_there_is() {
        let key = Key { object: "036_block".to_owned(), press: "1".to_owned(), decoder: "lookup".to_owned() };
        let rows = [
            row("004_box", "0", "lookup", 0.3, 0.8),
            row("004_box", "0", "threshold", 0.0, 0.8),
            row("036_block", "0", "lookup", 0.1, 0.1),
            Row::failed(key, "too dark".to_owned()),
        ];
        let folder = tempfile::tempdir().expect("a temporary folder");
        write(folder.path(), &rows, &["**Note.**".to_owned()]).expect("written");
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("there");
        let text = read("summary.md");
        assert!(text.contains("**Note.**"));
        // Mean of 0.3 and 0.1 mm over two objects; 0.2 mm are 6.78 px.
        assert!(text.contains("| lookup | 3 | 1 | 0.200 | 0.100 – 0.300 | 0.200 | 6.78 | 0.400 |"), "{text}");
        assert!(text.contains("| threshold | 1 | 0 | – |"), "{text}");
        assert!(text.contains("| 004_box | 1 | 0.300 / 0.600 / 0.750 | – / – / 0.750 |"), "{text}");
        assert!(text.contains("- 036_block 1, lookup: too dark"));
        assert!(text.contains("## Flat faces"));
        assert!(read("mask.svg").contains("036") && read("height.svg").contains("lookup"));
    }
}
