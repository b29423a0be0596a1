#!/bin/bash
# Cross-builds wingd for aarch64 and makes its Debian package, target/package/wingd_VERSION_arm64.deb; prints its path.
# As root, on Debian 12 for amd64; the first time it fetches a Debian to build in (aarch64-root.sh). The binary is kept
# in the cache, keyed by its inputs. With --cached it builds nothing and fails if there is none.
. "$(dirname "$0")/../tests/machine/common.sh"
cd "$ROOT"
target=aarch64-unknown-linux-gnu
base=$(packaging/aarch64-root.sh "$@"); base=${base%/root}
exec 9>"$base/lock"; flock 9 # one at a time
# What the program is made of; `crates` has the desk's too, which costs a build too many and never one too few.
inputs=(Cargo.toml Cargo.lock build.rs src crates config fixtures/demo systemd/wingd.service docs/images/installation.svg)
key=$( (find "${inputs[@]}" -type f -print0 | sort -z | xargs -0 sha256sum; cat packaging/aarch64.sh) | sha256sum | cut -c1-12)
binary=$base/wingd-$key
if [ ! -x "$binary" ]; then
    [ "${1:-}" != --cached ] || exit 1
    say "aarch64: building, 10 to 40 minutes the first time, later a third of that"
    # The crates are fetched with the settings of this machine's cargo; the build itself needs no network.
    for system in $target x86_64-unknown-linux-gnu; do
        "${CARGO:-cargo}" fetch --quiet --locked --target $system || die "cargo fetch failed"
    done
    nice packaging/aarch64-run.sh env PKG_CONFIG_ALLOW_CROSS=1 \
        PKG_CONFIG_LIBDIR=/usr/lib/aarch64-linux-gnu/pkgconfig:/usr/share/pkgconfig \
        CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc \
        cargo build --release --locked --offline --target $target --bin wingd --no-default-features --features board >&2
    built=$base/target/$target/release/wingd
    # Cargo's own list of its inputs.
    strange=$(tr ' ' '\n' <"$built.d" | grep "^$ROOT/" | grep -vE "^$ROOT/($(IFS="|"; echo "${inputs[*]}"))(/|\$)") && die "not in the key: $strange"
    rm -f "$base"/wingd-* # of other sources
    cp "$built" "$binary.part"; mv "$binary.part" "$binary"
fi
sh packaging/build.sh "$binary" arm64
