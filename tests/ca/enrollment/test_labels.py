import re
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
import zxingcpp
from PIL import Image

from ca.enrollment import qr
from ca.enrollment.qr import PER_PAGE, Label, sheet

FINGERPRINT = "0123 4567 89ab cdef 0123 4567 89ab cdef"


def label(number: int, name: str = "/robot") -> Label:
    return Label(f"{name}{number}", FINGERPRINT, qr.label_code(number.to_bytes(4)))


def pages(html: str) -> list[str]:
    return re.findall(r'<svg class="page".*?</svg>\n', html, re.DOTALL)


def printed(page: str, directory: Path, dpi: int) -> Image.Image:
    """The page as paper has it: A4 drawn by librsvg, which shares no code with us."""
    (directory / "page.svg").write_text(page)
    done = subprocess.run(
        ["rsvg-convert", "-d", str(dpi), "-p", str(dpi), directory / "page.svg"],
        capture_output=True,
        check=True,
    )
    (directory / "page.png").write_bytes(done.stdout)
    return Image.open(directory / "page.png").convert("L")


@pytest.mark.parametrize("dpi", [75, 150])
def test_every_label_of_a_printed_sheet_scans(tmp_path: Path, dpi: int) -> None:
    labels = [label(number) for number in range(PER_PAGE)]
    (page,) = pages(sheet(labels))
    image = printed(page, tmp_path, dpi)
    assert abs(image.width - 210 / 25.4 * dpi) < 2
    found = [code.text for code in zxingcpp.read_barcodes(image)]
    assert sorted(found) == sorted(each.text for each in labels)


def test_a_full_sheet_begins_another_one() -> None:
    assert [page.count(FINGERPRINT[:9]) for page in pages(sheet([label(1)] * 25))] == [48, 2]
    assert pages(sheet([])) == []


def test_a_long_name_stays_on_its_label() -> None:
    page = sheet([Label("/" + "a" * 254, FINGERPRINT, qr.label_code(b"x"))])
    assert ">...</text>" in page
    assert max(float(y) for y in re.findall(r'y="([0-9.]+)" font', page)) < 33
    assert "/aaaaaaaaaaaaaaaa<" in page


def test_nothing_on_a_label_is_markup() -> None:
    hostile = Label("</text><script>alert('1')</script>&", '" onload="x', qr.label_code(b"x"))
    html = sheet([hostile])
    assert "<script" not in html
    assert 'onload="' not in html
    (page,) = pages(html)
    texts = [element.text for element in ElementTree.fromstring(page).iter() if element.text]
    assert "".join(texts).startswith("</text><script>alert('1')</script>&")
    assert "default-src 'none'" in html
