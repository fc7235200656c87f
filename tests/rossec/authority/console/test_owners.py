from rossec.authority.console import owners


def test_a_phone_is_above_whoever_only_looks() -> None:
    assert owners.rank(owners.of_phone("look")) == 1
    for owner in (owners.of_looker(b"phone"), owners.LOOKER, "", "phone"):
        assert owners.rank(owner) == 0
