"""`python -m tests.support.join_crashes DIRECTORY`: a whole join under kill -9.

Node and authority are one process, so that every write of both is one at which it is killed: the
node's key and request, the use and the identity in the record, the identity in the node's
directory. Then it is done again with the same code. Prints how often each was killed, as JSON.
"""

import json
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import partial
from hashlib import sha256
from pathlib import Path

from ca.certificates import to_pem
from ca.enrollment.invitation import InvitationCode, JoinRequest, sign_proof
from ca.enrollment.join import Issued, JoinAnswer, WaitingMessage, WaitReason
from ca.store.identities import InvitationRow
from ca.svid import check_request
from rossec.authority.invitations import end, find, join
from rossec.home import NodeHome
from tests.support.crashes import CERTIFICATE, HELD, NOW, ROOT, opened, prepare
from tests.support.killing import run_killed

CODE = InvitationCode(
    sha256(CERTIFICATE).digest(), b"s" * 16, NOW + 3600, "127.0.0.1:9", "/**", wildcard=False
)
SECOND = InvitationCode(
    sha256(CERTIFICATE).digest(), b"t" * 16, NOW + 3600, "127.0.0.1:9", "/**", wildcard=False
)
NAMES = {"join": "/fleet/a", "wait": "/held"}
Scenario = Callable[[Path], None]


def answer_of(directory: Path, csr: bytes, name: str) -> JoinAnswer:
    """The answer of the authority in `directory`."""
    proof = sign_proof(CODE.signer, bytes(32), csr, name)
    authority = opened(directory)
    with closing(authority.store):
        return join(authority, JoinRequest(CODE.id, bytes(32), name, csr, proof), NOW)


def node_joins(directory: Path, name: str) -> None:
    """What `rossec node join` does, without the network."""
    home = NodeHome.of(directory, name)
    if (home.path / "node.pem").exists():
        home.identity(NOW)
        return
    found = answer_of(directory, home.join_request("home"), name)
    if isinstance(found, Issued):
        home.install(to_pem(*found.chain, CERTIFICATE), NOW)
    else:
        assert found == WaitingMessage(WaitReason.PERSON)


def ends(directory: Path) -> None:
    with closing(opened(directory).store) as store:
        end(store, find(store, CODE.id.hex()), "lost", NOW)


def invites(directory: Path) -> None:
    with closing(opened(directory).store) as store:
        if SECOND.id not in {row.id for row in store.invitations.all()}:
            store.invitations.add(row_of(SECOND))


def row_of(code: InvitationCode) -> InvitationRow:
    return InvitationRow(code.id, code.key, "/**", 2, False, code.expires, NOW)


SCENARIOS: dict[str, Scenario] = {
    "join": partial(node_joins, name=NAMES["join"]),
    "wait": partial(node_joins, name=NAMES["wait"]),
    "end": ends,
    "invite": invites,
}


EXPECTED = {"join": (1, 0, 0), "wait": (0, 1, 0), "end": (0, 0, 0), "invite": (0, 0, 1)}


def check(directory: Path, name: str, *, complete: bool) -> None:
    """The invariants: a use for each identity, and nothing twice."""
    with closing(opened(directory).store) as store:
        store.log.audit(ROOT.public_key)
        uses = [use.thumbprint for use in store.invitations.uses(CODE.id)]
        issued = [row.thumbprint for row in store.identities.by_name(NAMES["join"])]
        waiting = [row for row in store.requests.open() if row.name == NAMES["wait"]]
        ended = store.invitations.ended(CODE.id)
        invited = [row for row in store.invitations.all() if row.id == SECOND.id]
    assert uses == issued, "a use without its identity, or the reverse"
    assert len(issued) <= 1
    assert not (ended and waiting), "ended, and a request of it still waits"
    if complete:
        found = len(issued), len(waiting), len(invited)
        assert found == EXPECTED[name]
    if complete and name == "join":
        own = NodeHome.of(directory, NAMES["join"]).identity(NOW)
        assert own.thumbprint == issued[0]


def run(name: str, base: Path, work: Path) -> Counter[str]:
    """Kill one scenario at every write; the number of kills by system call."""
    scenario, deaths = SCENARIOS[name], Counter[str]()
    while True:
        directory = work / f"{name}{deaths.total()}"
        shutil.copytree(base, directory)
        died = run_killed(partial(scenario, directory), deaths.total() + 1)
        check(directory, name, complete=False)
        scenario(directory)
        check(directory, name, complete=True)
        shutil.rmtree(directory)
        if died is None:
            return deaths
        deaths[died] += 1


def main(work: Path) -> None:
    base, waits = work / "base", work / "waits"
    prepare(base)
    with closing(opened(base).store) as store:
        for row in store.requests.open():
            store.requests.deny(row.digest, NOW, "not of this test")
        store.invitations.add(row_of(CODE))
        assert check_request(HELD, "home").name == NAMES["wait"]
    shutil.copytree(base, waits)
    node_joins(waits, NAMES["wait"])
    deaths = {name: run(name, waits if name == "end" else base, work) for name in SCENARIOS}
    print(json.dumps(deaths))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
