#!/usr/bin/env bash
# Builds the wheel and checks that it holds exactly the three packages.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
.venv/bin/python -m build --wheel --outdir "$out" . >"$out/log" 2>&1 || { cat "$out/log"; exit 1; }
.venv/bin/check-wheel-contents "$out"/*.whl
