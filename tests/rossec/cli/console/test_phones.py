"""`rossec console phones`: shown, and removed at the terminal with what they approved."""

import json

from tests.support.approving import registered
from tests.support.commands import Shell, refused
from tests.support.consoleacts import Acts
from tests.support.passkeys import Passkey


def test_phones_are_shown_and_removed(empty: Shell) -> None:
    acts = Acts(empty.root)
    other = Passkey()
    with acts.store() as store:
        store.passkeys.add(registered(other, "Ben's phone", acts.now))
    acts.enroll("/lamp")
    lines = empty("console", "phones").out.splitlines()
    assert lines[0].startswith("Ann's phone  since 20")
    assert "approved last 20" in lines[0]
    assert "Ben's phone" in lines[1]
    assert "has approved nothing  http://localhost:7411" in lines[1]
    found = json.loads(empty("console", "phones", "--json").out)
    assert [(each["name"], each["approved_last"]) for each in found] == [
        ("Ann's phone", acts.now),
        ("Ben's phone", None),
    ]
    acts.lock()
    waits = acts.enroll("/late")
    said = empty("console", "phones", "remove", "Ann's phone", "--reason", "lost")
    assert said.out.splitlines() == [
        "Ann's phone can approve nothing any more",
        "what it approved and was not done yet comes to nothing: 1",
    ]
    assert acts.outcome(waits.id).result == "its phone was removed: lost"
    said = empty("console", "phones", "remove", "Ben's phone")
    assert said.out == "Ben's phone can approve nothing any more\n"
    assert empty("console", "phones").out == "no phone can approve; next: rossec console phone\n"
    assert "removed: lost" in empty("console", "phones", "--all").out


def test_an_unknown_phone_is_not_removed(empty: Shell) -> None:
    Acts(empty.root)
    refused(empty("console", "phones", "remove", "Eve's phone"), "no phone is called", "phones")
