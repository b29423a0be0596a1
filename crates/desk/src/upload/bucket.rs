//! S3 buckets, configured by AWS_* variables, and explanations of server errors.

use std::error::Error as _;
use std::time::Duration;

use object_store::aws::{AmazonS3, AmazonS3Builder, Checksum};
use object_store::{ClientOptions, RetryConfig};

use wingd_base::fault::Fault;

/// Time limit for connecting, so that a wrong endpoint is reported within 3 s. By satellite (0.7 s round trip) connecting
/// takes 2.1 s.
const CONNECT_TIMEOUT: Duration = Duration::from_millis(2500);
/// Time limit for a request: an object of 4 MiB takes 9 min at 64 kbit/s.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(600);
/// Retries by the S3 crate. Create-only puts are retried in this module: the crate cannot know that they may be.
const CRATE_RETRIES: usize = 0;
/// Variables whose values must not appear in any text.
const SECRETS: [&str; 3] = [
    "AWS_SECRET_ACCESS_KEY",
    "AWS_SESSION_TOKEN",
    "AWS_ACCESS_KEY_ID",
];
/// Variables that refer to credentials other than a key pair.
const CREDENTIAL_VARIABLES: [&str; 3] = [
    "AWS_WEB_IDENTITY_TOKEN_FILE",
    "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
    "AWS_CONTAINER_CREDENTIALS_FULL_URI",
];
/// Error codes of S3 servers (https://docs.aws.amazon.com/AmazonS3/latest/API/ErrorResponses.html), each with explanation
/// and remedy.
const SERVER_ERRORS: [(&str, &str, &str); 9] = [
    (
        "InvalidAccessKeyId",
        "the server does not know this access key",
        "check AWS_ACCESS_KEY_ID",
    ),
    (
        "SignatureDoesNotMatch",
        "the secret does not match the access key",
        "check AWS_SECRET_ACCESS_KEY (or AWS_REGION)",
    ),
    (
        "RequestTimeTooSkewed",
        "this machine's clock and the server's differ too much",
        "set the clock",
    ),
    (
        "RequestExpired",
        "this machine's clock and the server's differ too much",
        "set the clock",
    ),
    (
        "ExpiredToken",
        "the session token has expired",
        "get a new AWS_SESSION_TOKEN",
    ),
    (
        "InvalidToken",
        "the server does not accept the session token",
        "check AWS_SESSION_TOKEN",
    ),
    (
        "NoSuchBucket",
        "the bucket does not exist",
        "create it, or name another in --to",
    ),
    (
        "AccessDenied",
        "the access key has no permission for this",
        "permit list, get and put below the prefix; check the name of the bucket",
    ),
    (
        "AuthorizationHeaderMalformed",
        "the bucket is in another region",
        "check AWS_REGION",
    ),
];

/// Opens a bucket with the settings in the environment.
pub(super) fn open_bucket(bucket: &str) -> Result<AmazonS3, Fault> {
    let given = |name: &&str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let pair = given(&"AWS_ACCESS_KEY_ID") && given(&"AWS_SECRET_ACCESS_KEY");
    // The crate would query the metadata service of the network; only if explicitly enabled.
    let metadata = env_equals("AWS_EC2_METADATA_DISABLED", "false");
    if !pair && !CREDENTIAL_VARIABLES.iter().any(given) && !metadata {
        let problem =
            "are not both set, and no other credentials are in the environment".to_owned();
        let remedy = "export them; for your own server also set AWS_ENDPOINT_URL and AWS_REGION, for the role of an EC2 machine \
            set AWS_EC2_METADATA_DISABLED=false";
        return Err(option_fault(
            "environment",
            "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY",
            problem,
            remedy,
        ));
    }
    // Selects one cryptography library; an error means that it is set already.
    let _ = tokio_rustls::rustls::crypto::ring::default_provider().install_default();
    let options = ClientOptions::new()
        .with_connect_timeout(CONNECT_TIMEOUT)
        .with_timeout(REQUEST_TIMEOUT)
        .with_allow_http(env_equals("AWS_ALLOW_HTTP", "true"));
    let builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_client_options(options)
        .with_retry(RetryConfig {
            max_retries: CRATE_RETRIES,
            ..RetryConfig::default()
        })
        .with_checksum_algorithm(Checksum::SHA256);
    let remedy = "set the AWS_* variables as described in docs/fleet.md";
    builder.build().map_err(|e| {
        option_fault(
            "environment",
            "AWS_*",
            redact_secrets(&e.to_string()),
            remedy,
        )
    })
}

fn env_equals(name: &str, expected: &str) -> bool {
    std::env::var(name).is_ok_and(|value| value.eq_ignore_ascii_case(expected))
}

/// Creates an error for an option or an environment variable.
pub(super) fn option_fault(file: &str, place: &str, problem: String, remedy: &str) -> Fault {
    Fault::new(file, place, problem, remedy)
}

/// Returns whether the same request may succeed later.
pub(super) fn is_transient(error: &object_store::Error) -> bool {
    let is_permanent = |text: &str| SERVER_ERRORS.iter().any(|(code, ..)| text.contains(code));
    matches!(
        error,
        object_store::Error::Generic { .. } | object_store::Error::JoinError { .. }
    ) && !is_permanent(&error_chain(error))
}

/// Describes an error, with a remedy.
pub(super) fn describe_error(error: &object_store::Error) -> String {
    use object_store::Error;
    let text = error_chain(error);
    if let Some((code, problem, remedy)) =
        SERVER_ERRORS.iter().find(|(code, ..)| text.contains(code))
    {
        return format!("{problem} ({code}); {remedy}");
    }
    let remedy = match error {
        Error::NotFound { .. } => "check the bucket's name and AWS_ENDPOINT_URL",
        Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => {
            "check the credentials in the environment and their permissions"
        }
        Error::NotImplemented { .. } | Error::NotSupported { .. } => {
            "the server must support conditional puts"
        }
        Error::Generic { source, .. } if source.downcast_ref::<std::io::Error>().is_some() => {
            "check the directory and its disk"
        }
        _ => {
            "no S3 server answers there: check the network, AWS_ENDPOINT_URL and AWS_REGION (AWS_ALLOW_HTTP=true \
            for http), and run the command again to continue"
        }
    };
    format!("{}; {remedy}", redact_secrets(&text))
}

/// Joins the messages of an error and its causes into one line.
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

/// Removes the secrets of the environment from a text: servers repeat keys in their answers.
fn redact_secrets(text: &str) -> String {
    let secrets = SECRETS
        .iter()
        .filter_map(|name| std::env::var(name).ok())
        .filter(|value| value.len() > 3);
    secrets.fold(text.to_owned(), |text, secret| text.replace(&secret, "***"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(code: &str) -> object_store::Error {
        let body =
            format!("403 Forbidden: <Error><Code>{code}</Code><Message>no</Message></Error>");
        object_store::Error::Generic {
            store: "S3",
            source: body.into(),
        }
    }

    #[test]
    fn refusals_of_a_server_are_distinguished_and_not_retried() {
        let words: Vec<String> = SERVER_ERRORS
            .iter()
            .map(|(code, ..)| describe_error(&answer(code)))
            .collect();
        for (text, remedy) in words
            .iter()
            .zip(["ACCESS_KEY_ID", "SECRET_ACCESS_KEY", "clock"])
        {
            assert!(text.contains(remedy), "{text}");
        }
        assert!(
            SERVER_ERRORS
                .iter()
                .all(|(code, ..)| !is_transient(&answer(code)))
        );
        assert!(
            is_transient(&answer("SlowDown")),
            "a busy server is asked again"
        );
    }
}
