//! Refraction at the window, thermal expansion.
