"""How many drawn histories of a lot hold what they promise: every act, two stations, a sync (tests/unit_histories.py).

python benchmarks/histories.py [--minutes 15] [--acts 6] [--first 0]
"""

import sys
import tempfile
import time
from pathlib import Path

from common.command import parser_of

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.unit_histories import make_registries, run_histories  # noqa: E402

BLOCK = 10
"""So many histories are drawn from one seed."""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--minutes", type=float, default=15.0, help="for how long (default 15)")
    parser.add_argument("--acts", type=int, default=6, help="at most in one history (default 6)")
    parser.add_argument("--first", type=int, default=0, help="first seed (default 0)")
    options = parser.parse_args()
    held, number = 0, options.first
    with tempfile.TemporaryDirectory() as folder:
        make_registries(Path(folder))
        start_s = time.perf_counter()
        while time.perf_counter() - start_s < 60 * options.minutes:
            held, number = held + run_histories(Path(folder), BLOCK, options.acts, number), number + 1
            spent_s = time.perf_counter() - start_s
            print(f"{held} histories of at most {options.acts} acts held, {spent_s:.0f} s", flush=True)


if __name__ == "__main__":
    main()
