//! Figures, tables, exports.
