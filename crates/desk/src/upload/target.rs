//! Target of an upload: an S3 bucket or a directory.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{
    Attribute, Attributes, GetOptions, ObjectStore, ObjectStoreExt, PutMode, PutOptions, PutPayload,
};

use super::bucket::{self, describe_error, is_transient, option_fault};
use super::pace::RateLimit;
use wingd_base::fault::Fault;
use wingd_store::sha256_hex;

/// Pause before the first retry, doubled before each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Maximum pause between retries.
const MAX_PAUSE: Duration = Duration::from_secs(8);
/// Metadata key of an object's SHA-256, which allows comparison without reading the object.
const DIGEST_KEY: &str = "sha256";

/// Concurrency, retries and rate limit of an upload.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UploadSettings {
    /// Maximum number of concurrent objects.
    pub jobs: usize,
    /// Number of retries of a failed request.
    pub retries: u32,
    /// Maximum rate over the network, bytes per second; `None` for no limit.
    pub limit: Option<u64>,
}

/// Error of an upload target.
#[derive(Debug, thiserror::Error)]
pub enum TargetError {
    /// An object exists with different content.
    #[error("{url}: already exists with different content and is not overwritten; {remedy}")]
    Different { url: String, remedy: &'static str },
    /// The flight is published with another aircraft, type or wing than given.
    #[error(
        "{url}: already published as {published}; upload cannot change the aircraft. Use `wingd-fleet correct`, or \
        omit the options"
    )]
    Contradicted {
        url: String,
        /// Published aircraft, type and wing.
        published: String,
    },
    /// An object does not belong to the flight.
    #[error("{url}: is not a file of this flight; move it away, or upload below another prefix")]
    Foreign { url: String },
    /// A request failed after all retries.
    #[error("{url}: {reason}")]
    Failed {
        url: String,
        /// Answer of the target, with a remedy.
        reason: String,
    },
}

/// Result of putting an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PutOutcome {
    /// The object was put.
    Sent,
    /// The object existed with the same bytes.
    AlreadyPresent,
}

/// Bucket and prefix, or directory.
#[derive(Debug)]
pub struct UploadTarget {
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    url: String,
    /// Set if objects carry their digest as metadata; otherwise they are read for comparison.
    metadata: bool,
    /// Limit over the network; `None` for a directory too.
    limit: Option<RateLimit>,
    settings: UploadSettings,
}

impl UploadTarget {
    /// Opens `s3://bucket/prefix` or `file:///directory`. Credentials, region and endpoint come only from the environment
    /// (`AWS_ACCESS_KEY_ID` etc.).
    ///
    /// # Errors
    /// Returns an error that names the option or variable if the URL or the environment is not valid.
    pub fn open(url: &str, settings: UploadSettings) -> Result<Self, Fault> {
        let url = url.trim_end_matches('/');
        if let Some(path) = url.strip_prefix("file://") {
            return Self::open_directory(path, settings);
        }
        let known = "give s3://BUCKET/PREFIX or file:///DIRECTORY";
        let Some(rest) = url.strip_prefix("s3://") else {
            return Err(option_fault(
                "--to",
                "value",
                "is neither a bucket nor a directory".into(),
                known,
            ));
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
        if bucket.is_empty() || !bucket.chars().all(plain) {
            // The text is not repeated: the part before an @ may be a secret.
            let problem = "names no bucket (only letters, digits, '.', '-', '_')".to_owned();
            let remedy = "give s3://BUCKET/PREFIX, credentials in AWS_* variables";
            return Err(option_fault("--to", "value", problem, remedy));
        }
        let prefix = Path::parse(prefix)
            .map_err(|e| option_fault("--to", "prefix", e.to_string(), known))?;
        let store = Arc::new(bucket::open_bucket(bucket)?);
        let limit = settings.limit.map(RateLimit::new);
        Ok(Self {
            store,
            prefix,
            url: url.to_owned(),
            metadata: true,
            limit,
            settings,
        })
    }

    fn open_directory(path: &str, settings: UploadSettings) -> Result<Self, Fault> {
        let wrong = |problem: String| {
            option_fault(
                "--to",
                "value",
                problem,
                "give file:///DIRECTORY, a writable directory",
            )
        };
        if !path.starts_with('/') {
            return Err(wrong("names no absolute directory".to_owned()));
        }
        std::fs::create_dir_all(path)
            .map_err(|e| wrong(format!("{path} cannot be created ({e})")))?;
        let store = LocalFileSystem::new_with_prefix(path)
            .map_err(|e| wrong(e.to_string()))?
            .with_fsync(true);
        let url = format!("file://{path}");
        Ok(Self {
            store: Arc::new(store),
            prefix: Path::default(),
            url,
            metadata: false,
            limit: None,
            settings,
        })
    }

    /// Returns the settings.
    pub fn settings(&self) -> UploadSettings {
        self.settings
    }

    /// Returns the URL of a key, for messages.
    pub fn display_url(&self, key: &str) -> String {
        format!("{}/{key}", self.url)
    }

    fn object_path(&self, key: &str) -> Path {
        key.split('/')
            .fold(self.prefix.clone(), |path, part| path.join(part))
    }

    /// Checks, without retries, that the target is reachable and permits access.
    pub async fn check_access(&self, place: &str) -> Result<(), TargetError> {
        let below = self.object_path(place);
        let listed = self.store.list(Some(&below)).try_collect::<Vec<_>>().await;
        listed
            .map(|_| ())
            .map_err(|error| self.request_error(place, &error))
    }

    /// Lists the keys below a prefix, with lengths.
    pub async fn list_keys(&self, place: &str) -> Result<BTreeMap<String, u64>, TargetError> {
        let below = self.object_path(place);
        let list = || async { self.store.list(Some(&below)).try_collect::<Vec<_>>().await };
        let all = self.with_retries(place, list).await?;
        let own = self.prefix.parts().count();
        let key = |path: &Path| {
            path.parts()
                .skip(own)
                .map(|part| part.as_ref().to_owned())
                .collect::<Vec<_>>()
                .join("/")
        };
        Ok(all
            .iter()
            .map(|meta| (key(&meta.location), meta.size))
            .collect())
    }

    /// Reads an object; `None` if it does not exist.
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

    /// Writes an object within the rate limit, once; `Ok(false)` if it must not exist and does.
    async fn write_object(
        &self,
        key: &str,
        payload: &PutPayload,
        mode: PutMode,
        digest: &str,
    ) -> object_store::Result<bool> {
        let mut attributes = Attributes::new();
        if self.metadata {
            attributes.insert(
                Attribute::Metadata(DIGEST_KEY.into()),
                digest.to_owned().into(),
            );
        }
        let (path, length) = (self.object_path(key), payload.content_length() as u64);
        let put = self.store.put_opts(
            &path,
            payload.clone(),
            PutOptions {
                mode,
                attributes,
                ..PutOptions::default()
            },
        );
        let put = match &self.limit {
            Some(limit) => limit.send_within(length, put).await,
            None => put.await,
        };
        match put {
            Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
            put => put.map(|_| true),
        }
    }

    /// Puts an object that must not exist. An existing object with the same bytes counts as success: it may come from an
    /// attempt whose answer was lost.
    pub async fn put_object(
        &self,
        key: &str,
        bytes: Vec<u8>,
        digest: &str,
    ) -> Result<PutOutcome, TargetError> {
        let (length, payload) = (bytes.len() as u64, PutPayload::from(bytes));
        if self
            .with_retries(key, || {
                self.write_object(key, &payload, PutMode::Create, digest)
            })
            .await?
        {
            return Ok(PutOutcome::Sent);
        }
        if self.has_digest(key, length, digest).await? {
            Ok(PutOutcome::AlreadyPresent)
        } else {
            Err(self.different_error(key))
        }
    }

    /// Replaces a damaged object.
    pub async fn replace_object(
        &self,
        key: &str,
        bytes: Vec<u8>,
        digest: &str,
    ) -> Result<PutOutcome, TargetError> {
        let payload = PutPayload::from(bytes);
        self.with_retries(key, || {
            self.write_object(key, &payload, PutMode::Overwrite, digest)
        })
        .await?;
        Ok(PutOutcome::Sent)
    }

    /// Returns whether an object has the given length and digest; reads it if it has no digest metadata.
    pub async fn has_digest(
        &self,
        key: &str,
        length: u64,
        digest: &str,
    ) -> Result<bool, TargetError> {
        let path = self.object_path(key);
        let get = |head: bool| {
            let options = GetOptions {
                head,
                ..GetOptions::default()
            };
            self.store.get_opts(&path, options)
        };
        let compare = || async {
            let found = get(self.metadata).await?;
            if found.meta.size != length {
                return Ok(false);
            }
            let stored = found
                .attributes
                .get(&Attribute::Metadata(DIGEST_KEY.into()))
                .map(|v| v.to_string());
            match stored {
                Some(stored) => Ok(stored == digest),
                None => Ok(sha256_hex(&get(false).await?.bytes().await?) == digest),
            }
        };
        self.with_retries(key, compare).await
    }

    pub(super) fn different_error(&self, key: &str) -> TargetError {
        let remedy = "a published flight does not change: publish later results as tables (docs/fleet.md), and another state of \
            the flight below another prefix; if the object was changed or damaged there, `--repair` restores it";
        TargetError::Different {
            url: self.display_url(key),
            remedy,
        }
    }

    fn request_error(&self, key: &str, error: &object_store::Error) -> TargetError {
        TargetError::Failed {
            url: self.display_url(key),
            reason: describe_error(error),
        }
    }

    /// Repeats a request while its error is transient, up to the configured number of retries, with growing pauses.
    async fn with_retries<T, W>(
        &self,
        key: &str,
        mut work: impl FnMut() -> W,
    ) -> Result<T, TargetError>
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
