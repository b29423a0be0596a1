//! Board pictures -> interior orientation.
