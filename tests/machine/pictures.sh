# Pictures for the virtual cameras; for the host and for the guest.
# shellcheck shell=bash
# numbered N FRAME: the JPEG with the number in a comment (marker FFFE) behind its start marker, so that no two are alike.
numbered() { head -c 2 "$2"; printf '\xff\xfe\x00\x08%06d' "$1"; tail -c +3 "$2"; }
