"""Which PINs are too easy, and the code that proves the first account. No Streamlit."""

import secrets

from softcal.core.errors import InputError
from softcal.core.messages.reason import Reason

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


def new_code() -> str:
    """Return a code that nobody can guess, in two halves to be read out."""
    digits = "".join(secrets.choice("0123456789") for _ in range(CODE_DIGITS))
    return f"{digits[:4]}-{digits[4:]}"


def is_code(typed: str, code: str) -> bool:
    """Whether somebody typed a code; spaces and the dash are no matter."""
    plain = [text.replace("-", "").replace(" ", "").encode() for text in (typed, code)]
    return secrets.compare_digest(*plain)
