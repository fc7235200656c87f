"""Every page of the console. What is not here does not exist, and nothing is served beside it."""

from typing import Final

from rossec.console import assets
from rossec.console.pages import approve, login, news, phones
from rossec.console.routing import Page

ROUTES: Final[tuple[Page, ...]] = (
    *assets.PAGES,
    *login.PAGES,
    *phones.PAGES,
    *news.PAGES,
    *approve.PAGES,
)
