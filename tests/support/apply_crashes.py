"""`python -m tests.support.apply_crashes DIRECTORY`: `policy apply` under kill -9.

A changed policy is applied, and killed at its first write, its second, and so on. After each kill
the log verifies and the master has heard of no revocation whose replacement it does not have.
Applying again must give each node exactly its grants, none twice, here and at the master. Prints
how often it was killed, as JSON. The master is a directory: what was delivered is a file.
"""

import json
import shutil
import sys
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from ca.authority import Authority
from ca.revocation.lists import open_list
from grants import document
from rossec.authority.home import AuthorityHome
from rossec.authority.policyfile import read_policy
from rossec.authority.service import AuthorityService
from rossec.authority.session import StatementCall
from rossec.authority.signing import SigningAuthority
from rossec.home import NodeHome
from tests.support.killing import run_killed

NOW, DAY, SECRET = 1_800_000_000, 86400, "four random words here"
POLICY = """rossec: 1
robot: r
rules:
  - {id: a, who: "*", allow: {subscribe: [/pose]}}
  - {id: b, who: /here, allow: {publish: [/odom]}}
"""
CHANGED = POLICY.replace("[/pose]}}", "[/pose]}, limit: {rate: 1}}")


class Master:
    """What was delivered, as files."""

    def __init__(self, root: Path) -> None:
        self.path = root / "delivered"  # by name: the grants, and the list

    def __call__(self, call: StatementCall) -> object:
        self.path.mkdir(exist_ok=True)
        (items, *_) = call.statement
        if call.method == "rossec.updateRevocations":
            assert len(self.grants()) == 5, "revoked before the replacement was delivered"
            assert isinstance(items, bytes)
            (self.path / "list").write_bytes(items)
            return 0
        assert isinstance(items, Sequence)
        if call.method == "rossec.deliveryStates":
            return ["waiting" if (self.path / item[:16].hex()).exists() else "" for item in items]
        for item in items:
            (self.path / document.grant_id(item).hex()).write_bytes(item)
        return ["" for _ in items]

    def grants(self) -> set[str]:
        """The ids of what was deposited."""
        return {path.name for path in self.path.glob("*") if len(path.name) == 32}

    def revoked(self, authority: Authority) -> set[str]:
        """The ids in the list."""
        path = self.path / "list"
        if not path.exists() or not path.read_bytes():  # killed while it was written
            return set()
        listed = open_list(path.read_bytes(), authority.signer.public_key)
        return {entry.hex() for entry in listed.entries}


class UnlockedService(AuthorityService):
    """An authority whose key is in memory: to decrypt it would take most of the time."""

    def __init__(self, root: Path, authority: Authority) -> None:
        super().__init__(root, str, Master(root), lambda: NOW)
        self._authority = authority
        self._open: SigningAuthority | None = None

    def unlock(self) -> SigningAuthority:
        """As the service's, without a passphrase."""
        if self._open is None:
            self._open = SigningAuthority(self._authority, self.home.store(), self.home.path)
        return self._open

    def close(self) -> None:
        """Close the record."""
        if self._open is not None:
            self._open.store.close()


def write_policy(root: Path, text: str) -> None:
    (root / "ca" / "policy.yaml").write_text(text)


def prepare(root: Path) -> Authority:
    """An authority with a node here and one elsewhere, and a policy in force that has changed."""
    AuthorityHome.create(root, "home", SECRET, NOW)
    authority = AuthorityHome.at(root).unlock(SECRET)
    for home in (NodeHome.of(root, "/here"), NodeHome.of(root / "other", "/there")):
        home.create_request("home")
        home.install(authority.issue(home.request(), NOW, 30 * DAY), NOW)
    authority.store.close()
    write_policy(root, POLICY)
    apply(root, authority.authority)
    write_policy(root, CHANGED)
    return authority.authority


def apply(root: Path, authority: Authority) -> None:
    """What `rossec policy apply --yes` does."""
    with closing(UnlockedService(root, authority)) as service:
        plan = service.policy.plan(read_policy(root, None, signs=True))
        if plan.is_empty:
            service.policy.complete()
        else:
            service.policy.apply(plan)


def check(root: Path, authority: Authority) -> None:
    """The invariants, however the previous process ended."""
    with closing(AuthorityHome.at(root).store()) as store:
        store.log.audit(authority.signer.public_key)
        rows = store.grants()
    assert len(rows) <= 5, "a grant was signed twice"
    master = Master(root)
    if master.revoked(authority):
        assert len(master.grants()) == 5, "revoked before the replacement was delivered"


def check_done(root: Path, authority: Authority) -> None:
    """The policy is in force, here and at the master."""
    check(root, authority)
    with closing(AuthorityHome.at(root).store()) as store:
        rows, rules = store.unrevoked_grants(), store.policy_grants()
        revoked = {entry.hex() for entry in store.revoked_entries()}
    assert sorted((row.name, rules[row.id]) for row in rows) == [
        ("/here", "a"),
        ("/here", "b"),
        ("/there", "a"),
    ]
    master = Master(root)
    assert {row.id.hex() for row in rows} <= master.grants()
    assert master.revoked(authority) == revoked
    held = {document.grant_id(data) for data in NodeHome.of(root, "/here").grants()}
    assert {row.id for row in rows if row.name == "/here"} <= held


def run(base: Path, work: Path, authority: Authority) -> Counter[str]:
    """Kill it at every write; the number of kills by system call."""
    deaths = Counter[str]()
    while True:
        root = work / f"apply{deaths.total()}"
        shutil.copytree(base, root)
        died = run_killed(partial(apply, root, authority), deaths.total() + 1)
        check(root, authority)
        apply(root, authority)
        apply(root, authority)  # what is left to deliver, if the plan was carried out before
        check_done(root, authority)
        shutil.rmtree(root)
        if died is None:
            return deaths
        deaths[died] += 1


def main(work: Path) -> None:
    base = work / "base"
    authority = prepare(base)
    print(json.dumps(run(base, work, authority)))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
