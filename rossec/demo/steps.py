"""The demo, step by step: from an authority to a filtered, encrypted, revoked topic.

Each step does the real thing through the command line and real processes, and checks what it
claims; a claim that does not hold ends the demo with an error.
"""

import asyncio
import math
import secrets
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

from rossec.demo.environment import DemoEnvironment, DemoFailed, DemoProcess, Report
from rossec.demo.robot import CAMERA, FRAME, POSE, SCAN
from rossec.files import create
from rossec.home import NodeHome

COARSE: Final = 2.0
NODES: Final = ("/master", "/robot", "/doctor", "/heating")
_TOLERANCE: Final = 1e-9
# Seconds to wait for images after the revocation.
_SILENCE: Final = 1.5


async def run_steps(demo: DemoEnvironment) -> None:
    """Run every step in `demo`, whose directory is empty.

    Raises:
        DemoFailed: a step did not do what it says.
    """
    with demo.printer.step("the home gets its own authority"):
        await found_authority(demo)
    with demo.printer.step("four nodes make their keys and are enrolled by their QR codes"):
        await enroll(demo)
    with demo.printer.step("the person who lives there decides who may see what"):
        camera = await sign_grants(demo)
    with demo.printer.step("master, robot and the two receivers start, each its own process"):
        robot, doctor, heating, port = await start(demo)
    with demo.printer.step("both receive the same messages, and do not see the same"):
        await compare(demo, doctor, heating)
    with demo.printer.step("a peer with a certificate of another authority connects"):
        await connect_intruder(demo, port)
    with demo.printer.step("the doctor's view of the camera is revoked"):
        await revoke(demo, doctor, camera)
    if robot.ended:
        raise DemoFailed("the robot ended before the demo")


async def found_authority(demo: DemoEnvironment) -> None:
    """The passphrase is in a file; a person would type it."""
    create(demo.root / "passphrase", secrets.token_urlsafe(18).encode())
    await demo.command("ca", "init", "home", *passphrase(demo))


async def enroll(
    demo: DemoEnvironment, names: Sequence[str] = NODES, shown: str = "/robot"
) -> None:
    """Each key stays in its node's directory; the code authenticates the request."""
    codes = []
    for name in names:
        await demo.command("node", "request", name, "--domain", "home", quiet=True)
        text = await demo.command("node", "code", name, "--text", quiet=True)
        codes.append(text.strip())
    demo.printer.print(f"this is what {shown} shows to the camera of the phone:")
    await demo.command("node", "code", shown)
    scanned = [item for code in codes for item in ("--code", code)]
    await demo.command(
        "ca", "sign", *map(_request_of(demo), names), *scanned, "--yes", *passphrase(demo)
    )
    for name in names:
        await demo.command(
            "node", "install", str(directory(demo, name) / "node.pem"), "--yes", quiet=True
        )


async def sign_grants(demo: DemoEnvironment) -> str:
    """Sign the grants; returns the id of the one that will be revoked."""
    sign = ("grant", "sign")
    always = (*passphrase(demo), "--for", "1d")
    publishes = [item for topic, _ in (POSE, SCAN, CAMERA) for item in ("--publish", topic)]
    await demo.command(*sign, "/robot", *publishes, *always)
    await demo.command(*sign, "/doctor", "--subscribe", POSE[0], "--subscribe", SCAN[0], *always)
    output = await demo.command(*sign, "/doctor", "--subscribe", CAMERA[0], *always)
    await demo.command(
        *sign, "/heating", "--subscribe", POSE[0], "--type", POSE[1],
        "--round", f"pose.position={COARSE:g}",
        "--clear", "pose.orientation", "--clear", "header.frame_id", *always,
    )  # fmt: skip
    return output.split()[1]


async def start(demo: DemoEnvironment) -> tuple[DemoProcess, DemoProcess, DemoProcess, int]:
    """Start all processes; returns robot, doctor, heating, and the robot's topic port."""
    master = await demo.start("rossec", "master", "--port", "0", "--json", name="master")
    ready = await master.expect("starting", lambda report: "ready" in report)
    demo.set("ROS_MASTER_URI", ready["ready"])
    robot = await demo.start("rossec.demo.robot", name="robot")
    listening = await robot.expect("starting", lambda report: "tcpros" in report)
    everything = ["=".join(item) for item in (POSE, SCAN, CAMERA)]
    subscriber = "rossec.demo.subscriber"
    doctor = await demo.start(subscriber, "/doctor", *everything, name="doctor")
    heating = await demo.start(subscriber, "/heating", "=".join(POSE), name="heating")
    demo.printer.print(f"master at {ready['ready']}, robot at {listening['ready']}")
    for topic, _ in (POSE, SCAN, CAMERA):
        await doctor.expect(f"{topic} arriving", on_topic(topic))
    await heating.expect(f"{POSE[0]} arriving", on_topic(POSE[0]))
    return robot, doctor, heating, int(listening["tcpros"])


async def compare(demo: DemoEnvironment, doctor: DemoProcess, heating: DemoProcess) -> None:
    """The same message, side by side, as each of the two received it."""
    for _ in range(3):
        coarse = await heating.expect("a pose", on_topic(POSE[0]), after=len(heating.reports))
        exact = await doctor.expect("the same pose", partial(same_message, coarse))
        _check_coarse(exact, coarse)
        demo.printer.print(f"message {coarse['seq']}:")
        demo.printer.print(f"  doctor   {_describe(exact)}")
        demo.printer.print(f"  heating  {_describe(coarse)}")
    image, scan = doctor.about(CAMERA[0])[-1], doctor.about(SCAN[0])[-1]
    demo.printer.print(
        f"the doctor also sees {scan['ranges']} laser rays and images of {image['bytes']} bytes"
    )


async def connect_intruder(demo: DemoEnvironment, port: int) -> None:
    """The intruder has the doctor's name, certified by an authority of its own."""
    other = DemoEnvironment(demo.root / "intruder", demo.printer, {}, demo.run)
    other.root.mkdir(mode=0o700)
    create(other.root / "passphrase", secrets.token_urlsafe(18).encode())
    quiet = {"quiet": True}
    await other.command("ca", "init", "home", *passphrase(other), **quiet)
    await other.command("node", "request", "/doctor", "--domain", "home", **quiet)
    await other.command(
        "ca", "sign", _request_of(other)("/doctor"), "--yes", *passphrase(other), **quiet
    )
    await other.command(
        "node", "install", str(directory(other, "/doctor") / "node.pem"), "--yes", **quiet
    )
    try:
        intruder = await other.start("rossec.demo.intruder", "/doctor", str(port), name="intruder")
        answer = await intruder.expect("an answer", bool)
    finally:
        await other.stop_all()
    if "refused" not in answer:
        raise DemoFailed(f"the intruder was not refused: {answer}")
    demo.printer.print(
        f"the robot closes the connection; the peer learns only: {answer['refused']}"
    )


async def revoke(demo: DemoEnvironment, doctor: DemoProcess, grant: str) -> None:
    """Revoke while images arrive, and measure when the last one came."""
    await doctor.expect("an image", on_topic(CAMERA[0]), after=len(doctor.reports))
    given = time.time()
    await demo.command("grant", "revoke", grant, "--reason", "the visit is over", *passphrase(demo))
    finished = time.time()
    before = len(doctor.about(POSE[0]))
    await asyncio.sleep(_SILENCE)
    last = doctor.about(CAMERA[0])[-1]["at"]
    if last > finished + 1:
        raise DemoFailed(f"an image arrived {last - finished:.2f} s after the revocation")
    if len(doctor.about(POSE[0])) <= before:
        raise DemoFailed("the pose stopped as well, though its grant was not revoked")
    demo.printer.print(
        f"last image {1000 * (last - given):.0f} ms after the command was given"
        f" (it took {1000 * (finished - given):.0f} ms in all, most to unlock the authority's key)"
    )
    demo.printer.print("poses and laser scans continue: they have another grant")


def passphrase(demo: DemoEnvironment) -> tuple[str, str]:
    """The option with the file that has it."""
    return "--passphrase-file", str(demo.root / "passphrase")


def directory(demo: DemoEnvironment, name: str) -> Path:
    """Of a node."""
    return NodeHome.of(demo.root, name).path


def _request_of(demo: DemoEnvironment) -> Callable[[str], str]:
    return lambda name: str(directory(demo, name) / "node.csr")


def on_topic(topic: str) -> Callable[[Report], bool]:
    """Whether a report is about a message of this topic."""
    return lambda report: report.get("topic") == topic


def same_message(one: Report, other: Report) -> bool:
    """Whether two reports are about one message."""
    return (one["topic"], one["seq"]) == (other.get("topic"), other.get("seq"))


def _check_coarse(exact: Report, coarse: Report) -> None:
    """Raise unless `coarse` is `exact` on a grid of COARSE metres, without its frame."""
    wanted = [math.floor(value / COARSE + 0.5) * COARSE for value in exact["position"]]
    if any(abs(a - b) > _TOLERANCE for a, b in zip(wanted, coarse["position"], strict=True)):
        raise DemoFailed(f"the heating saw {coarse['position']}, expected {wanted}")
    if coarse["frame"] or exact["frame"] != FRAME:
        raise DemoFailed("the frame was not cleared for the heating, or was for the doctor")


def _describe(report: Report) -> str:
    x, y = report["position"]
    return f"position ({x:8.4f}, {y:8.4f})  frame {report['frame']!r}"
