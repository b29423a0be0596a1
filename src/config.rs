//! The configuration: composed of the modules own sections.
