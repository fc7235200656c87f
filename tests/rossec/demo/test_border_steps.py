"""The demo of a border router runs, and checks what it claims."""

import pytest

from rossec.demo.environment import DemoFailed
from rossec.demo.steps import check_coarse_lamp
from tests.support.commands import Shell


def test_the_whole_demo_of_a_border_router(empty: Shell) -> None:
    said = empty("border", "--demo")
    assert said.code == 0, said
    for claim in (
        "signed /things/lamp until",
        "border router at coap://[::1]:",
        ", heating 20.0",
        "the lamp says: the light is on",
        "revoked the thing /things/lamp",
        "last temperature",
    ):
        assert claim in said.out
    assert said.err == ""
    assert list(empty.root.glob("nodes")) == []


@pytest.mark.parametrize(("exact", "coarse"), [(21.3, 21.3), (21.3, 25.0), (20.0, 20.0)])
def test_the_demo_checks_the_steps(exact: float, coarse: float) -> None:
    with pytest.raises(DemoFailed, match="the heating saw"):
        check_coarse_lamp({"temperature": exact}, {"temperature": coarse})


def test_the_demo_knows_the_steps() -> None:
    check_coarse_lamp({"temperature": 21.3}, {"temperature": 20.0})
    check_coarse_lamp({"temperature": 22.6}, {"temperature": 25.0})
