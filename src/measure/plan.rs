//! Resolution, depth of field and predicted uncertainty of an installation.
