# Shared by the scripts of this folder: where things are cached, and how Debian's packages are fetched.
# shellcheck shell=bash
set -euo pipefail
MACHINE=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
ROOT=$(cd "$MACHINE/../.." && pwd)
CACHE=${WINGD_CACHE:-$HOME/.cache/wingd-machine}
JOBS=${JOBS:-2}
mkdir -p "$CACHE"

say() { printf '%s\n' "$*" >&2; }
die() { say "error: $*"; exit 1; }

# need PROGRAM PACKAGE: stops where a tool is missing; a missing tool is a failure, never a skip.
need() { command -v "$1" >/dev/null || die "$1 is missing; apt-get install $2"; }

# candidate PACKAGE: the version that apt would fetch.
candidate() { apt-cache policy "$1" | sed -n 's/^ *Candidate: //p'; }

# fetch_deb PACKAGE DIRECTORY: unpacks a binary package without installing it.
fetch_deb() {
    local work; work=$(mktemp -d "$CACHE/fetch.XXXXXX")
    (cd "$work" && apt-get -qq -o APT::Sandbox::User=root download "$1" && dpkg-deb -x ./*.deb "$2")
    rm -rf "$work"
}

# fetch_source PACKAGE DIRECTORY: unpacks a source package; the machine's own sources are asked, with
# their source indices, in a state directory of our own.
fetch_source() {
    local apt="$CACHE/apt"
    mkdir -p "$apt/parts" "$apt/lists/partial" "$2"
    local file
    for file in /etc/apt/sources.list.d/debian.sources; do
        [ -e "$file" ] && sed 's/^Types:.*/Types: deb-src/' "$file" >"$apt/parts/$(basename "$file")"
    done
    [ -s /etc/apt/sources.list ] && sed -n 's/^deb /deb-src /p' /etc/apt/sources.list >"$apt/parts/main.list"
    local options=(-qq -o "Dir::Etc::sourcelist=/dev/null" -o "Dir::Etc::sourceparts=$apt/parts"
        -o "Dir::State::lists=$apt/lists" -o "APT::Sandbox::User=root")
    apt-get "${options[@]}" update
    (cd "$2" && apt-get "${options[@]}" source --download-only "$1" && dpkg-source --no-check -x ./*.dsc source >/dev/null)
}
