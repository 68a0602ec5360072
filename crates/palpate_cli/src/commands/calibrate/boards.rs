//! Boards in images: the flags that describe them, and the search through many images.

use crate::progress::LateBar;
use crate::targets::one_name;
use anyhow::{Context as _, bail};
use palpate::calibrate::camera::{Board, BoardSearch, BoardView, find_board};
use palpate::geometry::Isometry;
use palpate::io::read_gray;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

#[derive(clap::Args)]
pub(crate) struct BoardArgs {
    /// Inner corners along and across the board: where four squares meet, one less than squares
    #[arg(long, value_name = "COLSxROWS", value_parser = parse_size)]
    board: (usize, usize),
    /// Side of a square, metres
    #[arg(long, value_name = "M")]
    square: f64,
    /// Half the side of the window in which a corner is refined, pixels [default: 0.35 of the way to the next, at most 10]
    #[arg(long, value_name = "PX")]
    corner_window: Option<usize>,
}

impl BoardArgs {
    /// From flags that may be missing.
    pub(crate) fn of(board: Option<(usize, usize)>, square: Option<f64>, corner_window: Option<usize>) -> Option<Self> {
        Some(Self { board: board?, square: square?, corner_window })
    }

    pub(crate) fn board(&self) -> anyhow::Result<Board> {
        let board = Board { cols: self.board.0, rows: self.board.1, square: self.square };
        board.validate().context("--board and --square")?;
        self.search().validate().context("--corner-window")?;
        Ok(board)
    }

    pub(crate) fn search(&self) -> BoardSearch {
        BoardSearch { window: self.corner_window }
    }
}

pub(crate) fn parse_size(text: &str) -> Result<(usize, usize), String> {
    let numbers: Vec<_> = text.split(['x', 'X', '×']).map(|n| n.trim().parse().ok()).collect();
    match numbers[..] {
        [Some(cols), Some(rows)] => Ok((cols, rows)),
        _ => Err(format!("'{text}' is not like 9x6")),
    }
}

/// A board that was found in an image.
pub(crate) struct Found {
    pub(crate) path: PathBuf,
    pub(crate) view: BoardView,
}

/// What a search through images brought.
pub(crate) struct Search {
    pub(crate) found: Vec<Found>,
    /// Why an image has no board.
    pub(crate) failed: Vec<(PathBuf, String)>,
    pub(crate) size: (usize, usize),
}

/// Images of folders, files as they are given; sorted within a folder.
///
/// * `own` – what the command writes: in a folder it is of an earlier run, and no input
pub(crate) fn images(inputs: &[PathBuf], own: &[&Path]) -> anyhow::Result<Vec<PathBuf>> {
    let own: Vec<PathBuf> = own.iter().map(|path| one_name(path)).collect();
    let mut all = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            all.push(input.clone());
            continue;
        }
        let before = all.len();
        let entries = std::fs::read_dir(input).with_context(|| format!("reading the folder {}", input.display()))?;
        for entry in entries {
            let path = entry.with_context(|| format!("reading the folder {}", input.display()))?.path();
            let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase());
            let image = extension.is_some_and(|e| ["png", "jpg", "jpeg"].contains(&e.as_str()));
            if image && !own.contains(&one_name(&path)) {
                all.push(path);
            }
        }
        if all.len() == before {
            bail!("the folder {} holds no image (.png, .jpg)", input.display());
        }
        all[before..].sort();
    }
    Ok(all)
}

/// The images of one folder.
pub(crate) fn images_of(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    images(&[folder.to_owned()], &[])
}

/// Looks for the board in every image. All images must have one size; an image without a board is no error here.
pub(crate) fn search(paths: &[PathBuf], args: &BoardArgs) -> anyhow::Result<Search> {
    let board = args.board()?;
    let bar = LateBar::new(Some(paths.len()), "images");
    let results: Vec<anyhow::Result<((usize, usize), Result<BoardView, String>)>> = paths
        .par_iter()
        .map(|path| {
            let image = read_gray(path)?;
            let view = find_board(&image, &board, &args.search()).map_err(|e| e.to_string());
            bar.step();
            Ok(((image.cols(), image.rows()), view))
        })
        .collect();
    drop(bar);
    let (mut found, mut failed, mut size) = (Vec::new(), Vec::new(), None);
    for (path, result) in paths.iter().zip(results) {
        let (this, view) = match result {
            Ok(result) => result,
            Err(error) => {
                failed.push((path.clone(), format!("{error:#}")));
                continue;
            }
        };
        let (first, needed): &(&PathBuf, (usize, usize)) = size.get_or_insert((path, this));
        if this != *needed {
            bail!(
                "{} is {}×{} px, {} is {}×{}: the images of one camera have one size",
                path.display(),
                this.0,
                this.1,
                first.display(),
                needed.0,
                needed.1
            );
        }
        match view {
            Ok(view) => found.push(Found { path: path.clone(), view }),
            Err(reason) => failed.push((path.clone(), format!("{}: {reason}", path.display()))),
        }
    }
    Ok(Search { found, failed, size: size.map_or((0, 0), |s| s.1) })
}

/// A pose from the command line: X,Y,Z,QX,QY,QZ,QW in metres.
pub(crate) fn parse_pose(text: &str) -> Result<Isometry, String> {
    let numbers: Vec<f64> =
        text.split(',').filter_map(|n| n.trim().parse().ok()).filter(|n: &f64| n.is_finite()).collect();
    let [x, y, z, qx, qy, qz, qw] = numbers[..] else {
        return Err("seven numbers X,Y,Z,QX,QY,QZ,QW are needed (metres; quaternion, w last)".to_owned());
    };
    palpate::io::pose([x, y, z], [qx, qy, qz, qw])
}

pub(crate) fn name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}
