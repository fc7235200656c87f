"""Requests in the record: taken once, answered once, never changed."""

import sqlite3
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.errors import StoreError
from ca.keys.signing import KeySigner
from ca.store.database import Database
from ca.store.record import Store
from grants.model import Right
from grants.request import GrantRequest, RequestedRight, sign_request
from rossec.authority import requests
from rossec.authority.requests import GrantRequestStore
from rossec.errors import ConfigurationError

NOW = 1_800_000_000
NODE = KeySigner(ec.generate_private_key(ec.SECP256R1()))
RIGHTS = (RequestedRight(Right.CALL, "/lift"), RequestedRight(Right.SUBSCRIBE, "/pose"))
ASKED = GrantRequest("home", "/toaster", NOW, bytes(16), RIGHTS, "")
DATA = sign_request(NODE, ASKED)


def opened(path: Path) -> GrantRequestStore:
    return GrantRequestStore(Database.open(path / "ca.db"))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    Store.create(tmp_path / "ca.db").close()
    return tmp_path


def test_a_request_is_answered_wish_by_wish(path: Path) -> None:
    box = opened(path)
    box.add(ASKED, DATA, NOW + 5)
    first, second = box.unanswered()
    assert (first.request, first.at, [first.requested, second.requested]) == (ASKED, NOW + 5, list(RIGHTS))
    assert first.short_id == ASKED.id.hex()[:8]
    box.answer(first, "granted", "policy", NOW)
    assert box.unanswered() == [second]
    assert opened(path).unanswered() == [second]
    Store.open(path / "ca.db").close()  # still a record


def test_a_request_is_recorded_and_answered_once(path: Path) -> None:
    box = opened(path)
    box.add(ASKED, DATA, NOW)
    (first, _) = box.unanswered()
    box.answer(first, "denied", "", NOW)
    with pytest.raises(StoreError, match="already recorded or answered"):
        box.answer(first, "granted", "", NOW)
    with pytest.raises(StoreError, match="already recorded or answered"):
        box.add(ASKED, DATA, NOW)


@pytest.mark.parametrize("table", ["grant_request", "decision"])
@pytest.mark.parametrize("change", ["DELETE FROM {}", "UPDATE {} SET at = 0"])
def test_nothing_is_changed_or_deleted(path: Path, table: str, change: str) -> None:
    box = opened(path)
    box.add(ASKED, DATA, NOW)
    box.answer(box.unanswered()[0], "granted", "", NOW)
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        sqlite3.connect(path / "ca.db").execute(change.format(table))


def test_a_record_that_is_closed_cannot_be_written(path: Path) -> None:
    database = Database.open(path / "ca.db")
    box = GrantRequestStore(database)
    database.close()
    with pytest.raises(StoreError, match="cannot be used"):
        box.add(ASKED, DATA, NOW)


def test_files_are_laid_and_found(path: Path) -> None:
    assert requests.inbox_files(path) == []
    laid = requests.put_in_inbox(path, ASKED, DATA)
    assert requests.inbox_files(path) == [laid]
    assert requests.read_request(laid) == DATA
    laid.write_bytes(bytes(requests.MAX_FILE + 1))
    with pytest.raises(ConfigurationError, match="larger than"):
        requests.read_request(laid)
    with pytest.raises(ConfigurationError, match="there is no"):
        requests.read_request(path / "absent")
