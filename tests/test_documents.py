"""What the documents point at is there."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")])
THREATS = (ROOT / "docs" / "threat-model.md").read_text()


def links() -> Iterator[tuple[str, str]]:
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
            if "://" not in target and not target.startswith(("#", "mailto:")):
                yield str(document.relative_to(ROOT)), target


@pytest.mark.parametrize(("document", "target"), sorted(set(links())))
def test_a_link_leads_somewhere(document: str, target: str) -> None:
    assert ((ROOT / document).parent / target.partition("#")[0]).exists()


def test_links_and_tests_are_found() -> None:
    """The tests beside this one are not empty."""
    assert ("README.md", "SECURITY.md") in set(links())
    assert "tests/ca/test_revocation.py" in named_tests()


def named_tests() -> list[str]:
    return sorted(set(re.findall(r"`(tests/[^`]*)`", THREATS)))


@pytest.mark.parametrize("path", named_tests())
def test_a_test_the_threat_model_names_exists(path: str) -> None:
    found = ROOT / path
    assert found.is_file() or any(found.glob("test_*.py"))


def test_every_threat_names_its_test() -> None:
    rows = THREATS.partition("| attack |")[2].partition("\n\n")[0].splitlines()[2:]
    assert len(rows) > 10
    for row in rows:
        assert "`tests/" in row.rsplit("|", 2)[1], row


@pytest.mark.parametrize("part", re.findall(r"^- `(?:channel|node|master|net)\.[a-z]+",
    (ROOT / "docs" / "architecture.md").read_text(), re.MULTILINE))  # fmt: skip
def test_a_module_the_architecture_names_exists(part: str) -> None:
    assert (ROOT / "rossec" / f"{part[3:].replace('.', '/')}.py").exists()


UNITS = sorted(ROOT.glob("examples/**/*.service"))


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.stem)
def test_a_unit_is_one_that_systemd_reads(unit: Path, tmp_path: Path) -> None:
    """Its program is not installed here; everything else is judged."""
    judge = shutil.which("systemd-analyze")
    if judge is None:
        pytest.skip("NOT RUN: no systemd on this machine")
    copy = tmp_path / unit.name
    program = re.compile(r"^ExecStart=\S+", re.MULTILINE)
    copy.write_text(program.sub("ExecStart=/bin/true", unit.read_text()))
    done = subprocess.run([judge, "verify", copy], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
