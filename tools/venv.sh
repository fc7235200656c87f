#!/usr/bin/env bash
# Makes .venv, once: from the system's Python when that one can serve (it sees Debian's ROS
# packages), otherwise from any Python 3.11 or newer on PATH. Says what it does.
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

python=$(choose)
ready=.venv/.ready
wanted="$python $(cat pyproject.toml constraints.txt | sha256sum | cut -c1-16)"
if [ "$(cat $ready 2>/dev/null)" = "$wanted" ]; then touch $ready; exit 0; fi

echo "rossec: preparing .venv from $python (a minute, once)"
rm -rf .venv
"$python" -m venv --system-site-packages .venv
PIP_DISABLE_PIP_VERSION_CHECK=1 .venv/bin/python -m pip install --quiet \
    --constraint constraints.txt --editable '.[dev]' 2> >(grep -v '^WARNING: Location' >&2)
echo "$wanted" > $ready
