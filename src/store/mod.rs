//! The store: layout, commit, recover, verify, space. Every fsync of the project lives here.
