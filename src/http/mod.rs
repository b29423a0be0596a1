//! Read-only pages over a store.
