#!/bin/sh
# base.sh REVISION: prints the path of that revision's program. It is built once per commit, in a work tree and a target folder
# of its own below target/compare.
set -eu
cd "$(dirname "$0")/../.."
commit=$(git rev-parse --verify --quiet "$1^{commit}") || {
    echo "$1 is no revision of this repository; git log lists them" >&2
    exit 1
}
home=$PWD/target/compare/$commit
if [ ! -x "$home/wingd" ]; then
    mkdir -p "$home"
    git worktree prune
    [ -d "$home/tree" ] || git worktree add --quiet --detach "$home/tree" "$commit"
    (cd "$home/tree" && cargo build --release --locked --bin wingd --target-dir "$home/target" >&2)
    cp "$home/target/release/wingd" "$home/wingd"
    git worktree remove --force "$home/tree"
    rm -rf "$home/target"
fi
echo "$home/wingd"
