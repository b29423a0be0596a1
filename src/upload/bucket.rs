//! A bucket by the AWS_* variables, and what its server says, in words.

use std::error::Error as _;
use std::sync::Arc;
use std::time::Duration;

use object_store::aws::{AmazonS3, AmazonS3Builder, Checksum};
use object_store::{ClientOptions, RetryConfig};

use super::manifest::PART_BYTES;
use super::pace::{RateLimit, RateLimitedClient};
use crate::installation::Fault;

/// For a connection to be made: a wrong endpoint is said within 3 s. By satellite, 0.7 s there and back, it takes 2.1 s.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(2500);
/// For a request: an object of 4 MiB over 64 kbit/s takes nine minutes.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(600);
/// Repeats of the crate's own: a put that is create-only is repeated by us, it does not know that it may be.
const CRATE_RETRIES: usize = 0;
/// What may not stand in any text of ours.
const SECRETS: [&str; 3] = ["AWS_SECRET_ACCESS_KEY", "AWS_SESSION_TOKEN", "AWS_ACCESS_KEY_ID"];
/// Credentials that are no pair of keys, by a variable that names where they are.
const CREDENTIAL_VARIABLES: [&str; 3] = [
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
];
/// What servers of S3's kind answer
/// (https://docs.aws.amazon.com/AmazonS3/latest/API/ErrorResponses.html), and what it means here.
const SERVER_ERRORS: [(&str, &str, &str); 9] = [
    ("InvalidAccessKeyId", "the server does not know this access key", "look at AWS_ACCESS_KEY_ID"),
    (
        "SignatureDoesNotMatch",
        "the secret is not that of the access key",
        "look at AWS_SECRET_ACCESS_KEY (or AWS_REGION)",
    ),
    ("RequestTimeTooSkewed", "this machine's clock and the server's differ too much", "set the clock"),
    ("RequestExpired", "this machine's clock and the server's differ too much", "set the clock"),
    ("ExpiredToken", "the session token has run out", "get a new AWS_SESSION_TOKEN"),
    ("InvalidToken", "the session token is not one of the server's", "look at AWS_SESSION_TOKEN"),
    ("NoSuchBucket", "there is no such bucket", "make it, or name another in --to"),
    (
        "AccessDenied",
        "the access key may not do this",
        "let it list, get and put below the prefix; look at the name of the bucket too",
    ),
    ("AuthorizationHeaderMalformed", "the bucket is in another region", "look at AWS_REGION"),
];

/// `limit`: bytes a second.
pub(super) fn open_bucket(bucket: &str, limit: Option<u64>) -> Result<AmazonS3, Fault> {
    let given = |name: &&str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let pair = given(&"AWS_ACCESS_KEY_ID") && given(&"AWS_SECRET_ACCESS_KEY");
    // The crate would ask a metadata address of the machine's network: only where that is wished for.
    let metadata = env_equals("AWS_EC2_METADATA_DISABLED", "false");
    if !pair && !CREDENTIAL_VARIABLES.iter().any(given) && !metadata {
        let problem = "are not both set, and no other credentials are in the environment".to_owned();
        let mend = "export them; a server of your own needs AWS_ENDPOINT_URL and AWS_REGION too, a machine whose role \
            counts AWS_EC2_METADATA_DISABLED=false";
        return Err(option_fault("environment", "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY", problem, mend));
    }
    // One library of cryptography; that it is set already is as good.
    let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
    let timeout = limit.map_or(REQUEST_TIMEOUT, |rate| {
        REQUEST_TIMEOUT.max(Duration::from_secs(2 * PART_BYTES as u64 / rate.max(1)))
    });
    let http = env_equals("AWS_ALLOW_HTTP", "true");
    let options = ClientOptions::new().with_connect_timeout(CONNECT_TIMEOUT).with_timeout(timeout);
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(options.with_allow_http(http))
        .with_retry(RetryConfig { max_retries: CRATE_RETRIES, ..RetryConfig::default() })
        .with_checksum_algorithm(Checksum::SHA256);
    let mend = "set the AWS_* variables as docs/fleet.md says";
    let wrong = |problem: String| option_fault("environment", "AWS_*", redact_secrets(&problem), mend);
    if let Some(rate) = limit {
        let client = reqwest::Client::builder()
            .http1_only()
            .https_only(!http)
            .connect_timeout(CONNECT_TIMEOUT)
            .timeout(timeout);
        let client = client.build().map_err(|e| wrong(e.to_string()))?;
        builder = builder.with_http_connector(RateLimitedClient { limit: Arc::new(RateLimit::new(rate)), client });
    }
    builder.build().map_err(|e| wrong(e.to_string()))
}

fn env_equals(name: &str, wanted: &str) -> bool {
    std::env::var(name).is_ok_and(|value| value.eq_ignore_ascii_case(wanted))
}

/// A fault of an option or of the environment.
pub(super) fn option_fault(file: &str, place: &str, problem: String, mend: &str) -> Fault {
    Fault { file: file.into(), place: place.to_owned(), problem, remedy: mend.to_owned() }
}

/// Whether the same request may do later.
pub(super) fn is_transient(error: &object_store::Error) -> bool {
    let lasting = |text: &str| SERVER_ERRORS.iter().any(|(code, ..)| text.contains(code));
    matches!(error, object_store::Error::Generic { .. } | object_store::Error::JoinError { .. })
        && !lasting(&error_chain(error))
}

/// An error in words, with what to look at.
pub(super) fn describe_error(error: &object_store::Error) -> String {
    use object_store::Error;
    let text = error_chain(error);
    if let Some((code, what, mend)) = SERVER_ERRORS.iter().find(|(code, ..)| text.contains(code)) {
        return format!("{what} ({code}); {mend}");
    }
    let mend = match error {
        Error::NotFound { .. } => "look at the bucket's name and at AWS_ENDPOINT_URL",
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            "look at the credentials in the environment and at what they may do"
        }
        Error::NotImplemented { .. } | Error::NotSupported { .. } => {
            "the server has to know conditional puts"
        }
        Error::Generic { source, .. } if source.downcast_ref::<std::io::Error>().is_some() => {
            "look at the directory and its disk"
        }
        _ => {
            "nobody answers there as a store does: look at the network, AWS_ENDPOINT_URL and AWS_REGION \
            (AWS_ALLOW_HTTP=true for http), and call the command again: it goes on where it ended"
        }
    };
    format!("{}; {mend}", redact_secrets(&text))
}

/// What an error says, and what it comes from, in one line.
fn error_chain(error: &object_store::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let more = cause.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        source = cause.source();
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A text without the secrets that the environment holds: servers repeat keys in their answers.
fn redact_secrets(text: &str) -> String {
    let secrets = SECRETS.iter().filter_map(|name| std::env::var(name).ok()).filter(|value| value.len() > 3);
    secrets.fold(text.to_owned(), |text, secret| text.replace(&secret, "***"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(code: &str) -> object_store::Error {
        let body = format!("403 Forbidden: <Error><Code>{code}</Code><Message>no</Message></Error>");
        object_store::Error::Generic { store: "S3", source: body.into() }
    }

    #[test]
    fn what_a_server_refuses_is_told_apart_and_not_asked_again() {
        let words: Vec<String> = SERVER_ERRORS.iter().map(|(code, ..)| describe_error(&answer(code))).collect();
        for (text, mend) in words.iter().zip(["ACCESS_KEY_ID", "SECRET_ACCESS_KEY", "clock"]) {
            assert!(text.contains(mend), "{text}");
        }
        assert!(SERVER_ERRORS.iter().all(|(code, ..)| !is_transient(&answer(code))));
        assert!(is_transient(&answer("SlowDown")), "a server with much to do is asked again");
    }
}
