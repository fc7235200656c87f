"""`rossec demo`: the main job, end to end, with real processes."""

import asyncio
import sys
import tempfile
from functools import partial
from pathlib import Path

import click

from rossec.cli.shared import invocation
from rossec.demo import story
from rossec.demo.stage import Narrator, Run, Stage
from rossec.errors import ConfigurationError
from rossec.terminal import say


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
            asyncio.run(_play(Path(directory), run))
        return
    try:
        keep.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        raise ConfigurationError(f"{keep} exists", "give a directory that does not exist") from None
    asyncio.run(_play(keep.resolve(), run))
    say(_GO_ON.format(directory=keep.resolve(), programs=Path(sys.executable).parent))


async def _play(directory: Path, run: Run) -> None:
    narrator = Narrator(sys.stdout.write)
    stage = Stage(directory, narrator, {"ROS_IP": "127.0.0.1"}, run)
    try:
        await story.tell(stage)
    finally:
        await stage.clear()


_GO_ON = """
Everything is in {directory}. To go on, in three terminals:

    export ROSSEC_HOME={directory} ROS_IP=127.0.0.1 PATH="{programs}:$PATH"
    rossec master
    python -I -m rossec.demo.robot
    rossec topic echo /robot/pose geometry_msgs/PoseStamped --as /heating

The authority's passphrase is in {directory}/passphrase. Try

    rossec grant list
    rossec grant sign /heating --subscribe /robot/scan --passphrase-file {directory}/passphrase
"""
