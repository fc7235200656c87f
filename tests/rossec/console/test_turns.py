"""Questions before a login: a source has a few that wait, and others are not told to wait."""

import pytest

from rossec.console.sessions import MAX_WAITING, LoginTurns
from rossec.errors import HttpRefused


@pytest.mark.attack("login-flood")
def test_a_source_has_few_that_wait() -> None:
    turns = LoginTurns()
    begun = [turns.wait(f"2001:db8::{host}") for host in range(MAX_WAITING)]
    for each in begun:
        each.__enter__()
    with pytest.raises(HttpRefused) as caught, turns.wait("2001:db8::99"):
        pass
    assert caught.value.status == 429
    with turns.wait("192.0.2.1"), turns.wait("2001:db8:0:1::1"):
        pass
    begun[0].__exit__(None, None, None)
    with turns.wait("2001:db8::99"):
        pass


def test_behind_a_proxy_nobody_is_told_apart() -> None:
    turns = LoginTurns()
    for each in [turns.wait("") for _ in range(MAX_WAITING + 1)]:
        each.__enter__()
