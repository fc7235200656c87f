#!/usr/bin/env bash
# Builds the wheel twice and checks that both are the same, that it holds exactly the three packages,
# and that the manual pages, the outlines for completion and the units of systemd are in it.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
for build in first second; do
    .venv/bin/python -m build --wheel --outdir "$out/$build" . >"$out/log" 2>&1 ||
        { cat "$out/log"; exit 1; }
done
cmp "$out"/first/*.whl "$out"/second/*.whl
.venv/bin/check-wheel-contents "$out"/first/*.whl
.venv/bin/python -m zipfile -l "$out"/first/*.whl >"$out/files"
for file in rossec/cli/completion/outlines.json data/share/man/man1/rossec{,-ca}.1 \
    data/share/rossec/systemd/rossec-{ca,master,sidecar}.service; do
    grep -q "$file " "$out/files" || { echo "not in the wheel: $file" >&2; exit 1; }
done
