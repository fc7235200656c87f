"""`rossec console --demo`: the demo's home, running, with a console that shows it."""

import asyncio
import sys
import tempfile
from functools import partial
from pathlib import Path

import click

from ca.enrollment import qr
from rossec.cli.console.serve import check_libraries
from rossec.cli.shared import invocation
from rossec.console.listening import listen
from rossec.console.options import PORT, Options, read_options
from rossec.demo.environment import DemoEnvironment, Run, StepPrinter
from rossec.demo.story import begin_story
from rossec.demo.trying import FRIDGE, show_code
from rossec.errors import ConfigurationError
from rossec.operation.shutdown import stop_on_signals, until_first_ends
from rossec.terminal import say, say_block, say_picture


def show_demo(context: click.Context, options: Options) -> None:
    """Run the demo's home with a console until it is interrupted; nothing is left.

    Raises:
        ConfigurationError: a library is missing, or an option is not for it.
        DemoFailed: a step did not do what it says.
    """
    check_libraries()
    if options != Options(port=options.port):
        raise ConfigurationError("--demo is for localhost", "leave the other options, but --port")
    _check_port(options)
    run = partial(invocation.run, context.find_root().command)
    with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
        asyncio.run(_play(Path(directory), run, options.port or PORT))


def _check_port(options: Options) -> None:
    """Return if nobody listens there: before the story, which takes a while.

    Raises:
        ConfigurationError: another program does.
    """
    for sock in listen(read_options(options, "localhost")):
        sock.close()


async def _play(directory: Path, run: Run, port: int) -> None:
    stop = stop_on_signals()
    demo = DemoEnvironment(directory, StepPrinter(sys.stdout.write), {"ROS_IP": "127.0.0.1"}, run)
    others: list[DemoEnvironment] = []
    try:
        await until_first_ends(_show(demo, port, others), stop.wait())
    finally:
        for each in (*others, demo):
            await each.stop_all()


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
