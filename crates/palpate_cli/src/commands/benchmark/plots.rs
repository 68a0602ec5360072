//! The plots of the shape benchmark, as SVG.

use super::results::Row;
use super::summary::{QUANTITIES, Quantity, Series, series, summary_of, value};
use kuva::backend::svg::SvgBackend;
use kuva::plot::{BoxPlot, LinePlot, ScatterPlot};
use kuva::render::figure::Figure;
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use std::path::Path;

/// Okabe & Ito's palette: told apart by colour-blind readers too.
pub(super) const COLORS: [&str; 6] = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9"];

/// Writes `touches.svg`, `distribution.svg` and `objects.svg` into the folder; nothing if no run gave a mesh.
pub(super) fn write(folder: &Path, rows: &[Row]) -> anyhow::Result<()> {
    if rows.iter().all(|row| !row.error.is_empty()) {
        return Ok(());
    }
    let all = series(rows);
    for (name, svg) in [("touches", touches(&all)), ("distribution", distribution(&all)), ("objects", objects(&all))] {
        let path = folder.join(name).with_extension("svg");
        palpate::io::atomic_write(path, |file| std::io::Write::write_all(file, svg.as_bytes()))?;
    }
    Ok(())
}

/// Labels in order, each with its series by touches.
fn by_label<'a, 'r>(all: &'a [Series<'r>]) -> Vec<(&'a str, &'a [Series<'r>])> {
    all.chunk_by(|a, b| a.label == b.label).map(|chunk| (chunk[0].label.as_str(), chunk)).collect()
}

/// Means with bootstrap intervals over the number of touches: one panel a quantity, one line a method.
fn touches(all: &[Series]) -> String {
    let panels: Vec<Vec<Plot>> = QUANTITIES.iter().map(|quantity| touch_panel(all, quantity)).collect();
    let layouts = panels.iter().zip(&QUANTITIES).map(|(plots, quantity)| {
        let better = if quantity.larger_is_better { "larger is better" } else { "smaller is better" };
        Layout::auto_from_plots(plots)
            .with_title(format!("{} ({better})", quantity.title))
            .with_x_label("touches")
            .with_y_label("mean, 95 % interval")
    });
    let layouts: Vec<Layout> = layouts.collect();
    let figure = Figure::new(2, 2)
        .with_plots(panels)
        .with_layouts(layouts)
        .with_cell_size(520.0, 380.0)
        .with_shared_legend_bottom();
    SvgBackend.render_scene(&figure.render())
}

fn touch_panel(all: &[Series], quantity: &Quantity) -> Vec<Plot> {
    let mut plots = Vec::new();
    for ((label, by_touches), color) in by_label(all).into_iter().zip(COLORS.iter().cycle()) {
        let points: Vec<_> =
            by_touches.iter().filter_map(|s| Some((s.touches as f64, summary_of(&s.rows, quantity.column)?))).collect();
        let means: Vec<(f64, f64)> = points.iter().map(|(x, v)| (*x, v.mean)).collect();
        let line = LinePlot::new()
            .with_data(means.clone())
            .with_color(*color)
            // After the colour: the band takes that of the line so far.
            .with_band(points.iter().map(|(_, v)| v.interval.low), points.iter().map(|(_, v)| v.interval.high))
            .with_stroke_width(2.0)
            .with_legend(label);
        plots.push(Plot::Line(line));
        plots.push(Plot::Scatter(ScatterPlot::new().with_data(means).with_color(*color).with_size(4.0)));
    }
    plots
}

/// Box plot of the IoU of all runs, by method and touches.
fn distribution(all: &[Series]) -> String {
    let mut plot = BoxPlot::new();
    let mut colors = Vec::new();
    for ((label, by_touches), color) in by_label(all).into_iter().zip(COLORS.iter().cycle()) {
        for s in by_touches {
            let values: Vec<f64> = s.rows.iter().filter_map(|row| value(row, QUANTITIES[0].column)).collect();
            plot = plot.with_group(format!("{label} @{}", s.touches), values);
            colors.push(*color);
        }
    }
    let width = 140.0 + 50.0 * all.len() as f64;
    // Every run as a dot: the worst objects lie far outside the whiskers.
    let plot = plot.with_group_colors(colors).with_strip(0.25).with_overlay_color("#444444").with_overlay_size(1.5);
    let plots = vec![Plot::Box(plot)];
    let layout = Layout::auto_from_plots(&plots)
        .with_title("Volumetric IoU of all runs, by method @ touches")
        .with_y_label("volumetric IoU")
        .with_y_axis_min(0.0)
        .with_y_axis_max(1.0)
        .with_x_tick_rotate(-45.0)
        .with_width(width.max(500.0))
        .with_height(420.0);
    SvgBackend.render_scene(&kuva::render::render::render_multiple(plots, layout))
}

/// One row an object, one dot a method: mean over views at the largest number of touches that all methods have.
fn objects(all: &[Series]) -> String {
    let labels = by_label(all);
    let in_all = |touches: &usize| labels.iter().all(|(_, s)| s.iter().any(|s| s.touches == *touches));
    let most = all.iter().map(|s| s.touches).filter(in_all).max();
    let most = most.or(all.iter().map(|s| s.touches).max()).unwrap_or(0);
    let mut names: Vec<&str> = all.iter().flat_map(|s| &s.rows).map(|row| row.key.object.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    names.reverse();
    let panels: Vec<Vec<Plot>> = QUANTITIES[..2].iter().map(|q| object_panel(&labels, &names, most, q)).collect();
    let categories: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
    let layouts: Vec<Layout> = panels
        .iter()
        .zip(&QUANTITIES)
        .map(|(plots, quantity)| {
            Layout::auto_from_plots(plots)
                .with_title(format!("{}, {most} touches", quantity.title))
                .with_x_label(quantity.title)
                .with_y_categories(categories.clone())
                .with_y_axis_min(0.5)
                .with_y_axis_max(names.len() as f64 + 0.5)
                .with_x_axis_min(0.0)
        })
        .collect();
    let figure = Figure::new(1, 2)
        .with_plots(panels)
        .with_layouts(layouts)
        .with_cell_size(560.0, 120.0 + 20.0 * names.len() as f64)
        .with_shared_legend_bottom();
    SvgBackend.render_scene(&figure.render())
}

fn object_panel(labels: &[(&str, &[Series])], names: &[&str], touches: usize, quantity: &Quantity) -> Vec<Plot> {
    let mut plots = Vec::new();
    for ((label, by_touches), color) in labels.iter().zip(COLORS.iter().cycle()) {
        let rows = by_touches.iter().find(|s| s.touches == touches).map_or(&[][..], |s| &s.rows);
        let points: Vec<(f64, f64)> = (1..)
            .zip(names)
            .filter_map(|(place, name)| {
                let views = rows.iter().filter(|row| row.key.object == *name);
                let values: Vec<f64> = views.filter_map(|row| value(row, quantity.column)).collect();
                let mean = values.iter().sum::<f64>() / values.len() as f64;
                (!values.is_empty()).then_some((mean, f64::from(place)))
            })
            .collect();
        plots.push(Plot::Scatter(
            ScatterPlot::new().with_data(points).with_color(*color).with_size(4.5).with_legend(*label),
        ));
    }
    plots
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::row;
    use super::*;

    #[test]
    fn plots_name_methods_and_objects() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let rows: Vec<Row> = ["can", "mug"]
            .iter()
            .flat_map(|object| [0, 5].map(|touches| row(object, touches, "fused", 0.8)))
            .chain([row("can", 5, "paper-psr", 0.6)])
            .collect();
        write(folder.path(), &rows).expect("written");
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect("there");
        assert!(read("touches.svg").contains("paper-psr"));
        assert!(read("objects.svg").contains("mug"));
        assert!(read("distribution.svg").contains("fused @5"));
    }
}
