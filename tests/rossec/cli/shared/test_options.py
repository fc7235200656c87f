from pathlib import Path

import click

from rossec.cli.shared import options


def test_the_options_have_their_names() -> None:
    @click.command()
    @options.policy
    @options.master_uri
    def command(policy_path: Path | None, master_uri: str | None) -> tuple[Path | None, str | None]:
        return policy_path, master_uri

    words = ["--policy", "p.yaml", "--master", "http://m:1"]
    assert command.main(words, standalone_mode=False) == (Path("p.yaml"), "http://m:1")
    assert command.main([], standalone_mode=False) == (None, None)
