"""What the how-tos print of `rossec explain` is what it prints."""

import re
from pathlib import Path

from tests.support.commands import Shell

PAGE = Path(__file__).parents[4] / "docs" / "howto" / "a-policy-for-a-home.md"


def test_the_policy_for_a_home_is_explained_as_its_page_says(empty: Shell, tmp_path: Path) -> None:
    page = PAGE.read_text()
    [text] = re.findall(r"<<'END'\n(rossec: 1\n.*?)^END$", page, re.DOTALL | re.MULTILINE)
    (tmp_path / "policy.yaml").write_text(text)
    said = empty("explain", "/heating", "subscribe", "/robot/pose", "--policy", str(tmp_path / "policy.yaml"))
    lines = said.out.splitlines()[:4]
    assert "\n".join(lines) in page
