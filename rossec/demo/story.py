"""The story of the demo, running: a robot and its receivers, the authority, and its console.

`rossec console --demo`: what `rossec demo` sets up, left running until somebody ends it. Like the
demo it does everything by commands and processes; the console is one of them.
"""

import socket

from rossec.demo import steps, trying
from rossec.demo.environment import DemoEnvironment

START = 60.0  # seconds for the console on a busy machine


async def begin_story(demo: DemoEnvironment, port: int) -> str:
    """Set everything up in `demo`, whose directory is empty; returns the link to log in by.

    Args:
        demo: runs the commands and holds the processes, which the caller stops.
        port: of the console.

    Raises:
        DemoFailed: a step did not do what it says.
    """
    with demo.printer.step("the home gets its own authority"):
        await steps.found_authority(demo)
    with demo.printer.step("master, robot and two receivers are enrolled by their QR codes"):
        await steps.enroll(demo)
    with demo.printer.step("the person who lives there decides who may see what"):
        camera = await steps.sign_grants(demo)
    with demo.printer.step("they start, each its own process"):
        _, doctor, _, _ = await steps.start(demo)
    with demo.printer.step("the doctor's view of the camera is revoked"):
        await steps.revoke(demo, doctor, camera)
    with demo.printer.step("a lamp asks to see where the robot is, and waits for an answer"):
        await trying.ask(demo)
    with demo.printer.step("the authority's service starts, then the console"):
        return await _start_console(demo, port)


async def _start_console(demo: DemoEnvironment, port: int) -> str:
    service = await demo.start(
        "rossec", "ca", "serve", "--json", "--unlock-for", "0",
        "--join-address", f"127.0.0.1:{_free_port()}",
        "--passphrase-file", str(demo.root / "passphrase"), name="authority",
    )  # fmt: skip
    await service.expect("starting", lambda report: "ready" in report, within=START)
    console = await demo.start("rossec", "console", "--json", "--port", str(port), name="console")
    ready = await console.expect("starting", lambda report: "ready" in report, within=START)
    return str(ready["login"])


def _free_port() -> int:
    """A port that nobody listens at now; the join port must be named."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return int(sock.getsockname()[1])
