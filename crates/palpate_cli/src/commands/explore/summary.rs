//! Means over the runs, and the share of the gap between random and oracle that a policy closes.

use super::results::Row;
use crate::say;
use palpate::explore::{ObjectErrors, gap_closed};
use palpate::io;
use palpate::metrics::summarize;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

pub(super) const POLICIES: [&str; 4] = ["random", "even", "next-best", "oracle"];

pub(super) fn write(path: &Path, rows: &[Row]) -> anyhow::Result<()> {
    io::write_text(path, &text(rows))?;
    Ok(())
}

/// Values of a policy after a number of touches by object. Runs of different length have the same beginning: each counts once.
///
/// A run that ended before the touches asked for (no other place could be reached) keeps its last value, or the mean of the later
/// counts would be over other objects than that of the earlier ones.
pub(super) fn groups(
    rows: &[Row],
    policy: &str,
    touches: usize,
    value: fn(&Row) -> Option<f64>,
) -> BTreeMap<String, Vec<f64>> {
    let mut runs = BTreeMap::new();
    for row in rows.iter().filter(|r| r.key.policy == policy && r.touches <= touches && touches <= r.key.asked) {
        let run = runs.entry((&row.key.object, row.key.view, row.key.seed)).or_insert(row);
        if row.touches > run.touches {
            *run = row;
        }
    }
    let mut by_object: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for ((object, ..), row) in runs {
        by_object.entry(object.clone()).or_default().extend(value(row));
    }
    by_object
}

pub(super) fn most_touches(rows: &[Row]) -> usize {
    rows.iter().map(|r| r.touches).max().unwrap_or(0)
}

/// Runs that ended before the touches asked for.
fn ended_early(rows: &[Row]) -> usize {
    let mut last: BTreeMap<(&String, usize, u64, &String, usize), usize> = BTreeMap::new();
    for Row { key, touches, .. } in rows {
        let run = last.entry((&key.object, key.view, key.seed, &key.policy, key.asked)).or_default();
        *run = (*run).max(*touches);
    }
    last.iter().filter(|((.., asked), touches)| *touches < asked).count()
}

/// A Markdown table, and the gap closed where random and oracle were run.
pub(super) fn text(rows: &[Row]) -> String {
    let mut out = String::from(
        "| policy | touches | runs | Chamfer mean, mm (95 % interval over objects) | volumetric IoU | misses a run |\n|---|---|---|---|---|---|\n",
    );
    for policy in POLICIES {
        for touches in 0..=most_touches(rows) {
            let of = |value| groups(rows, policy, touches, value).into_values().collect::<Vec<_>>();
            let Some(error) = summarize(&of(|r| Some(r.chamfer_mean_mm)), 0) else { continue };
            let iou = summarize(&of(|r| r.volumetric_iou), 0).map_or_else(|| "–".into(), |s| format!("{:.3}", s.mean));
            let misses = summarize(&of(|r| Some(r.misses as f64)), 0).map_or(0.0, |s| s.mean);
            let (low, high) = (error.interval.low, error.interval.high);
            let _ = writeln!(
                out,
                "| {policy} | {touches} | {} | {:.3} ({low:.3} to {high:.3}) | {iou} | {misses:.2} |",
                error.count, error.mean
            );
        }
    }
    let early = ended_early(rows);
    if early > 0 {
        let runs = say::count(early, "run", "runs");
        let _ = writeln!(
            out,
            "\n{runs} ended early, no other place could be reached: the last error counts for the touches not made."
        );
    }
    for policy in ["next-best", "even"] {
        for touches in 1..=most_touches(rows) {
            let objects = paired(rows, policy, touches);
            if let Some((share, interval)) = gap_closed(&objects, 0) {
                let _ = writeln!(
                    out,
                    "\n{policy} closes {:.0} % of the gap between random and oracle after {touches} touches (95 % interval {:.0} to {:.0} %, {} objects).",
                    100.0 * share,
                    100.0 * interval.low,
                    100.0 * interval.high,
                    objects.len()
                );
            }
        }
    }
    out
}

/// Objects that were explored with the policy, with random and with the oracle: mean Chamfer over the runs.
fn paired(rows: &[Row], policy: &str, touches: usize) -> Vec<ObjectErrors> {
    let means = |policy| -> BTreeMap<String, f64> {
        let groups = groups(rows, policy, touches, |r| Some(r.chamfer_mean_mm));
        groups.into_iter().map(|(o, v)| (o, v.iter().sum::<f64>() / v.len().max(1) as f64)).collect()
    };
    let (random, chosen, oracle) = (means("random"), means(policy), means("oracle"));
    let of = |(object, &random): (&String, &f64)| {
        Some(ObjectErrors { random, chosen: *chosen.get(object)?, oracle: *oracle.get(object)? })
    };
    random.iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::row;
    use super::*;

    #[test]
    fn the_table_has_every_policy_and_the_gap_is_stated_where_it_can_be() {
        let rows = [row("mug", "random", 5, 2.0), row("mug", "next-best", 5, 1.5), row("mug", "oracle", 5, 1.0)];
        let said = text(&rows);
        assert!(said.contains("next-best closes 50 % of the gap"), "{said}");
        assert!(said.contains("| oracle | 5 | 1 | 1.000"), "{said}");
        assert!(!text(&rows[..2]).contains("closes"), "no oracle, no gap");
    }

    #[test]
    fn a_run_that_ended_early_keeps_its_last_error() {
        // Two objects; the can could be touched twice, the mug as often as asked (5 times).
        let mut rows: Vec<Row> = (0..=5).map(|n| row("mug", "random", n, 1.0)).collect();
        rows.extend((0..=2).map(|n| row("can", "random", n, 3.0)));
        let said = text(&rows);
        for touches in [2, 3, 5] {
            assert!(said.contains(&format!("| random | {touches} | 2 | 2.000")), "{said}");
        }
        assert!(said.contains("1 run ended early"), "{said}");
        assert!(!text(&rows[..6]).contains("ended early"), "the mug alone was touched as often as asked");
    }
}
