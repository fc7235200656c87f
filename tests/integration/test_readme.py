"""The commands of the README, typed as printed."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Final

from tests.integration.test_first_steps import ROOT, SECRET
from tests.support.ports import free_port


def quickstart() -> str:
    """The commands of README as printed."""
    text = (ROOT / "README.md").read_text()
    return text.partition("<!-- quickstart -->\n```\n")[2].partition("```")[0]


ANSWERS: Final = (SECRET, SECRET, SECRET)  # ca init twice, ca unlock


def test_the_commands_of_the_readme_work_as_printed(tmp_path: Path) -> None:
    """Typed into one shell at a terminal, where a person answers; `rossec` is not installed."""
    port = free_port()
    printed = quickstart()
    # The only addition: a person waits for the master's first line.
    started = "rossec master &"
    assert printed.count(f"\n{started} ") == 1
    script = tmp_path / "quickstart.sh"
    waits = re.sub(rf"(?m)^{started}.*$", rf"\g<0>\n{READY}", printed)
    # The usual port of joins is free on a robot, not where tests run side by side.
    waits = waits.replace("ca serve", f"ca serve --join-address 127.0.0.1:{free_port()}", 1)
    script.write_text(f"set -e\ntrap 'kill $(jobs -p) 2>/dev/null || true' EXIT\n{waits}")
    env = {
        "HOME": str(tmp_path),
        "PATH": "/usr/bin:/bin",
        "PORT": str(port),
        "TERM": "dumb",
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
    }
    typed = [sys.executable, "-m", "tests.support.terminal", *ANSWERS, "--"]
    done = subprocess.run(
        [*typed, "/bin/bash", str(script)],
        env=env,
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=160,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert done.stdout.count("x: 4.0") == 1
    assert done.stdout.count('frame_id: "map"\n') == 1
    assert done.stdout.count("the master has the new list") == 2


READY: Final = "until (: >/dev/tcp/127.0.0.1/$PORT) 2>/dev/null; do sleep 0.05; done"
