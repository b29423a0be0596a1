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

use super::bucket::{self, fault, passes, said};
use crate::installation::Fault;
use crate::store::sha256;

/// Pause before the first repeat, doubled before each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Longest pause between two repeats.
const MAX_PAUSE: Duration = Duration::from_secs(8);
/// Metadata of an object with its SHA-256, so that it can be compared without being read.
const DIGEST: &str = "sha256";

/// How much at once, and how often again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
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
    #[error("{place}: is there already, with other bytes, and is not written over; {mend}")]
    Different {
        /// URL.
        place: String,
        /// What to do.
        mend: &'static str,
    },
    /// The same flight, of another aircraft, type or wing than the call says.
    #[error(
        "{place}: is published as {there}; whose it is stays as it was said first: correct it with \
        `wingd-fleet correct`, or leave the options out"
    )]
    Contradicted {
        /// URL.
        place: String,
        /// Aircraft, type and wing there.
        there: String,
    },
    /// Something that is not of this flight.
    #[error("{place}: is not a file of this flight; move it away, or upload below another prefix")]
    Foreign {
        /// URL.
        place: String,
    },
    /// After all repeats.
    #[error("{place}: {why}")]
    Failed {
        /// URL.
        place: String,
        /// The other side's answer, and the mend.
        why: String,
    },
}

/// What became of an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Put {
    /// It is there by us.
    Sent,
    /// It was there, with the same bytes.
    There,
}

/// A bucket and prefix, or a directory.
#[derive(Debug)]
pub struct Target {
    store: Arc<dyn ObjectStore>,
    prefix: Path,
    url: String,
    /// Objects carry their digest; files are read instead.
    metadata: bool,
    settings: Settings,
}

impl Target {
    /// `s3://bucket/prefix` or `file:///directory`. Credentials, region and endpoint come from the environment
    /// (`AWS_ACCESS_KEY_ID` and its like) and from nowhere else.
    ///
    /// # Errors
    /// A fault names the option or variable.
    pub fn open(url: &str, settings: Settings) -> Result<Self, Fault> {
        let url = url.trim_end_matches('/');
        if let Some(path) = url.strip_prefix("file://") {
            return Self::directory(path, settings);
        }
        let known = "give s3://BUCKET/PREFIX or file:///DIRECTORY";
        let Some(rest) = url.strip_prefix("s3://") else {
            return Err(fault("--to", "value", "is neither a bucket nor a directory".into(), known));
        };
        let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
        let plain = |c: char| c.is_ascii_alphanumeric() || ".-_".contains(c);
        if bucket.is_empty() || !bucket.chars().all(plain) {
            // The text is not repeated: what stands before an @ may be a secret.
            let problem = "names no bucket (letters, digits, '.', '-', '_' alone)".to_owned();
            let mend = "give s3://BUCKET/PREFIX, credentials in AWS_* variables";
            return Err(fault("--to", "value", problem, mend));
        }
        let prefix = Path::parse(prefix).map_err(|e| fault("--to", "prefix", e.to_string(), known))?;
        let store = bucket::open(bucket, settings.limit)?;
        Ok(Self { store: Arc::new(store), prefix, url: url.to_owned(), metadata: true, settings })
    }

    fn directory(path: &str, settings: Settings) -> Result<Self, Fault> {
        let wrong = |problem: String| {
            fault("--to", "value", problem, "give file:///DIRECTORY, a directory that can be written")
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
    pub fn settings(&self) -> Settings {
        self.settings
    }

    /// A key as a URL, for people.
    pub fn shown(&self, key: &str) -> String {
        format!("{}/{key}", self.url)
    }

    fn path(&self, key: &str) -> Path {
        key.split('/').fold(self.prefix.clone(), |path, part| path.join(part))
    }

    /// The first question, asked once: whether anybody is there, and lets us in.
    pub async fn greet(&self, place: &str) -> Result<(), TargetError> {
        let below = self.path(place);
        let listed = self.store.list(Some(&below)).try_collect::<Vec<_>>().await;
        listed.map(|_| ()).map_err(|error| self.failed(place, &error))
    }

    /// Keys below a place, with their lengths.
    pub async fn list(&self, place: &str) -> Result<BTreeMap<String, u64>, TargetError> {
        let below = self.path(place);
        let list = || async { self.store.list(Some(&below)).try_collect::<Vec<_>>().await };
        let all = self.again(place, list).await?;
        let own = self.prefix.parts().count();
        let key = |path: &Path| {
            path.parts().skip(own).map(|part| part.as_ref().to_owned()).collect::<Vec<_>>().join("/")
        };
        Ok(all.iter().map(|meta| (key(&meta.location), meta.size)).collect())
    }

    /// An object's bytes; `None` where there is none.
    pub async fn read(&self, key: &str) -> Result<Option<Vec<u8>>, TargetError> {
        let path = self.path(key);
        let get = || async {
            match self.store.get(&path).await {
                Ok(found) => Ok(Some(found.bytes().await?.to_vec())),
                Err(object_store::Error::NotFound { .. }) => Ok(None),
                Err(error) => Err(error),
            }
        };
        self.again(key, get).await
    }

    fn options(&self, mode: PutMode, digest: &str) -> PutOptions {
        let mut attributes = Attributes::new();
        if self.metadata {
            attributes.insert(Attribute::Metadata(DIGEST.into()), digest.to_owned().into());
        }
        PutOptions { mode, attributes, ..PutOptions::default() }
    }

    /// Puts an object where there is none. One that is there with the same bytes is as good: it may be ours, of an
    /// attempt whose answer was lost.
    pub async fn put(&self, key: &str, bytes: Vec<u8>, digest: &str) -> Result<Put, TargetError> {
        let (path, length) = (self.path(key), bytes.len() as u64);
        let payload = PutPayload::from(bytes);
        let options = self.options(PutMode::Create, digest);
        let put = || async {
            match self.store.put_opts(&path, payload.clone(), options.clone()).await {
                Ok(_) => Ok(true),
                Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
                Err(error) => Err(error),
            }
        };
        if self.again(key, put).await? {
            return Ok(Put::Sent);
        }
        if self.same(key, length, digest).await? { Ok(Put::There) } else { Err(self.different(key)) }
    }

    /// Puts the right bytes in place of damaged ones.
    pub async fn replace(&self, key: &str, bytes: Vec<u8>, digest: &str) -> Result<Put, TargetError> {
        let path = self.path(key);
        let payload = PutPayload::from(bytes);
        let options = self.options(PutMode::Overwrite, digest);
        let put = || async { self.store.put_opts(&path, payload.clone(), options.clone()).await };
        self.again(key, put).await.map(|_| Put::Sent)
    }

    /// Whether an object is the one that was to be put; read where it does not carry its digest.
    pub async fn same(&self, key: &str, length: u64, digest: &str) -> Result<bool, TargetError> {
        let path = self.path(key);
        let get = |head: bool| {
            let options = GetOptions { head, ..GetOptions::default() };
            self.store.get_opts(&path, options)
        };
        let look = || async {
            let found = get(self.metadata).await?;
            if found.meta.size != length {
                return Ok(false);
            }
            let said = found.attributes.get(&Attribute::Metadata(DIGEST.into())).map(|v| v.to_string());
            match said {
                Some(said) => Ok(said == digest),
                None => Ok(sha256(&get(false).await?.bytes().await?) == digest),
            }
        };
        self.again(key, look).await
    }

    pub(super) fn different(&self, key: &str) -> TargetError {
        let mend = "a published flight stays as it is: results that were added since belong into tables \
            (docs/fleet.md), another state of the flight below another prefix; where the object was changed \
            or damaged there, `--repair` puts the right bytes again";
        TargetError::Different { place: self.shown(key), mend }
    }

    fn failed(&self, key: &str, error: &object_store::Error) -> TargetError {
        TargetError::Failed { place: self.shown(key), why: said(error) }
    }

    /// Does it again where the reason may pass, so many times, with growing pauses.
    async fn again<T, W>(&self, key: &str, mut work: impl FnMut() -> W) -> Result<T, TargetError>
    where
        W: Future<Output = object_store::Result<T>>,
    {
        let mut pause = FIRST_PAUSE;
        let mut left = self.settings.retries;
        loop {
            match work().await {
                Ok(done) => return Ok(done),
                Err(error) if left > 0 && passes(&error) => {
                    tokio::time::sleep(pause).await;
                    pause = (2 * pause).min(MAX_PAUSE);
                    left -= 1;
                }
                Err(error) => return Err(self.failed(key, &error)),
            }
        }
    }
}
