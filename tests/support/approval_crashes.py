"""`python -m tests.support.approval_crashes DIRECTORY KIND...`: approvals under kill -9.

Each kind is approved with the key, and carried out at unlock, and killed at its first write, its
second, and so on. After each kill the record is whole; the service that starts then does what was
recorded, exactly once, and what was not recorded has not been done. Prints how often it was killed,
as JSON.
"""

import json
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Mapping
from functools import partial
from hashlib import sha256
from pathlib import Path

from ca.encoding import Value
from rossec.authority.keyservice.process import operations_of
from rossec.authority.signing import delegations
from rossec.ros.names import MASTER
from tests.support.consoleacts import DAY, POLICY, Acts
from tests.support.killing import run_killed

CHANGED = POLICY.replace("subscribe: [/pose]", "publish: [/odom]", 1)
Arguments = tuple[Value, ...]


def certificates(acts: Acts) -> int:
    with acts.store() as store:
        return len(store.identities.by_name("/lamp"))


def changed(acts: Acts) -> int:
    """Whether the policy is in force, in full: 1, or 2 if anything was signed twice."""
    with acts.store() as store:
        rows, left = store.grants(), store.unrevoked_grants()
    of_node = [row for row in rows if row.name == "/fleet/a"]
    lasts = [row for row in left if row.name == "/fleet/a"]
    assert len(lasts) == 1, "it has both, or neither"
    return len(of_node) - 1


def invitations(acts: Acts) -> int:
    with acts.store() as store:
        return len(store.invitations.all())


def revoked(acts: Acts) -> int:
    with acts.store() as store:
        return int(not store.unrevoked_keys(MASTER, acts.now))


DONE: Mapping[str, Callable[[Acts], int]] = {
    "enroll": certificates,
    "grant": lambda acts: acts.grants("/map"),
    "policy": changed,
    "delegate": lambda acts: len(delegations(acts.home.path, acts.home.own_key())),
    "invitation": invitations,
    "revoke-master": revoked,
}
NEED_KEY = ("enroll", "grant", "policy", "delegate")


def prepare(root: Path) -> tuple[Acts, dict[str, Arguments]]:
    """A service, and the arguments of each kind."""
    acts = Acts(root)
    acts.enroll("/fleet/a")
    acts.enroll_master()
    question = acts.ask("/map")
    return acts, {
        "enroll": (acts.csr("/lamp"), "code", False, 30 * DAY, False),
        "grant": (question, "", 3600),
        "policy": (sha256(CHANGED.encode()).digest(),),
        "delegate": (DAY, 3600),
        "invitation": ("/lamps/*", 3, 3600, False),
        "revoke-master": ("stolen", "/master"),
    }


def approve(acts: Acts, kind: str, arguments: Arguments) -> None:
    """What a person and the service do."""
    acts.touch(acts.prepare(kind, *arguments))


def check(acts: Acts, kind: str, before: int) -> bool:
    """Start again and check; whether it was approved."""
    acts.start()
    acts.audit_record()
    with acts.store() as store:
        recorded = len(store.approvals.all()) - before
    assert recorded <= 1
    acts.approving.carry_out_waiting()
    acts.approving.carry_out_waiting()
    assert DONE[kind](acts) == recorded, f"{kind}: approved {recorded}, done {DONE[kind](acts)}"
    with acts.store() as store:
        assert not store.approvals.waiting()
    acts.audit_record()
    return recorded == 1


def run(base: Acts, work: Path, kind: str, act: Callable[[Acts], None], before: int) -> int:
    """Kill `act` at every write; how often."""
    kills, was_done = 0, set[bool]()
    while True:
        acts = base.moved(work / f"{kind}{kills}")
        died = run_killed(partial(act, acts), kills + 1)
        was_done.add(check(acts, kind, before))
        shutil.rmtree(acts.root)
        if died is None:
            assert True in was_done
            return kills
        kills += 1


def main(work: Path, kinds: list[str]) -> None:
    acts, arguments = prepare(work / "base")
    (acts.home.path / "policy.yaml").write_text(POLICY)
    kills = Counter[str]()
    for kind in kinds:
        given = arguments[kind]
        if kind == "policy":
            (acts.home.path / "policy.yaml").write_text(CHANGED)
        with acts.store() as store:
            before = len(store.approvals.all())
        act = partial(approve, kind=kind, arguments=given)
        kills[kind] = run(acts, work, kind, act, before)
        if kind in NEED_KEY:
            kills[f"{kind} at unlock"] = _at_unlock(acts, work, kind, given, before)
        (acts.home.path / "policy.yaml").write_text(POLICY)
    print(json.dumps(kills))  # noqa: T201


def _at_unlock(acts: Acts, work: Path, kind: str, arguments: Arguments, before: int) -> int:
    locked = operations_of(acts.home, acts.write_audit)
    waits = acts.moved(work / "waits", locked)
    approve(waits, kind, arguments)
    waits.operations = acts.operations  # which holds the key
    act: Callable[[Acts], None] = lambda each: each.approving.carry_out_waiting()  # noqa: E731
    kills = run(waits, work, kind, act, before)
    shutil.rmtree(waits.root)
    return kills


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
