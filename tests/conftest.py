"""No test passes silently: without ROS or a browser those that need it are reported as not run.

In CI they fail.
"""

import importlib.util
import os
import shutil
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import coverage
import pytest
from hypothesis import HealthCheck, settings

from rossec.participant import delivery_options
from rossec.peer_limits import LogRateLimit

# A loaded machine is slow, not wrong: no example is judged by the time it takes.
settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("untimed")

# What tests read is the same on every terminal.
os.environ["NO_COLOR"] = "1"

# A background shell ignores Ctrl-C, and what it starts inherits that, with what a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

_ROS: Final = all(
    importlib.util.find_spec(name) is not None
    for name in ("rospy", "rosmaster", "rosgraph", "geometry_msgs", "sensor_msgs", "nav_msgs")
)
# What a marked test needs, and whether it is there.
_NEEDED: Final = {
    "ros": ("ROS packages", _ROS),
    "browser": ("Chromium", shutil.which("chromium") is not None),
}


@pytest.fixture(autouse=True)
def _empty_rate_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lines that a process logs once a minute are logged in every test."""
    monkeypatch.setattr(delivery_options, "RATE_LIMIT", LogRateLimit())


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Coverage is recorded for the file of the test, also what its processes run."""
    measured = coverage.Coverage.current()
    context = item.path.relative_to(item.config.rootpath).as_posix()
    if measured is not None and measured.get_option("run:context") != context:
        measured.switch_context(context)
        measured.set_option("run:context", context)
        os.environ["COVERAGE_PROCESS_CONFIG"] = measured.config.serialize()


def pytest_make_parametrize_id(val: object, argname: str) -> str | None:
    """Bytes make no name: some are signed anew in each process, and workers compare the names."""
    return argname if isinstance(val, bytes) else None


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--quick", action="store_true", help="leave out what needs ROS or a browser, and slow files"
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--quick"):
        slow = set((config.rootpath / "tests" / "slow.txt").read_text().split())
        left_out = [
            item
            for item in items
            if item.path.relative_to(config.rootpath).as_posix() in slow
            or any(item.get_closest_marker(marker) for marker in _NEEDED)
        ]
        config.hook.pytest_deselected(items=left_out)
        items[:] = [item for item in items if item not in set(left_out)]
        return
    for marker, (what, is_there) in _NEEDED.items():
        if is_there:
            continue
        if os.environ.get("CI"):
            raise pytest.UsageError(f"no {what} on this machine: see tools/ros-packages.sh")
        for item in items:
            if item.get_closest_marker(marker):
                item.add_marker(pytest.mark.skip(reason=f"NOT RUN: no {what} on this machine"))


@pytest.fixture
def short_path() -> Iterator[Path]:
    """As `tmp_path`, short enough for the path of a unix socket (108 bytes) below a home in it."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as directory:
        yield Path(directory)
