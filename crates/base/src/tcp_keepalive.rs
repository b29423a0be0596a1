//! Detects a peer that is gone without closing the TCP connection, for example after a pulled cable or a power cut.

use std::io;
use std::os::fd::AsFd;
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};

/// Time without traffic after which a connection is probed.
const IDLE_BEFORE_PROBES: Duration = Duration::from_secs(10);
/// Time between two unanswered probes.
const PROBE_INTERVAL: Duration = Duration::from_secs(5);
/// Number of unanswered probes that end the connection.
const MAX_PROBES: u32 = 2;
/// Time after which unacknowledged data end the connection.
const MAX_UNACKNOWLEDGED: Duration = Duration::from_secs(20);

/// Makes the kernel end a TCP connection 20 s after the peer is gone.
///
/// # Errors
/// Returns an error if the kernel rejects the options.
pub fn keep_alive(connection: &impl AsFd) -> io::Result<()> {
    let socket = SockRef::from(connection);
    let probes = TcpKeepalive::new()
        .with_time(IDLE_BEFORE_PROBES)
        .with_interval(PROBE_INTERVAL)
        .with_retries(MAX_PROBES);
    socket.set_tcp_keepalive(&probes)?;
    socket.set_tcp_user_timeout(Some(MAX_UNACKNOWLEDGED))
}
