//! A fresh folder for every test, and the real binary run in it.

#![allow(dead_code)] // Every test binary uses a part of it.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// A folder of its own, removed when dropped.
pub struct Dir(PathBuf);

/// What a finished command left.
#[derive(Debug)]
pub struct Run {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
    pub seconds: f64,
    /// Largest resident size that the system showed (Linux), else 0.
    pub peak_bytes: u64,
}

impl Dir {
    pub fn new() -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::SeqCst);
        let path =
            std::env::temp_dir().join(format!("occlude-test-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    pub fn write(&self, name: &str, text: &str) -> PathBuf {
        std::fs::write(self.path(name), text).unwrap();
        self.path(name)
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        std::fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&self.read(name)).unwrap()
    }

    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(&self.0)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// The binary with these arguments, separated by spaces, in this folder.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_occlude"));
        command
            .current_dir(&self.0)
            .args(arguments.split_whitespace());
        command
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    }

    pub fn run(&self, arguments: &str) -> Run {
        finish(self.command(arguments).spawn().unwrap())
    }

    /// Runs and wants success.
    pub fn must(&self, arguments: &str) -> Run {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(0), "occlude {arguments}: {}", run.stderr);
        run
    }

    /// Runs and wants exit code 2 and one line that contains all of `words`.
    pub fn refuses(&self, arguments: &str, words: &[&str]) {
        let run = self.run(arguments);
        assert_eq!(run.code, Some(2), "occlude {arguments}: {}", run.stderr);
        run.has_one_error_line(arguments);
        for word in words {
            assert!(
                run.stderr.contains(word),
                "occlude {arguments}: no {word:?} in {}",
                run.stderr
            );
        }
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

impl Run {
    pub fn has_one_error_line(&self, what: &str) {
        let errors = self
            .stderr
            .lines()
            .filter(|line| line.starts_with("error: "))
            .count();
        let others = self
            .stderr
            .lines()
            .filter(|line| !line.starts_with("error: ") && !line.starts_with("warning: "))
            .count();
        assert!(
            errors == 1 && others == 0 && self.stdout.is_empty(),
            "{what}: {} {}",
            self.stdout,
            self.stderr
        );
        assert!(
            self.stderr.lines().all(|line| line.chars().count() <= 400),
            "{what}: {}",
            self.stderr
        );
    }
}

/// Waits for the end, watching memory.
pub fn finish(mut child: Child) -> Run {
    let began = Instant::now();
    let mut peak_bytes = 0;
    let (mut out, mut err) = (child.stdout.take().unwrap(), child.stderr.take().unwrap());
    let out = std::thread::spawn(move || std::io::read_to_string(&mut out).unwrap());
    let err = std::thread::spawn(move || std::io::read_to_string(&mut err).unwrap());
    let status = loop {
        peak_bytes = peak_bytes.max(peak_of(child.id()));
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        if began.elapsed() > Duration::from_secs(120) {
            child.kill().unwrap();
            panic!("no end in 120 s");
        }
        std::thread::sleep(Duration::from_millis(2));
    };
    let seconds = began.elapsed().as_secs_f64();
    Run {
        code: status.code(),
        stdout: out.join().unwrap(),
        stderr: err.join().unwrap(),
        seconds,
        peak_bytes,
    }
}

fn peak_of(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    line.and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok())
        .unwrap_or(0)
        * 1024
}

/// The folder of public test scenes, or `None` with a loud note.
pub fn scenes() -> Option<PathBuf> {
    let beside = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes");
    let folder = std::env::var_os("OCCLUDE_SCENES").map_or(beside, PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    eprintln!(
        "SKIPPED: no test scenes at {}: set OCCLUDE_SCENES",
        folder.display()
    );
    None
}

/// Sends a signal by its name, such as `INT`.
#[cfg(unix)]
pub fn signal(name: &str, process: u32) {
    let status = Command::new("kill")
        .args([&format!("-{name}"), &process.to_string()])
        .status();
    assert!(status.unwrap().success());
}
