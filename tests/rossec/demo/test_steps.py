from pathlib import Path
from typing import cast

import pytest

from rossec.demo import steps
from rossec.demo.environment import DemoEnvironment, DemoFailed
from tests.support.commands import Shell, refused


def test_the_whole_demo(empty: Shell) -> None:
    said = empty("demo")
    assert said.code == 0, said
    for claim in (
        "7. the doctor's view",
        "\u2580",
        "frame ''",
        "last image",
        "the robot closes the connection",
    ):
        assert claim in said.out
    assert said.err == ""


async def test_no_grant_of_the_demo_tells_by_a_condition_what_it_clears(tmp_path: Path) -> None:
    signed: list[tuple[str, ...]] = []

    class Commands:
        root = tmp_path

        async def command(self, *words: str) -> str:
            signed.append(words)
            return "grant 1234"

    await steps.sign_grants(cast("DemoEnvironment", Commands()))
    [heating] = [words for words in signed if "/heating" in words]
    assert "header.frame_id" in heating
    assert "--when" not in heating


def test_a_kept_demo_needs_a_new_directory(empty: Shell, tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    refused(empty("demo", "--keep", str(tmp_path / "there")), "exists", "does not exist")


@pytest.mark.parametrize(
    ("coarse", "exact_frame"),
    [
        ({"position": [4.1, 2.0], "frame": ""}, "living_room_map"),
        ({"position": [4.0, 2.0], "frame": "living_room_map"}, "living_room_map"),
        ({"position": [4.0, 2.0], "frame": ""}, ""),
    ],
)
def test_the_demo_checks_what_it_claims(coarse: dict[str, object], exact_frame: str) -> None:
    exact = {"position": [4.1, 2.9], "frame": exact_frame}
    with pytest.raises(DemoFailed):
        steps.check_coarse(exact, coarse)


def test_the_demo_checks_the_grid() -> None:
    exact = {"position": [4.1, -2.9], "frame": "living_room_map"}
    steps.check_coarse(exact, {"position": [4.0, -2.0], "frame": ""})
