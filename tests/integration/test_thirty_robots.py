"""`docs/howto/thirty-robots.md`, typed as printed: an empty home, thirty joins, a rule changed.

The four blocks run in one shell at a terminal, where a person answers the prompts. What is added:
it waits for the service and the master, and looks at what flows.
"""

import re
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import BIN, ROOT, SECRET, free_port

TEXT: Final = (ROOT / "docs" / "howto" / "thirty-robots.md").read_text()
BACKGROUND: Final = re.compile(r"(?m)^(rossec (?:ca serve|master)) .*&.*$")
CUT: Final = 1.0  # seconds


def block(name: str) -> str:
    """One block of commands as printed."""
    _, found, rest = TEXT.partition(f"<!-- {name} -->\n```\n")
    assert found
    return rest.partition("```")[0]


def test_a_site_of_thirty_takes_eight_commands_and_one_passphrase() -> None:
    printed = "".join(map(block, ("site", "robots", "run", "change")))
    typed = [line for line in printed.splitlines() if re.match(r"rossec |\w+=\S+ rossec ", line)]
    loop = [line for line in printed.splitlines() if re.match(r"    \w+=\S+ rossec ", line)]
    shown = [line for line in typed if " topic " in line]  # a robot's work, not the operator's
    assert len(loop) == 1
    assert len(typed) - len(shown) <= 8
    assert printed.count("asks for") == 2


@pytest.fixture
def script(tmp_path: Path) -> str:
    waits = {
        "rossec ca serve": "until rossec ca status >/dev/null 2>&1; do sleep 0.1; done",
        "rossec master": "until (: >/dev/tcp/127.0.0.1/$PORT) 2>/dev/null; do sleep 0.1; done",
    }
    site = BACKGROUND.sub(lambda found: f"{found[0]}\n{waits[found[1]]}", block("site"))
    return "\n".join(
        ("set -e", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT", f"cd {tmp_path}",
         site, block("robots"), FLOWS, block("run"), LOOKS, block("change"), AFTER)
    )  # fmt: skip


FLOWS: Final = """
as() { ROSSEC_HOME=~/hosts/$1 "${@:2}"; }
for name in robots/r01 robots/r02; do for what in pose camera; do
    as $name rossec topic pub /site/$name/$what std_msgs/String \
        --as /site/$name --rate 20 'data: x' &
done; done
for name in robots/r01 robots/r02; do for what in pose camera; do
    as station rossec topic echo /site/$name/$what std_msgs/String --as /site/station \
        > $what.${name##*/} 2>/dev/null &
done; done
as guest rossec topic echo /site/robots/r01/pose std_msgs/String --as /site/guest > guest 2>&1 &
"""
LOOKS: Final = """
for file in pose.r01 pose.r02 camera.r01 camera.r02; do
    until [ -s $file ]; do sleep 0.1; done
done
lines() { cat $1 | wc -l; }
"""
AFTER: Final = """
date +%s.%N > applied
for what in pose camera; do for name in r01 r02; do lines $what.$name; done; done > at
sleep 1
for what in pose camera; do for name in r01 r02; do lines $what.$name; done; done > second
sleep 2
for what in pose camera; do for name in r01 r02; do lines $what.$name; done; done > later
rossec grant list --json > grants
"""


def test_the_howto_works_as_printed(tmp_path: Path, script: str) -> None:
    port = free_port()
    (tmp_path / "howto.sh").write_text(script)
    env = {
        "HOME": str(tmp_path), "PATH": f"{BIN}:/usr/bin:/bin", "PORT": str(port), "TERM": "dumb",
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
    }  # fmt: skip
    typed = [sys.executable, "-m", "tests.support.terminal", SECRET, SECRET, SECRET, "--"]
    done = subprocess.run(
        [*typed, "/bin/bash", str(tmp_path / "howto.sh")],
        env=env, cwd=ROOT, text=True, capture_output=True, timeout=240, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Traceback" not in said
    at, second, later = (
        [int(line) for line in (tmp_path / name).read_text().split()]
        for name in ("at", "second", "later")
    )
    assert all(after > before + 20 for before, after in zip(at[:2], later[:2], strict=True))
    assert second[2:] == later[2:], "the cameras were not cut within a second"
    guest = (tmp_path / "guest").read_text()
    assert "needs the right subscribe" in guest
    assert "data" not in guest
