"""The demo of a border router, step by step: `rossec border --demo`.

A lamp with a thermometer speaks CoAP with EDHOC and OSCORE, a doctor and a heating see what their
grants say, and at the end the lamp is revoked. Each step does the real thing and checks it.
"""

import asyncio
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from rossec import clock
from rossec.demo.environment import DemoEnvironment, DemoFailed, DemoProcess, Report
from rossec.demo.steps import directory, enroll, found_authority, on_topic, passphrase, same_message

LAMP: Final = "/things/lamp"
TEMPERATURE: Final = (f"{LAMP}/temperature", "sensor_msgs/Temperature")
LIGHT: Final = (f"{LAMP}/light", "std_msgs/Bool")
STEP: Final = 5.0  # degrees that the heating sees
NODES: Final = ("/master", "/border", "/doctor", "/heating")
_THING: Final = "rossec.demo.thing"
_EVERY: Final = 2  # seconds between two registrations of the lamp
_SILENCE: Final = 3.5  # seconds after the revocation; the lamp measures once a second


async def run_border_steps(demo: DemoEnvironment) -> None:
    """Run every step in `demo`, whose directory is empty.

    Raises:
        DemoFailed: a step did not do what it says.
    """
    with demo.printer.step("a home with an authority, a border router and two receivers"):
        await found_authority(demo)
        await enroll(demo, NODES, "/border")
    with demo.printer.step("a lamp makes its key; the authority says which node it is, and where"):
        things = await add_lamp(demo)
    with demo.printer.step("the person who lives there decides who may see what"):
        await sign_grants(demo)
    with demo.printer.step("master, border router, lamp and receivers start"):
        lamp, doctor, heating = await start(demo, things)
    with demo.printer.step("both receive the same temperature, and do not see the same"):
        await compare(demo, doctor, heating)
    with demo.printer.step("the doctor switches the light"):
        await switch(demo, lamp)
    with demo.printer.step("the lamp is revoked"):
        await revoke(demo, doctor)


async def add_lamp(demo: DemoEnvironment) -> Path:
    """Returns the directory of the lamp, where its key is."""
    things = demo.root / "lamp"
    things.mkdir(mode=0o700)
    await demo.command("border", "credential", str(things / "border.ccs"))
    made = await demo.start(_THING, str(things), "lamp", name="key")
    await made.wait()
    ccs = str(things / "lamp.ccs")
    await demo.command("border", "add", LAMP, "--key", ccs)
    await demo.command(
        "ca", "thing", LAMP, "--border", "/border", "--key", ccs, "--yes",
        "--request", str(directory(demo, LAMP) / "node.csr"),
        "--out", str(things / "lamp.thing"), *passphrase(demo),
    )  # fmt: skip
    return things


async def sign_grants(demo: DemoEnvironment) -> None:
    """The heating sees steps of five degrees."""
    sign, always = ("grant", "sign"), (*passphrase(demo), "--for", "1d")
    lamp = ("--publish", TEMPERATURE[0], "--subscribe", LIGHT[0])
    doctor = ("--subscribe", TEMPERATURE[0], "--publish", LIGHT[0])
    await demo.command(*sign, LAMP, *lamp, *always)
    await demo.command(*sign, "/doctor", *doctor, *always)
    await demo.command(
        *sign, "/heating", "--subscribe", TEMPERATURE[0], "--type", TEMPERATURE[1],
        "--round", f"temperature={STEP:g}", *always,
    )  # fmt: skip


async def start(
    demo: DemoEnvironment, things: Path
) -> tuple[DemoProcess, DemoProcess, DemoProcess]:
    """Start all processes; returns lamp, doctor and heating."""
    master = await demo.start("rossec", "master", "--port", "0", "--json", name="master")
    ready = await master.expect("starting", lambda report: "ready" in report)
    demo.set("ROS_MASTER_URI", ready["ready"])
    border = await demo.start(
        "rossec", "border", "--listen", "::1", "--port", "0", "--json", name="border"
    )
    listening = await border.expect("starting", lambda report: "ready" in report)
    topic = "=".join(TEMPERATURE)
    subscriber = "rossec.demo.subscriber"
    doctor = await demo.start(subscriber, "/doctor", topic, name="doctor")
    heating = await demo.start(subscriber, "/heating", topic, name="heating")
    host = f"[::1]:{listening['ready'][1]}"
    lamp = await demo.start(
        _THING, str(things), "lamp", host, "border.ccs", str(_EVERY), name="lamp"
    )
    await lamp.expect("registering", _said("registered"))
    demo.printer.print(f"master at {ready['ready']}, border router at coap://{host}")
    for receiver in (doctor, heating):
        await receiver.expect("a temperature", on_topic(TEMPERATURE[0]))
    return lamp, doctor, heating


async def compare(demo: DemoEnvironment, doctor: DemoProcess, heating: DemoProcess) -> None:
    """The same measurement, side by side, as each of the two received it."""
    for _ in range(2):
        coarse = await heating.expect(
            "a temperature", on_topic(TEMPERATURE[0]), after=len(heating.reports)
        )
        exact = await doctor.expect("the same temperature", partial(same_message, coarse))
        check_coarse(exact, coarse)
        demo.printer.print(
            f"doctor {exact['temperature']:.4f} degrees, heating {coarse['temperature']:.1f}"
        )


def check_coarse(exact: Report, coarse: Report) -> None:
    """Raise `DemoFailed` unless `coarse` is `exact` in steps of five degrees."""
    wanted = math.floor(exact["temperature"] / STEP + 0.5) * STEP
    if coarse["temperature"] != wanted or exact["temperature"] == wanted:
        raise DemoFailed(f"the heating saw {coarse['temperature']}, expected {wanted}")


async def switch(demo: DemoEnvironment, lamp: DemoProcess) -> None:
    """One message of the doctor; the lamp says what it does."""
    await demo.command(
        "topic", "pub", *LIGHT, "{data: true}", "--as", "/doctor", "--count", "3", quiet=True
    )
    await lamp.expect("light", _said("the light is on"))
    demo.printer.print("the lamp says: the light is on")


async def revoke(demo: DemoEnvironment, doctor: DemoProcess) -> None:
    """Revoke while temperatures arrive, and measure when the last one came."""
    await doctor.expect("a temperature", on_topic(TEMPERATURE[0]), after=len(doctor.reports))
    given = clock.time()
    await demo.command("ca", "revoke", "--thing", LAMP, "--reason", "lost", *passphrase(demo))
    finished = clock.time()
    await asyncio.sleep(_SILENCE)
    last = doctor.about(TEMPERATURE[0])[-1]["at"]
    if last > finished + 1:
        raise DemoFailed(f"a temperature arrived {last - finished:.2f} s after the revocation")
    demo.printer.print(
        f"the last temperature came {1000 * (given - last):.0f} ms before the command was given"
        if last < given
        else f"last temperature {1000 * (last - given):.0f} ms after the command was given"
    )


def _said(line: str) -> Callable[[Report], bool]:
    return lambda report: report.get("said") == line
