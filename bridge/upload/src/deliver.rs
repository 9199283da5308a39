//! The upload of one recording: in parts, each of which is noted before the next one.
//!
//! ```text
//! file ──hash──▶ key free? ──▶ begin ──▶ part 1 … part N ──▶ complete ──▶ noted as complete
//!                   │ equal hash                  ▲ │ no answer: later, from the first part that the store lacks
//!                   ▼                             └─┘
//!                noted as complete
//! ```
//!
//! A store may complete an upload whose answer is lost. Therefore every attempt first reads the
//! key: an object with the hash of the file is this recording, and is not sent again.

use crate::failure::Failure;
use crate::folder::Recording;
use crate::journal::{Entry, Journal, Upload};
use object_store::aws::AmazonS3;
use object_store::multipart::{MultipartStore, PartId};
use object_store::path::Path as Key;
use object_store::{Attribute, Attributes, Error, GetOptions, ObjectStore, PutMultipartOptions, PutPayload};
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, Read};
use std::os::unix::fs::FileExt;

/// Bytes of a file that are hashed at once.
const HASH_BYTES: usize = 1 << 20;

/// A store that did not complete an upload so often, although it answered before, gets another one.
const COMPLETIONS_MAX: u32 = 3;

/// The member of an object's metadata with the hash of its recording.
const HASH: &str = "sha256";

/// How a recording came into the store.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Outcome {
    /// The journal has it as complete.
    Known,
    /// The store had it.
    Present,
    /// This attempt completed it.
    Uploaded,
}

/// The destination of recordings.
#[derive(Debug)]
pub(crate) struct Destination {
    pub(crate) store: AmazonS3,
    /// Endpoint and bucket.
    pub(crate) name: String,
    pub(crate) prefix: String,
    pub(crate) part_bytes: u64,
}

impl Destination {
    pub(crate) fn key(&self, recording: &Recording) -> Key {
        Key::from(self.prefix.as_str()).join(recording.name.as_str())
    }
}

/// The attempt to upload a recording.
pub(crate) struct Delivery<'a> {
    destination: &'a Destination,
    journal: &'a Journal,
    recording: &'a Recording,
    key: Key,
    entry: Entry,
    /// The store took a part in this attempt.
    pub(crate) has_moved: bool,
}

impl<'a> Delivery<'a> {
    /// Continues the upload that the journal has, or begins one.
    ///
    /// # Errors
    ///
    /// The file cannot be read.
    pub(crate) fn new(
        destination: &'a Destination,
        journal: &'a Journal,
        recording: &'a Recording,
    ) -> Result<Self, Failure> {
        let key = destination.key(recording);
        let address = format!("{}/{key}", destination.name);
        let is_same = |entry: &Entry| {
            (entry.destination.as_str(), entry.bytes, entry.modified_ns)
                == (address.as_str(), recording.bytes, recording.modified_ns)
        };
        let entry = match journal.read(&recording.name).filter(is_same) {
            Some(entry) => entry,
            None => Entry {
                sha256: hash(recording).map_err(|error| unreadable(recording, error))?,
                destination: address,
                bytes: recording.bytes,
                modified_ns: recording.modified_ns,
                upload: None,
                completions_failed: 0,
                parts_sent: 0,
                is_complete: false,
            },
        };
        Ok(Self { destination, journal, recording, key, entry, has_moved: false })
    }

    pub(crate) fn entry(&self) -> &Entry {
        &self.entry
    }

    /// Uploads what the store lacks.
    ///
    /// # Errors
    ///
    /// The store does not answer; it has another object; the file changed; the journal cannot be
    /// written.
    pub(crate) async fn run(&mut self) -> Result<Outcome, Failure> {
        if self.entry.is_complete {
            return Ok(Outcome::Known);
        }
        if self.is_stored().await? {
            self.note_complete()?;
            return Ok(Outcome::Present);
        }
        if self.entry.upload.is_none() {
            self.begin().await?;
        }
        let sent = self.send().await;
        if let Err(Failure::Store { error, .. }) = &sent
            && (!is_silence(error) || self.entry.completions_failed >= COMPLETIONS_MAX)
        {
            self.forget_upload().await?;
        }
        sent?;
        self.note_complete()?;
        Ok(Outcome::Uploaded)
    }

    /// Lets the next attempt begin another upload: the store does not have this one any more, or
    /// does not complete it.
    async fn forget_upload(&mut self) -> Result<(), Failure> {
        if let Some(upload) = self.entry.upload.take() {
            let _unknown = self.destination.store.abort_multipart(&self.key, &upload.id).await;
        }
        self.entry.completions_failed = 0;
        self.note()
    }

    /// Returns true if the store has this recording under its key.
    async fn is_stored(&self) -> Result<bool, Failure> {
        let options = GetOptions { head: true, ..GetOptions::default() };
        let object = match self.destination.store.get_opts(&self.key, options).await {
            Ok(object) => object,
            Err(Error::NotFound { .. }) => return Ok(false),
            Err(error) => return Err(self.failed(error)),
        };
        let known = object.attributes.get(&Attribute::Metadata(HASH.into()));
        let is_ours = known.is_some_and(|known| known.as_ref() == self.entry.sha256)
            && object.meta.size == self.recording.bytes;
        if is_ours { Ok(true) } else { Err(Failure::Conflict(self.key.to_string())) }
    }

    async fn begin(&mut self) -> Result<(), Failure> {
        let mut attributes = Attributes::new();
        attributes.insert(Attribute::Metadata(HASH.into()), self.entry.sha256.clone().into());
        let options = PutMultipartOptions { attributes, ..PutMultipartOptions::default() };
        let begun = self.destination.store.create_multipart_opts(&self.key, options).await;
        let id = begun.map_err(|error| self.failed(error))?;
        let part_bytes = self.destination.part_bytes;
        self.entry.upload = Some(Upload { id, part_bytes, parts: Vec::new() });
        self.note()
    }

    /// Sends the parts that the store lacks, and completes the upload.
    async fn send(&mut self) -> Result<(), Failure> {
        let store = &self.destination.store;
        let file = File::open(&self.recording.path).map_err(|error| unreadable(self.recording, error))?;
        while let Some((at, part)) = self.next_part(&file)? {
            let Some(upload) = &self.entry.upload else { return Ok(()) };
            let sent = store.put_part(&self.key, &upload.id, at, PutPayload::from(part)).await;
            let id = sent.map_err(|error| self.failed(error))?.content_id;
            self.entry.upload.iter_mut().for_each(|upload| upload.parts.push(id.clone()));
            self.entry.parts_sent += 1;
            self.has_moved = true;
            self.note()?;
        }
        // The parts are those of the file that was hashed.
        if Recording::at(&self.recording.path).as_ref() != Some(self.recording) {
            return Err(Failure::Changed(self.recording.name.clone()));
        }
        let Some(upload) = &self.entry.upload else { return Ok(()) };
        let parts = upload.parts.iter().map(|id| PartId { content_id: id.clone() }).collect();
        if let Err(error) = store.complete_multipart(&self.key, &upload.id, parts).await {
            self.entry.completions_failed += 1;
            self.note()?;
            return Err(self.failed(error));
        }
        Ok(())
    }

    /// Returns the index and the bytes of the first part that the store lacks.
    fn next_part(&self, file: &File) -> Result<Option<(usize, Vec<u8>)>, Failure> {
        let Some(Upload { part_bytes, parts, .. }) = &self.entry.upload else { return Ok(None) };
        let begin = part_bytes * parts.len() as u64;
        let bytes = self.entry.bytes.saturating_sub(begin).min(*part_bytes);
        if bytes == 0 {
            return Ok(None);
        }
        let mut part = vec![0; usize::try_from(bytes).unwrap_or(usize::MAX)];
        file.read_exact_at(&mut part, begin).map_err(|error| unreadable(self.recording, error))?;
        Ok(Some((parts.len(), part)))
    }

    fn note_complete(&mut self) -> Result<(), Failure> {
        (self.entry.is_complete, self.entry.upload) = (true, None);
        self.note()
    }

    fn note(&self) -> Result<(), Failure> {
        self.journal.write(&self.recording.name, &self.entry)
    }

    fn failed(&self, error: Error) -> Failure {
        Failure::Store { name: self.recording.name.clone(), error }
    }
}

/// Returns true if the store may still have the upload: it did not answer, or failed itself.
fn is_silence(error: &Error) -> bool {
    matches!(error, Error::Generic { .. } | Error::JoinError { .. })
}

/// Returns the error of a file that was complete a moment ago.
fn unreadable(recording: &Recording, error: io::Error) -> Failure {
    match error.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::UnexpectedEof => Failure::Changed(recording.name.clone()),
        _ => Failure::File { path: recording.path.clone(), error },
    }
}

fn hash(recording: &Recording) -> io::Result<String> {
    let (mut file, mut hash) = (File::open(&recording.path)?, Sha256::new());
    let mut buffer = vec![0; HASH_BYTES];
    loop {
        match file.read(&mut buffer)? {
            0 => break,
            read => hash.update(&buffer[..read]),
        }
    }
    Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}
