"""Titles and types of the policy: read when the file has changed, and never a reason to fail."""

from pathlib import Path

import pytest

from rossec.authority.console import queries as module
from rossec.authority.console.messages import PolicyName
from rossec.authority.console.queries import PolicyNames
from rossec.authority.policyfile import PolicyFile
from tests.support.consolework import ConsoleWork, ask, many

POLICY = """rossec: 1
robot: r
types: {/pose: geometry_msgs/PoseStamped, /scan: sensor_msgs/LaserScan}
groups: {lamps: [/lamp1, /lamp2]}
title: {/doctor: Dr. Meier, /pose: where it is, lamps: a lamp}
rules: []
"""


def test_titles_and_types_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = ConsoleWork(tmp_path)
    names, path, read = PolicyNames(site.work), site.work.policy_path(), []

    class Counted(PolicyFile):
        @classmethod
        def read(cls, path: Path, *, own: bool = False) -> "Counted":
            assert own, "another user could have written it"
            read.append(path)
            return super().read(path, own=own)

    monkeypatch.setattr(module, "PolicyFile", Counted)

    def told() -> tuple[PolicyName, ...]:
        return many(PolicyName, ask(names, "policy-names"))

    assert told() == ()
    path.write_text(POLICY)
    for _ in range(3):
        assert told() == (
            PolicyName("/doctor", "Dr. Meier", ""),
            PolicyName("/lamp1", "a lamp", ""),
            PolicyName("/lamp2", "a lamp", ""),
            PolicyName("/pose", "where it is", "geometry_msgs/PoseStamped"),
            PolicyName("/scan", "", "sensor_msgs/LaserScan"),
        )
    assert len(read) == 1, "not for every page"
    path.write_text(POLICY + "mistake: 1\n")
    assert told() == ()
    path.unlink()
    assert told() == ()
