#!/usr/bin/env bash
# A small Debian of an architecture with this checkout installed in /srv/cogradar, and commands in it. ARM64: under QEMU.
#
#   tests/arm/machine.sh ARCHITECTURE              make it, or bring it up to this checkout: amd64 or arm64
#   tests/arm/machine.sh ARCHITECTURE COMMAND...   run a command there, with the variables of the image
#
# Machines are kept in /var/tmp/cogradar-ARCHITECTURE. What is mounted in them is seen by the command alone.
set -euo pipefail

arch=$1
shift
root=/var/tmp/cogradar-$arch
cd "$(dirname "${BASH_SOURCE[0]}")/../.."

missing() { echo "make test-arm needs $1" >&2; exit 1; }
[ "$(uname -s)-$(uname -m)" = Linux-x86_64 ] || missing "Linux on x86-64"
[ "$(id -u)" = 0 ] || missing "root: it makes file systems and enters them"
command -v debootstrap >/dev/null || missing "debootstrap (Debian, Ubuntu: apt install debootstrap)"
[ "$arch" = amd64 ] || [ -x /usr/bin/qemu-aarch64-static ] ||
    missing "QEMU for programs of ARM64 (Debian, Ubuntu: apt install qemu-user-static)"

inside() {
    local variables
    variables=$(sed -n "/ AS base-$arch\$/{n;s/^ENV //;s/\"//g;p}" Dockerfile)
    # shellcheck disable=SC2016,SC2086
    exec unshare --mount bash -c 'mount --rbind /dev "$1/dev" && mount -t proc proc "$1/proc" && exec chroot "$@"' machine \
        "$root" env -i HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin SSL_CERT_FILE=/etc/ssl/certs/ca-certificates.crt OPENBLAS_NUM_THREADS=1 $variables \
        sh -c 'cd /srv/cogradar && exec "$@"' machine "$@"
}
[ $# = 0 ] || inside "$@"

# The kernel hands programs of ARM64 to QEMU, which it has opened already (F): also in the machine.
formats=/proc/sys/fs/binfmt_misc
if [ "$arch" = arm64 ] && [ ! -e $formats/qemu-aarch64 ]; then
    [ -e $formats/register ] || mount -t binfmt_misc none $formats || missing "a kernel with binfmt_misc"
    elf='\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00'
    mask='\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff'
    printf '%s' ":qemu-aarch64:M::$elf:$mask:/usr/bin/qemu-aarch64-static:F" >$formats/register
fi

if [ ! -e "$root/made" ]; then
    suite=$(. /etc/os-release && [ "$ID" = debian ] && echo "$VERSION_CODENAME" || echo bookworm)
    rm -rf --one-file-system "$root"
    debootstrap --arch="$arch" --variant=minbase --include=python3,python3-venv,make,ca-certificates "$suite" "$root"
    mkdir -p "$root/srv/cogradar"
    touch "$root/made"
fi
[ "$arch" != amd64 ] || cp /usr/bin/qemu-x86_64-static "$root/usr/bin/" || missing "QEMU (Debian, Ubuntu: apt install qemu-user-static)"
cp /etc/resolv.conf /etc/hosts "$root/etc/"
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
[ ! -e /etc/pip.conf ] || cp /etc/pip.conf "$root/etc/"
find "$root/srv/cogradar/" -mindepth 1 -maxdepth 1 ! -name .venv -exec rm -rf {} +
git ls-files -z --cached --others --exclude-standard | tar -c --null -T - --ignore-failed-read |
    tar -x -C "$root/srv/cogradar" --no-same-owner
(inside make --silent setup)
(inside .venv/bin/python -c 'from cogradar.services.kernels import compile_all; compile_all(print)')
