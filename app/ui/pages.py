"""The pages of the application and their tabs, each declared once with who may open it.

To add a page: write `app/ui/app_pages/NAME.py` with a function `render()`, add one line to `PAGES` and the text
`page.NAME`. To add a tab: write a function `draw_NAME()` in `app/ui/tabs/PAGE.py`, add it to its page and the text
`tab.NAME`. Every address answers; what a role may not see asks for a sign-in, and what is written asks
`account.permit` again.
"""

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from softcal.db.access.people import may
from softcal.db.entries import User


@dataclass(frozen=True)
class Tab:
    """A part of a page.

    Args:
        name: `tab` in the address, key of its title `tab.NAME`.
        actions: of `PERMISSIONS`; a role that has one of them may open it. Empty: everybody.
    """

    name: str
    actions: tuple[str, ...] = ("look",)

    def is_open_to(self, user: User) -> bool:
        """Whether a person may open it."""
        return is_allowed(user, self.actions)


@dataclass(frozen=True)
class PageEntry:
    """One page.

    Args:
        name: module in `app_pages`, address and key of its title `page.NAME`.
        icon: of Streamlit's bundled Material symbols; "" for a page that is opened by a link alone.
        actions: as those of a tab.
        tabs: its parts, the first of them drawn where the address names none.
        is_large: each of its tabs has a module of its own.
    """

    name: str
    icon: str = ""
    actions: tuple[str, ...] = ("look",)
    tabs: tuple[Tab, ...] = ()
    is_large: bool = False

    def render(self) -> None:
        """Draw it; its module is read when it is opened first."""
        importlib.import_module(f"softcal.app.ui.app_pages.{self.name}").render()

    def draw(self, tab: str, *subject: object) -> None:
        """Draw one of its tabs for what the page is about."""
        getattr(importlib.import_module(self.module_of(tab)), f"draw_{tab}")(*subject)

    def module_of(self, tab: str) -> str:
        """Return the module of one of its tabs."""
        return f"softcal.app.ui.tabs.{self.name}{f'_{tab}' if self.is_large else ''}"


SET_UP = ("set_up",)
PAGES = (
    PageEntry("line", "play_circle"),
    PageEntry("lots", "inventory_2", tabs=(Tab("files", SET_UP), Tab("rig", SET_UP))),
    PageEntry(
        "lot",
        tabs=(
            Tab("overview"),
            Tab("units"),
            Tab("audit", ("set_up", "audit")),
            Tab("release"),
            Tab("limits", ("set_limit",)),
            Tab("networks", ("set_up", "release")),
            Tab("known_loads", ("set_up", "audit")),
            Tab("compare"),
        ),
        is_large=True,
    ),
    PageEntry("unit", tabs=tuple(map(Tab, ("why", "recording", "files", "history", "compare")))),
    PageEntry("gap", "troubleshoot", SET_UP),
    PageEntry(
        "station",
        "precision_manufacturing",
        tabs=(Tab("state", ("set_up", "override")), Tab("cells", ("set_up", "audit")), Tab("profiles", SET_UP)),
    ),
    PageEntry(
        "settings",
        "settings",
        (),
        (Tab("account", ()), Tab("people", ("people",)), Tab("laboratory", SET_UP), Tab("audit_trail", ("audit",))),
    ),
)

REDIRECTS = {
    "start": ("lots", ""),
    "new_lot": ("lots", "files"),
    "source": ("lots", "rig"),
    **{name: ("lot", name) for name in ("audit", "release", "limits", "networks", "known_loads", "compare")},
    "long_term": ("unit", "history"),
    "profiles": ("station", "profiles"),
    "load_cells": ("station", "cells"),
    "sign_in": ("settings", "account"),
    "people": ("settings", "people"),
    "audit_trail": ("settings", "audit_trail"),
    "wall": ("line", ""),
}
"""Address of a page that was → its page and tab now."""


def page_of(name: str) -> PageEntry:
    """Return a page by its name."""
    return next(page for page in PAGES if page.name == name)


def is_allowed(user: User, actions: tuple[str, ...]) -> bool:
    """Whether a role has one of some actions; where there are none, everybody has."""
    return not actions or any(may(user, action) for action in actions)


def redirect(address: str, query: Mapping[str, Sequence[str]]) -> tuple[str, dict[str, Sequence[str]]]:
    """Return page and query of an address that was."""
    page, tab = REDIRECTS[address]
    parameters = dict(query)
    if address == "compare" and "a" in parameters:
        page, parameters = "unit", {"unit": parameters["a"], "with": parameters.get("b", ())}
    if address == "wall":
        parameters["wall"] = [""]
    return page, {**parameters, **({"tab": [tab]} if tab else {})}
