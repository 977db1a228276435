"""The limit as people state it: a number in the reference's unit, or a share of its range; and what is proposed."""

from dataclasses import dataclass

from softcal.core.errors import InputError

PROPOSED_SHARE = 0.10
"""Share of the range that is proposed where nobody stated a limit: a person has to confirm it."""


@dataclass(frozen=True)
class LimitText:
    """A limit as it was stated.

    Args:
        number: in the reference's unit; in per cent of its range where `is_percent`.
    """

    number: float
    is_percent: bool = False

    @classmethod
    def parse(cls, text: str) -> "LimitText":
        """Read `0.3` or `5%`.

        Raises:
            ValueError: another text, or a number that is not above 0.
        """
        number = float(text.strip().removesuffix("%"))
        if not 0 < number < float("inf"):
            raise ValueError(f"{text}: a number above 0 was expected")
        return cls(number, text.strip().endswith("%"))

    def rmse(self, full_range: float | None) -> float:
        """Return the limit in the reference's unit.

        Args:
            full_range: of the source's reference, in its unit; None where it is not known yet.

        Raises:
            InputError: a share of a range that nobody knows yet.
        """
        if not self.is_percent:
            return self.number
        if full_range is None:
            raise InputError(
                f"limit {self.number:g}%: the range of the reference is not known yet; state it in its unit"
            )
        return self.number / 100 * full_range


def proposed_limit(full_range: float) -> float:
    """Return what is proposed as a limit, with two significant digits: a person has to confirm it."""
    return float(f"{PROPOSED_SHARE * full_range:.2g}")
