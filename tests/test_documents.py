"""What the documents point at is there."""

import re
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")])


def links() -> Iterator[tuple[str, str]]:
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
            if "://" not in target and not target.startswith(("#", "mailto:")):
                yield str(document.relative_to(ROOT)), target


@pytest.mark.parametrize(("document", "target"), sorted(set(links())))
def test_a_link_leads_somewhere(document: str, target: str) -> None:
    assert ((ROOT / document).parent / target.partition("#")[0]).exists()


def test_links_are_found() -> None:
    """The test beside this one is not empty."""
    assert ("README.md", "SECURITY.md") in set(links())


ARCHITECTURE = (ROOT / "docs" / "architecture.md").read_text()
PATHS = sorted(set(re.findall(r"`((?:rossec|ca|grants|tests|docs|bench)/[\w/.]*)`", ARCHITECTURE)))
FOLDERS = sorted(
    str(found.parent.relative_to(ROOT))
    for package in ("ca", "grants", "rossec")
    for found in (ROOT / package).rglob("__init__.py")
    if len(found.relative_to(ROOT).parts) > 2
)


@pytest.mark.parametrize("path", PATHS)
def test_what_the_architecture_names_is_there(path: str) -> None:
    assert (ROOT / path).exists()


@pytest.mark.parametrize("folder", FOLDERS)
def test_the_architecture_says_what_a_package_is_for(folder: str) -> None:
    """A folder within one is named there, or in the paragraph of the folder above."""
    assert f"`{folder}/`" in ARCHITECTURE or f"`{folder.rpartition('/')[2]}/`" in ARCHITECTURE


README = (ROOT / "README.md").read_text()
INDEX = (ROOT / "docs" / "README.md").read_text()


def test_the_readme_is_one_screen() -> None:
    assert len(README.split()) <= 800


@pytest.mark.parametrize("folder", ["howto", "spec", "decisions"])
def test_the_index_has_every_page(folder: str) -> None:
    pages = {f"{folder}/{page.name}" for page in (ROOT / "docs" / folder).glob("*.md")}
    assert {page for page in pages if f"]({page})" not in INDEX} == set()


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
