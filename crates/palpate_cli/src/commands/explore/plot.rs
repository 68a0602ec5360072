//! Error against touches, one line a policy.

use super::results::Row;
use super::summary::{POLICIES, groups, most_touches};
use kuva::backend::svg::SvgBackend;
use kuva::plot::{LinePlot, ScatterPlot};
use kuva::render::figure::Figure;
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use palpate::metrics::summarize;
use std::path::Path;

/// Okabe & Ito's palette, as in the benchmark's plots; one colour a policy whichever were run.
const COLORS: [&str; 4] = ["#D55E00", "#E69F00", "#0072B2", "#009E73"];

/// Writes the plot; nothing if there is no row.
pub(super) fn write(path: &Path, rows: &[Row]) -> anyhow::Result<()> {
    if rows.is_empty() {
        return Ok(());
    }
    let panels = vec![panel(rows, |r| Some(r.chamfer_mean_mm)), panel(rows, |r| r.volumetric_iou)];
    let titles = ["Chamfer mean, mm (smaller is better)", "volumetric IoU (larger is better)"];
    let layouts: Vec<Layout> = panels
        .iter()
        .zip(titles)
        .map(|(plots, title)| {
            Layout::auto_from_plots(plots)
                .with_title(title)
                .with_x_label("touches")
                .with_y_label("mean, 95 % interval over objects")
        })
        .collect();
    let figure = Figure::new(1, 2)
        .with_plots(panels)
        .with_layouts(layouts)
        .with_cell_size(520.0, 380.0)
        .with_shared_legend_bottom();
    let svg = SvgBackend.render_scene(&figure.render());
    palpate::io::atomic_write(path, |file| std::io::Write::write_all(file, svg.as_bytes()))?;
    Ok(())
}

fn panel(rows: &[Row], value: fn(&Row) -> Option<f64>) -> Vec<Plot> {
    let mut plots = Vec::new();
    for (policy, color) in POLICIES.iter().zip(COLORS) {
        let points: Vec<_> = (0..=most_touches(rows))
            .filter_map(|touches| {
                let groups: Vec<Vec<f64>> = groups(rows, policy, touches, value).into_values().collect();
                Some((touches as f64, summarize(&groups, 0)?))
            })
            .collect();
        if points.is_empty() {
            continue;
        }
        let means: Vec<(f64, f64)> = points.iter().map(|(x, s)| (*x, s.mean)).collect();
        let line = LinePlot::new().with_data(means.clone()).with_color(color);
        let line = if points.iter().all(|(_, s)| s.interval.high > s.interval.low) {
            let (low, high) = (points.iter().map(|(_, s)| s.interval.low), points.iter().map(|(_, s)| s.interval.high));
            line.with_band(low, high)
        } else {
            line
        };
        plots.push(Plot::Line(line.with_stroke_width(2.0).with_legend(*policy)));
        plots.push(Plot::Scatter(ScatterPlot::new().with_data(means).with_color(color).with_size(4.0)));
    }
    plots
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::row;
    use super::*;

    #[test]
    fn the_plot_names_the_policies_that_were_run() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("touches.svg");
        write(&path, &[row("mug", "random", 0, 2.0), row("mug", "random", 1, 1.0)]).expect("written");
        let svg = std::fs::read_to_string(&path).expect("there");
        assert!(svg.contains("random") && !svg.contains("oracle"));
    }
}
