"""`rossec namespace messages`: the ROS package with the type of the service."""

from pathlib import Path

import click

from rossec.cli.shared.results import json_result
from rossec.namespace import message_package
from rossec.terminal import printable, record, say


@click.command("messages")
@click.argument(
    "directory", metavar="DIRECTORY", type=click.Path(path_type=Path, exists=True, file_okay=False)
)
@json_result()
def command(directory: Path) -> None:
    """Write the package rossec_namespace into DIRECTORY: the type of the service.

    Programs need it to call /get_topic_name: from rossec_namespace.srv import GetTopicName. The
    directory may be the `src` of a catkin workspace.
    """
    written = str(message_package.write(directory))
    record(path=written)
    say(printable(written))
