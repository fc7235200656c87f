"""`rossec demo`, `rossec console --demo`, `rossec border --demo`: real processes, in a home of their own."""

import asyncio
import sys
import tempfile
from collections.abc import Awaitable, Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import click
from click.core import ParameterSource

from ca.enrollment import qr
from rossec.cli.console import check_libraries
from rossec.cli.shared import context
from rossec.cli.shared.options import PATH, option
from rossec.console.listening import listen
from rossec.console.options import PORT, ConsoleOptions, read_options
from rossec.demo import steps
from rossec.demo.environment import DemoEnvironment, Run, StepPrinter
from rossec.demo.steps import FRIDGE, begin_story, show_code
from rossec.errors import ConfigurationError
from rossec.host.runner import stop_on_signals, until_first_ends
from rossec.terminal import say, say_block, say_picture

_CONTINUE = """
Everything is in {directory}. To continue, in three terminals:

    export ROSSEC_HOME={directory} ROS_IP=127.0.0.1 PATH="{programs}:$PATH"
    rossec master
    python -I -m rossec.demo.robot
    rossec topic echo /robot/pose geometry_msgs/PoseStamped --as /heating

The authority's passphrase is in {directory}/passphrase. Try

    rossec grant list
    rossec grant sign /heating --subscribe /robot/scan --passphrase-file {directory}/passphrase

To look at it in a browser, in two more terminals (pip install 'rossec[console]'):

    rossec ca serve --unlock-for 0 --passphrase-file {directory}/passphrase
    rossec console
"""
_LIBRARIES = ("aiocoap", "lakers")


@click.command()
@option("--keep", "new directory to leave everything in", type=PATH)
@click.pass_context
def demo(called: click.Context, keep: Path | None) -> None:
    """Show the main job: enroll, grant, filter, refuse, revoke. Needs no ROS, ends by itself."""
    run = partial(context.run, called.find_root().command)
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
            asyncio.run(_run(Path(directory), run, steps.run_steps))
        say_block("\nto look at such a home in a browser: rossec console --demo")
        return
    try:
        keep.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        raise ConfigurationError(f"{keep} exists", "give a directory that does not exist") from None
    asyncio.run(_run(keep.resolve(), run, steps.run_steps))
    say_block(_CONTINUE.format(directory=keep.resolve(), programs=Path(sys.executable).parent))


async def _run(directory: Path, run: Run, play: Callable[[DemoEnvironment], Awaitable[None]]) -> None:
    demo = DemoEnvironment(directory, StepPrinter(sys.stdout.write), {"ROS_IP": "127.0.0.1"}, run)
    try:
        await play(demo)
    finally:
        await demo.stop_all()


def show_console_demo(called: click.Context, options: ConsoleOptions) -> None:
    """Run the demo's home with a console until it is interrupted; nothing is left."""
    check_libraries()
    if options != ConsoleOptions(port=options.port):
        raise ConfigurationError("--demo is for localhost", "leave the other options, but --port")
    # Whether the port is free, before anything is made.
    for sock in listen(read_options(options, "localhost")):
        sock.close()
    run = partial(context.run, called.find_root().command)

    async def play(demo: DemoEnvironment) -> None:
        others: list[DemoEnvironment] = []
        try:
            await until_first_ends(_show(demo, options.port or PORT, others), stop_on_signals().wait())
        finally:
            for each in others:
                await each.stop_all()

    with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
        asyncio.run(_run(Path(directory), run, play))


async def _show(demo: DemoEnvironment, port: int, others: list[DemoEnvironment]) -> None:
    link = await begin_story(demo, port)
    waiting = await show_code(demo)
    others.append(waiting.environment)
    say_block(f"\nopen this in a browser of this computer, within 2 minutes:\n\n    {link}\n")
    say(f"a new code: ROSSEC_HOME={demo.root} rossec console phone")
    say(f"a question waits there; and {FRIDGE} to be added, by this code, within 5 minutes:")
    say_picture(qr.terminal(waiting.code))
    say(waiting.code)
    home = f"ROSSEC_HOME={waiting.environment.root}"
    say(f"when both show the same digits: {home} rossec node confirm {FRIDGE}")
    say(f"a new code of it: {home} rossec node enroll {FRIDGE} --address 127.0.0.1")
    say("Ctrl-C ends everything and leaves nothing")
    await demo.until_one_ends()


def show_border_demo(called: click.Context) -> None:
    """Show a lamp behind a border router; nothing is left."""
    if any(find_spec(name) is None for name in _LIBRARIES):
        raise ConfigurationError("CoAP for things is not installed", "pip install 'rossec[constrained]'")
    others = (name for name in called.params if name != "is_demo")
    if any(called.get_parameter_source(name) != ParameterSource.DEFAULT for name in others):
        raise ConfigurationError("--demo has a home of its own", "leave the other options out")
    run = partial(context.run, called.find_root().command)
    with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
        asyncio.run(_run(Path(directory), run, steps.run_border_steps))
