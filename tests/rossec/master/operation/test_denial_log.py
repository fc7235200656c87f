import stat
from pathlib import Path

import pytest

from grants.model import Right
from grants.policy.learn import from_log
from rossec.errors import RossecError
from rossec.master.server import effects
from rossec.master.server.effects import DenialLog
from tests.support.site import Site


def test_what_is_written_can_be_learnt_from(tmp_path: Path) -> None:
    path = tmp_path / "denial_log"
    log = DenialLog(path)
    log(7, "/arm", Right.CALL, "/gripper/close")
    log(8, "/arm", Right.CALL, "/gripper/close")
    log(9, "/arm", Right.PARAM_GET, "/arm/speed")
    log.close()
    seen = from_log(path.read_text().splitlines())
    assert {(item.node, item.right, item.name) for item in seen} == {
        ("/arm", Right.CALL, "/gripper/close"),
        ("/arm", Right.PARAM_GET, "/arm/speed"),
    }
    assert len(path.read_text().splitlines()) == 2
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


def test_a_restart_appends_and_the_lines_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effects, "MAX_LINES", 1)
    monkeypatch.setattr(effects, "LINES_PER_NODE", 2)
    for _ in range(2):
        log = DenialLog(tmp_path / "denial_log")
        for number in range(10):
            log(7, "/eve", Right.SUBSCRIBE, f"/flood{number}")
        log.close()
    assert len((tmp_path / "denial_log").read_text().splitlines()) == 6


def test_no_node_uses_up_the_quota_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effects, "MAX_LINES", 5)
    monkeypatch.setattr(effects, "LINES_PER_NODE", 3)
    log = DenialLog(tmp_path / "denial_log")
    for node, lines in (("/eve", 99), ("/mallory", 99), ("/robot", 3)):
        for number in range(lines):
            log(7, node, Right.SUBSCRIBE, f"/t{number}")
    log.close()
    seen = from_log((tmp_path / "denial_log").read_text().splitlines())
    nodes = [item.node for item in seen]
    assert [nodes.count(node) for node in ("/eve", "/mallory", "/robot")] == [8, 3, 3]


async def test_the_master_logs_denials(tmp_path: Path) -> None:
    received_calls: list[tuple[str, Right, str]] = []
    site = Site(tmp_path / "site")
    site.on_denial = lambda _, node, right, name: received_calls.append((node, right, name))
    async with site.running(), site.node("/viewer") as viewer:
        with pytest.raises(RossecError):
            await viewer.subscriber("/robot/pose", "geometry_msgs/PoseStamped")
        with pytest.raises(RossecError):
            await viewer._membership.session.call("getParam", "/robot/name")
        with pytest.raises(RossecError):
            await viewer._membership.session.call("registerPublisher", "not a name", "*", viewer.uri)
    assert received_calls == [
        ("/viewer", Right.SUBSCRIBE, "/robot/pose"),
        ("/viewer", Right.PARAM_GET, "/robot/name"),
    ]


def test_runs_of_an_anonymous_node_are_one_line(tmp_path: Path) -> None:
    log = DenialLog(tmp_path / "denial_log")
    for run in ("/rviz_1795466501944712825", "/rviz_1795466501944712826"):
        log(7, "/rviz", Right.PROVIDE, f"{run}/load_config")
    log.close()
    assert len((tmp_path / "denial_log").read_text().splitlines()) == 1
