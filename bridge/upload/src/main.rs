//! `motord-upload`: copies complete recordings to a store that speaks the S3 protocol, and goes on
//! where it was after a loss of the network, of the store or of its own process.
//!
//! It reads a folder of recordings, talks to no daemon, and never changes or removes a recording.

#![forbid(unsafe_code)]

mod deliver;
mod failure;
mod folder;
mod journal;

use clap::Parser;
use deliver::{Delivery, Destination, Outcome};
use failure::Failure;
use folder::Recording;
use journal::{Entry, Journal};
use object_store::aws::{AmazonS3Builder, Checksum};
use object_store::{ClientOptions, RetryConfig};
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

/// Bytes of a part by its option, MiB. A store refuses smaller ones.
const PART_MIB: std::ops::RangeInclusive<u64> = 5..=1024;
/// Shortest and longest pause after an attempt that failed.
const PAUSES: [Duration; 2] = [Duration::from_millis(500), Duration::from_secs(60)];
/// Longest time of a request without an answer.
const SILENCE: Duration = Duration::from_secs(60);

/// Uploads the complete recordings of a folder to a store that speaks the S3 protocol.
///
/// A recording is complete when its recorder has ended it. Each is uploaded once, in parts. After a loss of the network, of
/// the store or of this process, the upload goes on with the first part that the store lacks. An object with the key of a
/// recording and other content stays, and is an error. Recordings are neither changed nor removed.
///
/// The credentials are those of the environment: AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or the other ways of AWS.
#[derive(Debug, Parser)]
#[command(
    name = "motord-upload",
    version,
    max_term_width = 100,
    after_help = "Examples:\n  motord-upload /var/lib/motord/flight --bucket robots --prefix spot\n  motord-upload . --bucket robots --endpoint https://minio.lab:9000 --once --json\n\nExit status of --once: 0 the store has every complete recording; 1 it has another object under the key of one, or one was\nremoved meanwhile; 64 usage; 74 a file cannot be read or written; 75 another motord-upload uses the folder."
)]
struct Arguments {
    /// The folder of the recordings (.mcap).
    directory: PathBuf,
    /// The bucket.
    #[arg(long)]
    bucket: String,
    /// The part of each key before the name of the recording, such as the name of the robot.
    #[arg(long, default_value = "")]
    prefix: String,
    /// The address of the store; without it that of AWS in the region.
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// The region.
    #[arg(long, default_value = "us-east-1")]
    region: String,
    /// Permit an endpoint without TLS that is not on this computer: the network can read the recordings.
    #[arg(long)]
    allow_http: bool,
    /// Size of the parts, MiB: 5 to 1024. An upload has at most 10000 parts.
    #[arg(long, value_name = "MIB", default_value_t = 8, value_parser = clap::value_parser!(u64).range(PART_MIB))]
    part_mib: u64,
    /// The folder for the progress of each upload; the default is `.motord-upload` in the directory.
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Seconds between two looks into the directory: 1 to 86400.
    #[arg(long, value_name = "S", default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    interval: u64,
    /// End when the store has every complete recording.
    #[arg(long)]
    once: bool,
    /// Print one JSON object for each recording.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    fn destination(&self) -> Result<Destination, Failure> {
        let retries = RetryConfig { max_retries: 1, retry_timeout: SILENCE, ..RetryConfig::default() };
        let is_plain = self.endpoint.as_ref().is_some_and(|endpoint| endpoint.starts_with("http://"));
        if is_plain && !self.allow_http && !self.endpoint.as_deref().is_some_and(is_loopback) {
            let text = "the network can read recordings that go to an endpoint without TLS: give an https:// one, or --allow-http";
            return Err(Failure::Usage(text.to_owned()));
        }
        let client = ClientOptions::new().with_allow_http(is_plain).with_timeout(SILENCE * 10);
        let mut builder = AmazonS3Builder::from_env()
            .with_bucket_name(&self.bucket)
            .with_region(&self.region)
            .with_retry(retries)
            .with_checksum_algorithm(Checksum::SHA256)
            .with_client_options(client.with_connect_timeout(SILENCE / 6));
        if let Some(endpoint) = &self.endpoint {
            builder = builder.with_endpoint(endpoint);
        }
        let store = builder.build().map_err(|error| Failure::Usage(error.to_string()))?;
        let name = format!("{}/{}", self.endpoint.as_deref().unwrap_or(&self.region), self.bucket);
        Ok(Destination { store, name, prefix: self.prefix.clone(), part_bytes: self.part_mib << 20 })
    }
}

fn is_loopback(endpoint: &str) -> bool {
    let host = endpoint.trim_start_matches("http://");
    ["127.0.0.1", "localhost", "[::1]"].iter().any(|local| {
        host.strip_prefix(local).is_some_and(|rest| rest.is_empty() || rest.starts_with([':', '/']))
    })
}

/// A recording in the store, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Delivered<'a> {
    /// The name of the file.
    recording: &'a str,
    key: String,
    bytes: u64,
    sha256: &'a str,
    /// `uploaded`, or `present` if the store had it.
    result: &'static str,
    /// Parts that the store took, in all attempts.
    parts_sent: u64,
}

/// The program between two looks into the directory.
struct Uploader {
    arguments: Arguments,
    destination: Destination,
    journal: Journal,
    /// Recordings that cannot be uploaded, which are reported once.
    refused: BTreeSet<Recording>,
    /// The error that was reported last: an outage of hours is reported once.
    reported: String,
}

impl Uploader {
    fn new(arguments: Arguments) -> Result<Self, Failure> {
        let state = arguments.state.clone();
        let journal = Journal::open(&state.unwrap_or_else(|| arguments.directory.join(".motord-upload")))?;
        let destination = arguments.destination()?;
        Ok(Self { arguments, destination, journal, refused: BTreeSet::new(), reported: String::new() })
    }

    /// Uploads until the store has everything, with `--once`; otherwise forever.
    async fn follow(mut self) -> Result<(), Failure> {
        let mut pause = PAUSES[0];
        loop {
            let (is_pending, has_moved) = self.deliver_all().await?;
            if self.arguments.once && !is_pending {
                return if self.refused.is_empty() { Ok(()) } else { Err(self.refusal()) };
            }
            let interval = Duration::from_secs(self.arguments.interval);
            pause = if has_moved { PAUSES[0] } else { (pause * 2).min(PAUSES[1]) };
            tokio::time::sleep(if is_pending { pause.min(interval) } else { interval }).await;
        }
    }

    fn refusal(&self) -> Failure {
        let names: Vec<_> = self.refused.iter().map(|refused| refused.name.as_str()).collect();
        Failure::Conflict(names.join(", "))
    }

    /// Tries each complete recording once. Returns true if one is left, and true if a part was
    /// sent.
    async fn deliver_all(&mut self) -> Result<(bool, bool), Failure> {
        let directory = &self.arguments.directory;
        let found =
            folder::complete(directory).map_err(|error| Failure::File { path: directory.clone(), error })?;
        let (mut is_pending, mut has_moved) = (false, false);
        for recording in found.into_iter().filter(|found| !self.refused.contains(found)).collect::<Vec<_>>() {
            let mut delivery = match Delivery::new(&self.destination, &self.journal, &recording) {
                Err(Failure::Changed(_)) => continue,
                delivery => delivery?,
            };
            let outcome = delivery.run().await;
            has_moved |= delivery.has_moved;
            match outcome {
                Ok(outcome) => self.print(&recording, &delivery, outcome)?,
                // The next look finds what it is now.
                Err(Failure::Changed(_)) => is_pending = true,
                Err(failure) if failure.is_transient() => {
                    is_pending = true;
                    report(&mut self.reported, &failure);
                }
                Err(failure @ Failure::Conflict(_)) => {
                    report(&mut self.reported, &failure);
                    self.refused.insert(recording);
                }
                Err(failure) => return Err(failure),
            }
        }
        Ok((is_pending, has_moved))
    }

    fn print(&self, recording: &Recording, delivery: &Delivery<'_>, outcome: Outcome) -> Result<(), Failure> {
        let result = match outcome {
            Outcome::Known => return Ok(()),
            Outcome::Present => "present",
            Outcome::Uploaded => "uploaded",
        };
        let key = self.destination.key(recording).to_string();
        let Entry { sha256, parts_sent, .. } = delivery.entry();
        let Recording { name, bytes, .. } = recording;
        let line = if self.arguments.json {
            let delivered =
                Delivered { recording: name, key, bytes: *bytes, sha256, result, parts_sent: *parts_sent };
            serde_json::json!(delivered).to_string()
        } else {
            format!("{}: {result} as {key}, {bytes} bytes", name.escape_debug())
        };
        let written = writeln!(io::stdout(), "{line}");
        written.map_err(|error| Failure::File { path: "standard output".into(), error })
    }
}

/// Prints an error, unless it is the last one that was printed.
fn report(reported: &mut String, failure: &Failure) {
    let text = failure.to_string();
    if *reported != text {
        eprintln!("motord-upload: {}", text.escape_debug());
        *reported = text;
    }
}

fn run(arguments: Arguments) -> Result<(), Failure> {
    // Of the two that the libraries know, this one needs no further compiler.
    let _installed = rustls::crypto::ring::default_provider().install_default();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|error| Failure::File { path: "/".into(), error })?;
    runtime.block_on(async { Uploader::new(arguments)?.follow().await })
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _unwritable = error.print();
            return ExitCode::from(if error.use_stderr() { 64 } else { 0 });
        }
    };
    match run(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("motord-upload: {}", failure.to_string().escape_debug());
            ExitCode::from(failure.status())
        }
    }
}
