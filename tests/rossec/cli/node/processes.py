"""`rossec` as a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

BIN = str(Path(sys.executable).parent / "rossec")


def started(arguments: list[str], **env: str) -> subprocess.CompletedProcess[str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    return subprocess.run(
        [BIN, *arguments], env=kept | env, text=True, capture_output=True, timeout=30, check=False
    )
