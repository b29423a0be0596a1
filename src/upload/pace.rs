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
const OBJECT_TIME: Duration = Duration::from_secs(2);
/// Objects that the rate is taken of.
const REMEMBERED: usize = 8;
/// Bytes that go at once where the rate is limited: 16 kB at 128 kbit/s are a second.
const SLICE_BYTES: usize = 16 << 10;

/// Measures the rate of what was sent, and tells how many objects may be under way.
#[derive(Debug)]
pub(super) struct Pace {
    most: usize,
    /// When objects arrived, and their bytes.
    arrived: VecDeque<(Instant, u64)>,
}

impl Pace {
    /// One at a time until a rate is known, `most` at the most.
    pub fn new(most: usize, now: Instant) -> Self {
        Self { most: most.max(1), arrived: VecDeque::from([(now, 0)]) }
    }

    pub fn arrived(&mut self, length: u64, now: Instant) {
        self.arrived.push_back((now, length));
        if self.arrived.len() > REMEMBERED {
            self.arrived.pop_front();
        }
    }

    /// Objects of that length at a time.
    pub fn at_once(&self, length: u64) -> usize {
        let (Some(first), Some(last)) = (self.arrived.front(), self.arrived.back()) else { return 1 };
        let bytes: u64 = self.arrived.iter().skip(1).map(|(_, length)| length).sum();
        let seconds = last.0.duration_since(first.0).as_secs_f64();
        if seconds <= 0.0 || length == 0 {
            return 1;
        }
        let objects = bytes as f64 / seconds * OBJECT_TIME.as_secs_f64() / length as f64;
        (objects as usize).clamp(1, self.most)
    }
}

/// Bytes a second at most, over all requests of a program.
pub(super) struct Limit {
    bytes_per_s: f64,
    /// When what was let through is through.
    free: Mutex<Instant>,
}

impl Limit {
    pub fn new(bytes_per_s: u64) -> Self {
        Self { bytes_per_s: bytes_per_s.max(1) as f64, free: Mutex::new(Instant::now()) }
    }

    /// When so many bytes more may go.
    fn turn(&self, bytes: usize, now: Instant) -> Instant {
        let mut free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let turn = (*free).max(now);
        *free = turn + Duration::from_secs_f64(bytes as f64 / self.bytes_per_s);
        turn
    }
}

/// Makes clients whose requests keep the limit.
#[derive(Clone)]
pub(super) struct Limited {
    pub limit: Arc<Limit>,
    pub client: reqwest::Client,
}

impl fmt::Debug for Limited {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Limited({} bytes/s)", self.limit.bytes_per_s)
    }
}

impl HttpConnector for Limited {
    fn connect(&self, _: &object_store::ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}

type Called<'a> = Pin<Box<dyn Future<Output = Result<HttpResponse, HttpError>> + Send + 'a>>;

impl HttpService for Limited {
    fn call<'a, 'b>(&'a self, request: HttpRequest) -> Called<'b>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(async move {
            let request = self.paced(request).await?;
            let response = self.client.execute(request).await.map_err(failed)?;
            let (status, headers) = (response.status(), response.headers().clone());
            let bytes = response.bytes().await.map_err(failed)?;
            let mut answer = HttpResponse::new(HttpResponseBody::from(bytes));
            *answer.status_mut() = status;
            *answer.headers_mut() = headers;
            Ok(answer)
        })
    }
}

impl Limited {
    /// The same request whose body waits for its turn, slice by slice.
    async fn paced(&self, request: HttpRequest) -> Result<reqwest::Request, HttpError> {
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
                let turn = limit.turn(slice.len(), Instant::now());
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

fn failed(error: reqwest::Error) -> HttpError {
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
        let mut pace = Pace::new(4, begun);
        assert_eq!(pace.at_once(1_000_000), 1, "nothing is known yet");
        pace.arrived(1_000_000, at(4000));
        assert_eq!(pace.at_once(1_000_000), 1, "0.25 MB/s");
        assert_eq!(pace.at_once(100_000), 4, "short ones are through soon");
        for n in 1..=REMEMBERED as u64 {
            pace.arrived(1_000_000, at(4000 + 100 * n));
        }
        assert_eq!(pace.at_once(4_000_000), 4, "10 MB/s: the old rate is forgotten");
    }

    #[test]
    fn turns_follow_from_the_limit() {
        let limit = Limit::new(1000);
        let now = Instant::now() + Duration::from_secs(1);
        let turns: Vec<f64> =
            (0..3).map(|_| limit.turn(500, now).duration_since(now).as_secs_f64()).collect();
        assert_eq!(turns, [0.0, 0.5, 1.0]);
    }
}
