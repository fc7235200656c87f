"""`rossec border --demo`: a border router and a lamp in a home of their own, and it ends."""

import asyncio
import sys
import tempfile
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import click
from click.core import ParameterSource

from rossec.cli.shared import invocation
from rossec.demo.border_steps import run_border_steps
from rossec.demo.environment import DemoEnvironment, Run, StepPrinter
from rossec.errors import ConfigurationError

_LIBRARIES = ("aiocoap", "lakers")


def show_demo(context: click.Context) -> None:
    """Show a lamp behind a border router; nothing is left.

    Raises:
        ConfigurationError: a library is missing, or another option was given.
        DemoFailed: a step did not do what it says.
    """
    if any(find_spec(name) is None for name in _LIBRARIES):
        raise ConfigurationError(
            "CoAP for things is not installed", "pip install 'rossec[constrained]'"
        )
    others = (name for name in context.params if name != "is_demo")
    if any(context.get_parameter_source(name) != ParameterSource.DEFAULT for name in others):
        raise ConfigurationError("--demo has a home of its own", "leave the other options out")
    run = partial(invocation.run, context.find_root().command)
    with tempfile.TemporaryDirectory(prefix="rossec-demo-") as directory:
        asyncio.run(_play(Path(directory), run))


async def _play(directory: Path, run: Run) -> None:
    printer = StepPrinter(sys.stdout.write)
    demo = DemoEnvironment(directory, printer, {"ROS_IP": "127.0.0.1"}, run)
    try:
        await run_border_steps(demo)
    finally:
        await demo.stop_all()
