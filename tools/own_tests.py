"""Each module is covered by its own test file: the last gate of `make cover`.

`rossec/a/b.py` belongs to `tests/rossec/a/test_b.py` and to `test_b_*.py` beside it; `__init__.py`
to `test_init.py`. `tests/conftest.py` has coverage record which file a line ran for, in the
programs that a test starts too. Only statements and branches inside functions count: the others
run when anything imports the module.
"""

import json
import re
import sys
import tempfile
from pathlib import Path
from typing import Final

import coverage

ROOT: Final = Path(__file__).parents[1]
LEAST: Final = 80  # percent

OTHERS: Final[dict[str, tuple[str, ...]]] = {
    # The base of Initiator and Responder, which alone are ever made.
    "rossec/channel/edhoc/peer.py": (
        "rossec/channel/edhoc/test_handshake.py",
        "rossec/channel/edhoc/test_own_dials.py",
    ),
    # Bases of SecureSocket, which alone is ever made.
    "rossec/net/threads/carrier.py": (
        "rossec/net/threads/test_carrier.py",
        "rossec/net/threads/test_secure_socket.py",
    ),
    # `connect` is half of a handshake, and the driver the half of a stream that moves bytes.
    "rossec/net/aio/client.py": (
        "rossec/net/aio/test_client.py",
        "rossec/net/aio/test_handshake.py",
    ),
    "rossec/net/aio/driver.py": (
        "rossec/net/aio/test_driver.py",
        "rossec/net/aio/test_stream.py",
    ),
    # What rospy calls in place of its own: only a program of rospy shows what it does.
    "rossec/inprocess/headers.py": ("rossec/inprocess/test_connections.py",),
    "rossec/inprocess/hooks.py": ("rossec/inprocess/test_secure.py",),
    "rossec/inprocess/plain_stream.py": ("rossec/inprocess/test_sockets.py",),
    "rossec/inprocess/service_probe.py": (
        "rossec/inprocess/test_secure.py",
        "rossec/inprocess/test_allow_plain.py",
    ),
    "rossec/inprocess/subscription.py": (
        "rossec/inprocess/test_connections.py",
        "rossec/inprocess/test_background.py",
    ),
    "rossec/inprocess/xmlrpc_client.py": (
        "rossec/inprocess/test_xmlrpc_client.py",
        "rossec/inprocess/test_early.py",
        "rossec/inprocess/test_connections.py",
    ),
    "rossec/inprocess/xmlrpc_server.py": (
        "rossec/inprocess/test_xmlrpc_server.py",
        "rossec/inprocess/test_connections.py",
        "rossec/inprocess/test_allow_plain.py",
    ),
    # Its rules for anonymous nodes are those of the holder of a grant.
    "rossec/master/rights/presented_grants.py": (
        "rossec/master/rights/test_presented_grants.py",
        "rossec/master/rights/test_grant_holder.py",
    ),
    # Programs: they are started, and end with what started them.
    "rossec/demo/intruder.py": ("rossec/demo/test_steps.py",),
    "rossec/demo/robot.py": ("rossec/demo/test_steps.py",),
    "rossec/demo/subscriber.py": ("rossec/demo/test_steps.py",),
    "rossec/sidecar/__main__.py": (
        "rossec/cli/node/test_sidecar.py",
        "rossec/cli/node/test_run.py",
    ),
}
"""Module: its tests, where their names are not made from its own."""


def own_tests(module: Path) -> list[str]:
    """The test files of the module, as paths from the root."""
    if (others := OTHERS.get(module.as_posix())) is not None:
        return [f"tests/{other}" for other in others]
    own = f"test_{module.stem.strip('_')}"
    neighbours = {f"test_{path.stem}" for path in (ROOT / module.parent).glob("*.py")} - {own}
    return [
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "tests" / module.parent).glob(f"{own}*.py")
        if path.stem == own or (path.stem.startswith(f"{own}_") and path.stem not in neighbours)
    ]


def covered(measured: coverage.Coverage, path: Path) -> float | None:
    """Percent of its functions' statements and branches, or None without any."""
    contexts = [f"^{re.escape(test)}$" for test in own_tests(path.relative_to(ROOT))]
    with tempfile.NamedTemporaryFile("r") as report:
        measured.json_report(
            morfs=[str(path)], contexts=contexts or ["^no test$"], outfile=report.name
        )
        (found,) = json.load(report)["files"].values()
    functions = [each["summary"] for name, each in found["functions"].items() if name]
    count, hit = (
        sum(each[lines] + each[branches] for each in functions)
        for lines, branches in (
            ("num_statements", "num_branches"),
            ("covered_lines", "covered_branches"),
        )
    )
    return 100 * hit / count if count else None


def main() -> int:
    """Print each module that its tests do not cover; the exit status."""
    measured = coverage.Coverage()
    measured.load()
    measured_files = measured.get_data().measured_files()
    gone = OTHERS.keys() - {Path(path).relative_to(ROOT).as_posix() for path in measured_files}
    for module in sorted(gone):
        print(f"{module}: there is no such module: remove it from {Path(__file__).name}")
    wrong = len(gone)
    for path in map(Path, sorted(measured_files)):
        module, percent = path.relative_to(ROOT).as_posix(), covered(measured, path)
        if percent is not None and percent < LEAST:
            print(f"{module}: its own tests cover {percent:.0f} %, not {LEAST} %")
            wrong += 1
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
