//! The recorder: schedule, capture, processing, status, shutdown.
