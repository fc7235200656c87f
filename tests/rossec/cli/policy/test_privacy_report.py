import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.commands import Shell

POSE = "geometry_msgs/PoseStamped"


POLICY = """# The flat.
rossec: 1
robot: robbie
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: view, who: /viewer, why: looking, allow: {subscribe: [/pose]}}
  - {id: drive, who: /robot, allow: {publish: ["/**"]}}
"""


@pytest.fixture
def site(shell: Shell) -> Shell:
    shell.enroll("/viewer")
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    return shell


def test_the_report_shows_what_the_policy_allows(site: Shell) -> None:
    lines = site("privacy").out.splitlines()
    assert lines[:5] == [
        "/pose (geometry_msgs/PoseStamped) -> /viewer",
        "  sees where it is: exactly; how it moves: exactly",
        "  why: looking (rule view)",
        "  when: always",
        "  until: 7d at a time",
    ]
    rows = json.loads(site("privacy", "--field", "position", "--json").out)
    assert {row["field"] for row in rows} == {f"pose.position.{axis}" for axis in "xyz"}
    assert {row["tells"] for row in rows} == {"position"}
    assert site("privacy", "--node", "/nobody").out == "no receiver has access\n"


def test_the_page_is_the_report_of_the_console(site: Shell, tmp_path: Path) -> None:
    page = tmp_path / "privacy.html"
    assert site("privacy", "--html", str(page)).out == f"written to {page}\n"
    text = page.read_text()
    assert text.startswith("<!doctype html>")
    assert "<title>What robbie shows to whom</title>" in text
    assert "/viewer" in text
    assert "pose.position.x" in text
    assert "sees where it is: exactly; how it moves: exactly" in text
    site("privacy", "--html", str(page), "--field", "orientation")
    assert "pose.position.x" not in page.read_text()
    site("privacy", "--html", str(page), "--node", "/nobody")
    assert "No receiver has access" in page.read_text()


def test_the_page_has_titles_and_the_times_of_this_host(site: Shell, tmp_path: Path) -> None:
    path = site.root / "ca" / "policy.yaml"
    path.write_text(POLICY + "title: {/viewer: the tablet, /pose: where it is}\n")
    assert site("policy", "check").code == 0
    site.unlocked("grant", "sign", "/viewer", "--subscribe", "/pose", "--for", "1d")
    page = tmp_path / "privacy.html"
    assert site("privacy", "--held", "--html", str(page)).code == 0
    text = page.read_text()
    assert '<b class="title"><bdi>the tablet</bdi></b> <bdi class="name">/viewer</bdi>' in text
    assert "where it is" in text
    assert "UTC" not in text
    assert site("privacy", "--held").out.count("UTC") >= 1, "a terminal's are as in all commands"


WITHOUT_JINJA = """
import sys
sys.modules["jinja2"] = None
from rossec.cli.main import main
main()
"""


def test_without_the_extra_a_page_is_refused_and_the_text_is_not(site: Shell, tmp_path: Path) -> None:
    def run(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", WITHOUT_JINJA, *words]
        environ = site.environ
        return subprocess.run(command, env=environ, capture_output=True, text=True, check=False)

    said = run("privacy", "--html", str(tmp_path / "x.html"))
    assert said.returncode == 1
    assert "a page needs the package" in said.stderr
    assert "rossec[console]" in said.stderr
    assert not (tmp_path / "x.html").exists()
    assert "looking" in run("privacy").stdout


def test_the_report_shows_the_grants_held_now(site: Shell) -> None:
    assert site("privacy", "--held").out == "no receiver has access\n"
    site.unlocked(
        "grant",
        "sign",
        "/viewer",
        "--subscribe",
        "/pose",
        "--type",
        POSE,
        "--clear",
        "header",
        "--publish",
        "/out",
    )
    site.unlocked("grant", "sign", "/viewer", "--subscribe", "/other")
    said = site("privacy", "--held").out.splitlines()
    assert "/other (type not known) -> /viewer" in said
    assert "  why: no reason given (grant " in "\n".join(said)
    assert "  why: looking (grant " in "\n".join(said)
    assert "  clear: header.frame_id, header.seq, header.stamp" in said
