# What the examples begin with: `. begin.sh NODE...` makes an authority for the trust domain "home"
# and enrolls the nodes; then `may NODE --publish TOPIC` signs a grant.
# In earnest each node makes its request on its own machine, and a person types the passphrase.
set -euo pipefail
export ROSSEC_HOME="${ROSSEC_HOME:?set it to a new directory, for example ~/rossec-example}"

mkdir -p "$ROSSEC_HOME"
(umask 077 && head -c 18 /dev/urandom | base64 > "$ROSSEC_HOME/passphrase")
secret=(--passphrase-file "$ROSSEC_HOME/passphrase")

rossec ca init home "${secret[@]}"
for name in "$@"; do
    rossec node request "$name"
done
rossec ca sign "$ROSSEC_HOME"/nodes/*/node.csr --yes "${secret[@]}"
for bundle in "$ROSSEC_HOME"/nodes/*/node.pem; do
    rossec node install "$bundle" --yes
done

may() { rossec grant sign "$@" "${secret[@]}"; }
