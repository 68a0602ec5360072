use assert_cmd::Command;
use std::path::Path;

const TETRAHEDRON: &str = "OFF\n4 4 0\n0 0 0\n.1 0 0\n0 .1 0\n0 0 .1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";

fn palpate(folder: &Path) -> Command {
    let mut command = Command::cargo_bin("palpate").expect("the binary is built with its tests");
    command.current_dir(folder);
    command
}

/// Width and height in a PNG's header.
fn png_size(path: &Path) -> (u32, u32) {
    let bytes = std::fs::read(path).expect("the picture was written");
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    let number = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes"));
    (number(16), number(20))
}

#[test]
fn a_picture_of_two_meshes_and_a_cloud_side_by_side() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("a.off"), TETRAHEDRON).expect("the folder is writable");
    let args = ["render", "a.off", "a.off+a.off", "--output", "p.png", "--size", "64x48", "--view", "-30,20"];
    let plain = palpate(folder.path()).args(args).assert().success();
    assert!(plain.get_output().stdout.is_empty());
    assert_eq!(png_size(&folder.path().join("p.png")), (128, 48));
    let bytes = std::fs::read(folder.path().join("p.png")).expect("the picture was written");
    palpate(folder.path()).args(args).args(["--threads", "1"]).assert().success();
    assert_eq!(bytes, std::fs::read(folder.path().join("p.png")).expect("the picture was written"));
    palpate(folder.path()).args(args).arg("--labels").assert().success();
    assert!(png_size(&folder.path().join("p.png")).1 > 48);
}

#[test]
fn mistakes_are_named_and_leave_no_picture() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::write(folder.path().join("a.off"), TETRAHEDRON).expect("the folder is writable");
    let cases: [(&[&str], i32, &str); 5] = [
        (&["render", "b.off", "--output", "p.png"], 1, "b.off"),
        (&["render", "a.off", "--output", "p.jpg"], 1, ".png"),
        (&["render", "a.off", "--output", "p.png", "--view", "camera"], 1, "scene"),
        (&["render", "a.off", "--output", "p.png", "--view", "behind"], 2, "front"),
        (&["render", "a.off", "--output", "p.png", "--caption", "a,b"], 1, "2 captions for 1 panels"),
    ];
    for (args, status, message) in cases {
        let run = palpate(folder.path()).args(args).assert().code(status);
        let said = String::from_utf8_lossy(&run.get_output().stderr).into_owned();
        assert!(said.contains(message), "{args:?} said: {said}");
        assert!(!folder.path().join("p.png").exists());
    }
}
