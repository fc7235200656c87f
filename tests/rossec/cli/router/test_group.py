import json

import pytest

from tests.support.commands import Shell, refused


@pytest.mark.parametrize("word", ["--open", "--json", "--print-config", "--host=a", "--join=tls/a:1"])
def test_only_the_directory_stands_before_a_verb(empty: Shell, word: str) -> None:
    said = empty("router", word, "accounts", "list")
    assert (said.code, "only --home stands before a verb" in said.err) == (2, True)
    assert not (empty.root / "router").exists()


def test_what_a_router_was_told_is_kept(empty: Shell) -> None:
    words = "--open", "--print-config", "--home", str(empty.root / "r")
    listen = "--listen", "tcp/127.0.0.1:7448", "--join", "tcp/192.0.2.1:7447"
    first, again = empty("router", *words, *listen), empty("router", *words)
    assert first.out == again.out
    found = json.loads(again.out)
    assert found["listen"]["endpoints"] == ["tcp/127.0.0.1:7448"]
    assert found["connect"]["endpoints"] == ["tcp/192.0.2.1:7447"]


def test_a_router_that_nobody_may_use_does_not_begin(empty: Shell) -> None:
    refused(empty("router"), "nobody has an account", "rossec router accounts add")
