"""`python -m tests.support.phone_crashes DIRECTORY`: a phone that is added, under kill -9.

The service is killed at every write while it adds a passkey, then starts anew: its codes and
challenges are gone, and the phone is added with new ones. Prints how often it was killed, as JSON.
"""

import json
import shutil
import sys
from collections import Counter
from contextlib import closing
from functools import partial
from pathlib import Path

from rossec.authority.console.access import ConsoleAccess
from rossec.authority.console.messages import LoginChallenge, from_value
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.process import operations_of
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from tests.support.commands import PASSPHRASE
from tests.support.consolework import NOW, ask
from tests.support.killing import run_killed
from tests.support.passkeys import ORIGIN, RP_ID, Passkey

PHONE = Passkey(counts=False)


def no_master(call: StatementCall) -> object:
    raise NotDelivered(call.what)


def start(root: Path) -> ConsoleAccess:
    """What a service that was started knows."""
    operations = operations_of(AuthorityHome.at(root), lambda _: None)
    work = AuthorityWork(root, operations, no_master, now=lambda: NOW)
    return ConsoleAccess(work, lambda _: None)


def add(root: Path) -> None:
    """Add the phone, unless it is there."""
    with closing(AuthorityHome.at(root).store()) as store:
        if store.passkeys.all():
            return
    access = start(root)
    asked = from_value(LoginChallenge, ask(access, "new-passkey", ORIGIN, RP_ID))
    answer = PHONE.register(asked.challenge)
    ask(access, "add-passkey", asked.id, access.phone_code("a test"), "Ann's phone", *answer)


def check(root: Path, *, complete: bool) -> None:
    """The phone is there with its entry in the log, or neither is; and it logs in."""
    home = AuthorityHome.at(root)
    with closing(home.store()) as store:
        store.log.audit(home.anchor().public_key)
        found = [each.id for each in store.passkeys.active()]
    assert found in ([], [PHONE.id])
    if complete:
        access = start(root)
        asked = from_value(LoginChallenge, ask(access, "login-challenge", ORIGIN))
        assert ask(access, "login", asked.id, *PHONE.sign(asked.challenge)) == "Ann's phone"


def main(work: Path) -> None:
    base, deaths = work / "base", Counter[str]()
    AuthorityHome.create(base, "home", PASSPHRASE, NOW)
    while True:
        root = work / f"add{deaths.total()}"
        shutil.copytree(base, root)
        died = run_killed(partial(add, root), deaths.total() + 1)
        check(root, complete=False)
        add(root)
        check(root, complete=True)
        shutil.rmtree(root)
        if died is None:
            break
        deaths[died] += 1
    print(json.dumps(deaths))  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]))
