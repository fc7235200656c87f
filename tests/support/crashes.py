"""`python -m tests.support.crashes DIRECTORY`: the authority's database under kill -9.

Each scenario changes a real database. It is killed at its first write, its second, and so on until
it completes. After each kill another process must find every identity that was issued,
at most one for the request, and a log that verifies; a retry must complete. Prints how
often each was killed, as JSON.
"""

import json
import shutil
import sqlite3
import sys
from collections import Counter
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from unittest import mock

from ca.approvals.statement import StatementKind
from ca.authority import Authority, create_root
from ca.certificates import from_pem, sign_renewal
from ca.domains import verify_domains
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.lists import open_list
from ca.store.log import ApprovalState
from ca.store.record import Store
from ca.store.values import DAY, RequestState
from ca.svid import build_request, check_request
from ca.things import sign_statement
from rossec.authority.renewals import renew
from rossec.authority.signing import SigningAuthority
from tests.support import approving
from tests.support.killing import run_killed
from tests.support.passkeys import Passkey
from tests.support.things import LAMP, again, row_of
from tests.vectors.make_domains import ENTRY

NOW = 1_800_000_000
ROOT, NODE, NEW = (KeySigner(generate()) for _ in range(3))
CERTIFICATE = create_root(ROOT, "home", now=NOW, serial=1)
HELD, ASKED = build_request(NODE, "home", "/held"), build_request(NEW, "home", "/robot")
DUE = NOW + 20 * DAY
LIGHT = again(LAMP, 2, name="/things/light")
Scenario = Callable[[SigningAuthority, Path], None]


def opened(directory: Path) -> SigningAuthority:
    return SigningAuthority(Authority(ROOT, CERTIFICATE), Store.open(directory / "ca.db"), directory)


def prepare(directory: Path) -> None:
    """A database with an identity and a pending request."""
    directory.mkdir()
    Store.create(directory / "ca.db").close()
    authority = opened(directory)
    authority.sign_list(NOW)
    (directory / "held.pem").write_bytes(authority.issue(HELD, NOW))
    authority.store.requests.add(check_request(ASKED, "home"), ASKED, "test", NOW)
    authority.store.close()


def issue(authority: SigningAuthority, directory: Path) -> None:
    bundle = authority.issue(ASKED, NOW)
    (directory / "out.pem").write_bytes(bundle)


def deny(authority: SigningAuthority, _: Path) -> None:
    digest = check_request(ASKED, "home").digest
    if authority.store.requests.get(digest).state is RequestState.PENDING:
        authority.store.requests.deny(digest, NOW, "unknown")


def collect(authority: SigningAuthority, _: Path) -> None:
    with mock.patch("ca.store.identities.KEPT_EXPIRED", 0):
        authority.store.requests.collect(NOW + 60 * DAY)


def revoke(authority: SigningAuthority, _: Path) -> None:
    authority.revoke(b"k" * 32, "stolen", NOW)


RENEWAL = build_request(NEW, "home", "/held")


def succeed(authority: SigningAuthority, directory: Path) -> None:
    leaf, _ = from_pem((directory / "held.pem").read_bytes())
    bundle = renew(authority, sign_renewal(NODE, (leaf,), RENEWAL, DUE), DUE)
    (directory / "out.pem").write_bytes(bundle)


REPLACEMENT = build_request(NEW, "home", "/held")


def replace(authority: SigningAuthority, directory: Path) -> None:
    """A reinstalled node replaces its old key, which is revoked."""
    bundle = authority.issue(REPLACEMENT, NOW, replace_key="/held")
    (directory / "out.pem").write_bytes(bundle)


PHONE = Passkey()


def approve(authority: SigningAuthority, _: Path) -> None:
    """A phone is added, approves once, and the act is recorded with the approval."""
    store = authority.store
    if not store.passkeys.all():
        store.passkeys.add(approving.registered(PHONE))
    if not store.approvals.all():
        statement = approving.state(approving.WHATS[StatementKind.DELEGATE], store=store)
        with store.transaction():
            store.approvals.add(approving.touch(statement, device=PHONE))
            store.log_event("delegation", "/master", "", NOW)
    for approval in store.approvals.waiting():
        store.approvals.end(approval.id, ApprovalState.DONE, "", NOW)


def check_approved(directory: Path) -> None:
    """An approval is recorded exactly if what it approved was."""
    with closing(opened(directory).store) as store:
        acts = [entry for entry in store.log.entries() if entry.what == "delegation"]
        assert len(acts) == len(store.approvals.all()) <= 1


def trust(authority: SigningAuthority, _: Path) -> None:
    """A domain is accepted, and in a list, in one step."""
    with authority.store.transaction():
        if not authority.store.domains.accepted():
            authority.store.domains.accept(ENTRY, NOW)
            authority.sign_domains(NOW)


def check_trusted(directory: Path) -> None:
    """The newest list names the domains that are trusted, and no others."""
    with closing(opened(directory).store) as store:
        data, terms = store.domains.newest_list(), [row.read() for row in store.domains.accepted()]
        listed = verify_domains(data, ROOT.public_key).domains if data else ()
        assert terms == [*listed], "a domain is trusted that is not listed, or the reverse"


def rename(authority: SigningAuthority, _: Path) -> None:
    """A thing is stated; under another name, its former statement ends in the same step."""
    store = authority.store
    for statement in (LAMP, LIGHT):
        with store.transaction():
            if any(row.id == statement.id for row in store.things.all()):
                continue
            if former := frozenset(row.id for row in store.things.in_force(NOW)):
                authority.revoke_all(former, "renamed", NOW)
            data = sign_statement(authority.signer, statement)
            store.things.add(row_of(statement)._replace(data=data), statement, NOW)


def check_renamed(directory: Path) -> None:
    """The audit finds two names in force; here: what was stated is not lost with its successor."""
    with closing(opened(directory).store) as store:
        names = [row.name for row in store.things.all()]
        assert names in ([], [LAMP.name], [LAMP.name, LIGHT.name])
        assert len(store.things.in_force(NOW)) == min(len(names), 1)


SCENARIOS: dict[str, Scenario] = {
    "issue": issue,
    "deny": deny,
    "collect": collect,
    "revoke": revoke,
    "renew": succeed,
    "replace": replace,
    "approve": approve,
    "trust": trust,
    "rename": rename,
}


def act(scenario: Scenario, directory: Path) -> None:
    authority = opened(directory)
    scenario(authority, directory)
    authority.store.close()


def check(directory: Path, before: int) -> None:
    """The invariants, however the previous process ended."""
    with closing(opened(directory).store) as store:
        store.log.audit(ROOT.public_key)  # approvals too
        ders = [row.der for row in store.identities.all()]
        assert before <= len(ders) <= before + 1, "an identity was lost, or there are two"
        for out in directory.glob("*.pem"):
            data = out.read_bytes()
            if data.count(b"END CERTIFICATE") == 2:  # else it was killed while delivering
                assert from_pem(data)[0] in ders, f"{out.name} was handed out and is not recorded"


def check_listed(directory: Path) -> None:
    """Every revocation in the database is in a signed list."""
    with closing(opened(directory).store) as store:
        newest = store.newest_list()
        revoked = store.revoked_entries()
        listed = open_list(newest, ROOT.public_key).entries if newest is not None else frozenset()
        assert revoked <= listed, "a revocation was recorded and never signed"


def run(name: str, base: Path, work: Path) -> Counter[str]:
    """Kill one scenario at every write; the number of kills by system call."""
    scenario, deaths = SCENARIOS[name], Counter[str]()
    total = _count(base) + (name in {"issue", "renew", "replace"})
    while True:
        directory = work / f"{name}{deaths.total()}"
        shutil.copytree(base, directory)
        died = run_killed(partial(act, scenario, directory), deaths.total() + 1)
        check(directory, _count(base))
        check_approved(directory)
        check_trusted(directory)
        check_renamed(directory)
        recorded = _newest(directory) if _count(directory) == total else None
        act(scenario, directory)
        check(directory, _count(base))
        check_approved(directory)
        check_trusted(directory)
        check_renamed(directory)
        assert _count(directory) == total, "doing it again did not complete it"
        check_listed(directory)
        assert recorded in {None, _newest(directory)}, "a second identity for one request"
        shutil.rmtree(directory)
        if died is None:
            return deaths
        deaths[died] += 1


def _count(directory: Path) -> int:
    with closing(sqlite3.connect(directory / "ca.db")) as db:
        return int(db.execute("SELECT count(*) FROM certificate").fetchone()[0])


def _newest(directory: Path) -> bytes:
    with closing(sqlite3.connect(directory / "ca.db")) as db:
        rows = db.execute("SELECT der FROM certificate ORDER BY rowid DESC LIMIT 1").fetchall()
        return bytes(rows[0][0])


def main(work: Path) -> None:
    base = work / "base"
    prepare(base)
    deaths = {name: run(name, base, work) for name in SCENARIOS}
    print(json.dumps(deaths))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
