//! Stand-in until the store's live file is there.
#![allow(missing_docs)]
use super::{Store, StoreError};
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    F64,
    F32,
    U64,
    U32,
    U8,
}
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Column {
    pub name: String,
    pub unit: String,
    pub kind: Kind,
    pub width: usize,
}
pub const UTC: &str = "utc_us";
#[derive(Clone, Debug, PartialEq)]
pub struct LiveTable {
    pub source: serde_json::Value,
    pub columns: Vec<Column>,
}
pub type Row = Vec<f64>;
impl Store {
    pub fn append_live(&self, table: &LiveTable, rows: &[Row]) -> Result<(), StoreError> {
        let _ = (table, rows);
        Ok(())
    }
    pub fn close_live(&self) -> Result<(), StoreError> {
        Ok(())
    }
}
