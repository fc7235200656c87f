"""`rossec namespace check`: rules tried on the metadata of many nodes, before they are used."""

import asyncio
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Final

import click

from rossec import files
from rossec.authority.policyfile import PolicyFile
from rossec.cli.namespace.coverage import Coverage, read_grants
from rossec.cli.shared import options
from rossec.errors import ConfigurationError, ProposedNameRefused
from rossec.naming.documents import MAX_INPUT
from rossec.naming.examine import Covered, Report, examine
from rossec.naming.runner import RuleRunner
from rossec.terminal import note, printable, say, say_json

SUFFIX: Final = "*.xml"
MAX_FILES: Final = 1024
_DIRECTORY: Final = click.Path(path_type=Path, exists=True, file_okay=False)


@click.command()
@click.argument("rules", type=options.FILE)
@click.option(
    "--meta", "directory", metavar="DIR", required=True, type=_DIRECTORY,
    help=f"metadata of nodes, files {SUFFIX}",
)  # fmt: skip
@click.option(
    "--policy", "policy_path", metavar="FILE", type=options.FILE,
    help="report names on which this policy gives their node nothing",
)  # fmt: skip
@click.option(
    "--grants", "grants_path", metavar="DIR", type=_DIRECTORY,
    help="report names on which no grant in DIR (files *.grant) gives their node anything",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
def check(
    rules: Path,
    directory: Path,
    policy_path: Path | None,
    grants_path: Path | None,
    as_json: bool,
) -> None:
    """Try RULES on the metadata of many nodes: which names are wrong, and why.

    Reported are, each with the file and line of the metadata: names that are none or reserved, one
    name for two things, names that change with the order of the metadata, and with --policy or
    --grants names that no rule or grant covers.
    """
    documents = _documents(directory)
    covered = _coverage(policy_path, grants_path)
    report = asyncio.run(_examined(files.read(rules, MAX_INPUT), documents, covered))
    if as_json:
        say_json({"names": _rows(report), "findings": [asdict(each) for each in report.findings]})
    else:
        _print(report)
    if covered is None:
        note("names were not compared with rights: give --policy or --grants")
    if report.findings:
        raise ProposedNameRefused(
            f"{len(report.findings)} findings with the rules {rules}",
            "correct the rules or the metadata, and check again",
        )


def _documents(directory: Path) -> list[tuple[str, bytes]]:
    found = sorted(directory.glob(SUFFIX))
    if not found:
        raise ConfigurationError(
            f"there are no metadata in {directory}", f"it is a folder with files {SUFFIX}"
        )
    if len(found) > MAX_FILES:
        raise ConfigurationError(f"{len(found)} files in {directory} where {MAX_FILES} are allowed")
    return [(str(path), files.read(path, MAX_INPUT)) for path in found]


def _coverage(policy_path: Path | None, grants_path: Path | None) -> Covered | None:
    if policy_path is None and grants_path is None:
        return None
    held = [] if grants_path is None else read_grants(grants_path)
    return Coverage(held, None if policy_path is None else PolicyFile.read(policy_path).policy)


async def _examined(
    rules: bytes, documents: Sequence[tuple[str, bytes]], covered: Covered | None
) -> Report:
    async with RuleRunner(rules) as runner:
        return await examine(runner, documents, covered)


def _rows(report: Report) -> list[dict[str, object]]:
    return [
        {"kind": kind.value, "name": name, **asdict(place)}
        for (kind, name), places in sorted(report.names.items())
        for place in places
    ]


def _print(report: Report) -> None:
    for finding in report.findings:
        say(printable(str(finding)))
    count = sum(map(len, report.names.values()))
    say(f"{count} names, {len(report.findings)} findings")
