//! A module imports only modules of lower rank, only `io` touches files, and nothing prints. Tests at a file's foot may use anything.

use std::path::{Path, PathBuf};

const RANKS: &[(&str, u8)] = &[
    ("geometry", 0),
    ("camera", 1),
    ("tactile", 1),
    ("calibrate", 2),
    ("capture", 2),
    ("scene", 2),
    ("evidence", 2),
    ("surface", 2),
    ("metrics", 2),
    ("symmetry", 3),
    ("simulate", 3),
    ("render", 3),
    ("completion", 4),
    ("io", 4),
    ("pipeline", 5),
    ("explore", 6),
];

fn rank(module: &str) -> Option<u8> {
    RANKS.iter().find(|(name, _)| *name == module).map(|(_, rank)| *rank)
}

/// The code that ships: no comments, and nothing from a test module on.
fn shipped(source: &str) -> String {
    let code = source.split("#[cfg(test)]\nmod ").next().unwrap_or_default();
    code.lines().map(|line| line.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
}

fn identifier(text: &str) -> &str {
    let end = text.find(|c: char| !(c.is_alphanumeric() || c == '_')).unwrap_or(text.len());
    &text[..end]
}

/// First names of `{a::{b, c}, d}`.
fn group_heads(text: &str) -> Vec<&str> {
    let (mut heads, mut depth, mut at_start) = (Vec::new(), 0, true);
    for (i, c) in text.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth == 1 => break,
            '}' => depth -= 1,
            ',' if depth == 1 => at_start = true,
            c if depth == 1 && at_start && !c.is_whitespace() => {
                heads.push(identifier(&text[i..]));
                at_start = false;
            }
            _ => {}
        }
    }
    heads
}

/// Top-level modules that the code names through `crate::` or by climbing out with `super::super::`.
fn imports(code: &str) -> Vec<&str> {
    let mut found = Vec::new();
    for (i, path) in code.match_indices("crate::") {
        let rest = &code[i + path.len()..];
        if rest.starts_with('{') { found.extend(group_heads(rest)) } else { found.push(identifier(rest)) }
    }
    for (i, path) in code.match_indices("super::super::") {
        found.extend(Some(identifier(&code[i + path.len()..])).filter(|name| rank(name).is_some()));
    }
    found
}

/// What is wrong with one file of `module`.
fn faults(module: &str, source: &str) -> Vec<String> {
    let code = shipped(source);
    let Some(own) = rank(module) else { return vec![format!("module '{module}' has no rank")] };
    let mut faults: Vec<String> = imports(&code)
        .into_iter()
        .filter(|name| *name != module)
        .filter(|name| rank(name).is_none_or(|theirs| theirs >= own))
        .map(|name| format!("'{module}' (rank {own}) imports '{name}' (rank {:?})", rank(name)))
        .collect();
    if module != "io" {
        let files = ["std::fs", "File::", "std::net", "std::process", "std::env"];
        faults.extend(files.iter().filter(|f| code.contains(*f)).map(|f| format!("'{module}' names {f}")));
    }
    let prints = ["println!", "eprintln!", "print!(", "dbg!"];
    faults.extend(prints.iter().filter(|p| code.contains(*p)).map(|p| format!("'{module}' prints with {p}")));
    faults
}

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .expect("the source folder is readable")
        .map(|entry| entry.expect("a folder entry is readable").path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_module_imports_only_lower_ranks_and_only_io_touches_files() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&source, &mut files);
    let mut wrong = Vec::new();
    let mut modules = std::collections::BTreeSet::new();
    for file in files {
        let relative = file.strip_prefix(&source).expect("files were found below the source folder");
        let first = relative.components().next().expect("a file has a name").as_os_str().to_string_lossy().into_owned();
        let module = first.trim_end_matches(".rs");
        if module == "lib" {
            continue;
        }
        modules.insert(module.to_owned());
        let text = std::fs::read_to_string(&file).expect("sources are UTF-8");
        wrong.extend(faults(module, &text).into_iter().map(|fault| format!("{}: {fault}", relative.display())));
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
    let ranked: std::collections::BTreeSet<String> = RANKS.iter().map(|(name, _)| (*name).to_owned()).collect();
    assert_eq!(modules, ranked, "the list of ranks and the modules differ");
}

#[test]
fn the_checker_catches_what_it_is_for() {
    let count = |module: &str, source: &str| faults(module, source).len();
    assert_eq!(count("geometry", "use crate::io;"), 1);
    assert_eq!(count("camera", "use crate::{geometry::{Point, Plane}, scene::Scene};"), 1);
    assert_eq!(count("camera", "fn f() -> crate::tactile::Touch {}"), 1, "same rank");
    assert_eq!(count("surface", "use super::super::pipeline::run;"), 1);
    assert_eq!(count("surface", "let f = std::fs::read(p);"), 1);
    assert_eq!(count("surface", "println!(\"{x}\");"), 1);
    assert_eq!(count("novelty", ""), 1);
    assert_eq!(count("pipeline", "use crate::{geometry::Point, io::IoError};\nuse crate::pipeline::x;"), 0);
    assert_eq!(count("camera", "/// See [`crate::io`].\nuse crate::geometry::Point;"), 0);
    assert_eq!(count("camera", "#[cfg(test)]\nmod tests {\n    use crate::simulate::sphere;\n}"), 0);
}
