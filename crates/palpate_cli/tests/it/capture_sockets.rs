//! `capture touch` with a robot on a socket: a thread that plays it.

use crate::capture::record;
use crate::workshop::{Said, Workshop, palpate};
use palpate::io::read_scene;
use std::io::{BufRead as _, BufReader, Read as _, Write};
use std::net::TcpStream;
use std::process::{Child, ChildStderr, Command, Stdio};

/// A capture that is running, and what it says as it says it.
struct Running {
    child: Child,
    err: BufReader<ChildStderr>,
    said: String,
}

impl Running {
    fn start(shop: &Workshop, pose: &str) -> Self {
        let (frames, scene) = (shop.text("frames"), shop.text("s"));
        let mut child = Command::new(assert_cmd::cargo::cargo_bin!("palpate"))
            .args(["capture", "touch", "--frames", &frames, "--pose", pose, "--pose-timeout", "60", "--output", &scene])
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let err = BufReader::new(child.stderr.take().expect("piped"));
        Self { child, err, said: String::new() }
    }

    /// Waits for a line that holds this text, and returns it.
    fn until(&mut self, text: &str) -> String {
        loop {
            let mut line = String::new();
            let read = self.err.read_line(&mut line).expect("text");
            assert!(read > 0, "'{text}' was not said, but\n{}", self.said);
            self.said.push_str(&line);
            if line.contains(text) {
                return line;
            }
        }
    }

    fn end(mut self) -> Said {
        self.err.read_to_string(&mut self.said).expect("text");
        let output = self.child.wait_with_output().expect("it ends");
        let out = String::from_utf8_lossy(&output.stdout).into_owned();
        Said { status: output.status.code().unwrap_or(-1), out, err: self.said }
    }
}

/// x of the touches that were added.
fn added(shop: &Workshop) -> Vec<f64> {
    let scene = read_scene(shop.path("s")).expect("a scene at any moment").scene;
    scene.touches[2..].iter().map(|t| t.world_from_sensor.translation.x).collect()
}

#[test]
fn a_robot_on_tcp_may_stammer_hang_up_and_call_again() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 2);
    let mut capture = Running::start(&shop, "tcp:127.0.0.1:0");
    let line = capture.until("poses are expected on tcp:");
    let address = line.trim().rsplit("tcp:").next().expect("an address").to_owned();
    {
        let mut robot = TcpStream::connect(&address).expect("it listens");
        robot.write_all(b"0.1 0.0 0.3 1 0 0 0\n").expect("sent");
        capture.until("touches/002.png: (0.1000, 0.0000, 0.3000) m");
        // The second press has settled by now, and its pose is not the first one's.
        std::thread::sleep(std::time::Duration::from_millis(500));
        assert_eq!(added(&shop), [0.1]);
        // Half a line, and the cable is out.
        robot.write_all(b"0.15 0.0 0.").expect("sent");
    }
    let mut robot = TcpStream::connect(&address).expect("it still listens");
    robot.write_all(b"\xff\xfe{]\n{\"translation\": [0.2]}\n").expect("sent");
    // What was wrong has been read by now, and not been taken for a pose.
    std::thread::sleep(std::time::Duration::from_millis(300));
    assert_eq!(added(&shop), [0.1]);
    let pose = b"{\"translation\": [0.2, 0.0, 0.3], \"quaternion_xyzw\": [1, 0, 0, 0], \"stamp\": 12.5}\n";
    robot.write_all(pose).expect("sent");
    capture.until("touches/003.png: (0.2000, 0.0000, 0.3000) m");
    capture.end().expect(0, &["2 touches added, 4 in all"]);
    assert_eq!(added(&shop), [0.1, 0.2]);
}

#[cfg(unix)]
#[test]
fn a_robot_on_a_unix_socket_sends_a_line_a_touch() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 2);
    let socket = shop.path("robot.sock");
    let mut capture = Running::start(&shop, &format!("unix:{}", socket.display()));
    let connect = || {
        // The file appears when it listens.
        (0..3000)
            .find_map(|_| {
                std::thread::sleep(std::time::Duration::from_millis(20));
                std::os::unix::net::UnixStream::connect(&socket).ok()
            })
            .expect("it listens")
    };
    // One connection for each touch, as from a shell.
    connect().write_all(b"{\"translation\": [0.3, 0, 0.3], \"quaternion_xyzw\": [1, 0, 0, 0]}\n").expect("sent");
    capture.until("touches/002.png");
    connect().write_all(b"0.4 0 0.3 1 0 0 0\n").expect("sent");
    capture.until("touches/003.png");
    capture.end().expect(0, &["2 touches added"]);
    assert_eq!(added(&shop), [0.3, 0.4]);
    // Another run finds the file, and says so before anything is recorded.
    let (frames, scene) = (shop.text("frames"), shop.text("s"));
    let pose = format!("unix:{}", socket.display());
    palpate(["capture", "touch", "--frames", &frames, "--pose", &pose, "--output", &scene])
        .expect(1, &["listening on unix:", "a file left there by another run must go first"]);
}

/// Nobody calls within the time.
#[test]
fn a_touch_for_which_no_pose_comes_is_lost_and_said() {
    let shop = Workshop::new();
    record(&shop.path("frames"), 2);
    let (frames, scene) = (shop.text("frames"), shop.text("s"));
    let before = std::fs::read(shop.path("s/scene.toml")).expect("there");
    let flags = ["--pose", "tcp:127.0.0.1:0", "--pose-timeout", "0.1"];
    palpate([&["capture", "touch", "--frames", &frames, "--output", &scene][..], &flags].concat()).expect(
        3,
        &["a contact was not saved: no pose for touch 2 came from tcp:127.0.0.1:0", "0 touches added, 2 in all"],
    );
    assert_eq!(std::fs::read(shop.path("s/scene.toml")).expect("there"), before);
    assert!(!shop.path("s/touches/002.png").exists());
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = format!("tcp:{}", taken.local_addr().expect("bound"));
    palpate(["capture", "touch", "--frames", &frames, "--pose", &port, "--output", &scene])
        .expect(1, &["listening on tcp:127.0.0.1:"]);
}
