"""What tests of several rooms need: where the repository is, and processes that are stopped."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DOCS, EXAMPLES = ROOT / "docs", ROOT / "examples"


def started(folder: Path, code: str, seconds: float) -> subprocess.Popen[str]:
    """A process that is at work since so many seconds."""
    child = subprocess.Popen(
        [sys.executable, "-c", code], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    child.stdout.readline()
    time.sleep(seconds)
    return child


def ended(child: subprocess.Popen[str], number: int) -> tuple[int, str, float]:
    """Its exit status, its messages and the seconds that it took to obey."""
    begun = time.monotonic()
    child.send_signal(number)
    try:
        _, message = child.communicate(timeout=60)
    finally:
        child.kill()
    return child.returncode, message, time.monotonic() - begun
