"""Own names and groups, from the file to the grants: `apply`, `explain`, requests, by hand."""

from pathlib import Path

import pytest

from grants.document import peek
from grants.model import Right
from tests.support.commands import Shell, refused

POLICY = """rossec: 1
robot: r
defaults: {decision: deny, lifetime: 7d}
groups: {robots: [/robot1, /robot2]}
rules:
  - id: own-logs
    why: Each provides its own loggers.
    who: "*"
    allow: {provide: ["{node}/get_loggers"]}
  - {id: own-pose, why: Its own., who: robots, allow: {publish: [~/pose]}}
  - {id: asked, why: On request., who: /rviz, prompt: {publish: [~/marker]}}
"""


@pytest.fixture
def site(shell: Shell) -> Shell:
    shell.enroll("/robot1")
    shell.enroll("/rviz", "--anonymous")
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    return shell


def held(site: Shell, node: str) -> set[tuple[str, Right]]:
    """What the grants of a node give, each entry."""
    files: list[Path] = sorted((site.node(node) / "grants").glob("*.grant"))
    grants = [peek(file.read_bytes()) for file in files]
    return {(each.pattern, each.rights) for grant in grants for each in grant.permissions}


def test_a_policy_is_applied_to_each_by_its_own_names(site: Shell) -> None:
    assert site.unlocked("policy", "apply", "--yes").code == 0
    assert held(site, "/robot1") == {("/robot1/get_loggers", Right.PROVIDE), ("/robot1/pose", Right.PUBLISH)}
    assert held(site, "/rviz") == {("/rviz~/get_loggers", Right.PROVIDE)}
    again = site.unlocked("policy", "apply", "--yes")
    assert "nothing" in again.out + again.err


@pytest.mark.parametrize(
    ("node", "right", "name", "first"),
    [
        ("/robot1", "publish", "/robot1/pose", "ALLOW: /robot1 publish /robot1/pose"),
        ("/robot1", "publish", "{node}/pose", "ALLOW: /robot1 publish /robot1/pose"),
        ("/robot1", "publish", "/robot2/pose", "DENY: /robot1 publish /robot2/pose"),
        ("/rviz", "provide", "/rviz_1_2/get_loggers", "ALLOW: /rviz provide /rviz_1_2/get_loggers"),
        ("/rviz_1_2", "provide", "/rviz_1_2/get_loggers", "ALLOW: /rviz provide"),
        ("/rviz", "provide", "/rvizx/get_loggers", "DENY: /rviz provide"),
    ],
)
def test_it_is_explained(site: Shell, node: str, right: str, name: str, first: str) -> None:
    said = site("explain", node, right, name)
    assert said.code == 0, said
    assert said.out.startswith(first)


def test_an_anonymous_node_asks_and_a_person_approves(site: Shell) -> None:
    said = site("grant", "request", "/rviz", "--publish", "{node}/marker", "--why", "to show")
    assert said.code == 0, said
    assert "1 for you" in site.unlocked("grant", "decide").out
    pending = site("grant", "pending").out
    assert "/rviz~/marker" in pending
    assert site.unlocked("grant", "approve", said.out.split()[1]).code == 0
    assert ("/rviz~/marker", Right.PUBLISH) in held(site, "/rviz")


def test_own_names_are_signed_by_hand(site: Shell) -> None:
    for node in ("/robot1", "/rviz"):
        said = site.unlocked("grant", "sign", node, "--subscribe", "{node}/cmd")
        assert said.code == 0, said
    assert ("/robot1/cmd", Right.SUBSCRIBE) in held(site, "/robot1")
    assert ("/rviz~/cmd", Right.SUBSCRIBE) in held(site, "/rviz")
    said = site.unlocked("grant", "sign", "/robot1", "--subscribe", "/robot1~/cmd")
    refused(said, "/robot1 is one node", "without ~")
    said = site.unlocked("grant", "sign", "/robot1", "--subscribe", "/rviz~/cmd")
    refused(said, "a tail pattern of another node", "/robot1~/...")
