#!/bin/sh
# Start of every container: cogradar with the arguments given, as process 1, so that it gets the stop signal itself.
set -eu

grep -qw avx2 /proc/cpuinfo || {
    echo "this image needs a processor with AVX2 (x86-64-v3)" >&2
    exit 1
}

# Numba opens its cache for writing even when everything is in it, and the image is read-only: it works on a copy.
mkdir -p "$COGRADAR_CACHE_DIR"
cp -R /opt/cogradar/kernels/. "$COGRADAR_CACHE_DIR"

# A service is named after its container, so that its health check, `docker ps` and its log say the same. One with a
# certificate has the certificate's name instead.
if [ "${1:-}" = service ] && [ $# -ge 2 ]; then
    role=$2
    shift 2
    export COGRADAR_HEARTBEAT="/tmp/heartbeat-$role" # two containers of a pod share /tmp
    rm -f "$COGRADAR_HEARTBEAT"
    set -- service "$role" --name "$role-$(hostname)" "$@"
fi

# Several certificates, as /keys/*/zenoh.json5: this process takes one that no other container of this machine has, for
# each is for one process. The lock lasts as long as the file is open: to the end of what follows. They are tried in any
# order: a container of another machine may have one, and who was refused for it takes another one at the next start.
case ${COGRADAR_ZENOH:-} in
*'*'*)
    for file in $(shuf -e $COGRADAR_ZENOH); do
        exec 9<"$file"
        flock --nonblock 9 || continue
        export COGRADAR_ZENOH="$file"
        break
    done
    [ "${COGRADAR_ZENOH#*'*'}" = "$COGRADAR_ZENOH" ] || {
        echo "$COGRADAR_ZENOH: other containers have all of these certificates: issue one more" >&2
        exit 1
    }
    ;;
esac
exec cogradar "$@"
