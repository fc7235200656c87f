#!/usr/bin/env bash
# Makes .venv: from the system's Python when that one can serve (it sees Debian's ROS packages),
# otherwise from any Python 3.11 or newer on PATH. Says what it does.
#   tools/venv.sh            with all that tests and development need
#   tools/venv.sh runtime    with what rossec itself needs, as for the demo: a tenth of it
# A whole one serves for both; one for the demo is completed when more is needed.
set -euo pipefail
cd "$(dirname "$0")/.."

usable() { "$1" -c 'import sys, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }

choose() {
    local candidate
    for candidate in ${PYTHON:-} /usr/bin/python3 python3 python3.13 python3.12 python3.11; do
        candidate=$(command -v "$candidate") || continue
        if usable "$candidate"; then readlink -f "$candidate"; return; fi
    done
    echo "rossec: error: no Python 3.11 or newer with the venv module" >&2
    echo "rossec: hint: apt-get install python3-venv, or set PYTHON=/path/to/python3" >&2
    return 1
}

is_made() { [ "$(cat ".venv/.$1" 2>/dev/null)" = "$wanted" ]; }

python=$(choose)
wanted="$python $(cat pyproject.toml constraints.txt | sha256sum | cut -c1-16)"
if [ "${1:-}" = runtime ]; then made=runtime what=. said="half a minute"; else made=ready what='.[dev]' said="a minute"; fi
if is_made "$made" || { [ $made = runtime ] && is_made ready; }; then
    if [ -e ".venv/.$made" ]; then touch ".venv/.$made"; else echo "$wanted" > ".venv/.$made"; fi
    exit 0
fi

echo "rossec: preparing .venv from $python ($said, once)"
if ! is_made runtime; then
    rm -rf .venv
    "$python" -m venv --system-site-packages .venv
fi
PIP_DISABLE_PIP_VERSION_CHECK=1 .venv/bin/python -m pip install --quiet \
    --constraint constraints.txt --editable "$what" 2> >(grep -v '^WARNING: Location' >&2)
echo "$wanted" > ".venv/.$made"
