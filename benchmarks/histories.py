"""Drawn histories of a lot that hold what they promise: every act, two stations, a sync (tests/unit_histories.py).

python benchmarks/histories.py [--histories 2000] [--minutes 60] [--acts 6] [--first 0]

Exit code 1: a history broke a promise. Its traceback names the acts that led there.
"""

import sys
import tempfile
import time
import traceback
from pathlib import Path

from common.command import parser_of
from common.tables import print_table

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.unit_histories import UnitHistories, make_registries, run_histories  # noqa: E402

BLOCK = 20
"""So many histories are drawn from one seed."""

PROMISES = (
    "every serial in any list of released units passes on every surface",
    "every surface states the same errors of a unit",
    "an act changes what its preview named, and an act on one unit changes no other",
    "a refused act changes nothing",
    "two independent acts end the same in either order",
)


def main() -> int:
    parser = parser_of(__doc__)
    parser.add_argument("--histories", type=int, default=2000, help="at most so many (default 2000)")
    parser.add_argument("--minutes", type=float, default=60.0, help="for how long at most (default 60)")
    parser.add_argument("--acts", type=int, default=6, help="at most in one history (default 6)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    options = parser.parse_args()
    histories, number, is_broken = 0, options.first, False
    with tempfile.TemporaryDirectory() as folder:
        make_registries(Path(folder))
        start_s = time.perf_counter()
        while histories < options.histories and time.perf_counter() - start_s < 60 * options.minutes and not is_broken:
            try:
                histories, number = histories + run_histories(Path(folder), BLOCK, options.acts, number), number + 1
            except AssertionError:
                traceback.print_exc()
                is_broken = True
            print(f"{histories} histories, {time.perf_counter() - start_s:.0f} s", file=sys.stderr, flush=True)
        spent_s = time.perf_counter() - start_s
    counts = UnitHistories.counts
    acts = sorted({name.removesuffix(" refused") for name in counts})
    print_table(
        ("act", "done", "refused"), [(name, str(counts[name]), str(counts[f"{name} refused"])) for name in acts]
    )
    passed = "held" if not is_broken else "held, and the next one did not"
    print(f"\n{histories} histories of at most {options.acts} acts {passed}, {spent_s:.0f} s. After every act:\n")
    print("\n".join(f"- {promise}" for promise in PROMISES))
    return int(is_broken)


if __name__ == "__main__":
    raise SystemExit(main())
