"""Which PINs are too easy, how long guessing has to wait, and the code that proves the first account. No Streamlit.

The pause is the same for a name that nobody has: else its length would tell which names there are.
"""

import secrets
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

from softcal.core.errors import InputError
from softcal.core.words.reason import Reason, reason

FREE_FAILURES = 2
FIRST_PAUSE, LONGEST_PAUSE = timedelta(seconds=2), timedelta(minutes=5)
MOST_NAMES = 10_000
"""So many names are remembered; whoever invents more does not fill the memory."""

CODE_DIGITS = 8


def check_pin(pin: str, again: str) -> None:
    """Refuse a PIN typed differently twice, or guessed first: one digit, a run, a pair repeated."""
    if pin != again:
        raise InputError(Reason("account.pins_differ"))
    steps = {(int(b) - int(a)) % 10 for a, b in zip(pin, pin[1:], strict=False) if a.isdecimal() and b.isdecimal()}
    is_run = pin.isdecimal() and len(steps) == 1 and steps <= {0, 1, 9}
    is_pair = len(pin) >= 4 and len(pin) % 2 == 0 and pin == pin[:2] * (len(pin) // 2)
    if is_run or is_pair:
        raise InputError(Reason("account.pin_easy"))


class Pauses:
    """Wrong tries of each name at this server; the next one waits 2 s, then twice as long each."""

    def __init__(self, clock: Callable[[], datetime] = lambda: datetime.now(UTC)) -> None:
        self._clock = clock
        self._failures: dict[str, tuple[int, datetime]] = {}

    def check(self, name: str) -> None:
        _, until = self._failures.get(_key(name), (0, self._clock()))
        left_s = (until - self._clock()).total_seconds()
        if left_s > 0:
            raise InputError(reason("account.wait", seconds=max(1, round(left_s))))

    def failed(self, name: str) -> None:
        """Count a wrong try."""
        count = self._failures.pop(_key(name), (0, None))[0] + 1
        pause = FIRST_PAUSE * 2 ** min(count - FREE_FAILURES - 1, 20) if count > FREE_FAILURES else timedelta(0)
        if len(self._failures) >= MOST_NAMES:
            del self._failures[next(iter(self._failures))]
        self._failures[_key(name)] = (count, self._clock() + min(pause, LONGEST_PAUSE))

    def succeeded(self, name: str) -> None:
        """Forget the wrong tries of a name."""
        self._failures.pop(_key(name), None)


def new_code() -> str:
    """Return a code that nobody can guess, in two halves to be read out."""
    digits = "".join(secrets.choice("0123456789") for _ in range(CODE_DIGITS))
    return f"{digits[:4]}-{digits[4:]}"


def is_code(typed: str, code: str) -> bool:
    """Whether somebody typed a code; spaces and the dash are no matter."""
    plain = [text.replace("-", "").replace(" ", "").encode() for text in (typed, code)]
    return secrets.compare_digest(*plain)


def _key(name: str) -> str:
    return name.strip().lower()[:120]
