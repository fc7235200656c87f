#!/usr/bin/env bash
# An authority, and what the programs of this folder need. Then, in another shell: rossec master
set -euo pipefail
export ROSSEC_HOME="${ROSSEC_HOME:?set it to a new directory, for example ~/rossec-rospy}"

mkdir -p "$ROSSEC_HOME"
(umask 077 && head -c 18 /dev/urandom | base64 > "$ROSSEC_HOME/passphrase")
secret=(--passphrase-file "$ROSSEC_HOME/passphrase")

rossec ca init home "${secret[@]}"
for name in /master /robot /viewer; do
    rossec node request "$name"
done
rossec ca sign "$ROSSEC_HOME"/nodes/*/node.csr --yes "${secret[@]}"
for bundle in "$ROSSEC_HOME"/nodes/*/node.pem; do
    rossec node install "$bundle" --yes
done

may() { rossec grant sign "$@" "${secret[@]}"; }
may /robot --publish /chatter --publish /camera/image --provide /lamp
may /viewer --subscribe /chatter --call /lamp \
    --param-get "/viewer/**" --param-set "/viewer/**"
may /viewer --subscribe /camera/image --type sensor_msgs/Image --clear header.frame_id \
    --rate 5 --when 'msg.height < 1000'
