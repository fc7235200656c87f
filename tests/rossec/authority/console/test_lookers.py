"""Requests of those who may only look: a few at a time, however many they prepare."""

from contextlib import closing
from pathlib import Path

import pytest

from ca.svid import build_request, check_request
from rossec.authority.console import approving, messages
from rossec.authority.console.approving import LookersRequests
from rossec.authority.home import AuthorityHome
from rossec.errors import KeyServiceRefused
from tests.support.commands import PASSPHRASE
from tests.support.pki import new_signer

NOW = 1_800_000_000
LOOKER, PHONE = messages.of_looker(b"1"), messages.of_phone("Anna's")


def csr(name: str) -> bytes:
    return build_request(new_signer(), "home", name)


@pytest.mark.attack("looker-floods")
def test_whoever_only_looks_fills_no_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(approving, "MAX_REQUESTS", 2)
    home = AuthorityHome.create(tmp_path / "home", "home", PASSPHRASE, NOW)
    requests = LookersRequests()
    made = [csr(f"/n{number}") for number in range(3)]
    for der in made[:2]:
        requests.check(home, (der,), LOOKER, NOW)
        with closing(home.store()) as store:
            store.requests.add(check_request(der, "home"), der, "", NOW)
    requests.check(home, (made[0],), LOOKER, NOW)  # it is there already
    with pytest.raises(KeyServiceRefused, match="2 nodes wait"):
        requests.check(home, (made[2],), LOOKER, NOW)
    requests.check(home, (made[2],), PHONE, NOW)
    with closing(home.store()) as store:
        store.requests.deny(store.requests.open()[0].digest, NOW)
    requests.check(home, (made[2],), LOOKER, NOW)
    for arguments in ((), ("text",)):
        requests.check(home, arguments, LOOKER, NOW)
