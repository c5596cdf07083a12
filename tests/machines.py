"""The part of the suite that depends on the processor, under the code that the libraries have for others.

    python tests/machines.py [--quick] [MACHINE ...]        # make test-machines

OpenBLAS, LLVM, NumPy and XLA choose their code by the processor, and each can be made to choose otherwise.  What
compiles otherwise has a cache of kernels of its own, in out/machines; the processor's own code is `make test`.  --quick
is the machine with all of it at once, on the tests that failed on one processor and not on another: .ci/run does that.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Files, or single tests, whose figures come from rounding, LAPACK or libm: one line for a new one.
PART = (
    "implicit/test_branch.py",
    "runs/test_simulate.py",
    "method/test_baecklund.py",
    "method/test_variational.py",
    "kernels/test_large.py",
    "house/test_gallery.py",
    "graph/test_graph.py",
    "kernels/test_engine.py",
    "system/test_vectors.py",
    "kernels/test_projection.py",
    "exact/test_exact.py",
    "exact/test_conjugate.py",
    "exact/test_exact_pair.py",
    "exact/test_jumps.py",
    "exact/test_exact_rotor.py",
    "physical/test_free_body.py",
    "lab/test_laws.py",
    "reduction/test_reduction.py",
    "analysis/test_analysis.py",
    "method/test_auto.py",
    "house/test_readme.py",
    "house/test_machines.py",
    "storage/test_resume.py::test_resumed_on_another_processor",
    "storage/test_resume.py::test_resumed_by_the_code_of_another_processor",
)
QUICK = (
    "implicit/test_branch.py::test_integrals_stand_still_close_to_the_longest_step",
    "house/test_gallery.py::test_the_claims_of_the_gallery_hold[hess_appelrot]",
    "method/test_variational.py::test_order_of_state_and_orientation[heavy-top-8]",
    "runs/test_simulate.py::test_integrals_stand_still[lagrange-top-3-2]",
    "storage/test_resume.py::test_resumed_on_another_processor",
    "house/test_machines.py",
)

NO_VECTORS = {"NPY_DISABLE_CPU_FEATURES": "all that NumPy found"}  # see `environment`
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "KREISEL_NUM_THREADS"), "1")
MACHINES: dict[str, dict[str, str]] = {
    "Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "LLVM-generic": {"KREISEL_CPU_NAME": "generic"},
    "NumPy-baseline": NO_VECTORS,
    "XLA-SSE4_2": {"XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2"},
    "one-thread": ONE_THREAD,
}
COMPILED_FOR = {"KREISEL_CPU_NAME"}
OLDEST = {
    "OPENBLAS_CORETYPE": "Prescott",
    "KREISEL_CPU_NAME": "generic",
    "XLA_FLAGS": "--xla_cpu_max_isa=SSE4_2",
    **NO_VECTORS,
    **ONE_THREAD,
}


def environment(machine: dict[str, str]) -> dict[str, str]:
    """The environment of a process for that machine."""
    env = {**os.environ, **machine}
    if machine.items() >= NO_VECTORS.items():
        from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

        found = " ".join(name for name in __cpu_dispatch__ if __cpu_features__[name])
        env["NPY_DISABLE_CPU_FEATURES"] = os.environ.get("NPY_DISABLE_CPU_FEATURES", found)
    return env


def tested(name: str, machine: dict[str, str], part: tuple[str, ...]) -> tuple[str, list[str]]:
    """A line of the table, and the tests that failed."""
    folder = ROOT / "out" / "machines" / name
    folder.mkdir(parents=True, exist_ok=True)
    report, begun = folder / "report.xml", time.monotonic()
    report.unlink(missing_ok=True)
    options = ["-q", "-n", "2", "--timeout", "800", "--timeout-method", "thread", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", *options, f"--junitxml={report}", *(f"tests/{name}" for name in part)]
    env = environment(machine)
    if COMPILED_FOR & machine.keys():
        env["KREISEL_CACHE"] = str(folder / "kernels")  # other code; the rest shares the kernels of `make test`
    done = subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False)
    (folder / "log.txt").write_text(done.stdout + done.stderr)
    took = f"{time.monotonic() - begun:>8.0f}"
    if not report.exists():
        return f"{name:<16}{'-':>8}{'-':>8}{'-':>8}{took}", [f"no report, see {folder / 'log.txt'}"]
    cases = [*ElementTree.parse(report).iter("testcase")]
    bad = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    skipped = sum(case.find("skipped") is not None for case in cases)
    failed = [f"{case.get('classname')}::{case.get('name')}" for case in bad]
    if done.returncode and not failed:
        failed = [f"pytest ended with {done.returncode}, see {folder / 'log.txt'}"]
    return f"{name:<16}{len(cases) - len(bad) - skipped:>8}{len(bad):>8}{skipped:>8}{took}", failed


def main() -> int:
    """The table; 1 where a test failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the oldest machine and few tests")
    parser.add_argument("machine", nargs="*", choices=[[], *MACHINES], help=f"of {', '.join(MACHINES)}; default: all")
    asked = parser.parse_args()
    chosen = {"oldest": OLDEST} if asked.quick else {name: MACHINES[name] for name in asked.machine or MACHINES}
    print(f"{'machine':<16}{'passed':>8}{'failed':>8}{'skipped':>8}{'s':>8}", flush=True)
    failures = 0
    for name, machine in chosen.items():
        line, failed = tested(name, machine, QUICK if asked.quick else PART)
        print(line, *(f"    {test}" for test in failed), sep="\n", flush=True)
        failures += len(failed)
    return int(failures > 0)


if __name__ == "__main__":
    sys.exit(main())
