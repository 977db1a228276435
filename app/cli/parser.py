"""The parser of `softcal`: what argparse does, and a suggestion where a name was mistyped."""

import argparse
import difflib
from collections.abc import Callable, Iterable, Sequence
from typing import Any


class _Formatter(argparse.HelpFormatter):
    """Fills a text as a paragraph, and keeps the lines of a text with several, such as examples."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" not in text:
            return super()._fill_text(text, width, indent)
        return "".join(indent + line for line in text.splitlines(keepends=True))


class Parser(argparse.ArgumentParser):
    """Parser that suggests a correction of a mistyped command, option or choice, and keeps lines of examples.

    Args:
        load: gives the parser its description and options when the command is called. So a command imports only its
            own module, and `softcal --help` none.
    """

    def __init__(self, *, load: Callable[["Parser"], None] | None = None, **options: Any) -> None:
        super().__init__(formatter_class=_Formatter, **options)
        self._load = load

    def load(self) -> None:
        """Load description and options of the command on first use."""
        load, self._load = self._load, None
        if load is not None:
            load(self)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            raise argparse.ArgumentError(action, error.message + suggestion(str(value), action.choices or ())) from None

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse the arguments; the command that defines the options refuses an unknown option."""
        self.load()
        options, unparsed = super().parse_known_args(args, namespace)
        if unparsed:
            unknown = next((word for word in unparsed if word.startswith("-")), unparsed[0]).partition("=")[0]
            near = suggestion(unknown, self._option_string_actions)
            self.error(f"unrecognized arguments: {' '.join(unparsed)}{near}")
        return options, unparsed


def suggestion(word: str, choices: Iterable[object]) -> str:
    """Return `; did you mean X?`, or an empty text without a similar name."""
    near = difflib.get_close_matches(word, [str(name) for name in choices], n=1, cutoff=0.6)
    return f"; did you mean {near[0]}?" if near else ""
