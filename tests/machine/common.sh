# Shared by the scripts of this folder: where things are cached, and how Debian's packages are fetched.
# shellcheck shell=bash
set -euo pipefail
MACHINE=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
ROOT=$(cd "$MACHINE/../.." && pwd)
CACHE=${WINGD_CACHE:-$HOME/.cache/wingd-machine}
JOBS=${JOBS:-2}
# The program of the on-board package.
BOARD=${BOARD:-$ROOT/target/board/wingd}
mkdir -p "$CACHE"

say() { printf '%s\n' "$*" >&2; }
die() { say "error: $*"; exit 1; }

# need PROGRAM PACKAGE: stops where a tool is missing; a missing tool is a failure, never a skip.
need() { command -v "$1" >/dev/null || die "$1 is missing; apt-get install $2"; }

# candidate PACKAGE: the version that apt would fetch.
candidate() { apt-cache policy "$1" | sed -n 's/^ *Candidate: //p'; }

. "$MACHINE/pictures.sh"
# fresh_camera DIRECTORY N FRAMES…: the virtual PTP camera there, with an empty card and N different views.
fresh_camera() {
    local cam=$1 count=$2 i frame; shift 2
    local frames=("$@")
    rm -rf "$cam"; mkdir -p "$cam"/{card/DCIM,shots,state}
    for ((i = 0; i < count; i++)); do
        frame=${frames[i % ${#frames[@]}]}
        numbered "$i" "$frame" >"$cam/shots/$(printf %02d "$i").jpg"
    done
    cp "$cam/shots/00.jpg" "$cam/card/dummy.jpg"
    export VCAMERADIR=$cam/card VCAMERA_SHOTS=$cam/shots VCAMERA_STATE=$cam/state
}

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
    for file in /etc/apt/sources.list.d/*debian.sources; do
        [ -e "$file" ] && sed 's/^Types:.*/Types: deb-src/' "$file" >"$apt/parts/$(basename "$file")"
    done
    [ -s /etc/apt/sources.list ] && sed -n 's/^deb /deb-src /p' /etc/apt/sources.list >"$apt/parts/main.list"
    local options=(-qq -o "Dir::Etc::sourcelist=/dev/null" -o "Dir::Etc::sourceparts=$apt/parts"
        -o "Dir::State::lists=$apt/lists" -o "APT::Sandbox::User=root")
    apt-get "${options[@]}" update
    (cd "$2" && apt-get "${options[@]}" source --download-only "$1" && dpkg-source --no-check -x ./*.dsc source >/dev/null)
}

# uml KERNEL_DIRECTORY WORD…: runs the kernel of a virtual machine until it switches itself off; its console is our
# output. It is killed after UML_LIMIT (s), and where it stays on for 10 s after the line UML_END. UML_MEMORY.
uml() {
    local kernel=$1 shim console guest shown begin=$SECONDS over=; shift
    shim="$CACHE/uml-xstate-$(sha256sum "$MACHINE/uml-xstate.c" | cut -c1-12).so"
    [ -e "$shim" ] || gcc -O1 -shared -fPIC "$MACHINE/uml-xstate.c" -o "$shim" -ldl
    console=$(mktemp "$CACHE/console.XXXXXX")
    # In a session of its own, and without our output: one that hangs can be killed whole, and holds nobody up.
    LD_PRELOAD=$shim setsid "$kernel/linux" "mem=${UML_MEMORY:-2500M}" "$@" con=null con0=fd:0,fd:1 quiet panic=1 \
        </dev/null > >(exec cat >"$console" 2>/dev/null) 2>&1 & guest=$!
    tail -n +1 -f -s 0.2 --pid=$guest "$console" | stdbuf -oL tr -d '\r' & shown=$!
    while kill -0 "$guest" 2>/dev/null && [ $((SECONDS - begin)) -lt "${UML_LIMIT:-900}" ]; do
        [ -n "$over" ] || ! grep -qa "${UML_END:-^guest: end}" "$console" || over=$SECONDS
        [ -z "$over" ] || [ $((SECONDS - over)) -lt 10 ] || break
        sleep 0.5
    done
    if kill -0 "$guest" 2>/dev/null; then
        say "the virtual machine is still on after $((SECONDS - begin)) s, and is killed:"
        ps -s "$guest" -o pid,stat,wchan:20,time,comm >&2 || true
    fi
    pkill -KILL -s "$guest" || true
    wait "$guest" "$shown" 2>/dev/null || true
    rm -f "$console"
}
# The guest kernel keeps fewer registers than AVX-512 has; the guest's C library must not use those.
TUNABLES=glibc.cpu.hwcaps=-AVX512F,-AVX512VL,-AVX512BW,-AVX512CD,-AVX512DQ,-AVX512_VL
