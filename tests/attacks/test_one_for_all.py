"""A node that asks for too much: others lose what was taken from them, and get what is theirs."""

import contextlib
import secrets
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path

import pytest

from grants import document
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority import policyfile
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import PolicyFile, read_policy
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from tests.support.consoleacts import POLICY as CONSOLE_POLICY
from tests.support.consoleacts import Acts
from tests.support.consolepages import Browser
from tests.support.refusals import refuse_to_sign_for

pytestmark = pytest.mark.attack("one-for-all")

NOW, DAY = 1_800_000_000, 86_400
SECRET = "four random words here"
POLICY = """rossec: 1
robot: r
types: {/camera: std_msgs/String}
rules:
  - {id: own, who: /greedy, allow: {call: ["/s/*"], publish: ["/**"]}}
  - {id: camera, who: /viewer, allow: {subscribe: [/camera]}}
  - {id: lift, who: /viewer, allow: {call: [/lift/up]}}
"""
TAKEN = POLICY.replace("/camera]", "/map]")


class Place:
    def __init__(self, root: Path) -> None:
        self.root = root
        self.answer: Callable[[StatementCall], object] | None = None
        AuthorityHome.create(root, "home", SECRET, NOW)
        self.service = AuthorityService(root, lambda: SECRET, self._deliver, lambda: NOW)
        self.nodes = {name: self._enroll(name) for name in ("/greedy", "/viewer")}
        self.write(POLICY)

    def _deliver(self, call: StatementCall) -> object:
        if self.answer is not None:
            return self.answer(call)
        raise NotDelivered(f"no master for {call.what}")

    def _enroll(self, name: str) -> NodeHome:
        node = NodeHome.of(self.root, name)
        node.create_request("home")
        bundle = self.service.identities.issue(
            node.request(), 30 * DAY, replace_key=None, wildcard=False, source="a test"
        )
        node.install(bundle, NOW)
        return node

    def write(self, text: str) -> None:
        (self.root / "ca" / "policy.yaml").write_text(text)

    def policy(self) -> PolicyFile:
        return read_policy(self.root, None, signs=True)

    def ask(self, node: str, *rights: RequestedRight) -> None:
        asked = GrantRequest("home", node, NOW, secrets.token_bytes(16), rights, "please")
        data = sign_request(self.nodes[node].credentials().signer, asked)
        self.service.policy.collect_requests(self.policy(), [data])

    def apply(self) -> None:
        plan = self.service.policy.plan(self.policy())
        with contextlib.suppress(NotDelivered):
            self.service.policy.apply(plan)

    def grants(self, node: str) -> dict[str, int]:
        """The names in its grants in force, and in how many grants there are."""
        with contextlib.closing(self.service.home.store()) as store:
            rows = [document.peek(row.data) for row in store.unrevoked_grants((node,))]
        return {item.pattern: len(rows) for grant in rows for item in grant.permissions}


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Place]:
    made = Place(tmp_path / "site")
    with contextlib.closing(made.service):
        yield made


def test_a_node_with_seventy_grants_keeps_no_other_the_camera(place: Place) -> None:
    place.apply()
    for number in range(70):
        place.ask("/greedy", RequestedRight(Right.CALL, f"/s/n{number}"))
        place.service.policy.decide(place.policy())
    place.write(TAKEN)
    place.apply()
    assert place.grants("/viewer").keys() == {"/map", "/lift/up"}
    greedy = place.grants("/greedy")
    assert len(greedy) == 72, "it has what it asked for, in fewer grants"
    assert set(greedy.values()) <= set(range(1, 65))
    assert place.service.policy.plan(place.policy()).is_empty


@pytest.mark.parametrize("name", ["/remote/hospital/x"], ids=["a name that another authority grants"])
def test_a_request_that_no_grant_can_have_is_denied_alone(place: Place, name: str) -> None:
    place.ask("/greedy", RequestedRight(Right.PUBLISH, name), RequestedRight(Right.CALL, "/s/a"))
    place.ask("/viewer", RequestedRight(Right.CALL, "/lift/up"))
    decided = place.service.policy.decide(place.policy())
    assert (decided.allowed, len(decided.denied)) == (2, 1)
    assert place.grants("/viewer").keys() == {"/lift/up"}
    assert place.grants("/greedy").keys() == {"/s/a"}
    again = place.service.policy.decide(place.policy())
    assert (again.grants, again.allowed, again.denied) == ([], 0, [])


def test_where_one_node_cannot_be_signed_for_all_else_is_done(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    place.apply()
    place.write(TAKEN.replace('publish: ["/**"]}', 'publish: ["/**"]}, lifetime: 1d'))
    refuse_to_sign_for("/greedy", monkeypatch)
    said: list[str] = []
    with pytest.raises(NotDelivered):
        place.service.policy.apply(place.service.policy.plan(place.policy()), said.append)
    assert [line.partition(" (")[0] for line in said] == [
        "revoked: 1",
        "signed: 1",
        "revoked: 1",
        "not granted: /greedy: too large",
    ]
    assert place.grants("/greedy") == {}
    assert place.grants("/viewer").keys() == {"/map", "/lift/up"}


def test_a_node_whose_disk_is_full_keeps_no_other_from_its_grants(place: Place) -> None:
    directory = place.nodes["/greedy"].path / "grants"
    directory.rmdir()
    directory.write_text("no file can be written here")
    master = list[bytes]()
    place.answer = lambda call: _deposited(call, master)
    said: list[str] = []
    place.service.policy.apply(place.service.policy.plan(place.policy()), said.append)
    assert len(place.nodes["/viewer"].grants()) == len(place.grants("/viewer")) > 0
    assert sorted({document.peek(each).subject for each in master}) == ["/greedy", "/viewer"]
    assert any(line.startswith("a grant of /greedy cannot be stored here") for line in said)
    place.service.policy.complete()
    for path in place.nodes["/viewer"].grant_files():
        path.unlink()
    place.service.policy.complete()
    assert len(place.nodes["/viewer"].grants()) == len(place.grants("/viewer"))


def _deposited(call: StatementCall, master: list[bytes]) -> object:
    (items, *_) = call.statement
    assert isinstance(items, list)
    if call.method == "rossec.deliveryStates":
        return [""] * len(items)
    if call.method == "rossec.depositGrants":
        master.extend(items)
        return [""] * len(items)
    return 0


def test_where_a_list_has_no_room_for_all_others_lose_what_was_taken(
    place: Place, monkeypatch: pytest.MonkeyPatch
) -> None:
    place.apply()
    for number in range(5):
        place.ask("/greedy", RequestedRight(Right.CALL, f"/s/n{number}"))
        place.service.policy.decide(place.policy())
    place.write(POLICY.replace("who: /greedy", "who: /nobody").replace("/camera]", "/map]"))
    monkeypatch.setattr(policyfile, "MAX_LEAVES", 3)
    plan = place.service.policy.plan(place.policy())
    assert plan.listed == 3
    assert [reason.partition(":")[0] for reason in plan.refused] == ["/greedy"]
    with pytest.raises(NotDelivered):
        place.service.policy.apply(plan)
    assert place.grants("/viewer").keys() == {"/map", "/lift/up"}


def test_a_console_says_of_whom_some_of_the_policy_is_not_in_force() -> None:
    browser = Browser().log_in()
    why = "/greedy: too many names for one node"
    browser.home.policy = browser.home.policy._replace(refused=(why,))
    text = browser.get("/policy").text
    assert "It cannot give" in text
    assert "too many names" in text
    browser.home.policy = browser.home.policy._replace(gives=(), takes=())
    text = browser.get("/policy").text
    assert "All is as the policy says" not in text
    assert "Some of the policy is not in force" in text
    assert "Some of the policy is not in force" in browser.get("/").text


def test_a_phone_puts_the_rest_in_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    acts = Acts(tmp_path / "home")
    for name in ("/fleet/a", "/fleet/b"):
        assert acts.enroll(name).state == "done"
    refuse_to_sign_for("/fleet/a", monkeypatch)
    text = CONSOLE_POLICY.replace("subscribe: [/pose]", "publish: [/odom]", 1)
    (acts.home.path / "policy.yaml").write_text(text)
    outcome = acts.approve("policy", sha256(text.encode()).digest())
    assert outcome.state == "done"
    assert outcome.result == "1 grant signed, 2 revoked; not granted: /fleet/a: too large"
    with acts.store() as store:
        assert [row.name for row in store.unrevoked_grants()] == ["/fleet/b"]
    assert acts.home.count_unlisted(acts.now) == 0
    acts.audit_record()
