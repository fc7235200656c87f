#!/usr/bin/env bash
# Take back everything the listener was given. Connections that are open are cut within moments.
set -euo pipefail
rossec grant list /listener | cut -d' ' -f1 | while read -r grant; do
    rossec grant revoke "$grant" --reason "example over" --passphrase-file "$ROSSEC_HOME/passphrase"
done
rossec grant list /listener
