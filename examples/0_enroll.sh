#!/usr/bin/env bash
# An authority for the trust domain "home", three nodes, and what two of them may do.
# In earnest each node makes its request on its own machine, and a person types the passphrase.
set -euo pipefail
export ROSSEC_HOME="${ROSSEC_HOME:?set it to a new directory, for example ~/rossec-example}"

mkdir -p "$ROSSEC_HOME"
(umask 077 && head -c 18 /dev/urandom | base64 > "$ROSSEC_HOME/passphrase")
secret=(--passphrase-file "$ROSSEC_HOME/passphrase")

rossec ca init home "${secret[@]}"
for name in /master /talker /listener; do
    rossec node request "$name"
done
rossec ca sign "$ROSSEC_HOME"/nodes/*/node.csr --yes "${secret[@]}"
for bundle in "$ROSSEC_HOME"/nodes/*/node.pem; do
    rossec node install "$bundle" --yes
done

rossec grant sign /talker --publish /chatter --publish /robot/pose \
    --provide /talker/mute --param-get /talker "${secret[@]}"
rossec grant sign /listener --subscribe /chatter \
    --call /talker/mute --param-set /talker/rate "${secret[@]}"
echo "now start the master in another shell: rossec master"
