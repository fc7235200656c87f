"""What the checks of pages find, by a page that has one fault of each kind."""

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
import segno
import zxingcpp
from PIL import Image

from tests.support.browser import Chromium
from tests.support.pagecheck import PageCheck, accessibility

pytestmark = pytest.mark.browser

SOUND = "<h1>A page</h1><p>Nothing is wrong with it.</p>"
POLICY = "default-src 'none'; require-trusted-types-for 'script'; trusted-types 'none'"


class Pages(BaseHTTPRequestHandler):
    """Answers every path with `bodies[path]`, under a strict policy."""

    bodies: dict[str, str]

    def do_GET(self) -> None:
        body = self.bodies.get(self.path)
        page = (
            "<!doctype html><html lang=en><meta charset=utf-8><title>Test</title>"
            "<link rel=icon href=data:,><meta name=viewport content='width=device-width'>"
            f"<main>{body}</main></html>"
        ).encode()
        self.send_response(500 if body is None else 200)
        self.send_header("Content-Type", "text/html")
        self.send_header("Content-Length", str(len(page)))
        self.send_header("Content-Security-Policy", POLICY + "; img-src data:")
        self.end_headers()
        self.wfile.write(page)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture(scope="module")
def origin() -> Iterator[str]:
    Pages.bodies = {
        "/": SOUND,
        "/pale": "<h1>A page</h1><p><font color='#ddd'>pale on white</font></p>",
        "/wide": "<h1>A page</h1><pre>" + "x" * 200 + "</pre>",
        "/large": SOUND + "<!--" + "x" * 100_000 + "-->",
        "/inline": SOUND + "<script>alert(1)</script>",
    }
    server = ThreadingHTTPServer(("127.0.0.1", 0), Pages)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://localhost:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_sound_page_passes_and_has_its_picture(chromium: Chromium, origin: str, tmp_path: Path) -> None:
    with chromium.window(origin) as window:
        window.open("/")
        PageCheck(tmp_path)(window, "sound", "phone", "desktop-dark")
    sizes = {}
    for path in tmp_path.iterdir():
        with Image.open(path) as picture:
            sizes[path.name] = picture.width
    assert sizes == {"sound-phone.png": 780, "sound-desktop-dark.png": 2240}


@pytest.mark.parametrize(
    ("path", "finding"), [("/pale", "color-contrast"), ("/wide", "scrolls sideways"), ("/large", "size")]
)
def test_a_page_with_a_fault_fails(
    chromium: Chromium, origin: str, tmp_path: Path, path: str, finding: str
) -> None:
    with chromium.window(origin) as window:
        window.open(path)
        with pytest.raises(AssertionError, match=finding):
            PageCheck(tmp_path)(window, "faulty")


def test_rules_that_are_named_are_the_only_ones(chromium: Chromium, origin: str) -> None:
    with chromium.window(origin) as window:
        window.open("/pale")
        assert accessibility(window, "document-title") == []


@pytest.mark.parametrize(
    ("path", "fault"), [("/inline", "CSP: script-src-elem inline"), ("/none", "answer: 500")]
)
def test_a_fault_while_loading_is_collected(chromium: Chromium, origin: str, path: str, fault: str) -> None:
    with pytest.raises(AssertionError, match=fault):
        visit(chromium, origin, path)


def visit(chromium: Chromium, origin: str, path: str) -> None:
    with chromium.window(origin) as window:
        window.open(path)


def test_the_camera_plays_the_code(chromium: Chromium, origin: str, tmp_path: Path) -> None:
    code = tmp_path / "code.png"
    segno.make("ROSSEC:TEST").save(str(code), scale=8)
    with Image.open(code) as picture:
        chromium.camera.show(picture)
    with chromium.window(origin) as window:
        window.open("/")
        frame = window.evaluate_apart(_FRAME)
    pixels = bytes(frame["data"])
    seen = Image.frombytes("L", (frame["width"], frame["height"]), pixels)
    assert [found.text for found in zxingcpp.read_barcodes(seen)] == ["ROSSEC:TEST"]


# Frames come and go; the first one with something dark and something bright shows the code.
_FRAME = """(async () => {
    const stream = await navigator.mediaDevices.getUserMedia({video: true})
    const video = Object.assign(document.createElement("video"), {srcObject: stream})
    await video.play()
    const canvas = new OffscreenCanvas(video.videoWidth, video.videoHeight)
    const brush = canvas.getContext("2d", {willReadFrequently: true})
    for (;;) {
        brush.drawImage(video, 0, 0)
        const {data, width, height} = brush.getImageData(0, 0, canvas.width, canvas.height)
        const grey = Array.from({length: width * height}, (_, i) => data[4 * i])
        if (Math.max(...grey.slice(0, 100000)) > 200) {
            stream.getTracks().forEach(track => track.stop())
            return {data: grey, width, height}
        }
        await new Promise(done => setTimeout(done, 50))
    }
})()"""
