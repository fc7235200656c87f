"""The demos, step by step: `rossec demo`, `rossec border --demo`, `rossec console --demo`.

Each step does the real thing through the command line and real processes, and checks what it claims; a
claim that does not hold ends the demo with an error.
"""

import asyncio
import math
import secrets
import socket
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from rossec import clock, files
from rossec.demo.environment import DemoEnvironment, DemoFailed, DemoProcess, Report
from rossec.demo.robot import CAMERA, FRAME, POSE, SCAN
from rossec.home import NodeHome

COARSE: Final = 2.0
NODES: Final = ("/master", "/robot", "/doctor", "/heating")
_TOLERANCE: Final = 1e-9
# Seconds to wait for images after the revocation.
_SILENCE: Final = 1.5
LAMP: Final = "/things/lamp"
TEMPERATURE: Final = (f"{LAMP}/temperature", "sensor_msgs/Temperature")
LIGHT: Final = (f"{LAMP}/light", "std_msgs/Bool")
STEP: Final = 5.0  # degrees that the heating sees
BORDER_NODES: Final = ("/master", "/border", "/doctor", "/heating")
_THING: Final = "rossec.demo.thing"
_EVERY: Final = 2  # seconds between two registrations of the lamp
_BORDER_STEPS_SILENCE: Final = 3.5  # seconds after the revocation; the lamp measures once a second
TRIED_LAMP: Final = "/lamp"
FRIDGE: Final = "/fridge"
WHY: Final = "to light the room that the robot is in"
POLICY: Final = f"""\
# Whatever a node asks for waits for a person. What was granted before is by hand, and stays.
rossec: 1
robot: the robot at home
defaults: {{decision: prompt, prompt_timeout: 8h, lifetime: 7d}}
types: {{{", ".join(f"{topic}: {kind}" for topic, kind in (POSE, SCAN, CAMERA))}}}
title:
  /robot: the robot
  /doctor: Dr. Meier
  /heating: the heating
  {TRIED_LAMP}: the lamp in the hall
  {FRIDGE}: the fridge
  {POSE[0]}: where the robot is
  {SCAN[0]}: what the laser meets
  {CAMERA[0]}: what the camera sees
rules: []
"""
START = 60.0  # seconds for the console on a busy machine


async def run_steps(demo: DemoEnvironment) -> None:
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


async def found_authority(demo: DemoEnvironment, *, quiet: bool = False) -> None:
    files.create(demo.root / "passphrase", secrets.token_urlsafe(18).encode())
    await demo.command("ca", "init", "home", *passphrase(demo), quiet=quiet)


def passphrase(demo: DemoEnvironment) -> tuple[str, str]:
    return "--passphrase-file", str(demo.root / "passphrase")


async def enroll(demo: DemoEnvironment, names: Sequence[str] = NODES, shown: str = "/robot") -> None:
    codes = []
    for name in names:
        await demo.command("node", "request", name, "--domain", "home", quiet=True)
        text = await demo.command("node", "code", name, "--text", quiet=True)
        codes.append(text.strip())
    demo.printer.print(f"this is what {shown} shows to the camera of the phone:")
    await demo.command("node", "code", shown)
    scanned = [item for code in codes for item in ("--code", code)]
    requests = [str(directory(demo, name) / "node.csr") for name in names]
    await demo.command("ca", "sign", *requests, *scanned, "--yes", *passphrase(demo))
    for name in names:
        await demo.command("node", "install", str(directory(demo, name) / "node.pem"), "--yes", quiet=True)


def directory(demo: DemoEnvironment, name: str) -> Path:
    return NodeHome.of(demo.root, name).path


async def sign_grants(demo: DemoEnvironment) -> str:
    sign = ("grant", "sign")
    always = (*passphrase(demo), "--for", "1d")
    publishes = [item for topic, _ in (POSE, SCAN, CAMERA) for item in ("--publish", topic)]
    await demo.command(*sign, "/robot", *publishes, *always)
    await demo.command(*sign, "/doctor", "--subscribe", POSE[0], "--subscribe", SCAN[0], *always)
    output = await demo.command(*sign, "/doctor", "--subscribe", CAMERA[0], *always)
    sees = ("--subscribe", POSE[0], "--type", POSE[1], "--round", f"pose.position={COARSE:g}")
    hidden = ("--clear", "pose.orientation", "--clear", "header.frame_id")
    await demo.command(*sign, "/heating", *sees, *hidden, *always)
    return output.split()[1]


async def start_master(demo: DemoEnvironment) -> str:
    master = await demo.start("rossec", "master", "--port", "0", "--json", name="master")
    ready = await master.expect("starting", lambda report: "ready" in report)
    demo.set("ROS_MASTER_URI", ready["ready"])
    return str(ready["ready"])


async def start(demo: DemoEnvironment) -> tuple[DemoProcess, DemoProcess, DemoProcess, int]:
    uri = await start_master(demo)
    robot = await demo.start("rossec.demo.robot", name="robot")
    listening = await robot.expect("starting", lambda report: "tcpros" in report)
    everything = ["=".join(item) for item in (POSE, SCAN, CAMERA)]
    subscriber = "rossec.demo.subscriber"
    doctor = await demo.start(subscriber, "/doctor", *everything, name="doctor")
    heating = await demo.start(subscriber, "/heating", "=".join(POSE), name="heating")
    demo.printer.print(f"master at {uri}, robot at {listening['ready']}")
    for topic, _ in (POSE, SCAN, CAMERA):
        await doctor.expect(f"{topic} arriving", on_topic(topic))
    await heating.expect(f"{POSE[0]} arriving", on_topic(POSE[0]))
    return robot, doctor, heating, int(listening["tcpros"])


def on_topic(topic: str) -> Callable[[Report], bool]:
    return lambda report: report.get("topic") == topic


async def compare(demo: DemoEnvironment, doctor: DemoProcess, heating: DemoProcess) -> None:
    for _ in range(3):
        coarse = await heating.expect("a pose", on_topic(POSE[0]), after=len(heating.reports))
        exact = await doctor.expect("the same pose", partial(same_message, coarse))
        check_coarse(exact, coarse)
        demo.printer.print(f"message {coarse['seq']}:")
        demo.printer.print(f"  doctor   {_describe(exact)}")
        demo.printer.print(f"  heating  {_describe(coarse)}")
    image, scan = doctor.about(CAMERA[0])[-1], doctor.about(SCAN[0])[-1]
    sees = f"{scan['ranges']} laser rays and images of {image['bytes']} bytes"
    demo.printer.print(f"the doctor also sees {sees}")


def same_message(one: Report, other: Report) -> bool:
    return (one["topic"], one["seq"]) == (other.get("topic"), other.get("seq"))


def check_coarse(exact: Report, coarse: Report) -> None:
    wanted = [math.floor(value / COARSE + 0.5) * COARSE for value in exact["position"]]
    if any(abs(a - b) > _TOLERANCE for a, b in zip(wanted, coarse["position"], strict=True)):
        raise DemoFailed(f"the heating saw {coarse['position']}, expected {wanted}")
    if coarse["frame"] or exact["frame"] != FRAME:
        raise DemoFailed("the frame was not cleared for the heating, or was for the doctor")


def _describe(report: Report) -> str:
    x, y = report["position"]
    return f"position ({x:8.4f}, {y:8.4f})  frame {report['frame']!r}"


async def connect_intruder(demo: DemoEnvironment, port: int) -> None:
    # An authority of the same name, made by somebody else: only its key tells it from the home's.
    other = DemoEnvironment(demo.root / "intruder", demo.printer, {}, demo.run)
    other.root.mkdir(mode=0o700)
    await found_authority(other, quiet=True)
    doctor = directory(other, "/doctor")
    await other.command("node", "request", "/doctor", "--domain", "home", quiet=True)
    await other.command("ca", "sign", str(doctor / "node.csr"), "--yes", *passphrase(other), quiet=True)
    await other.command("node", "install", str(doctor / "node.pem"), "--yes", quiet=True)
    try:
        intruder = await other.start("rossec.demo.intruder", "/doctor", str(port), name="intruder")
        answer = await intruder.expect("an answer", bool)
    finally:
        await other.stop_all()
    if "refused" not in answer:
        raise DemoFailed(f"the intruder was not refused: {answer}")
    demo.printer.print(f"the robot closes the connection; the peer learns only: {answer['refused']}")


async def revoke(demo: DemoEnvironment, doctor: DemoProcess, grant: str) -> None:
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


async def run_border_steps(demo: DemoEnvironment) -> None:
    with demo.printer.step("a home with an authority, a border router and two receivers"):
        await found_authority(demo)
        await enroll(demo, BORDER_NODES, "/border")
    with demo.printer.step("a lamp makes its key; the authority says which node it is, and where"):
        things = await add_lamp(demo)
    with demo.printer.step("the person who lives there decides who may see what"):
        await sign_border_grants(demo)
    with demo.printer.step("master, border router, lamp and receivers start"):
        lamp, doctor, heating = await start_border(demo, things)
    with demo.printer.step("both receive the same temperature, and do not see the same"):
        await compare_lamp(demo, doctor, heating)
    with demo.printer.step("the doctor switches the light"):
        await switch(demo, lamp)
    with demo.printer.step("the lamp is revoked"):
        await revoke_lamp(demo, doctor)


async def add_lamp(demo: DemoEnvironment) -> Path:
    things = demo.root / "lamp"
    things.mkdir(mode=0o700)
    await demo.command("border", "credential", str(things / "border.ccs"))
    made = await demo.start(_THING, str(things), "lamp", name="key")
    await made.wait()
    ccs = str(things / "lamp.ccs")
    await demo.command("border", "add", LAMP, "--key", ccs)
    stated = ("--border", "/border", "--key", ccs, "--yes")
    request = ("--request", str(directory(demo, LAMP) / "node.csr"), "--out", str(things / "lamp.thing"))
    await demo.command("ca", "thing", LAMP, *stated, *request, *passphrase(demo))
    return things


async def sign_border_grants(demo: DemoEnvironment) -> None:
    sign, always = ("grant", "sign"), (*passphrase(demo), "--for", "1d")
    lamp = ("--publish", TEMPERATURE[0], "--subscribe", LIGHT[0])
    doctor = ("--subscribe", TEMPERATURE[0], "--publish", LIGHT[0])
    await demo.command(*sign, LAMP, *lamp, *always)
    await demo.command(*sign, "/doctor", *doctor, *always)
    sees = ("--subscribe", TEMPERATURE[0], "--type", TEMPERATURE[1], "--round", f"temperature={STEP:g}")
    await demo.command(*sign, "/heating", *sees, *always)


async def start_border(demo: DemoEnvironment, things: Path) -> tuple[DemoProcess, DemoProcess, DemoProcess]:
    uri = await start_master(demo)
    border = await demo.start("rossec", "border", "--listen", "::1", "--port", "0", "--json", name="border")
    listening = await border.expect("starting", lambda report: "ready" in report)
    topic = "=".join(TEMPERATURE)
    subscriber = "rossec.demo.subscriber"
    doctor = await demo.start(subscriber, "/doctor", topic, name="doctor")
    heating = await demo.start(subscriber, "/heating", topic, name="heating")
    host = f"[::1]:{listening['ready'][1]}"
    lamp = await demo.start(_THING, str(things), "lamp", host, "border.ccs", str(_EVERY), name="lamp")
    await lamp.expect("registering", _said("registered"))
    demo.printer.print(f"master at {uri}, border router at coap://{host}")
    for receiver in (doctor, heating):
        await receiver.expect("a temperature", on_topic(TEMPERATURE[0]))
    return lamp, doctor, heating


def _said(line: str) -> Callable[[Report], bool]:
    return lambda report: report.get("said") == line


async def compare_lamp(demo: DemoEnvironment, doctor: DemoProcess, heating: DemoProcess) -> None:
    for _ in range(2):
        coarse = await heating.expect("a temperature", on_topic(TEMPERATURE[0]), after=len(heating.reports))
        exact = await doctor.expect("the same temperature", partial(same_message, coarse))
        check_coarse_lamp(exact, coarse)
        demo.printer.print(f"doctor {exact['temperature']:.4f} degrees, heating {coarse['temperature']:.1f}")


def check_coarse_lamp(exact: Report, coarse: Report) -> None:
    wanted = math.floor(exact["temperature"] / STEP + 0.5) * STEP
    if coarse["temperature"] != wanted or exact["temperature"] == wanted:
        raise DemoFailed(f"the heating saw {coarse['temperature']}, expected {wanted}")


async def switch(demo: DemoEnvironment, lamp: DemoProcess) -> None:
    await demo.command("topic", "pub", *LIGHT, "{data: true}", "--as", "/doctor", "--count", "3", quiet=True)
    await lamp.expect("light", _said("the light is on"))
    demo.printer.print("the lamp says: the light is on")


async def revoke_lamp(demo: DemoEnvironment, doctor: DemoProcess) -> None:
    await doctor.expect("a temperature", on_topic(TEMPERATURE[0]), after=len(doctor.reports))
    given = clock.time()
    await demo.command("ca", "revoke", "--thing", LAMP, "--reason", "lost", *passphrase(demo))
    finished = clock.time()
    await asyncio.sleep(_BORDER_STEPS_SILENCE)
    last = doctor.about(TEMPERATURE[0])[-1]["at"]
    if last > finished + 1:
        raise DemoFailed(f"a temperature arrived {last - finished:.2f} s after the revocation")
    demo.printer.print(
        f"the last temperature came {1000 * (given - last):.0f} ms before the command was given"
        if last < given
        else f"last temperature {1000 * (last - given):.0f} ms after the command was given"
    )


class EnrollingNode(NamedTuple):
    code: str
    environment: DemoEnvironment


async def show_code(demo: DemoEnvironment) -> EnrollingNode:
    # The caller stops its environment.
    other = DemoEnvironment(demo.root / "fridge", demo.printer, {"ROS_IP": "127.0.0.1"}, demo.run)
    other.root.mkdir(mode=0o700)
    node = await other.start(
        "rossec", "node", "enroll", FRIDGE, "--address", "127.0.0.1", "--json", name="fridge"
    )
    try:
        return EnrollingNode(await node.logged(r"^ROSSEC:.*\S"), other)
    except DemoFailed:
        await other.stop_all()
        raise


async def begin_story(demo: DemoEnvironment, port: int) -> str:
    """Set everything up in `demo`, whose directory is empty; returns the link to log in by.

    The caller stops the processes; `port` is the console's.
    """
    with demo.printer.step("the home gets its own authority"):
        await found_authority(demo)
    with demo.printer.step("master, robot and two receivers are enrolled by their QR codes"):
        await enroll(demo)
    with demo.printer.step("the person who lives there decides who may see what"):
        camera = await sign_grants(demo)
    with demo.printer.step("they start, each its own process"):
        _, doctor, _, _ = await start(demo)
    with demo.printer.step("the doctor's view of the camera is revoked"):
        await revoke(demo, doctor, camera)
    with demo.printer.step("a lamp asks to see where the robot is, and waits for an answer"):
        await ask(demo)
    with demo.printer.step("the authority's service starts, then the console"):
        with socket.create_server(("127.0.0.1", 0)) as sock:  # a free port, to name it
            where = ("--join-address", f"127.0.0.1:{sock.getsockname()[1]}")
        serve = ("ca", "serve", "--json", "--unlock-for", "0")
        service = await demo.start("rossec", *serve, *where, *passphrase(demo), name="authority")
        await service.expect("starting", lambda report: "ready" in report, within=START)
        console = await demo.start("rossec", "console", "--json", "--port", str(port), name="console")
        ready = await console.expect("starting", lambda report: "ready" in report, within=START)
        return str(ready["login"])


async def ask(demo: DemoEnvironment) -> None:
    files.create(demo.root / "ca" / "policy.yaml", POLICY.encode())
    await demo.command("node", "request", TRIED_LAMP, "--domain", "home", quiet=True)
    request, answer = (str(directory(demo, TRIED_LAMP) / f"node.{end}") for end in ("csr", "pem"))
    await demo.command("ca", "sign", request, "--yes", *passphrase(demo), quiet=True)
    await demo.command("node", "install", answer, "--yes", quiet=True)
    await demo.command("grant", "request", TRIED_LAMP, "--subscribe", POSE[0], "--why", WHY, quiet=True)
