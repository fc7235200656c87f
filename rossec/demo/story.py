"""The demo, step by step: from an authority to a filtered, encrypted, revoked topic.

Each step does the real thing through the command line and real processes, and checks what it
claims; a claim that does not hold ends the demo with an error.
"""

import asyncio
import math
import secrets
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from rossec.demo.robot import CAMERA, FRAME, POSE, SCAN
from rossec.demo.stage import Actor, DemoFailed, Report, Stage
from rossec.files import create
from rossec.home import NodeHome

COARSE: Final = 2.0
NODES: Final = ("/master", "/robot", "/doctor", "/heating")
_TOLERANCE: Final = 1e-9
# How long the revoked camera is listened to after its last image.
_SILENCE: Final = 1.5


async def tell(stage: Stage) -> None:
    """Play the whole story on `stage`, an empty directory.

    Raises:
        DemoFailed: a step did not do what it says.
    """
    with stage.narrator.step("the home gets its own authority"):
        await found_authority(stage)
    with stage.narrator.step("four nodes make their keys and are enrolled by their QR codes"):
        await enroll(stage)
    with stage.narrator.step("the person who lives there decides who may see what"):
        camera = await sign_grants(stage)
    with stage.narrator.step("master, robot and the two receivers start, each its own process"):
        robot, doctor, heating, door = await start(stage)
    with stage.narrator.step("both receive the same messages, and do not see the same"):
        await compare(stage, doctor, heating)
    with stage.narrator.step("a stranger with a certificate of its own authority knocks"):
        await knock(stage, door)
    with stage.narrator.step("the doctor's view of the camera is revoked"):
        await revoke(stage, doctor, camera)
    if robot.ended:
        raise DemoFailed("the robot did not survive the demo")


async def found_authority(stage: Stage) -> None:
    """A passphrase in a file stands for the one a person would type."""
    create(stage.root / "passphrase", secrets.token_urlsafe(18).encode())
    await stage.command("ca", "init", "home", *_passphrase(stage))


async def enroll(stage: Stage) -> None:
    """Each key stays in its node's directory; the request travels, and its code vouches for it."""
    codes = []
    for name in NODES:
        await stage.command("node", "request", name, "--domain", "home", quiet=True)
        text = await stage.command("node", "code", name, "--text", quiet=True)
        codes.append(text.strip())
    stage.narrator.tell("this is what the robot shows to the camera of the phone:")
    await stage.command("node", "code", "/robot")
    scanned = [item for code in codes for item in ("--code", code)]
    await stage.command(
        "ca", "sign", *map(_request_of(stage), NODES), *scanned, "--yes", *_passphrase(stage)
    )
    for name in NODES:
        await stage.command(
            "node", "install", str(_directory(stage, name) / "node.pem"), "--yes", quiet=True
        )


async def sign_grants(stage: Stage) -> str:
    """Three plain decisions; returns the id of the grant that will be revoked."""
    sign = ("grant", "sign")
    always = (*_passphrase(stage), "--for", "1d")
    publishes = [item for topic, _ in (POSE, SCAN, CAMERA) for item in ("--publish", topic)]
    await stage.command(*sign, "/robot", *publishes, *always)
    await stage.command(*sign, "/doctor", "--subscribe", POSE[0], "--subscribe", SCAN[0], *always)
    told = await stage.command(*sign, "/doctor", "--subscribe", CAMERA[0], *always)
    await stage.command(
        *sign, "/heating", "--subscribe", POSE[0], "--type", POSE[1],
        "--round", f"pose.position={COARSE:g}",
        "--clear", "pose.orientation", "--clear", "header.frame_id",
        "--when", f'msg.header.frame_id == "{FRAME}"', *always,
    )  # fmt: skip
    return told.split()[1]


async def start(stage: Stage) -> tuple[Actor, Actor, Actor, int]:
    """Bring everything up; returns robot, doctor, heating, and the robot's topic port."""
    master = await stage.actor("rossec", "master", "--port", "0", "--json", name="master")
    ready = await master.expect("starting", lambda report: "ready" in report)
    stage.set("ROS_MASTER_URI", ready["ready"])
    robot = await stage.actor("rossec.demo.robot", name="robot")
    door = await robot.expect("starting", lambda report: "tcpros" in report)
    everything = ["=".join(item) for item in (POSE, SCAN, CAMERA)]
    watcher = "rossec.demo.watcher"
    doctor = await stage.actor(watcher, "/doctor", *everything, name="doctor")
    heating = await stage.actor(watcher, "/heating", "=".join(POSE), name="heating")
    stage.narrator.tell(f"master at {ready['ready']}, robot at {door['ready']}")
    for topic, _ in (POSE, SCAN, CAMERA):
        await doctor.expect(f"{topic} arriving", _on(topic))
    await heating.expect(f"{POSE[0]} arriving", _on(POSE[0]))
    return robot, doctor, heating, int(door["tcpros"])


async def compare(stage: Stage, doctor: Actor, heating: Actor) -> None:
    """The same message, side by side, as each of the two got it."""
    for _ in range(3):
        coarse = await heating.expect("a pose", _on(POSE[0]), after=len(heating.reports))
        exact = await doctor.expect("the same pose", partial(_same, coarse))
        _check_coarse(exact, coarse)
        stage.narrator.tell(f"message {coarse['seq']}:")
        stage.narrator.tell(f"  doctor   {_describe(exact)}")
        stage.narrator.tell(f"  heating  {_describe(coarse)}")
    image, scan = doctor.about(CAMERA[0])[-1], doctor.about(SCAN[0])[-1]
    stage.narrator.tell(
        f"the doctor also sees {scan['ranges']} laser rays and images of {image['bytes']} bytes"
    )


async def knock(stage: Stage, door: int) -> None:
    """The stranger takes the doctor's very name, certified by an authority of its own."""
    other = Stage(stage.root / "stranger", stage.narrator, {}, stage.run)
    other.root.mkdir(mode=0o700)
    create(other.root / "passphrase", secrets.token_urlsafe(18).encode())
    quiet = {"quiet": True}
    await other.command("ca", "init", "home", *_passphrase(other), **quiet)
    await other.command("node", "request", "/doctor", "--domain", "home", **quiet)
    await other.command(
        "ca", "sign", _request_of(other)("/doctor"), "--yes", *_passphrase(other), **quiet
    )
    await other.command(
        "node", "install", str(_directory(other, "/doctor") / "node.pem"), "--yes", **quiet
    )
    try:
        stranger = await other.actor("rossec.demo.stranger", "/doctor", str(door), name="stranger")
        answer = await stranger.expect("an answer", bool)
    finally:
        await other.clear()
    if "refused" not in answer:
        raise DemoFailed(f"the stranger was not refused: {answer}")
    stage.narrator.tell(f"the robot hangs up; all the stranger learns: {answer['refused']}")


async def revoke(stage: Stage, doctor: Actor, grant: str) -> None:
    """Revoke while images arrive, and measure when the last one came."""
    await doctor.expect("an image", _on(CAMERA[0]), after=len(doctor.reports))
    given = time.time()
    await stage.command(
        "grant", "revoke", grant, "--reason", "the visit is over", *_passphrase(stage)
    )
    finished = time.time()
    before = len(doctor.about(POSE[0]))
    await asyncio.sleep(_SILENCE)
    last = doctor.about(CAMERA[0])[-1]["at"]
    if last > finished + 1:
        raise DemoFailed(f"an image arrived {last - finished:.2f} s after the revocation")
    if len(doctor.about(POSE[0])) <= before:
        raise DemoFailed("the pose stopped as well, though its grant was not revoked")
    stage.narrator.tell(
        f"last image {1000 * (last - given):.0f} ms after the command was given"
        f" (it took {1000 * (finished - given):.0f} ms in all, most to unlock the authority's key)"
    )
    stage.narrator.tell("poses and laser scans go on: their grant is another one")


def _passphrase(stage: Stage) -> tuple[str, str]:
    return "--passphrase-file", str(stage.root / "passphrase")


def _directory(stage: Stage, name: str) -> Path:
    return NodeHome.of(stage.root, name).path


def _request_of(stage: Stage) -> Callable[[str], str]:
    return lambda name: str(_directory(stage, name) / "node.csr")


def _on(topic: str) -> Callable[[Report], bool]:
    return lambda report: report.get("topic") == topic


def _same(one: Report, other: Report) -> bool:
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
