//! Where a touch's pose comes from.

use anyhow::{Context as _, anyhow, bail};
use palpate::geometry::Isometry;
use palpate::io;
use std::io::{BufRead as _, BufReader, Read};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest line that is a pose.
const LONGEST: u64 = 4096;

pub(super) enum PoseSource {
    /// One line for each touch.
    Input,
    /// What the file holds.
    File(PathBuf),
    /// The last line that was sent since the touch before.
    Listener(Arc<Mutex<Option<String>>>, String),
}

impl PoseSource {
    pub(super) fn open(text: &str) -> anyhow::Result<Self> {
        if text == "-" {
            return Ok(Self::Input);
        }
        let last = Arc::new(Mutex::new(None));
        match text.split_once(':') {
            Some(("file", path)) => Ok(Self::File(PathBuf::from(path))),
            Some(("tcp", address)) => {
                let listener = std::net::TcpListener::bind(address).with_context(|| format!("listening on {text}"))?;
                // Port 0 takes any that is free.
                let local = listener.local_addr().with_context(|| format!("listening on {text}"))?;
                eprintln!("palpate: poses are expected on tcp:{local}");
                let shared = Arc::clone(&last);
                std::thread::spawn(move || {
                    for stream in listener.incoming().flatten() {
                        let shared = Arc::clone(&shared);
                        std::thread::spawn(move || keep_last(stream, &shared));
                    }
                });
                Ok(Self::Listener(last, text.to_owned()))
            }
            #[cfg(unix)]
            Some(("unix", path)) => {
                let listener = std::os::unix::net::UnixListener::bind(path)
                    .with_context(|| format!("listening on {text} (a file left there by another run must go first)"))?;
                let shared = Arc::clone(&last);
                std::thread::spawn(move || {
                    for stream in listener.incoming().flatten() {
                        let shared = Arc::clone(&shared);
                        std::thread::spawn(move || keep_last(stream, &shared));
                    }
                });
                Ok(Self::Listener(last, text.to_owned()))
            }
            _ => bail!("--pose {text}: - , file:PATH, tcp:HOST:PORT or unix:PATH is needed"),
        }
    }

    /// The pose of the touch that is being made.
    pub(super) fn next(&self, timeout: Duration, number: usize) -> anyhow::Result<Isometry> {
        match self {
            Self::Input => {
                let mut line = String::new();
                let mut input = std::io::stdin().lock().take(LONGEST);
                let read = input.read_line(&mut line).context("reading a pose from standard input")?;
                if read == 0 {
                    bail!("standard input ended: there is no pose for touch {number}");
                }
                parse(&line)
            }
            Self::File(path) => {
                let deadline = Instant::now() + timeout;
                loop {
                    // A robot may be writing it just now.
                    let found = io::read_text(path).map_err(anyhow::Error::from).and_then(|text| parse(&text));
                    match found {
                        Ok(pose) => return Ok(pose),
                        Err(error) if Instant::now() >= deadline => {
                            return Err(error.context(format!("no pose for touch {number} in {}", path.display())));
                        }
                        Err(_) => std::thread::sleep(Duration::from_millis(50)),
                    }
                }
            }
            Self::Listener(last, name) => {
                let deadline = Instant::now() + timeout;
                let mut wrong = None;
                loop {
                    // Taken, not copied: where the robot has fallen silent, the pose of the touch before is not this one's.
                    let line = last.lock().unwrap_or_else(PoisonError::into_inner).take();
                    match line.map(|line| parse(&line)) {
                        Some(Ok(pose)) => return Ok(pose),
                        // The next line may be sound.
                        Some(Err(error)) => wrong = Some(error),
                        None if Instant::now() < deadline => std::thread::sleep(Duration::from_millis(20)),
                        None => {
                            let missing = format!("no pose for touch {number} came from {name}");
                            return Err(
                                wrong.map_or_else(|| anyhow!("{missing}"), |error| error.context(missing.clone()))
                            );
                        }
                    }
                }
            }
        }
    }
}

/// Keeps the last line that a robot sent, until it goes away.
fn keep_last(stream: impl Read, last: &Mutex<Option<String>>) {
    let mut reader = BufReader::new(stream);
    loop {
        let mut line = Vec::new();
        match reader.by_ref().take(LONGEST).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) if line.trim_ascii().is_empty() => {}
            // What is no text is no pose either, and is said to be none.
            Ok(_) => {
                let line = String::from_utf8_lossy(&line).into_owned();
                *last.lock().unwrap_or_else(PoisonError::into_inner) = Some(line);
            }
        }
    }
}

#[derive(serde::Deserialize)]
struct Json {
    translation: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

/// Seven numbers, or JSON.
fn parse(line: &str) -> anyhow::Result<Isometry> {
    let line = line.trim();
    let said: String = line.chars().take(80).collect();
    let (translation, quaternion) = if line.starts_with('{') {
        let json: Json = serde_json::from_str(line).with_context(|| {
            format!("'{said}' is not {{\"translation\": [x, y, z], \"quaternion_xyzw\": [x, y, z, w]}}")
        })?;
        (json.translation, json.quaternion_xyzw)
    } else {
        let numbers: Vec<f64> =
            line.split([' ', ',', '\t']).filter(|n| !n.is_empty()).map_while(|n| n.parse().ok()).collect();
        let [x, y, z, qx, qy, qz, qw] = numbers[..] else {
            bail!("'{said}' is no pose: seven numbers x y z qx qy qz qw, or JSON");
        };
        ([x, y, z], [qx, qy, qz, qw])
    };
    io::pose(translation, quaternion).map_err(|e| anyhow::anyhow!("'{said}': {e}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_json_are_poses_and_nothing_else_is() {
        let pose = parse("0.1, 0.2 0.3\t1 0 0 0\n").expect("seven numbers");
        assert_eq!(pose.translation.z, 0.3);
        let json = r#"{"translation": [0.1, 0.2, 0.3], "quaternion_xyzw": [1, 0, 0, 0], "stamp": 5}"#;
        assert_eq!(parse(json).expect("JSON"), pose);
        for bad in ["", "1 2 3", "0 0 0 0 0 0 0", "nan 0 0 0 0 0 1", "{\"translation\": [1]}", "0 0 0 1 0 0 0 9"] {
            assert!(parse(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn the_last_line_of_a_socket_counts() {
        use std::io::Write as _;
        let source = PoseSource::open("tcp:127.0.0.1:0");
        assert!(source.is_ok());
        let last = Mutex::new(None);
        let (mut robot, palpate) = std::os::unix::net::UnixStream::pair().expect("a pair");
        robot.write_all(b"0 0 1 0 0 0 1\n\n\xff\xfe no text\n0 0 2 0 0 0 1\n").expect("sent");
        drop(robot);
        keep_last(palpate, &last);
        let line = last.into_inner().expect("not poisoned").expect("a line");
        assert_eq!(parse(&line).expect("a pose").translation.z, 2.0);
    }

    #[test]
    fn a_pose_is_used_once_and_a_wrong_line_waits_for_a_sound_one() {
        let last = Arc::new(Mutex::new(Some("0 0 1 0 0 0 1\n".to_owned())));
        let source = PoseSource::Listener(Arc::clone(&last), "tcp:robot".to_owned());
        let short = Duration::from_millis(30);
        assert_eq!(source.next(short, 4).expect("sent").translation.z, 1.0);
        let silent = source.next(short, 5).expect_err("the robot is silent").to_string();
        assert_eq!(silent, "no pose for touch 5 came from tcp:robot");
        let say = |line: &str| *last.lock().expect("not poisoned") = Some(line.to_owned());
        say("hello");
        let wrong = format!("{:#}", source.next(short, 6).expect_err("no pose"));
        assert!(wrong.contains("touch 6") && wrong.contains("'hello' is no pose: seven numbers"), "{wrong}");
        say("hello");
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(100));
                say("0 0 2 0 0 0 1");
            });
            assert_eq!(source.next(Duration::from_mins(1), 7).expect("sent later").translation.z, 2.0);
        });
    }

    #[test]
    fn a_source_that_is_none_says_what_would_do() {
        let error = PoseSource::open("http://robot").err().expect("unknown").to_string();
        assert!(error.contains("tcp:HOST:PORT"), "{error}");
    }
}
