"""`rossec console phone`: a one-time code for a phone."""

import time
from typing import Final

import click

from rossec.authority.home import AuthorityHome
from rossec.cli.console.service import login_address, running_service, show_code
from rossec.cli.shared.context import Environment, pass_environment
from rossec.terminal import say, say_json
