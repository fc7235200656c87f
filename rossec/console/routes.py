"""Every page of the console. What is not here does not exist, and nothing is served beside it."""

from typing import Final

from rossec.console import assets
from rossec.console.pages import (
    add,
    approve,
    approved,
    ask,
    happened,
    invite,
    join,
    login,
    news,
    nodes,
    phones,
    policy,
    privacy,
    revoke,
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
    *approved.PAGES,
    *add.PAGES,
    *join.PAGES,
    *ask.PAGES,
    *revoke.PAGES,
    *invite.PAGES,
    *policy.PAGES,
    *today.PAGES,
    *who.PAGES,
    *nodes.PAGES,
    *happened.PAGES,
    *privacy.PAGES,
)
