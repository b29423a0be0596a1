//! How many objects are sent at a time, and how fast.

use std::collections::VecDeque;
use std::fmt;
use std::future::Future;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures_util::{StreamExt, stream};
use object_store::client::{
    HttpClient, HttpConnector, HttpError, HttpErrorKind, HttpRequest, HttpResponse, HttpResponseBody,
    HttpService,
};

/// A break should not cost more of an object than was sent in this time: more objects at a time only where each is
/// through sooner.
const MAX_OBJECT_TIME: Duration = Duration::from_secs(2);
/// Objects that the rate is taken of.
const RATE_WINDOW: usize = 8;
/// Bytes that go at once where the rate is limited: 16 kB at 128 kbit/s are a second.
const SLICE_BYTES: usize = 16 << 10;

/// Measures the rate of what was sent, and tells how many objects may be under way.
#[derive(Debug)]
pub(super) struct SendPace {
    max_objects: usize,
    /// When objects arrived, and their bytes.
    arrived: VecDeque<(Instant, u64)>,
}

impl SendPace {
    /// One at a time until a rate is known, `most` at the most.
    pub fn new(most: usize, now: Instant) -> Self {
        Self { max_objects: most.max(1), arrived: VecDeque::from([(now, 0)]) }
    }

    pub fn record_object(&mut self, length: u64, now: Instant) {
        self.arrived.push_back((now, length));
        if self.arrived.len() > RATE_WINDOW {
            self.arrived.pop_front();
        }
    }

    /// Objects of that length at a time.
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

/// Bytes a second at most, over all requests of a program.
pub(super) struct RateLimit {
    bytes_per_s: f64,
    /// When what was let through is through.
    free_at: Mutex<Instant>,
}

impl RateLimit {
    pub fn new(bytes_per_s: u64) -> Self {
        Self { bytes_per_s: bytes_per_s.max(1) as f64, free_at: Mutex::new(Instant::now()) }
    }

    /// When so many bytes more may go.
    fn reserve_slot(&self, bytes: usize, now: Instant) -> Instant {
        let mut free = self.free_at.lock().unwrap_or_else(PoisonError::into_inner);
        let turn = (*free).max(now);
        *free = turn + Duration::from_secs_f64(bytes as f64 / self.bytes_per_s);
        turn
    }
}

/// Makes clients whose requests keep the limit.
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
    /// The same request whose body waits for its turn, slice by slice.
    async fn pace_request(&self, request: HttpRequest) -> Result<reqwest::Request, HttpError> {
        let (parts, body) = request.into_parts();
        let url = parts.uri.to_string().parse();
        let url =
            url.map_err(|error| HttpError::new(HttpErrorKind::Request, std::io::Error::other(error)))?;
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
        let begun = Instant::now();
        let at = |ms| begun + Duration::from_millis(ms);
        let mut pace = SendPace::new(4, begun);
        assert_eq!(pace.max_concurrent(1_000_000), 1, "nothing is known yet");
        pace.record_object(1_000_000, at(4000));
        assert_eq!(pace.max_concurrent(1_000_000), 1, "0.25 MB/s");
        assert_eq!(pace.max_concurrent(100_000), 4, "short ones are through soon");
        for n in 1..=RATE_WINDOW as u64 {
            pace.record_object(1_000_000, at(4000 + 100 * n));
        }
        assert_eq!(pace.max_concurrent(4_000_000), 4, "10 MB/s: the old rate is forgotten");
    }

    #[test]
    fn turns_follow_from_the_limit() {
        let limit = RateLimit::new(1000);
        let now = Instant::now() + Duration::from_secs(1);
        let turns: Vec<f64> =
            (0..3).map(|_| limit.reserve_slot(500, now).duration_since(now).as_secs_f64()).collect();
        assert_eq!(turns, [0.0, 0.5, 1.0]);
    }
}
