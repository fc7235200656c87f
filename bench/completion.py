"""What one press of Tab costs: CPU (user and system) of the whole program, beside Python itself."""

import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Final

ROSSEC: Final = Path(sys.executable).with_name("rossec")
NODES: Final = 1000
LINES: Final = {
    "a command": "rossec to",
    "an option": "rossec grant sign --s",
    "a node, of a thousand": "rossec node show /robot7",
    "a topic": "rossec topic echo /",
    "a message type": "rossec topic pub /x std_",
}


def measure(seconds: float) -> dict[str, Any]:
    """Median of CPU seconds for each kind of line; the first look at a tree is not counted."""
    with tempfile.TemporaryDirectory() as directory:
        home = Path(directory) / "home"
        for number in range(NODES):
            (home / "nodes" / f"robot{number}").mkdir(parents=True)
        home.chmod(0o700)
        share = seconds / (len(LINES) + 1)
        found = {name: _median(share, [str(ROSSEC)], home, line) for name, line in LINES.items()}
    return {"python alone": _median(share, [sys.executable, "-I", "-c", "pass"], home, ""), **found}


def _median(seconds: float, command: list[str], home: Path, line: str) -> float:
    environ = {**os.environ, "ROSSEC_HOME": str(home), "COMP_LINE": line}
    environ["_ROSSEC_COMPLETE"] = "bash_complete"
    spent: list[float] = []
    ends = time.monotonic() + seconds
    while len(spent) < 4 or time.monotonic() < ends:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, env=environ, check=True, stdout=subprocess.DEVNULL)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return round(statistics.median(spent[1:]), 3)
