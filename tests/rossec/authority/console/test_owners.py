from rossec.authority.console import messages


def test_a_phone_is_above_whoever_only_looks() -> None:
    assert messages.rank(messages.of_phone("look")) == 1
    for owner in (messages.of_looker(b"phone"), messages.LOOKER, "", "phone"):
        assert messages.rank(owner) == 0
