//! Scenes with known truth: for tests, benches, `simulate`, `demo`.
