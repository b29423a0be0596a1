//! A flight goes to a bucket of S3's kind, or to a directory.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    Attribute, Attributes, GetOptions, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload,
};

use super::bucket::{self, option_fault, is_transient, describe_error};
use crate::installation::Fault;
use crate::store::sha256_hex;

/// Pause before the first repeat, doubled before each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Longest pause between two repeats.
const MAX_PAUSE: Duration = Duration::from_secs(8);
/// Metadata of an object with its SHA-256, so that it can be compared without being read.
const DIGEST_KEY: &str = "sha256";

/// How much at once, and how often again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadSettings {
    /// Objects at a time, at most.
    pub jobs: usize,
    /// Repeats of a request that failed.
    pub retries: u32,
    /// Bytes a second at most, over the network; `None`: what the link gives.
    pub limit: Option<u64>,
}

/// What the other side did not do.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// Other bytes under a name of ours.
    #[error("{url}: already exists with different content and is not overwritten; {remedy}")]
    Different {
        /// URL.
        url: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The same flight, of another aircraft, type or wing than the call says.
    #[error(
        "{url}: already published as {published}; upload cannot change the aircraft. Use `wingd-fleet correct`, or \
        omit the options"
    )]
    Contradicted {
        /// URL.
        url: String,
        /// Aircraft, type and wing there.
        published: String,
    },
    /// Something that is not of this flight.
    #[error("{url}: is not a file of this flight; move it away, or upload below another prefix")]
    Foreign {
        /// URL.
        url: String,
    },
    /// After all repeats.
    #[error("{url}: {reason}")]
    Failed {
        /// URL.
        url: String,
        /// The other side's answer, and the mend.
        reason: String,
    },
}

/// What became of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PutOutcome {
    /// It is there by us.
    Sent,
    /// It was there, with the same bytes.
    AlreadyPresent,
}

/// A bucket and prefix, or a directory.
#[derive(Debug)]
pub struct UploadTarget {
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    url: String,
    /// Objects carry their digest; files are read instead.
    metadata: bool,
    settings: UploadSettings,
}

impl UploadTarget {
    /// `s3://bucket/prefix` or `file:///directory`. Credentials, region and endpoint come from the environment
    /// (`AWS_ACCESS_KEY_ID` and its like) and from nowhere else.
    ///
    /// # Errors
    /// A fault names the option or variable.
    pub fn open(url: &str, settings: UploadSettings) -> Result<Self, Fault> {
        let url = url.trim_end_matches('/');
        if let Some(path) = url.strip_prefix("file://") {
            return Self::open_directory(path, settings);
        }
        let known = "give s3://BUCKET/PREFIX or file:///DIRECTORY";
        let Some(rest) = url.strip_prefix("s3://") else {
            return Err(option_fault("--to", "value", "is neither a bucket nor a directory".into(), known));
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
        if bucket.is_empty() || !bucket.chars().all(plain) {
            // The text is not repeated: what stands before an @ may be a secret.
            let problem = "names no bucket (letters, digits, '.', '-', '_' alone)".to_owned();
            let mend = "give s3://BUCKET/PREFIX, credentials in AWS_* variables";
            return Err(option_fault("--to", "value", problem, mend));
        }
        let prefix = Path::parse(prefix).map_err(|e| option_fault("--to", "prefix", e.to_string(), known))?;
        let store = bucket::open_bucket(bucket, settings.limit)?;
        Ok(Self { store: Arc::new(store), prefix, url: url.to_owned(), metadata: true, settings })
    }

    fn open_directory(path: &str, settings: UploadSettings) -> Result<Self, Fault> {
        let wrong = |problem: String| {
            option_fault("--to", "value", problem, "give file:///DIRECTORY, a directory that can be written")
        };
        if !path.starts_with('/') {
            return Err(wrong("names no directory from the root".to_owned()));
        }
        std::fs::create_dir_all(path).map_err(|e| wrong(format!("{path} cannot be made ({e})")))?;
        let store =
            LocalFileSystem::new_with_prefix(path).map_err(|e| wrong(e.to_string()))?.with_fsync(true);
        let url = format!("file://{path}");
        Ok(Self { store: Arc::new(store), prefix: Path::default(), url, metadata: false, settings })
    }

    /// As it was opened.
    pub fn settings(&self) -> UploadSettings {
        self.settings
    }

    /// A key as a URL, for people.
    pub fn display_url(&self, key: &str) -> String {
        format!("{}/{key}", self.url)
    }

    fn object_path(&self, key: &str) -> Path {
        key.split('/').fold(self.prefix.clone(), |path, part| path.join(part))
    }

    /// The first question, asked once: whether anybody is there, and lets us in.
    pub async fn check_access(&self, place: &str) -> Result<(), TargetError> {
        let below = self.object_path(place);
        let listed = self.store.list(Some(&below)).try_collect::<Vec<_>>().await;
        listed.map(|_| ()).map_err(|error| self.request_error(place, &error))
    }

    /// Keys below a place, with their lengths.
    pub async fn list_keys(&self, place: &str) -> Result<BTreeMap<String, u64>, TargetError> {
        let below = self.object_path(place);
        let list = || async { self.store.list(Some(&below)).try_collect::<Vec<_>>().await };
        let all = self.with_retries(place, list).await?;
        let own = self.prefix.parts().count();
        let key = |path: &Path| {
            path.parts().skip(own).map(|part| part.as_ref().to_owned()).collect::<Vec<_>>().join("/")
        };
        Ok(all.iter().map(|meta| (key(&meta.location), meta.size)).collect())
    }

    /// An object's bytes; `None` where there is none.
    pub async fn read_object(&self, key: &str) -> Result<Option<Vec<u8>>, TargetError> {
        let path = self.object_path(key);
        let get = || async {
            match self.store.get(&path).await {
                Ok(found) => Ok(Some(found.bytes().await?.to_vec())),
                Err(object_store::Error::NotFound { .. }) => Ok(None),
                Err(error) => Err(error),
            }
        };
        self.with_retries(key, get).await
    }

    fn put_options(&self, mode: PutMode, digest: &str) -> PutOptions {
        let mut attributes = Attributes::new();
        if self.metadata {
            attributes.insert(Attribute::Metadata(DIGEST_KEY.into()), digest.to_owned().into());
        }
        PutOptions { mode, attributes, ..PutOptions::default() }
    }

    /// Puts an object where there is none. One that is there with the same bytes is as good: it may be ours, of an
    /// attempt whose answer was lost.
    pub async fn put_object(&self, key: &str, bytes: Vec<u8>, digest: &str) -> Result<PutOutcome, TargetError> {
        let (path, length) = (self.object_path(key), bytes.len() as u64);
        let payload = PutPayload::from(bytes);
        let options = self.put_options(PutMode::Create, digest);
        let put = || async {
            match self.store.put_opts(&path, payload.clone(), options.clone()).await {
                Ok(_) => Ok(true),
                Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
                Err(error) => Err(error),
            }
        };
        if self.with_retries(key, put).await? {
            return Ok(PutOutcome::Sent);
        }
        if self.has_digest(key, length, digest).await? { Ok(PutOutcome::AlreadyPresent) } else { Err(self.different_error(key)) }
    }

    /// Puts the right bytes in place of damaged ones.
    pub async fn replace_object(&self, key: &str, bytes: Vec<u8>, digest: &str) -> Result<PutOutcome, TargetError> {
        let path = self.object_path(key);
        let payload = PutPayload::from(bytes);
        let options = self.put_options(PutMode::Overwrite, digest);
        let put = || async { self.store.put_opts(&path, payload.clone(), options.clone()).await };
        self.with_retries(key, put).await.map(|_| PutOutcome::Sent)
    }

    /// Whether an object is the one that was to be put; read where it does not carry its digest.
    pub async fn has_digest(&self, key: &str, length: u64, digest: &str) -> Result<bool, TargetError> {
        let path = self.object_path(key);
        let get = |head: bool| {
            let options = GetOptions { head, ..GetOptions::default() };
            self.store.get_opts(&path, options)
        };
        let look = || async {
            let found = get(self.metadata).await?;
            if found.meta.size != length {
                return Ok(false);
            }
            let said = found.attributes.get(&Attribute::Metadata(DIGEST_KEY.into())).map(|v| v.to_string());
            match said {
                Some(said) => Ok(said == digest),
                None => Ok(sha256_hex(&get(false).await?.bytes().await?) == digest),
            }
        };
        self.with_retries(key, look).await
    }

    pub(super) fn different_error(&self, key: &str) -> TargetError {
        let mend = "a published flight stays as it is: results that were added since belong into tables \
            (docs/fleet.md), another state of the flight below another prefix; where the object was changed \
            or damaged there, `--repair` puts the right bytes again";
        TargetError::Different { url: self.display_url(key), remedy: mend }
    }

    fn request_error(&self, key: &str, error: &object_store::Error) -> TargetError {
        TargetError::Failed { url: self.display_url(key), reason: describe_error(error) }
    }

    /// Does it again where the reason may pass, so many times, with growing pauses.
    async fn with_retries<T, W>(&self, key: &str, mut work: impl FnMut() -> W) -> Result<T, TargetError>
    where
        W: Future<Output = object_store::Result<T>>,
    {
        let mut pause = FIRST_PAUSE;
        let mut left = self.settings.retries;
        loop {
            match work().await {
                Ok(done) => return Ok(done),
                Err(error) if left > 0 && is_transient(&error) => {
                    tokio::time::sleep(pause).await;
                    pause = (2 * pause).min(MAX_PAUSE);
                    left -= 1;
                }
                Err(error) => return Err(self.request_error(key, &error)),
            }
        }
    }
}
