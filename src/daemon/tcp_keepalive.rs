//! A connection that lasts must notice that the other side is gone without a word: a cable pulled, a machine switched off.

use std::io;
use std::os::fd::AsFd;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};

/// A connection without traffic is probed after so long.
const QUIET: Duration = Duration::from_secs(10);
/// Between two probes that are not answered.
const PROBES_EVERY: Duration = Duration::from_secs(5);
/// So many unanswered probes end it.
const PROBES: u32 = 2;
/// What was sent and is not acknowledged for so long ends it.
const UNACKNOWLEDGED: Duration = Duration::from_secs(20);

/// The kernel ends a TCP connection 20 s after the other side is gone.
///
/// # Errors
/// Where the kernel does not take the options.
pub fn keep_alive(connection: &impl AsFd) -> io::Result<()> {
    let socket = SockRef::from(connection);
    let probes = TcpKeepalive::new().with_time(QUIET).with_interval(PROBES_EVERY).with_retries(PROBES);
    socket.set_tcp_keepalive(&probes)?;
    socket.set_tcp_user_timeout(Some(UNACKNOWLEDGED))
}
