"""What a person can try at the console of the demo: a question to answer, a node to add.

A lamp asks to see where the robot is, and a fridge on another computer (a directory of its own)
waits with its code. Both are real: the answer is signed, and the fridge is enrolled.
"""

from typing import Final, NamedTuple

from rossec.demo.environment import DemoEnvironment, DemoFailed
from rossec.demo.robot import CAMERA, POSE, SCAN
from rossec.demo.steps import directory, passphrase
from rossec.files import create

LAMP: Final = "/lamp"
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
  {LAMP}: the lamp in the hall
  {FRIDGE}: the fridge
  {POSE[0]}: where the robot is
  {SCAN[0]}: what the laser meets
  {CAMERA[0]}: what the camera sees
rules: []
"""


class WaitingNode(NamedTuple):
    """A node that waits to be added: the text of its code, and where it lives."""

    code: str
    environment: DemoEnvironment


async def ask(demo: DemoEnvironment) -> None:
    """A lamp is enrolled, and asks."""
    create(demo.root / "ca" / "policy.yaml", POLICY.encode())
    await demo.command("node", "request", LAMP, "--domain", "home", quiet=True)
    request, answer = (str(directory(demo, LAMP) / f"node.{end}") for end in ("csr", "pem"))
    await demo.command("ca", "sign", request, "--yes", *passphrase(demo), quiet=True)
    await demo.command("node", "install", answer, "--yes", quiet=True)
    await demo.command("grant", "request", LAMP, "--subscribe", POSE[0], "--why", WHY, quiet=True)


async def show_code(demo: DemoEnvironment) -> WaitingNode:
    """Start a node that shows its code; the caller stops its environment.

    Raises:
        DemoFailed: it does not.
    """
    other = DemoEnvironment(demo.root / "fridge", demo.printer, {"ROS_IP": "127.0.0.1"}, demo.run)
    other.root.mkdir(mode=0o700)
    node = await other.start(
        "rossec", "node", "enroll", FRIDGE, "--address", "127.0.0.1", "--json", name="fridge"
    )
    try:
        return WaitingNode(await node.logged(r"^ROSSEC:.*\S"), other)
    except DemoFailed:
        await other.stop_all()
        raise
