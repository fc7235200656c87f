"""`rossec demo`: the main job, end to end, with real processes."""

import asyncio
import sys
import tempfile
from pathlib import Path

import click

from rossec.cli.voice import say
from rossec.demo import story
from rossec.demo.stage import Narrator, Stage
from rossec.errors import ConfigurationError


@click.command()
@click.option(
    "--keep", type=click.Path(path_type=Path), help="new directory to leave everything in"
)
def demo(keep: Path | None) -> None:
    """Show the main job: enroll, grant, filter, refuse, revoke. Needs no ROS, ends by itself."""
    if keep is None:
        with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
            asyncio.run(_play(Path(directory)))
        return
    try:
        keep.mkdir(mode=0o700, parents=True)
    except FileExistsError:
        raise ConfigurationError(f"{keep} exists", "give a directory that does not exist") from None
    asyncio.run(_play(keep.resolve()))
    say(_GO_ON.format(directory=keep.resolve(), programs=Path(sys.executable).parent))


async def _play(directory: Path) -> None:
    narrator = Narrator(sys.stdout.write)
    stage = Stage(directory, narrator, {"ROS_IP": "127.0.0.1"})
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
