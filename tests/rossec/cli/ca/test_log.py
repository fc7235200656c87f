import base64
import json
import sqlite3
from contextlib import closing

from ca.revocation.merkle import verify_inclusion
from ca.store.values import open_head
from rossec.authority.home import AuthorityHome
from tests.support.commands import Shell, refused
from tests.support.consistency import verify_consistency

NOBODY = ("--master", "http://127.0.0.1:1")


def test_the_log_shows_every_entry(shell: Shell) -> None:
    shell.enroll("/robot")
    entries = json.loads(shell("ca", "log", "--json").out)
    assert [entry["number"] for entry in entries] == list(range(len(entries)))
    assert [entry["what"] for entry in entries[-4:]] == ["pending", "approved", "issued", "certificate"]
    lines = shell("ca", "log").out.splitlines()
    assert len(lines) == len(entries)
    assert lines[-1].startswith(f"{len(entries) - 1}  20")
    assert "  certificate  /robot  " in lines[-1]
    assert shell("ca", "log", "--last", "2").out.splitlines() == lines[-2:]


def test_a_log_in_order_verifies(shell: Shell) -> None:
    said = shell("ca", "log", "verify")
    assert "entries, all as they were written" in said.out
    assert "a head kept elsewhere proves more" in said.err
    shell.enroll("/robot")
    kept = shell.root / "head"
    assert shell.unlocked("ca", "log", "head", "--out", str(kept)).out.startswith("head of ")
    counted = json.loads(shell("ca", "log", "verify", "--json", "--head", str(kept)).out)
    assert counted["entries"] == counted["signed"]
    quiet = shell("ca", "log", "verify", "--head", str(kept))
    assert (quiet.code, quiet.err) == (0, "")


def test_a_changed_entry_is_named(shell: Shell) -> None:
    shell.enroll("/robot")
    with closing(sqlite3.connect(shell.root / "ca" / "ca.db")) as db:
        db.execute("DROP TRIGGER log_no_UPDATE")
        db.execute("UPDATE log SET subject = '/thief' WHERE number = 5")
        db.commit()
    refused(shell("ca", "log", "verify"), "log entry 5 was changed", "compare it with")


def test_proofs_verify_against_the_signed_head(shell: Shell) -> None:
    old = base64.b64decode(shell.unlocked("ca", "log", "head").out)
    (shell.root / "old").write_bytes(old)
    shell.enroll("/robot")
    shell.unlocked("ca", "revoke", "/robot", *NOBODY)
    key = AuthorityHome.at(shell.root).own_key()
    said = json.loads(shell("ca", "log", "prove", "--entry", "3").out)
    head = open_head(base64.b64decode(said["head"]), key)
    assert (said["size"], said["root"]) == (head.size, head.root.hex())
    proof = [bytes.fromhex(text) for text in said["proof"]]
    verify_inclusion(bytes.fromhex(said["leaf"]), 3, head.size, proof, head.root)
    said = json.loads(shell("ca", "log", "prove", "--since", str(shell.root / "old")).out)
    proof = [bytes.fromhex(text) for text in said["proof"]]
    before = open_head(old, key)
    assert (said["first"], said["first_root"]) == (before.size, before.root.hex())
    verify_consistency(before.size, head.size, proof, before.root, head.root)


def test_an_entry_outside_the_log_is_not_proved(shell: Shell) -> None:
    prove = ("ca", "log", "prove")
    refused(shell(*prove), "nothing to prove, or too much", "--entry N or --since F")
    refused(shell(*prove, "--entry", "99"), "there is no leaf 99 in a tree of")
    (shell.root / "none").write_bytes(b"nothing")
    refused(shell(*prove, "--since", str(shell.root / "none")), "this is not a signed head")


def test_without_a_signed_head_nothing_is_proved(shell: Shell) -> None:
    with closing(sqlite3.connect(shell.root / "ca" / "ca.db")) as db:
        db.executescript("DROP TRIGGER head_no_DELETE; DELETE FROM head")
    refused(shell("ca", "log", "prove", "--entry", "0"), "no state of the log", "ca log head")
    said = shell("ca", "log", "verify")
    assert said.out.splitlines()[-1] == "none of them is signed: next, rossec ca log head"
