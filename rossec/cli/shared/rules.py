"""What commands that name by rules have in common: rules and metadata in files, a name."""

import asyncio
from pathlib import Path

from rossec import files
from rossec.naming import MAX_INPUT, RuleRunner, check_document, check_rules, require_extra, rule_runner


def read_rules(path: Path | None) -> bytes:
    """The rules in a file, else those that are shipped; the process for rules parses them."""
    require_extra()
    return rule_runner.shipped_rules() if path is None else check_rules(files.read(path, MAX_INPUT))


def read_metadata(path: Path) -> bytes:
    """The metadata in a file; they are not parsed here."""
    return check_document(files.read(path, MAX_INPUT))


def name_of_node(rules: bytes, metadata: bytes) -> str:
    async def ask() -> str:
        async with RuleRunner(rules) as runner:
            return await runner.name(metadata)

    return asyncio.run(ask())
