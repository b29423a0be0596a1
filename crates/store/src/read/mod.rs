//! Contents of a store, read without a lock: for reports, pages, exports, copies and the recorder itself.

pub mod aircraft;
pub mod bundle;
pub mod catalogue;
pub mod frames;
pub mod installations;
pub mod live;
pub mod manual_marks;
pub mod result_sets;
