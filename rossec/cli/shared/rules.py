"""What commands that name by rules have in common: options, rules and metadata in files, a name."""

import asyncio
from pathlib import Path

import click

from rossec import files
from rossec.cli.shared import options
from rossec.naming import shipped
from rossec.naming.documents import MAX_INPUT, check_document, check_rules
from rossec.naming.runner import RuleRunner, require_extra

option = click.option(
    "--rules", "rules_path", type=options.FILE, metavar="FILE",
    help="rules in XSLT instead of those that are shipped",
)  # fmt: skip


def read_rules(path: Path | None) -> bytes:
    """The rules in a file, else those that are shipped; the process for rules parses them.

    Raises:
        NamesExtraMissing: lxml is not installed.
        RulesRefused, ConfigurationError: too long, or with a document type.
    """
    require_extra()
    return shipped.rules() if path is None else check_rules(files.read(path, MAX_INPUT))


def read_metadata(path: Path) -> bytes:
    """The metadata in a file; they are not parsed here.

    Raises:
        MetadataRefused, ConfigurationError: too long, or with a document type.
    """
    return check_document(files.read(path, MAX_INPUT))


def name_of_node(rules: bytes, metadata: bytes) -> str:
    """The name that the rules give a node.

    Raises:
        RossecError: there is none, as `RuleRunner.name`.
    """

    async def ask() -> str:
        async with RuleRunner(rules) as runner:
            return await runner.name(metadata)

    return asyncio.run(ask())
