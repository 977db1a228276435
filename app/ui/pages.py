"""The pages of the application, each declared once with who may open it.

To add a page: write `app/ui/app_pages/NAME.py` with a function `render()` that draws it, add one line to `PAGES` and
the text `page.NAME` in every language of texts.toml. A page that a role may not open is not in that session's list, so
that its address answers as if it did not exist. What a page writes asks `account.permit` again.
"""

import importlib
from dataclasses import dataclass

from softcal.db.access.people import may
from softcal.db.entries import User


@dataclass(frozen=True)
class PageEntry:
    """One page.

    Args:
        name: module in `app_pages`, address and key of its title `page.NAME`.
        icon: of Streamlit's bundled Material symbols.
        actions: of `PERMISSIONS`; a role that has one of them may open it. Empty: everybody.
        section: menu it stands in, key of its title `section.NAME`; "" is the bar itself.
        begins: whether everybody may open it while there is no lot but the demo's.
    """

    name: str
    icon: str
    actions: tuple[str, ...] = ()
    section: str = ""
    begins: bool = False

    def is_open_to(self, user: User, is_new: bool = False) -> bool:
        """Whether a person may open it; `is_new` while the registry knows no lot but the demo's."""
        return not self.actions or (self.begins and is_new) or any(may(user, action) for action in self.actions)

    def render(self) -> None:
        """Draw it; its module is read when it is opened first."""
        importlib.import_module(f"softcal.app.ui.app_pages.{self.name}").render()


PAGES = (
    PageEntry("start", "flag", ("set_up",), begins=True),
    PageEntry("line", "play_circle", ("calibrate",)),
    PageEntry("lot", "inventory_2", ("look",)),
    PageEntry("unit", "memory", ("look",)),
    PageEntry("compare", "compare_arrows", ("look",)),
    PageEntry("audit", "fact_check", ("set_up", "audit")),
    PageEntry("release", "inventory", ("look",)),
    PageEntry("long_term", "timeline", ("look",)),
    PageEntry("new_lot", "upload_file", ("set_up",), "calibrate"),
    PageEntry("source", "straighten", ("set_up",), "calibrate"),
    PageEntry("networks", "hub", ("set_up", "release"), "calibrate"),
    PageEntry("limits", "rule", ("set_limit",), "calibrate"),
    PageEntry("known_loads", "weight", ("set_up", "audit"), "calibrate"),
    PageEntry("gap", "troubleshoot", ("set_up",), "calibrate"),
    PageEntry("station", "precision_manufacturing", ("set_up", "override"), "rig"),
    PageEntry("profiles", "show_chart", ("set_up",), "rig"),
    PageEntry("load_cells", "scale", ("set_up", "audit"), "rig"),
    PageEntry("wall", "tv", ("look",)),
    PageEntry("people", "group", ("people",)),
    PageEntry("audit_trail", "history", ("audit",)),
    PageEntry("sign_in", "login"),
)


def pages_for(user: User, is_new: bool = False) -> tuple[PageEntry, ...]:
    """Return the pages a person may open, in the order of the navigation."""
    return tuple(page for page in PAGES if page.is_open_to(user, is_new))
