"""`rossec policy learn | review`: transcripts."""

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from grants.model import Right
from grants.policy.learn import Observation, log_line
from rossec.authority.policyfile import PolicyFile
from rossec.cli.policy import apply as module
from rossec.cli.shared.context import Environment
from tests.grants.policy.policies import SMALL
from tests.support.commands import Shell, refused
from tests.support.site import Site


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "policy.yaml"
    path.write_text(SMALL)
    return path


def log(tmp_path: Path, *lines: str) -> str:
    path = tmp_path / "complain.log"
    path.write_text("\n".join(lines))
    return str(path)


def test_rules_are_learned_from_a_log(shell: Shell, file: Path, tmp_path: Path) -> None:
    lines = log(tmp_path, log_line(1, "/joy", Right.PUBLISH, "/cmd_vel", "geometry_msgs/Twist"))
    said = shell("policy", "learn", "--from-log", lines, "--policy", str(file))
    total = file.read_text().count("- id: ") + file.read_text().count("{id: ")
    assert said.out.splitlines() == [
        "learned learned-joy: publish /cmd_vel",
        f"1 new rule, {total} in {file}; next: rossec policy review --from-log FILE",
    ]
    assert "learned-joy" in file.read_text()
    out = tmp_path / "new.yaml"
    again = ("policy", "learn", "--from-log", lines, "--policy", str(file), "--out", str(out))
    assert shell(*again).out.startswith("0 new rules, ")
    assert PolicyFile.read(out).policy.rules


def test_learn_needs_a_source_and_a_place(shell: Shell, tmp_path: Path) -> None:
    refused(shell("policy", "learn"), "nothing to learn from", "--from-graph")
    lines = log(tmp_path, log_line(1, "/joy", Right.CALL, "/a"))
    nowhere = ("--policy", str(tmp_path / "absent" / "policy.yaml"))
    refused(shell("policy", "learn", "--from-log", lines, *nowhere), "there is no", "--policy FILE")
    new = tmp_path / "new.yaml"
    assert shell("policy", "learn", "--from-log", lines, "--policy", str(new)).code == 0
    assert [rule.id for rule in PolicyFile.read(new).policy.rules] == ["learned-joy", "basics"]


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


async def test_the_graph_of_a_running_master_is_observed(site: Site) -> None:
    site.grant("/looker", Right.GRAPH, "/**")
    site.publish("/robot", "/robot/pose")
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", "geometry_msgs/PoseStamped")
        seen = await module._observe_graph(Environment(site.environ), "/looker")
        blind = await module._observe_graph(Environment(site.environ), "/robot")
    pose = Observation("/robot", Right.PUBLISH, "/robot/pose", "geometry_msgs/PoseStamped")
    assert seen == [pose]
    assert blind == []


def test_rules_are_learned_from_the_graph(shell: Shell, file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def look(*_: object) -> list[Observation]:
        return [Observation("/robot", Right.PUBLISH, "/robot/pose", "geometry_msgs/PoseStamped")]

    monkeypatch.setattr(module, "_observe_graph", look)
    said = shell("policy", "learn", "--from-graph", "/looker", "--policy", str(file))
    assert said.out.startswith("learned learned-robot: publish {node}/pose\n")


def test_the_answers_of_a_review_become_rules(
    shell: Shell, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = log(
        tmp_path,
        log_line(1, "/a", Right.PUBLISH, "/x/one", "std_msgs/String"),
        log_line(2, "/b", Right.PUBLISH, "/x/one"),
        log_line(3, "/c", Right.SUBSCRIBE, "/robot/pose"),
        log_line(4, "/d", Right.CALL, "/lift"),
        log_line(5, "/e", Right.CALL, "/lift"),
        log_line(6, "/nav/z", Right.SUBSCRIBE, "/robot/pose"),
    )
    answers = iter(["a", "g", "c", "room", "d", "s"])
    monkeypatch.setattr("click.prompt", lambda *_, **__: next(answers))
    said = shell("policy", "review", "--from-log", lines, "--policy", str(file))
    assert said.code == 0, said
    rules = {rule.id: rule for rule in PolicyFile.read(file).policy.rules[4:]}
    assert {name: (str(rule.effect), rule.clauses[0].pattern) for name, rule in rules.items()} == {
        "reviewed-a": ("allow", "/x/one"),
        "reviewed-b": ("allow", "/x/*"),
        "reviewed-c": ("allow", "/robot/pose"),
        "no-d": ("deny", "/lift"),
    }
    assert rules["reviewed-c"].clauses[0].restriction is not None
    assert "/nav/z" not in said.out  # a rule decides it


def test_an_unknown_filter_in_a_review_is_refused(
    shell: Shell, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter(["c", "rom"])
    monkeypatch.setattr("click.prompt", lambda *_, **__: next(answers))
    lines = log(tmp_path, log_line(3, "/c", Right.SUBSCRIBE, "/robot/pose"))
    said = shell("policy", "review", "--from-log", lines, "--policy", str(file))
    refused(said, "no filter 'rom'", "did you mean 'room'?")
    assert file.read_text() == SMALL


def test_anonymous_nodes_are_learned_under_their_certified_name(
    shell: Shell, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell("node", "request", "/rviz")
    request = str(shell.node("/rviz") / "node.csr")
    assert shell.unlocked("ca", "sign", request, "--yes", "--anonymous").code == 0

    async def look(*_: object) -> list[Observation]:
        return [Observation(f"/rviz_{number}", Right.SUBSCRIBE, "/scan") for number in (1, 2)]

    monkeypatch.setattr(module, "_observe_graph", look)
    said = shell("policy", "learn", "--from-graph", "/looker", "--policy", str(file))
    assert said.out.splitlines()[0] == "learned learned-rviz: subscribe /scan"


def test_own_names_of_anonymous_nodes_are_learned_for_every_run(
    shell: Shell, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shell("node", "request", "/rviz")
    request = str(shell.node("/rviz") / "node.csr")
    assert shell.unlocked("ca", "sign", request, "--yes", "--anonymous").code == 0

    async def look(*_: object) -> list[Observation]:
        return [Observation(f"/rviz_{n}", Right.PROVIDE, f"/rviz_{n}/load") for n in (1, 2)]

    monkeypatch.setattr(module, "_observe_graph", look)
    said = shell("policy", "learn", "--from-graph", "/looker", "--policy", str(file))
    assert said.out.startswith("learned learned-rviz: provide {node}/load\n1 new rule, ")
    learned = PolicyFile.read(file).policy.rules[-1]
    assert [clause.pattern for clause in learned.clauses] == ["{node}/load"]


def test_what_basics_give_is_left_to_basics(shell: Shell, file: Path, tmp_path: Path) -> None:
    lines = log(
        tmp_path,
        log_line(1, "/joy", Right.PUBLISH, "/rosout"),
        log_line(2, "/joy", Right.PROVIDE, "/joy/get_loggers"),
        log_line(3, "/joy", Right.PUBLISH, "/cmd_vel"),
    )
    said = shell("policy", "learn", "--from-log", lines, "--policy", str(file))
    assert said.out.startswith("learned learned-joy: publish /cmd_vel\n1 new rule, ")
    assert "add basics: true to the policy" in said.err
    new = tmp_path / "new.yaml"
    said = shell("policy", "learn", "--from-log", lines, "--policy", str(new))
    assert "basics" not in said.err
    assert "basics: true" in new.read_text()
