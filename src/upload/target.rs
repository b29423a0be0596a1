//! A flight goes to a bucket of S3's kind, or to a directory.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::aws::{AmazonS3Builder, Checksum};
use object_store::local::LocalFileSystem;
use object_store::path::Path;
use object_store::{Attribute, Attributes, ClientOptions, GetOptions, ObjectStore, PutMode, PutOptions};
use object_store::{ObjectStoreExt, RetryConfig};

use crate::installation::Fault;
use crate::store::sha256;

/// Pause before the first repeat, doubled before each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);
/// Longest pause between two repeats.
const LONGEST_PAUSE: Duration = Duration::from_secs(8);
/// For a connection to be made.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(10);
/// For a request: a raw frame of 50 MB over 1 Mbit/s takes seven minutes.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(600);
/// Metadata of an object with its SHA-256, so that it can be compared without being read.
const DIGEST: &str = "sha256";
/// What may not stand in any text of ours.
const SECRETS: [&str; 3] = ["AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID"];

/// How much at once, and how often again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Objects at a time.
    pub jobs: usize,
    /// Repeats of a request that failed.
    pub retries: u32,
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

impl TargetError {
    pub(super) fn different(target: &Target, key: &str) -> Self {
        let mend = "a published flight stays as it is: results that were added since belong into tables \
            (docs/fleet.md), another state of the flight below another prefix";
        Self::Different { place: target.shown(key), mend }
    }
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
            return Err(fault(
                "--to",
                "value",
                problem,
                "give s3://BUCKET/PREFIX, credentials in AWS_* variables",
            ));
        }
        let prefix = Path::parse(prefix).map_err(|e| fault("--to", "prefix", e.to_string(), known))?;
        let store = bucket_of(bucket)?;
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

    /// Puts an object where there is none. One that is there with the same bytes is as good: it may be ours, of an
    /// attempt whose answer was lost.
    pub async fn put(&self, key: &str, bytes: Vec<u8>, digest: &str) -> Result<Put, TargetError> {
        let (path, length) = (self.path(key), bytes.len() as u64);
        let payload = object_store::PutPayload::from(bytes);
        let mut attributes = Attributes::new();
        if self.metadata {
            attributes.insert(Attribute::Metadata(DIGEST.into()), digest.to_owned().into());
        }
        let options = PutOptions { mode: PutMode::Create, attributes, ..PutOptions::default() };
        let put = || async {
            match self.store.put_opts(&path, payload.clone(), options.clone()).await {
                Ok(_) => Ok(true),
                Err(object_store::Error::AlreadyExists { .. }) => Ok(false),
                Err(error) => Err(error),
            }
        };
        match self.again(key, put).await? {
            true => Ok(Put::Sent),
            false => self.compare(key, length, digest).await,
        }
    }

    /// Whether an object is the one that was to be put; read where it does not carry its digest.
    pub async fn compare(&self, key: &str, length: u64, digest: &str) -> Result<Put, TargetError> {
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
        let same = self.again(key, look).await?;
        if same { Ok(Put::There) } else { Err(TargetError::different(self, key)) }
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
                    pause = (2 * pause).min(LONGEST_PAUSE);
                    left -= 1;
                }
                Err(error) => return Err(TargetError::Failed { place: self.shown(key), why: said(&error) }),
            }
        }
    }
}

/// A fault of an option or of the environment.
fn fault(file: &str, place: &str, problem: String, mend: &str) -> Fault {
    Fault { file: file.into(), place: place.to_owned(), problem, mend: mend.to_owned() }
}

fn bucket_of(bucket: &str) -> Result<object_store::aws::AmazonS3, Fault> {
    let given = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let pair = given("AWS_ACCESS_KEY_ID") && given("AWS_SECRET_ACCESS_KEY");
    let others = [
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
    ];
    if !pair && !others.iter().any(|name| given(name)) {
        let problem = "are not both set, and no other credentials are in the environment".to_owned();
        let mend = "export them; a server of your own needs AWS_ENDPOINT_URL and AWS_REGION too";
        return Err(fault("environment", "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY", problem, mend));
    }
    // One library of cryptography; that it is set already is as good.
    let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
    let options = ClientOptions::new().with_connect_timeout(CONNECT_TIMEOUT).with_timeout(REQUEST_TIMEOUT);
    let http = std::env::var("AWS_ALLOW_HTTP").is_ok_and(|value| value.eq_ignore_ascii_case("true"));
    let builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(options.with_allow_http(http))
        // A put that is create-only is repeated by us: the crate does not know that it may be.
        .with_retry(RetryConfig { max_retries: 0, ..RetryConfig::default() })
        .with_checksum_algorithm(Checksum::SHA256);
    let mend = "set the AWS_* variables as docs/fleet.md says";
    builder.build().map_err(|e| fault("environment", "AWS_*", redacted(&e.to_string()), mend))
}

/// Whether the same request may do later.
fn passes(error: &object_store::Error) -> bool {
    matches!(error, object_store::Error::Generic { .. } | object_store::Error::JoinError { .. })
}

/// An error in words, with what to look at.
fn said(error: &object_store::Error) -> String {
    use object_store::Error;
    let mend = match error {
        Error::NotFound { .. } => "make the bucket, or name another",
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            "look at the credentials in the environment and at what they may do"
        }
        Error::NotImplemented { .. } | Error::NotSupported { .. } => {
            "the server has to know conditional puts"
        }
        _ => {
            "look at the network, AWS_ENDPOINT_URL and AWS_REGION (AWS_ALLOW_HTTP=true for http), and call \
            the command again: it goes on where it ended"
        }
    };
    format!("{}; {mend}", redacted(&error.to_string()))
}

/// A text without the secrets that the environment holds: servers repeat keys in their answers.
fn redacted(text: &str) -> String {
    let secrets = SECRETS.iter().filter_map(|name| std::env::var(name).ok()).filter(|value| value.len() > 3);
    secrets.fold(text.to_owned(), |text, secret| text.replace(&secret, "***"))
}
