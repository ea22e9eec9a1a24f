//! The page `view.html` in a browser without a window: no errors on its console, and the picture that this program makes of the
//! same light maps. Skipped loudly where there is no Chromium.

mod util;
use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use util::Dir;

const WIDTH: u32 = 480;
const HEIGHT: u32 = 360;

/// Mean LDR-FLIP between the page and the program; edges are sampled differently.
const MOST_FLIP: f64 = 0.03;

/// How long the browser may take, and how often it is asked.
const PATIENCE: Duration = Duration::from_secs(60);
const ATTEMPTS: u32 = 3;

fn browser() -> Option<PathBuf> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders)
        .flat_map(|folder| names.map(|name| folder.join(name)))
        .find(|path| path.is_file());
    if found.is_none() {
        eprintln!("SKIPPED: no Chromium on this machine: view.html is not tested");
    }
    found
}

/// Serves a folder until the program ends.
fn serve(folder: PathBuf) -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let folder = folder.clone();
            std::thread::spawn(move || answer(stream, &folder));
        }
    });
    port
}

fn answer(mut stream: TcpStream, folder: &Path) {
    let mut request = [0; 4096];
    let length = stream.read(&mut request).unwrap_or(0);
    let request = String::from_utf8_lossy(&request[..length]).into_owned();
    let path = request.split(' ').nth(1).unwrap_or("/");
    let name = path.split('?').next().unwrap_or("").trim_start_matches('/');
    let kind = if name.ends_with(".html") {
        "text/html"
    } else {
        "application/octet-stream"
    };
    let (status, body) = match std::fs::read(folder.join(name)) {
        Ok(body) => ("200 OK", body),
        Err(_) => ("404 Not Found", Vec::new()),
    };
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
        body.len()
    );
    let _ = stream
        .write_all(head.as_bytes())
        .and_then(|()| stream.write_all(&body));
}

/// A picture of a page, and what the browser said; `None` if it hangs, which it does now and then.
fn shoot(browser: &Path, profile: &Path, shot: &Path, url: &str) -> Option<String> {
    std::fs::create_dir_all(profile).unwrap();
    let log = profile.join("stderr.txt");
    let mut child = Command::new(browser)
        .args([
            "--headless=new",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
        ])
        .args([
            "--hide-scrollbars",
            "--force-device-scale-factor=1",
            "--virtual-time-budget=30000",
        ])
        .args([
            "--enable-logging=stderr",
            "--run-all-compositor-stages-before-draw",
        ])
        .arg(format!("--user-data-dir={}", profile.display()))
        .arg(format!("--window-size={WIDTH},{HEIGHT}"))
        .arg(format!("--screenshot={}", shot.display()))
        .arg(url)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(std::fs::File::create(&log).unwrap())
        .spawn()
        .unwrap();
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if began.elapsed() > PATIENCE {
            child.kill().unwrap();
            child.wait().unwrap();
            eprintln!("the browser hangs");
            return None;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    Some(String::from_utf8_lossy(&std::fs::read(&log).unwrap()).into_owned())
}

#[test]
fn the_page_shows_what_the_program_shows() {
    let Some(browser) = browser() else { return };
    let dir = Dir::new();
    dir.must("scene cornell -o c.glb");
    for engine in ["three", "godot"] {
        let out = format!("out-{engine}");
        dir.must(&format!(
            "bake c.glb -o {out} --directions 128 --texels-per-metre 100 --gather path --engine {engine}"
        ));
        dir.must(&format!(
            "render {out}/scene.glb --integrator baked --samples 16 --size {WIDTH}x{HEIGHT} -o own.png"
        ));
        let port = serve(dir.path(&out));
        let shot = dir.path("shot.png");
        let url = format!("http://127.0.0.1:{port}/view.html?panel=0");
        let log = (0..ATTEMPTS)
            .find_map(|attempt| {
                shoot(
                    &browser,
                    &dir.path(&format!("profile-{attempt}")),
                    &shot,
                    &url,
                )
            })
            .expect("the browser makes no picture in time");
        let said: Vec<&str> = log
            .lines()
            .filter(|line| line.contains("CONSOLE"))
            .collect();
        assert!(said.is_empty(), "the page's console: {said:#?}");
        assert!(shot.exists(), "{log}");
        let told = dir.must("compare shot.png own.png --json").stdout;
        let told: serde_json::Value = serde_json::from_str(&told).unwrap();
        let flip = told["flip"].as_f64().unwrap();
        println!("{engine}: FLIP {flip}");
        assert!(flip < MOST_FLIP, "{engine}: FLIP {flip}");
    }
}
