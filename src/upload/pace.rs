//! Concurrency and rate limit of uploads.

use std::collections::VecDeque;
use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures_util::{StreamExt, stream};
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody, HttpService,
};

/// Time bound for an object: an interruption should not cost more than this much sending. More objects are sent
/// concurrently only if each is finished sooner.
const MAX_OBJECT_TIME: Duration = Duration::from_secs(2);
/// Number of recent objects from which the rate is measured.
const RATE_WINDOW: usize = 8;
/// Bytes sent at once if the rate is limited: 16 kB take 1 s at 128 kbit/s.
const SLICE_BYTES: usize = 16 << 10;

/// Measured upload rate, which determines the number of concurrent objects.
#[derive(Debug)]
pub(super) struct SendPace {
    max_objects: usize,
    /// Time of arrival and length of recent objects.
    arrived: VecDeque<(Instant, u64)>,
}

impl SendPace {
    /// Starts with one object at a time; never more than `most`.
    pub fn new(most: usize, now: Instant) -> Self {
        Self { max_objects: most.max(1), arrived: VecDeque::from([(now, 0)]) }
    }

    /// Records an object of `length` bytes that arrived at `now`.
    pub fn record_object(&mut self, length: u64, now: Instant) {
        self.arrived.push_back((now, length));
        if self.arrived.len() > RATE_WINDOW {
            self.arrived.pop_front();
        }
    }

    /// Returns the number of objects of this length to send concurrently.
    pub fn max_concurrent(&self, length: u64) -> usize {
        let (Some(first), Some(last)) = (self.arrived.front(), self.arrived.back()) else { return 1 };
        let bytes: u64 = self.arrived.iter().skip(1).map(|(_, length)| length).sum();
        let seconds = last.0.duration_since(first.0).as_secs_f64();
        if seconds <= 0.0 || length == 0 {
            return 1;
        }
        let objects = bytes as f64 / seconds * MAX_OBJECT_TIME.as_secs_f64() / length as f64;
        (objects as usize).clamp(1, self.max_objects)
    }
}

/// Maximum rate over all requests of the program.
pub(super) struct RateLimit {
    bytes_per_s: f64,
    /// Time at which the bytes admitted so far have been sent.
    free_at: Mutex<Instant>,
}

impl RateLimit {
    /// Creates a pace for at most `most` objects at a time.
    pub fn new(bytes_per_s: u64) -> Self {
        Self { bytes_per_s: bytes_per_s.max(1) as f64, free_at: Mutex::new(Instant::now()) }
    }

    /// Reserves the transmission of bytes; returns the time at which it may begin.
    fn reserve_slot(&self, bytes: usize, now: Instant) -> Instant {
        let mut free = self.free_at.lock().unwrap_or_else(PoisonError::into_inner);
        let turn = (*free).max(now);
        *free = turn + Duration::from_secs_f64(bytes as f64 / self.bytes_per_s);
        turn
    }
}

/// HTTP client whose requests observe the rate limit.
#[derive(Clone)]
pub(super) struct RateLimitedClient {
    pub limit: Arc<RateLimit>,
    pub client: reqwest::Client,
}

impl fmt::Debug for RateLimitedClient {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Limited({} bytes/s)", self.limit.bytes_per_s)
    }
}

impl HttpConnector for RateLimitedClient {
    fn connect(&self, _: &object_store::ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}

type ResponseFuture<'a> = Pin<Box<dyn Future<Output = Result<HttpResponse, HttpError>> + Send + 'a>>;

impl HttpService for RateLimitedClient {
    fn call<'a, 'b>(&'a self, request: HttpRequest) -> ResponseFuture<'b>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(async move {
            let request = self.pace_request(request).await?;
            let response = self.client.execute(request).await.map_err(to_http_error)?;
            let (status, headers) = (response.status(), response.headers().clone());
            let bytes = response.bytes().await.map_err(to_http_error)?;
            let mut answer = HttpResponse::new(HttpResponseBody::from(bytes));
            *answer.status_mut() = status;
            *answer.headers_mut() = headers;
            Ok(answer)
        })
    }
}

impl RateLimitedClient {
    /// Returns the request with a body that is sent slice by slice at the limited rate.
    async fn pace_request(&self, request: HttpRequest) -> Result<reqwest::Request, HttpError> {
        let (parts, body) = request.into_parts();
        let url = parts.uri.to_string().parse();
        let url = url.map_err(|error| HttpError::new(HttpErrorKind::Request, std::io::Error::other(error)))?;
        let mut paced = reqwest::Request::new(parts.method, url);
        *paced.headers_mut() = parts.headers;
        let length = body.content_length();
        if length > 0 {
            paced.headers_mut().insert("content-length", length.into());
            let bytes = HttpResponseBody::new(body).bytes().await?;
            let slices: Vec<_> = (0..length)
                .step_by(SLICE_BYTES)
                .map(|from| bytes.slice(from..length.min(from + SLICE_BYTES)))
                .collect();
            let limit = self.limit.clone();
            let body = stream::iter(slices).then(move |slice| {
                let turn = limit.reserve_slot(slice.len(), Instant::now());
                async move {
                    tokio::time::sleep_until(turn.into()).await;
                    Result::<_, std::io::Error>::Ok(slice)
                }
            });
            *paced.body_mut() = Some(reqwest::Body::wrap_stream(body));
        }
        Ok(paced)
    }
}

fn to_http_error(error: reqwest::Error) -> HttpError {
    let kind = if error.is_timeout() {
        HttpErrorKind::Timeout
    } else if error.is_connect() {
        HttpErrorKind::Connect
    } else {
        HttpErrorKind::Request
    };
    HttpError::new(kind, error.without_url())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_link_gets_one_object_at_a_time() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut pace = SendPace::new(4, start);
        assert_eq!(pace.max_concurrent(1_000_000), 1, "nothing is known yet");
        pace.record_object(1_000_000, at(4000));
        assert_eq!(pace.max_concurrent(1_000_000), 1, "0.25 MB/s");
        assert_eq!(pace.max_concurrent(100_000), 4, "short ones finish soon");
        for n in 1..=RATE_WINDOW as u64 {
            pace.record_object(1_000_000, at(4000 + 100 * n));
        }
        assert_eq!(pace.max_concurrent(4_000_000), 4, "10 MB/s: the old rate is forgotten");
    }

    #[test]
    fn turns_follow_from_the_limit() {
        let limit = RateLimit::new(1000);
        let now = Instant::now() + Duration::from_secs(1);
        let turns: Vec<f64> = (0..3).map(|_| limit.reserve_slot(500, now).duration_since(now).as_secs_f64()).collect();
        assert_eq!(turns, [0.0, 0.5, 1.0]);
    }
}
