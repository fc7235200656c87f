"""`rossec namespace rules`: the rules that are shipped, as a start for own ones."""

import click

from rossec.naming import shipped
from rossec.terminal import say_block


@click.command("rules")
def command() -> None:
    """Print the rules that are shipped, to be changed.

    They are those of the thesis, in XSLT 1.0: rossec namespace rules > names.xsl
    """
    say_block(shipped.rules().decode().removesuffix("\n"))
