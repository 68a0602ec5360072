//! The curves of a training run, as SVG.

use kuva::backend::svg::SvgBackend;
use kuva::plot::LinePlot;
use kuva::render::figure::Figure;
use kuva::render::layout::Layout;
use kuva::render::plots::Plot;
use palpate_nn::train::MetricLog;
use std::io::Write as _;
use std::path::Path;

/// Training loss and each validation metric over the epochs, one panel each.
pub(super) fn write(path: &Path, log: &MetricLog) -> anyhow::Result<()> {
    // A line needs two points.
    if log.rows.len() < 2 {
        return Ok(());
    }
    let series = |value: &dyn Fn(usize) -> f64| -> Vec<(f64, f64)> {
        log.rows.iter().enumerate().map(|(i, row)| (row.epoch, value(i))).collect()
    };
    let mut curves = vec![("training loss", series(&|i| log.rows[i].train_loss))];
    for (m, name) in log.names.iter().enumerate() {
        curves.push((name.as_str(), series(&|i| log.rows[i].values[m])));
    }
    let panels: Vec<Vec<Plot>> = curves
        .iter()
        .map(|(_, points)| {
            let line = LinePlot::new().with_data(points.clone()).with_color("#0072B2").with_stroke_width(2.0);
            vec![Plot::Line(line)]
        })
        .collect();
    let layouts: Vec<Layout> = panels
        .iter()
        .zip(&curves)
        .map(|(plots, (name, _))| {
            let title = if *name == "training loss" { (*name).to_owned() } else { format!("validation {name}") };
            Layout::auto_from_plots(plots).with_title(title).with_x_label("epoch")
        })
        .collect();
    let figure =
        Figure::new(curves.len().div_ceil(2), 2).with_plots(panels).with_layouts(layouts).with_cell_size(480.0, 320.0);
    let svg = SvgBackend.render_scene(&figure.render());
    palpate::io::atomic_write(path, |file| file.write_all(svg.as_bytes()))?;
    Ok(())
}
