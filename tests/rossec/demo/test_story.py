from pathlib import Path

import pytest

from rossec.demo import story
from rossec.demo.stage import DemoFailed
from tests.support.commands import Shell, refused


def test_the_whole_story(empty: Shell) -> None:
    said = empty("demo")
    assert said.code == 0, said
    for claim in ("7. the doctor's view", "\u2580", "frame ''", "last image", "the robot hangs up"):
        assert claim in said.out
    assert said.err == ""


def test_a_kept_demo_says_how_to_go_on(empty: Shell, tmp_path: Path) -> None:
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
def test_the_story_checks_what_it_claims(coarse: dict[str, object], exact_frame: str) -> None:
    exact = {"position": [4.1, 2.9], "frame": exact_frame}
    with pytest.raises(DemoFailed):
        story._check_coarse(exact, coarse)


def test_the_grid_of_the_story() -> None:
    exact = {"position": [4.1, -2.9], "frame": "living_room_map"}
    story._check_coarse(exact, {"position": [4.0, -2.0], "frame": ""})
