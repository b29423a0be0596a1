//! Limits of the answers: one budget of memory for all that are being sent, and few that are being made at a time. A page
//! must not take the memory that the recorder needs.

use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::body::{Body, Bytes};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body::{Frame, SizeHint};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::Refusal;

/// Memory of all answers being sent, kB.
const MEMORY_KB: usize = 64_000;
/// Memory of an answer that is sent from a file, kB: the pieces on their way.
const STREAM_KB: u64 = 200;
/// Maximum number of answers being made at the same time.
const MAX_MAKING: usize = 2;
/// Time after which a request that waits for others is refused.
const TURN_TIMEOUT: Duration = Duration::from_secs(20);

/// Budgets of a server's answers.
#[derive(Clone)]
pub(super) struct AnswerLimits {
    memory: Arc<Semaphore>,
    making: Arc<Semaphore>,
}

impl Default for AnswerLimits {
    fn default() -> Self {
        Self { memory: Arc::new(Semaphore::new(MEMORY_KB)), making: Arc::new(Semaphore::new(MAX_MAKING)) }
    }
}

/// Makes an answer when it is its turn, and holds its memory until it is sent; 503 if there is none.
pub(super) async fn limit_answers(State(limits): State<AnswerLimits>, request: Request, next: Next) -> Response {
    let turn = tokio::time::timeout(TURN_TIMEOUT, limits.making.acquire()).await;
    let Ok(Ok(_turn)) = turn else { return Refusal::Busy.into_response() };
    hold_memory(&limits.memory, next.run(request).await)
}

fn hold_memory(memory: &Arc<Semaphore>, response: Response) -> Response {
    let (head, body) = response.into_parts();
    let kilobytes = http_body::Body::size_hint(&body).upper().map_or(STREAM_KB, |bytes| bytes.div_ceil(1000));
    let kilobytes = u32::try_from(kilobytes).unwrap_or(u32::MAX);
    match memory.clone().try_acquire_many_owned(kilobytes) {
        Ok(held) => Response::from_parts(head, Body::new(HeldBody { body, _held: held })),
        Err(_) => Refusal::Busy.into_response(),
    }
}

/// Body of an answer, with the memory that it holds.
struct HeldBody {
    body: Body,
    _held: OwnedSemaphorePermit,
}

impl http_body::Body for HeldBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn size_hint(&self) -> SizeHint {
        http_body::Body::size_hint(&self.body)
    }

    fn is_end_stream(&self) -> bool {
        http_body::Body::is_end_stream(&self.body)
    }
}

#[cfg(test)]
mod tests {
    use axum::http::StatusCode;

    use super::*;

    #[test]
    fn answers_share_one_memory_until_they_are_sent() {
        let memory = Arc::new(Semaphore::new(1000));
        let answer = |bytes: usize| hold_memory(&memory, Response::new(Body::from(vec![0; bytes])));
        let first = answer(700_000);
        assert_eq!((first.status(), answer(400_000).status()), (StatusCode::OK, StatusCode::SERVICE_UNAVAILABLE));
        drop(first);
        assert_eq!(answer(400_000).status(), StatusCode::OK);
        assert_eq!(answer(2_000_000).status(), StatusCode::SERVICE_UNAVAILABLE, "more than there is");
    }
}
