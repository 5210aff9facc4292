#!/bin/sh
# Whether the service ROLE of this container is well, and what troubles it: healthy ROLE.
# It writes its heartbeat each second while its main loop goes round and the router is there (services/health.py).
file=${COGRADAR_HEARTBEAT:-/tmp/heartbeat-$1}
[ -n "$(find "$file" -newermt '30 seconds ago' 2>/dev/null)" ] || {
    echo "$1: no heartbeat for 30 seconds"
    exit 1
}
cat "$file"
