"""Every benchmark: `run.py` times single trajectories; `run.py --all` also follows round-off over 1e8 steps."""

from __future__ import annotations

import argparse

import roundoff
import single


def main() -> None:
    """Say what is done, do it, say where the results are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="also roundoff.py, some minutes")
    options = parser.parse_args()
    single.compiler()
    print("== single: one trajectory, n = 3, kernels against C++ by hand (about half a minute)")
    single.main([])
    if options.all:
        print("\n== roundoff: do rounding errors walk at random? (some minutes)")
        roundoff.main([])


if __name__ == "__main__":
    main()
