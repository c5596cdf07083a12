"""Every benchmark that needs no GPU, half an hour; `run.py --all` also what rounding does over 1e8 steps."""

from __future__ import annotations

import argparse
import sys

import dimension
import ensemble
import history
import propagator
import roundoff
import saving
import single
import startup

from kreisel.bench import MISSING, compiler


def main() -> None:
    """Run a step of the measurements, with a line before it and the place of its results after it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="also roundoff.py, some minutes")
    options = parser.parse_args()
    if compiler() is None:
        sys.exit(MISSING)
    print("== single: one trajectory, n = 3, kernels against C++ by hand (about half a minute)")
    single.main([])
    print("\n== ensemble: many trajectories, n = 3, kernels against C++ by hand (about a minute)")
    ensemble.main([])
    print("\n== saving: what saved states and integrals cost (some minutes)")
    saving.main([])
    print("\n== dimension: time of a step against n, and round-off of large n (a quarter of an hour)")
    dimension.main([])
    print("\n== propagator: what a call costs beside the steps (about a minute)")
    propagator.main()
    print("\n== startup: import and first step, fresh processes (about a minute)")
    startup.main([])
    if options.all:
        print("\n== roundoff: what rounding does to integrals and states (some minutes)")
        roundoff.main([])
    history.append()


if __name__ == "__main__":
    main()
