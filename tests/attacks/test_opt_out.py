"""Opting out is believed by people: it takes effect, and it changes nothing else."""

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from grants import document
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import read_policy
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from rossec.home import NodeHome

pytestmark = pytest.mark.attack("opt-out")

NOW, DAY = int(time.time()), 86_400
SECRET = "four random words here"
POLICY = """rossec: 1
robot: r
types: {/pose: std_msgs/String}
rules:
  - id: pose
    who: "*"
    allow: {subscribe: [/pose]}
    when: '%smsg.data != "bed  room"'
"""


def deliver(call: StatementCall) -> object:
    raise NotDelivered(f"no master for {call.what}")


@pytest.fixture
def service(tmp_path: Path) -> Iterator[AuthorityService]:
    AuthorityHome.create(tmp_path, "home", SECRET, NOW)
    made = AuthorityService(tmp_path, lambda: SECRET, deliver, lambda: NOW)
    node = NodeHome.of(tmp_path, "/rviz")
    node.create_request("home")
    bundle = made.identities.issue(node.request(), 30 * DAY, replace_key=None, wildcard=True, source="a test")
    node.install(bundle, NOW)
    path = tmp_path / "ca" / "policy.yaml"
    path.write_text(POLICY % ("true && " * 12))
    path.chmod(0o600)
    with contextlib.closing(made):
        yield made


@pytest.mark.parametrize(
    ("name", "is_node"),
    [("/rviz_1234_1700000000000", False), ("/rviz_1234_1700000000000", True), ("/rviz", False)],
)
def test_an_anonymous_node_is_opted_out_with_its_identity(
    service: AuthorityService, name: str, is_node: bool
) -> None:
    policy = read_policy(service.rossec_home, None, signs=True)
    with contextlib.suppress(NotDelivered):
        service.policy.apply(service.policy.plan(policy))
    done = service.policy.opt_out(policy, name, is_node=is_node)
    revoked = service.policy.revoke_opted_out(done)
    assert [grant.subject for grant, _ in revoked] == ["/rviz"]
    assert (done.name, done.is_node) == ("/rviz", True)
    with contextlib.closing(service.home.store()) as store:
        assert [document.peek(row.data) for row in store.unrevoked_grants()] == []
    plan = service.policy.plan(done.policy)
    assert plan.signs == 0


def test_nothing_else_of_the_policy_changes(service: AuthorityService) -> None:
    before = read_policy(service.rossec_home, None, signs=True)
    after = service.policy.opt_out(before, "/camera").policy
    assert after.policy.rules[:-1] == before.policy.rules
    assert "bed  room" in after.policy.rules[0].clauses[0].lines()[0]
    assert before.path.stat().st_mode & 0o777 == 0o600
