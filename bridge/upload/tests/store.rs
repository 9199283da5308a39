//! The program beside a real S3 server (s3s-fs), which is killed and started again, as is the
//! program.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};
use tempfile::TempDir;

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// The smallest part that a store accepts.
const PART: usize = 5 << 20;
/// Longest wait for an event on a busy machine.
const TIMEOUT: Duration = Duration::from_secs(300);

/// A server with the bucket `robots`, and a folder of recordings.
struct Scene {
    folder: TempDir,
    port: u16,
    server: Option<Child>,
}

impl Drop for Scene {
    fn drop(&mut self) {
        self.kill_server();
    }
}

impl Scene {
    fn new() -> Self {
        let folder = TempDir::new().unwrap();
        for name in ["store/robots", "flight"] {
            fs::create_dir_all(folder.path().join(name)).unwrap();
        }
        let mut scene = Self { folder, port: 0, server: None };
        scene.start_server();
        scene
    }

    /// Starts the server, on the port that it had before.
    fn start_server(&mut self) {
        let program =
            Path::new(env!("CARGO_BIN_EXE_motord-upload")).with_file_name("examples").join("server");
        let mut command = Command::new(program);
        command.arg(self.folder.path().join("store")).arg(self.port.to_string());
        let mut server = command.stdout(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
        self.port = line.trim().parse().unwrap();
        self.server = Some(server);
    }

    fn kill_server(&mut self) {
        if let Some(mut server) = self.server.take() {
            server.kill().unwrap();
            server.wait().unwrap();
        }
    }

    /// Writes a recording of this length. Its bytes differ in each part and each recording.
    fn record(&self, name: &str, bytes: usize) -> Vec<u8> {
        let seed = name.bytes().map(usize::from).sum::<usize>();
        let middle =
            (0..bytes - 2 * MAGIC.len()).map(|at| (at.wrapping_mul(31) / 7 + at / PART + seed) as u8);
        let content: Vec<u8> = MAGIC.iter().copied().chain(middle).chain(MAGIC.iter().copied()).collect();
        fs::write(self.folder.path().join("flight").join(name), &content).unwrap();
        content
    }

    fn command(&self) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_motord-upload"));
        command.arg(self.folder.path().join("flight")).args(["--bucket", "robots", "--prefix", "spot"]);
        command.args(["--endpoint", &format!("http://127.0.0.1:{}", self.port)]);
        command.args(["--part-mib", "5", "--interval", "1", "--once", "--json"]);
        command.env("AWS_ACCESS_KEY_ID", "key").env("AWS_SECRET_ACCESS_KEY", "secret");
        command
    }

    fn upload(&self) -> Output {
        self.command().output().unwrap()
    }

    fn spawn(&self) -> Child {
        self.command().stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    }

    /// The parts of a recording that the store took, by the journal.
    fn parts(&self, name: &str) -> u64 {
        let path = self.folder.path().join("flight/.motord-upload").join(format!("{name}.json"));
        let entry: Option<serde_json::Value> =
            fs::read(path).ok().and_then(|text| serde_json::from_slice(&text).ok());
        entry.map_or(0, |entry| entry["parts_sent"].as_u64().unwrap())
    }

    fn await_parts(&self, name: &str, parts: u64) {
        let end = Instant::now() + TIMEOUT;
        while self.parts(name) < parts {
            assert!(Instant::now() < end, "{} parts of {name}", self.parts(name));
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// The objects of the store by key. The server keeps files of its own beside them.
    fn objects(&self) -> BTreeMap<String, Vec<u8>> {
        let bucket = self.folder.path().join("store/robots");
        let mut objects = BTreeMap::new();
        let mut folders = vec![bucket.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path: PathBuf = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let key = path.strip_prefix(&bucket).unwrap().to_str().unwrap().to_owned();
                    objects.insert(key, fs::read(path).unwrap());
                }
            }
        }
        objects
    }
}

fn reports(output: &Output) -> Vec<serde_json::Value> {
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn assert_done(output: &Output) {
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{:?}: {errors}", output.status);
}

#[test]
fn each_complete_recording_is_uploaded_once() {
    let scene = Scene::new();
    let small = scene.record("a.mcap", 1000);
    let large = scene.record("b.mcap", 2 * PART + 17);
    fs::write(scene.folder.path().join("flight/growing.mcap"), [MAGIC, b"data"].concat()).unwrap();
    fs::write(scene.folder.path().join("flight/robot.unfinished"), &small).unwrap();
    let output = scene.upload();
    assert_done(&output);
    let sent: Vec<_> = reports(&output).iter().map(|report| report["parts_sent"].as_u64().unwrap()).collect();
    assert_eq!(sent, [1, 3]);
    let expected = BTreeMap::from([("spot/a.mcap".into(), small), ("spot/b.mcap".into(), large)]);
    assert!(scene.objects() == expected, "{:?}", scene.objects().keys());
    let again = scene.upload();
    assert_done(&again);
    assert!(reports(&again).is_empty(), "nothing is sent again");
}

#[test]
fn upload_continues_after_server_is_killed() {
    let mut scene = Scene::new();
    let content = scene.record("run.mcap", 12 * PART + 1);
    let program = scene.spawn();
    for parts in [2, 5, 9] {
        scene.await_parts("run.mcap", parts);
        scene.kill_server();
        std::thread::sleep(Duration::from_millis(300));
        scene.start_server();
    }
    let output = program.wait_with_output().unwrap();
    assert_done(&output);
    assert!(scene.objects() == BTreeMap::from([("spot/run.mcap".into(), content)]));
    // Each part was taken once: a part that was in flight was not.
    assert_eq!(reports(&output)[0]["parts_sent"], 13, "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn upload_continues_after_program_is_killed() {
    let scene = Scene::new();
    let content = scene.record("run.mcap", 8 * PART);
    for parts in [2, 5] {
        let mut program = scene.spawn();
        scene.await_parts("run.mcap", parts);
        program.kill().unwrap();
        program.wait().unwrap();
    }
    let output = scene.upload();
    assert_done(&output);
    assert!(scene.objects() == BTreeMap::from([("spot/run.mcap".into(), content)]));
    assert_eq!(reports(&output)[0]["parts_sent"], 8);
}

/// A completed upload whose answer is lost is found by its hash.
#[test]
fn stored_recording_is_not_sent_again() {
    let scene = Scene::new();
    scene.record("run.mcap", PART + 1);
    assert_done(&scene.upload());
    fs::remove_dir_all(scene.folder.path().join("flight/.motord-upload")).unwrap();
    let output = scene.upload();
    assert_done(&output);
    let report = &reports(&output)[0];
    assert_eq!((&report["result"], &report["parts_sent"]), (&"present".into(), &0.into()));
}

#[test]
fn another_object_with_the_key_stays() {
    let scene = Scene::new();
    scene.record("run.mcap", 1000);
    assert_done(&scene.upload());
    let before = scene.objects();
    scene.record("run.mcap", 1001);
    let output = scene.upload();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("another object with this key"));
    assert!(scene.objects() == before);
}

#[test]
fn store_that_forgot_the_upload_gets_another() {
    let mut scene = Scene::new();
    let content = scene.record("run.mcap", 6 * PART);
    let program = scene.spawn();
    scene.await_parts("run.mcap", 2);
    scene.kill_server();
    for entry in fs::read_dir(scene.folder.path().join("store")).unwrap() {
        let path = entry.unwrap().path();
        if path.is_file() {
            fs::remove_file(path).unwrap();
        }
    }
    scene.start_server();
    assert_done(&program.wait_with_output().unwrap());
    assert!(scene.objects() == BTreeMap::from([("spot/run.mcap".into(), content)]));
}

/// Server and program are killed at any moment; in the end the store has each recording once.
#[test]
fn kills_at_any_moment_lose_nothing() {
    let mut scene = Scene::new();
    let names = ["a.mcap", "b.mcap", "c.mcap", "d.mcap"];
    let contents = names.map(|name| (format!("spot/{name}"), scene.record(name, 2 * PART + 100)));
    let mut random = 7_u64;
    let mut pause = || {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        std::thread::sleep(Duration::from_millis(random >> 55));
    };
    for round in 0..20 {
        let mut program = scene.spawn();
        pause();
        if round % 2 == 0 {
            scene.kill_server();
            pause();
            scene.start_server();
        }
        pause();
        program.kill().unwrap();
        program.wait().unwrap();
    }
    assert_done(&scene.upload());
    assert!(scene.objects() == BTreeMap::from(contents), "{:?}", scene.objects().keys());
}

#[test]
fn endpoint_without_tls_must_be_local() {
    let scene = Scene::new();
    let output = scene.command().args(["--endpoint", "http://192.0.2.1"]).output().unwrap();
    assert_eq!(output.status.code(), Some(64));
    let mut plain = Command::new(env!("CARGO_BIN_EXE_motord-upload"));
    plain.arg(scene.folder.path().join("flight")).args(["--bucket", "b", "--endpoint", "http://192.0.2.1"]);
    let output = plain.output().unwrap();
    assert_eq!(output.status.code(), Some(64));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--allow-http"));
}
