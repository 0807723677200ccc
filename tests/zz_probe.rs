//! probe
mod common;
#[test]
fn probe() { common::write_dataset(std::path::Path::new("/tmp/h/probe/data")); }
