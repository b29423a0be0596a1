//! Aircraft data during a flight: receives the lines of a feed and records them. A feed that hangs, floods or is gone, or a
//! full disk, never stops capturing: only lines are lost, and they are counted.

mod config;
mod feed;
mod recording;

use std::sync::mpsc::sync_channel;
use std::time::Duration;

use super::core::{Core, DrainedThreads};
pub use config::AircraftConfig;
use feed::{FeedContext, LineIntake};
use recording::LineRecorder;

/// Maximum time that the end of the recorder waits for the last lines.
const DRAIN_TIMEOUT: Duration = Duration::from_secs(3);

/// Starts the threads that receive and record lines until the daemon ends. If a thread cannot be started, the status
/// reports it.
pub(crate) fn start_feed(core: &Core, config: &AircraftConfig) -> DrainedThreads {
    let shared = FeedContext {
        core: core.clone(),
        config: config.clone(),
    };
    let (lines, inbox) = sync_channel(recording::MAX_WAITING);
    let intake = LineIntake::new(shared.clone(), lines);
    let recorder = LineRecorder::new(shared.clone());
    let mut threads = DrainedThreads::new(DRAIN_TIMEOUT);
    let receiving = Core::spawn_thread("aircraft-feed", move || intake.run());
    let recording = threads.spawn("aircraft-store", move || recorder.run(&inbox));
    if let Err(error) = receiving.map(drop).and(recording) {
        shared.set_fault(Some(format!(
            "no thread can be started to receive lines: {error}; restart wingd"
        )));
    }
    threads
}

#[cfg(test)]
mod tests {
    use super::*;

    use std::io::{Read, Write};
    use std::net::UdpSocket;
    use std::sync::Arc;

    use crate::daemon::shutdown::Halt;
    use crate::daemon::status::{AircraftStatus, StatusBoard};
    use wingd_base::clock::{Clock, SystemClock};
    use wingd_store::manifest::{SeriesCause, SeriesState};
    use wingd_store::{RealDisk, SeriesPlan, Store, StoreConfig, catalogue, verify};

    struct Bench {
        dir: tempfile::TempDir,
        core: Core,
    }

    /// A store with a flight, which keeps `reserve_mb` free.
    fn bench(reserve_mb: u64) -> Bench {
        let dir = tempfile::tempdir().unwrap();
        let config = |reserve_mb| StoreConfig {
            reserve_mb,
            ..StoreConfig::new(dir.path())
        };
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let (store, _) = Store::open(Arc::new(RealDisk), config(0)).unwrap();
        let (series, _) = store
            .begin_series(
                SeriesPlan {
                    cause: SeriesCause::Scheduled,
                    shots: 1,
                },
                &clock.stamp(),
            )
            .unwrap();
        store
            .close_series(series, SeriesState::Interrupted, &clock.stamp(), vec![])
            .unwrap();
        drop(store);
        let store = Arc::new(
            Store::open(Arc::new(RealDisk), config(reserve_mb))
                .unwrap()
                .0,
        );
        let board = StatusBoard::new(clock.clone());
        let core = Core {
            store,
            clock,
            board,
            halt: Halt::default(),
            observer: Arc::new(|_| ()),
        };
        Bench { dir, core }
    }

    impl Bench {
        fn listen(&self, config: &str) -> DrainedThreads {
            let config: AircraftConfig = toml::from_str(config).unwrap();
            start_feed(&self.core, &config)
        }

        fn end(&self, feed: DrainedThreads) {
            self.core.halt.end(DRAIN_TIMEOUT);
            drop(feed);
        }

        /// Waits, on a slow machine too, until the status satisfies the condition.
        fn until(&self, condition: impl Fn(&AircraftStatus) -> bool) -> AircraftStatus {
            for _ in 0..600 {
                let status = self.core.board.snapshot().aircraft.unwrap_or_default();
                if condition(&status) {
                    return status;
                }
                std::thread::sleep(Duration::from_millis(50));
            }
            self.core.board.snapshot().aircraft.unwrap_or_default()
        }
    }

    /// UTC by the recorder's own clock.
    fn now_utc() -> jiff::Timestamp {
        SystemClock::new().stamp().utc
    }

    /// An unused port.
    fn free_port() -> u16 {
        UdpSocket::bind("127.0.0.1:0")
            .unwrap()
            .local_addr()
            .unwrap()
            .port()
    }

    fn send(port: u16, count: usize) {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        for _ in 0..count {
            let now = now_utc();
            let line = format!(
                "IWG1,{},1,2\r\nnoise\r\n",
                now.to_string().trim_end_matches('Z')
            );
            socket
                .send_to(line.as_bytes(), ("127.0.0.1", port))
                .unwrap();
        }
    }

    #[test]
    fn datagrams_are_recorded_and_covered_at_the_end() {
        let bench = bench(0);
        let port = free_port();
        let feed = bench.listen(&format!("udp = '127.0.0.1:{port}'"));
        // The socket may not be bound yet: nobody promises a datagram's arrival.
        let status = bench.until(|status| {
            send(port, 5);
            status.recorded >= 20
        });
        assert!(
            status.recorded >= 20 && status.lost == 0 && status.fault.is_none(),
            "{status:?}"
        );
        // Every other line is noise, and kept; the last one may still wait.
        assert!(
            (status.read * 2).abs_diff(status.recorded) <= 1,
            "{status:?}"
        );
        bench.end(feed);
        let flight = catalogue::list_flights(&RealDisk, bench.dir.path())
            .unwrap()
            .remove(0);
        assert_eq!(
            wingd_store::aircraft::closed_files(&RealDisk, &flight)
                .unwrap()
                .len(),
            1
        );
        assert!(verify::verify_path(&RealDisk, bench.dir.path()).is_sound());
    }

    #[test]
    fn lines_that_a_flood_displaced_stay_in_the_status_with_the_remedy() {
        let bench = bench(0);
        let port = free_port();
        let _feed = bench.listen(&format!("udp = '127.0.0.1:{port}'"));
        let flooded = bench.until(|status| {
            send(port, 1000);
            status.lost > 0
        });
        assert!(flooded.lost > 0, "{flooded:?}");
        std::thread::sleep(Duration::from_secs(5));
        let before = bench.until(|_| true).recorded;
        let status = bench.until(|status| {
            send(port, 1);
            status.recorded > before + 2
        });
        let fault = status.fault.unwrap_or_default();
        assert!(
            fault.contains("lines were lost") && fault.contains("senders"),
            "{fault}"
        );
    }

    #[test]
    fn a_full_disk_costs_the_lines_and_says_so() {
        let bench = bench(u64::MAX / 2_000_000);
        let port = free_port();
        let _feed = bench.listen(&format!("udp = '127.0.0.1:{port}'"));
        let status = bench.until(|status| {
            send(port, 5);
            status.lost > 0
        });
        assert!(status.recorded == 0 && status.lost > 0);
        assert!(status.fault.is_some_and(|fault| fault.contains("reserve")));
    }

    #[test]
    fn a_server_that_hangs_or_disconnects_is_reconnected_without_delay_to_others() {
        let bench = bench(0);
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = server.local_addr().unwrap().port();
        let text = format!(
            "tcp = '127.0.0.1:{port}'\nformat = 'text'\nsubscribe = ['add,mach']\n[[column]]\nfield = 2\nquantity = 'mach'\n"
        );
        let feed = bench.listen(&text);
        let (first, _) = server.accept().unwrap();
        // It says nothing, then goes.
        drop(first);
        let status = bench.until(|status| status.fault.is_some());
        assert!(
            status
                .fault
                .is_some_and(|fault| fault.contains(&port.to_string()))
        );
        let (mut second, _) = server.accept().unwrap();
        let mut asked = [0; 10];
        second.read_exact(&mut asked).unwrap();
        assert_eq!(&asked, b"add,mach\r\n");
        let now = now_utc();
        second
            .write_all(format!("{now},0.78\n{now},0.").as_bytes())
            .unwrap();
        second.write_all(b"79\n").unwrap();
        let status = bench.until(|status| status.read == 2);
        assert_eq!((status.recorded, status.read, status.fault), (2, 2, None));
        // It hangs: the connection stays and nothing comes.
        bench.end(feed);
        assert!(verify::verify_path(&RealDisk, bench.dir.path()).is_sound());
    }

    #[test]
    fn a_server_that_sends_no_line_is_called_again_and_the_fault_is_that() {
        let bench = bench(0);
        let server = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = server.local_addr().unwrap().port();
        let feed = bench.listen(&format!("tcp = '127.0.0.1:{port}'\nidle = '500ms'"));
        let (mut first, _) = server.accept().unwrap();
        let chatter = std::thread::spawn(move || {
            while first.write_all(b"\r\n").is_ok() {
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        let fault = bench.until(|status| status.fault.is_some()).fault.unwrap();
        assert!(fault.contains("no line for 0.5 s"), "{fault}");
        drop(server.accept().unwrap());
        chatter.join().unwrap();
        bench.end(feed);
    }

    #[test]
    fn datagrams_of_other_senders_are_not_recorded() {
        let bench = bench(0);
        let port = free_port();
        let feed = bench.listen(&format!(
            "udp = '127.0.0.1:{port}'\nsenders = ['127.0.0.2']"
        ));
        let named = UdpSocket::bind("127.0.0.2:0").unwrap();
        let status = bench.until(|status| {
            send(port, 5);
            let line = format!(
                "IWG1,{},1,2\r\n",
                now_utc().to_string().trim_end_matches('Z')
            );
            named.send_to(line.as_bytes(), ("127.0.0.1", port)).unwrap();
            status.recorded > 0
        });
        assert_eq!(
            (status.recorded, status.lost),
            (status.read, 0),
            "no noise: {status:?}"
        );
        bench.end(feed);
    }

    #[test]
    fn impossible_tags_are_a_fault() {
        let at = |synchronised: bool| wingd_base::clock::Stamp {
            utc: "2026-03-01T06:00:00Z".parse().unwrap(),
            utc_synchronised: synchronised,
            boot_id: "b".to_owned(),
            since_boot_s: 10.0,
        };
        let ahead = |seconds: f64, synchronised| {
            wingd_evaluation::aircraft::impossible_delay_s(
                1_772_344_800.0 + seconds,
                &at(synchronised),
            )
        };
        assert_eq!(
            (ahead(40.0, true), ahead(40.0, false), ahead(1.0, true)),
            (Some(-40.0), None, None)
        );
        assert_eq!(
            (ahead(-30.0, true), ahead(-3600.0, true)),
            (None, Some(3600.0))
        );
    }
}
