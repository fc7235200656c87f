"""`rossec demo`: the main job, end to end, with real processes."""

import asyncio
import sys
import tempfile
from functools import partial
from pathlib import Path

import click

from rossec.cli.shared import invocation
from rossec.demo import steps
from rossec.demo.environment import DemoEnvironment, Run, StepPrinter
from rossec.errors import ConfigurationError
from rossec.terminal import say_block


@click.command()
@click.option(
    "--keep", type=click.Path(path_type=Path), help="new directory to leave everything in"
)
@click.pass_context
def demo(context: click.Context, keep: Path | None) -> None:
    """Show the main job: enroll, grant, filter, refuse, revoke. Needs no ROS, ends by itself."""
    run = partial(invocation.run, context.find_root().command)
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
            asyncio.run(_run(Path(directory), run))
        say_block(_LOOK)
        return
    try:
        keep.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        raise ConfigurationError(f"{keep} exists", "give a directory that does not exist") from None
    asyncio.run(_run(keep.resolve(), run))
    say_block(_CONTINUE.format(directory=keep.resolve(), programs=Path(sys.executable).parent))


async def _run(directory: Path, run: Run) -> None:
    printer = StepPrinter(sys.stdout.write)
    environment = DemoEnvironment(directory, printer, {"ROS_IP": "127.0.0.1"}, run)
    try:
        await steps.run_steps(environment)
    finally:
        await environment.stop_all()


_LOOK = "\nto look at such a home in a browser: rossec console --demo"

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
