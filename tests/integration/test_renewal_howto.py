"""`docs/howto/renewal.md`, typed as printed: a node is renewed, ends, and comes back.

The blocks run in one shell at a terminal. What is added: it waits for the service, the master and
for what shall happen, instead of sleeping.
"""

import re
import subprocess
import sys
from pathlib import Path
from typing import Final

from tests.integration.test_first_steps import BIN, ROOT, SECRET
from tests.support.ports import free_port

TEXT: Final = (ROOT / "docs" / "howto" / "renewal.md").read_text()
WAITS: Final = {
    "rossec ca serve": "until rossec ca status >/dev/null 2>&1; do sleep 0.1; done",
    "rossec master": "until (: >/dev/tcp/127.0.0.1/$PORT) 2>/dev/null; do sleep 0.1; done",
}
RENEWED: Final = """
touch -r $ROSSEC_HOME/nodes/robot/node.pem first
until [ $ROSSEC_HOME/nodes/robot/node.pem -nt first ]; do sleep 0.2; done
"""
OVER: Final = "until ! rossec node show /robot >/dev/null 2>&1; do sleep 0.5; done"


def block(name: str) -> str:
    """One block of commands as printed."""
    _, found, rest = TEXT.partition(f"<!-- {name} -->\n```\n")
    assert found
    return rest.partition("```")[0]


def started(found: re.Match[str]) -> str:
    """A command in the background, and a wait until it answers."""
    return f"{found[0]}\n{WAITS[found[1]]}"


def test_the_howto_works_as_printed(tmp_path: Path) -> None:
    port = free_port()
    site = re.sub(r"(?m)^(rossec (?:ca serve|master)) .*&.*$", started, block("site"))
    site = site.replace("ca serve", f"ca serve --join-address 127.0.0.1:{free_port()}", 1)
    run, over = block("run"), block("over")
    assert "sleep 15\n" in run
    assert "sleep 20\n" in over
    lines = (
        "set -e",
        "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT",
        f"cd {tmp_path}",
        site,
        run.replace("sleep 15\n", RENEWED),
        over.replace("sleep 20\n", f"{OVER}\n").replace("--offline  ", "--offline || true  "),
    )
    (tmp_path / "howto.sh").write_text("\n".join(lines))
    env = {
        "HOME": str(tmp_path),
        "PATH": f"{BIN}:/usr/bin:/bin",
        "PORT": str(port),
        "TERM": "dumb",
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
    }
    typed = [sys.executable, "-m", "tests.support.terminal", SECRET, SECRET, SECRET, "--"]
    done = subprocess.run(
        [*typed, "/bin/bash", str(tmp_path / "howto.sh")],
        env=env,
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=110,
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Traceback" not in said
    shown = re.findall(r"/robot of site until (.*)", said)
    assert len(set(shown)) == len(shown) >= 3, said
    assert shown == sorted(shown)
    assert "the identity of /robot ended on 20" in said
    assert "installed in" in said
    assert len(set(re.findall(r"fingerprint .*", said.partition("enrolled")[2]))) == 1, "one key"
