//! The tree of frames over time.

use crate::{ImportError, TransformStamped};
use nalgebra::Isometry3;
use std::collections::BTreeMap;

/// A transform may be used this long before its first and after its last stamp, nanoseconds.
const SLACK: i64 = 100_000_000;

/// Transforms of a recording: static ones hold always, others between their stamps.
#[derive(Debug, Clone, Default)]
pub struct TfTree {
    links: BTreeMap<String, Link>,
}

#[derive(Debug, Clone)]
struct Link {
    parent: String,
    fixed: bool,
    /// By time.
    samples: BTreeMap<i64, Isometry3<f64>>,
}

impl TfTree {
    /// Adds a transform.
    ///
    /// * `fixed` – of `/tf_static`
    pub fn insert(&mut self, transform: TransformStamped, fixed: bool) {
        let TransformStamped { header, child, parent_from_child } = transform;
        let link = self.links.entry(child).or_insert_with(|| Link {
            parent: header.frame.clone(),
            fixed,
            samples: BTreeMap::new(),
        });
        if link.parent != header.frame {
            // A frame that changes hands: the last parent counts.
            *link = Link { parent: header.frame, fixed, samples: BTreeMap::new() };
        }
        link.samples.insert(header.stamp, parent_from_child);
    }

    /// `target_from_source` at a time, nanoseconds; between two stamps positions are linear and turns spherically so.
    ///
    /// # Errors
    /// [`ImportError::Tf`] names what is missing.
    pub fn lookup(&self, target: &str, source: &str, time: i64) -> Result<Isometry3<f64>, ImportError> {
        let (target, source) = (target.trim_start_matches('/'), source.trim_start_matches('/'));
        let missing = |reason: String| ImportError::Tf {
            target: target.to_owned(),
            source_frame: source.to_owned(),
            reason,
            known: self.known(),
        };
        let (up, down) = (self.ancestors(source), self.ancestors(target));
        let Some(meeting) = up.iter().find(|frame| down.contains(frame)) else {
            let root = |chain: &[&str]| chain.last().map_or(String::new(), |s| (*s).to_owned());
            let reason = format!("'{source}' hangs from '{}', '{target}' from '{}'", root(&up), root(&down));
            return Err(missing(reason));
        };
        let climb = |chain: &[&str]| -> Result<Isometry3<f64>, ImportError> {
            let mut total = Isometry3::identity();
            for frame in chain.iter().take_while(|f| *f != meeting) {
                let link = &self.links[*frame];
                let step = link.at(time).map_err(|e| missing(format!("'{}' from '{frame}' {e}", link.parent)))?;
                total = step * total;
            }
            Ok(total)
        };
        Ok(climb(&down)?.inverse() * climb(&up)?)
    }

    /// Every frame.
    pub fn frames(&self) -> Vec<String> {
        let mut all: Vec<String> =
            self.links.iter().flat_map(|(child, link)| [child.clone(), link.parent.clone()]).collect();
        all.sort();
        all.dedup();
        all
    }

    /// Every frame, in words.
    fn known(&self) -> String {
        let frames = self.frames();
        if frames.is_empty() {
            "none: no transform was recorded, neither on /tf nor on /tf_static".to_owned()
        } else {
            frames.join(", ")
        }
    }

    /// A frame and those above it.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let mut chain = vec![frame];
        while let Some(link) = self.links.get(chain[chain.len() - 1]) {
            // A loop has no root; what is in it is found all the same.
            if chain.contains(&link.parent.as_str()) {
                break;
            }
            chain.push(&link.parent);
        }
        chain
    }
}

impl Link {
    fn at(&self, time: i64) -> Result<Isometry3<f64>, String> {
        let before = self.samples.range(..=time).next_back();
        let after = self.samples.range(time..).next();
        let seconds = |ns: i64| ns as f64 * 1e-9;
        match (before, after) {
            (Some((_, pose)), _) | (_, Some((_, pose))) if self.fixed => Ok(*pose),
            (Some((t0, a)), Some((t1, b))) => {
                let share = if t1 > t0 { (time - t0) as f64 / (t1 - t0) as f64 } else { 0.0 };
                // Half a turn between two stamps has no shortest way: the nearer counts.
                Ok(a.try_lerp_slerp(b, share, 1e-9).unwrap_or(if share < 0.5 { *a } else { *b }))
            }
            (Some((t, pose)), None) | (None, Some((t, pose))) => {
                let gap = (time - t).abs();
                if gap <= SLACK {
                    Ok(*pose)
                } else {
                    Err(format!("is {:.3} s away from the time {:.3} s that is asked for", seconds(gap), seconds(time)))
                }
            }
            (None, None) => Err("was never sent".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Header;
    use nalgebra::Vector3;

    fn transform(parent: &str, child: &str, stamp: i64, x: f64, turn: f64) -> TransformStamped {
        TransformStamped {
            header: Header { stamp, frame: parent.into() },
            child: child.into(),
            parent_from_child: Isometry3::new(Vector3::new(x, 0.0, 0.0), Vector3::new(0.0, 0.0, turn)),
        }
    }

    fn tree() -> TfTree {
        let mut tree = TfTree::default();
        tree.insert(transform("world", "base", 5, 1.0, 0.0), true);
        tree.insert(transform("base", "hand", 1_000_000_000, 0.0, 0.0), false);
        tree.insert(transform("base", "hand", 2_000_000_000, 0.2, 0.4), false);
        tree.insert(transform("hand", "gel", 0, 0.05, 0.0), true);
        tree.insert(transform("world", "camera", 0, -1.0, 0.0), true);
        tree
    }

    #[test]
    fn chains_meet_at_the_common_frame_and_motion_is_interpolated() {
        let tree = tree();
        let gel = tree.lookup("/world", "gel", 1_500_000_000).expect("linked");
        let expected = Isometry3::new(Vector3::new(1.1, 0.0, 0.0), Vector3::new(0.0, 0.0, 0.2))
            * Isometry3::translation(0.05, 0.0, 0.0);
        assert!((gel.translation.vector - expected.translation.vector).norm() < 1e-12);
        assert!(gel.rotation.angle_to(&expected.rotation) < 1e-12);
        let camera = tree.lookup("camera", "base", 0).expect("linked");
        assert!((camera.translation.vector.x - 2.0).abs() < 1e-12);
        assert_eq!(tree.lookup("gel", "gel", 0).expect("itself"), Isometry3::identity());
    }

    #[test]
    fn missing_links_and_times_are_named() {
        let mut tree = tree();
        tree.insert(transform("island", "palm", 0, 0.0, 0.0), true);
        let error = tree.lookup("world", "palm", 0).expect_err("no link").to_string();
        assert!(error.contains("'palm' hangs from 'island', 'world' from 'world'"), "{error}");
        assert!(error.contains("known frames: base, camera, gel, hand, island, palm, world"), "{error}");
        let error = tree.lookup("world", "gel", 9_000_000_000).expect_err("too late").to_string();
        assert!(error.contains("'base' from 'hand' is 7.000 s away"), "{error}");
        assert!(tree.lookup("world", "gel", 2_050_000_000).is_ok(), "within the slack");
        tree.insert(transform("b", "a", 0, 0.0, 0.0), true);
        tree.insert(transform("a", "b", 0, 0.0, 0.0), true);
        assert!(tree.lookup("world", "a", 0).is_err(), "a loop");
        let error = TfTree::default().lookup("world", "gel", 0).expect_err("no tf at all").to_string();
        assert!(error.contains("known frames: none: no transform was recorded"), "{error}");
    }
}
