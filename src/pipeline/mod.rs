//! From frame bytes and an installation to a record.
