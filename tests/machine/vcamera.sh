#!/bin/bash
# Builds libgphoto2's virtual PTP camera (a Nikon D750) with our faults from Debian's source package;
# prints the directory for IOLIBS. Its code is fetched here, never kept in this repository.
. "$(dirname "$0")/common.sh"
need gcc gcc; need dpkg-source dpkg-dev
version=$(candidate libgphoto2-6)
key=$( (echo "$version"; cat "$MACHINE"/vcamera* "$0") | sha256sum | cut -c1-12)
out="$CACHE/vcamera-$key"
if [ -e "$out/iolibs/vusb.so" ]; then echo "$out/iolibs"; exit 0; fi

source="$CACHE/libgphoto2-$version"
if [ ! -d "$source/source" ]; then
    say "virtual camera: fetching the source of libgphoto2 $version"
    fetch_source libgphoto2 "$source"
fi
work=$(mktemp -d "$CACHE/vcamera.XXXXXX")
trap 'rm -rf "$work"' EXIT
vusb="$source/source/libgphoto2_port/vusb"
mkdir -p "$work/libgphoto2_port"
cp "$vusb"/{vusb.c,vcamera.c,vcamera.h} "$MACHINE"/vcamera-*.h "$work/"
cp "$source/source/libgphoto2_port/libgphoto2_port/i18n.h" "$work/libgphoto2_port/"
printf '%s\n' '#define HAVE_SYS_PARAM_H 1' '#define HAVE_LIBEXIF 1' '#define VERSION "test"' \
    '#define GETTEXT_PACKAGE_LIBGPHOTO2_PORT "libgphoto2_port"' >"$work/config.h"

# patch FILE SED: fails where the expression changes nothing, so that a new libgphoto2 is noticed.
patch() {
    cp "$work/$1" "$work/before"
    sed -i "$2" "$work/$1"
    ! cmp -s "$work/before" "$work/$1" || die "vcamera.sh: nothing to patch in $1: $2"
}
patch vcamera.h '/#undef FUZZ_PTP/d'
patch vcamera.c 's|^#include "vcamera.h"|&\n#include "vcamera-faults.h"|'
patch vcamera.c 's|^static struct ptp_property {|#include "vcamera-settings.h"\n&|'
patch vcamera.c 's|^\t{0x5011,.*|&\n\tMORE_PROPERTIES|'
patch vcamera.c 's|static int\t\tcapcnt = 98;|int capcnt = 0, refused = fault_capture();|'
patch vcamera.c 's|if (capcnt > 150) {|if (refused) { ptp_response (cam, refused, 0); return 1; }\n\tcapcnt = card_next();\n\tif (0) {|'
patch vcamera.c 's|if (capcnt++ == 150) {|if (0) {|'
patch vcamera.c 's|^\tsprintf(newcur->name,"GPH_%04d.JPG", capcnt++);|\tsprintf(newcur->name,"GPH_%04d.JPG", capcnt % 10000);\n\tnewcur->fsname = card_shot(VCAMERADIR, buf, newcur->name, capcnt);\n\tstat(newcur->fsname, \&newcur->stbuf);|'
patch vcamera.c 's|^\(\t*\)free_dirent (cur);|\1card_log("delete", cur->fsname); unlink(cur->fsname);\n&|'
patch vcamera.c 's|^static int vcam_write(.*|#include "vcamera-press.h"\n&\n\tpress_if_asked(cam);\n\tif (fault_write(data, bytes)) return GP_ERROR_IO_WRITE;|'
patch vcamera.c '/^vcam_readint(/,/{/ s|{$|{\n\tpress_if_asked(cam);|'
patch vcamera.c 's|^\tunsigned int\ttoread = bytes;|&\n\tif (fault_read(cam->nrinbulk)) return GP_ERROR_IO_READ;|'
patch vcamera.c 's|put_32bit_le (data+x, 150);|put_32bit_le (data+x, fault_is("full") ? 0 : 150);|'
patch vusb.c 's|^#include "vcamera.h"|&\n#include "vcamera-faults.h"|'
patch vusb.c '/^gp_port_vusb_find_device.*_lib(/,/{/ s|^{|{\n\tif (fault_is("gone")) return GP_ERROR_IO_USB_FIND;|'
patch vusb.c '/^gp_port_vusb_open /,/isopen)/ s|^{|{\n\tif (fault_is("claimed")) return GP_ERROR_IO_USB_CLAIM;|'

flags=(-fPIC -O1 -w -DHAVE_CONFIG_H -D_GPHOTO2_INTERNAL_CODE "-I$work" "-I$source/source/libgphoto2_port")
# shellcheck disable=SC2046
flags+=($(pkg-config --cflags libgphoto2_port libexif))
(cd "$work"
gcc "${flags[@]}" -DFUZZ_PTP -c vusb.c
gcc "${flags[@]}" '-DVCAMERADIR=(getenv("VCAMERADIR")?getenv("VCAMERADIR"):"/nonexistent")' -c vcamera.c
gcc -shared vusb.o vcamera.o -o vusb.so -lgphoto2_port -lexif)
mkdir -p "$out/iolibs"
mv "$work/vusb.so" "$out/iolibs/"
echo "$out/iolibs"
