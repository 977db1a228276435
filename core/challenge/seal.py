"""The seal of a challenge: labels as canonical text, and its SHA-256, published beforehand.

The text holds a random nonce, so the published hash tells nothing about the labels; and it holds the hash of every
case in its distributed form, so neither labels nor cases can change without breaking the seal.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import msgspec

from softcal.core.challenge.cases import SealedCase, distance_sigma
from softcal.core.errors import InputError
from softcal.core.json_input import parse_json

SCHEMA = "softcal.seal/1"


@dataclass(frozen=True)
class Label:
    """Label of one case in the seal.

    Args:
        sha256: content hash of the case in its distributed form.
        distance_sigma: visibility of its causes in σ after a refit of the base.
    """

    case: SealedCase
    sha256: str
    distance_sigma: float


@dataclass(frozen=True)
class Seal:
    """The sealed text and its commitment."""

    text: str

    @property
    def commitment(self) -> str:
        return hashlib.sha256(self.text.encode()).hexdigest()


def seal_labels(
    cases: Sequence[SealedCase], contents: Mapping[str, str], seed: int, nonce: str, seed_origin: str = "drawn"
) -> Seal:
    """Write the labels of a challenge as sealed text.

    Args:
        nonce: random text of at least 128 bits.
        seed_origin: `drawn` in secret, or `stated`.
    """
    labels = [
        {"case": asdict(case), "sha256": contents[case.name], "distance_sigma": round(distance_sigma(case), 3)}
        for case in cases
    ]
    sealed = {"schema": SCHEMA, "nonce": nonce, "seed": seed, "seed_origin": seed_origin, "labels": labels}
    return Seal(json.dumps(sealed, sort_keys=True, separators=(",", ":"), allow_nan=False))


def seed_origin(text: str) -> str:
    """Return where the seed of a sealed text came from."""
    return str(parse_json(text).get("seed_origin"))


def open_seal(text: str, commitment: str) -> list[Label]:
    """Check a sealed text against its published commitment and return the labels.

    Raises:
        InputError: the text is not the one that was sealed, or no seal of softcal.
    """
    if Seal(text).commitment != commitment:
        raise InputError(
            f"the seal is broken: SHA-256 of the sealed file is {Seal(text).commitment}, {commitment} was published; "
            "nothing was scored"
        )
    try:
        sealed = parse_json(text)
        if sealed["schema"] != SCHEMA:
            raise InputError(f"the sealed file has schema {sealed['schema']!r}; {SCHEMA!r} was expected")
        return msgspec.convert(sealed["labels"], list[Label])
    except (ValueError, TypeError, KeyError) as error:
        raise InputError("the sealed file holds no labels; nothing was scored") from error
