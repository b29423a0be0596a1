//! Limits of the answers: one budget of memory for all that are being sent, and few that are being made at a time. A page
//! must not take the memory that the recorder needs.

use std::sync::Arc;
use std::time::Duration;

use axum::body::{Body, HttpBody};
use axum::extract::{Request, State};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use http_body_util::BodyExt;
use tokio::sync::Semaphore;

use super::Refusal;
use super::access::Access;

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
    access: Arc<Access>,
}

impl AnswerLimits {
    /// Creates full budgets; refusals are counted in `access`.
    pub fn new(access: Arc<Access>) -> Self {
        Self {
            memory: Arc::new(Semaphore::new(MEMORY_KB)),
            making: Arc::new(Semaphore::new(MAX_MAKING)),
            access,
        }
    }
}

/// Makes an answer when it is its turn, and holds its memory until it is sent; 503 if there is none.
pub(super) async fn limit_answers(
    State(limits): State<AnswerLimits>,
    request: Request,
    next: Next,
) -> Response {
    let turn = tokio::time::timeout(TURN_TIMEOUT, limits.making.clone().acquire_owned()).await;
    let Ok(Ok(turn)) = turn else {
        limits.access.count_busy();
        return Refusal::Busy.into_response();
    };
    // A task of its own: the work goes on if the client disconnects, and its turn lasts as long.
    let making = tokio::spawn(async move {
        let _turn = turn;
        next.run(request).await
    });
    match making.await {
        Ok(response) => hold_memory(&limits.memory, response).unwrap_or_else(|| {
            limits.access.count_busy();
            Refusal::Busy.into_response()
        }),
        Err(error) => Refusal::Failed(error.to_string()).into_response(),
    }
}

/// Holds the memory of an answer until it is sent; `None` if there is none.
fn hold_memory(memory: &Arc<Semaphore>, response: Response) -> Option<Response> {
    let (head, body) = response.into_parts();
    let kilobytes = body
        .size_hint()
        .upper()
        .map_or(STREAM_KB, |bytes| bytes.div_ceil(1000));
    let kilobytes = u32::try_from(kilobytes).unwrap_or(u32::MAX);
    let held = memory.clone().try_acquire_many_owned(kilobytes).ok()?;
    // The closure lives as long as the body.
    let holding = body.map_err(move |error| {
        let _held = &held;
        error
    });
    Some(Response::from_parts(head, Body::new(holding)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_share_one_memory_until_they_are_sent() {
        let memory = Arc::new(Semaphore::new(1000));
        let answer = |bytes: usize| hold_memory(&memory, Response::new(Body::from(vec![0; bytes])));
        let first = answer(700_000);
        assert!(first.is_some() && answer(400_000).is_none());
        drop(first);
        assert!(
            answer(400_000).is_some() && answer(2_000_000).is_none(),
            "more than there is"
        );
    }
}
