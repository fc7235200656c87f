"""The service's state, and a number that differs when anything has changed, and only then."""

from collections.abc import Callable
from pathlib import Path

from rossec.authority.console.messages import Status, from_value
from rossec.authority.console.serving import StatusQuery
from tests.support import approving
from tests.support.consolework import NOW, ConsoleWork, ask


def test_the_number_differs_when_anything_has_changed(tmp_path: Path) -> None:
    site, seen, master = ConsoleWork(tmp_path), [0], [False]
    look = StatusQuery(site.work, site.operations.held, lambda: master[0], lambda: tuple(seen))
    numbers: list[int] = []

    def status() -> Status:
        return from_value(Status, ask(look, "status"))

    first = status()
    assert first[:4] == ("home", first.fingerprint, True, None)
    assert (first.phones, first.has_master, first.now) == (0, False, NOW)
    changes: list[Callable[[], object]] = [
        lambda: None,
        site.unlock,
        lambda: site.home.store().passkeys.add(approving.PASSKEY),
        lambda: site.work.policy_path().write_text("rossec: 1\n"),
        lambda: site.work.policy_path().unlink(),
        (site.home.path / "inbox").mkdir,
        (site.home.path / "inbox" / "x.request").touch,
        lambda: seen.append(1),
        lambda: master.append(master.pop(0) is False),
        site.operations.held.lock,
    ]
    for change in changes:
        change()
        found = status()
        assert status().number == found.number
        numbers.append(found.number)
    assert numbers[0] == first.number
    assert numbers[4] == numbers[2], "as before the policy was written"
    assert len(set(numbers)) == len(numbers) - 1
    assert all(0 <= number < 1 << 48 for number in numbers)
    last = status()
    assert (last.phones, last.has_master, last.locked) == (1, True, True)
