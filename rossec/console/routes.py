"""Every page of the console. What is not here does not exist, and nothing is served beside it."""

from typing import Final

from rossec.console import assets
from rossec.console.pages import (
    approve,
    happened,
    login,
    news,
    nodes,
    phones,
    privacy,
    today,
    who,
)
from rossec.console.routing import Page

ROUTES: Final[tuple[Page, ...]] = (
    *assets.PAGES,
    *login.PAGES,
    *phones.PAGES,
    *news.PAGES,
    *approve.PAGES,
    *today.PAGES,
    *who.PAGES,
    *nodes.PAGES,
    *happened.PAGES,
    *privacy.PAGES,
)
