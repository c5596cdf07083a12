"""A separate place for the trial: processes, devices and files that nothing else shares.

As root: a namespace of mounts and of processes.  Every file system there is read-only but one in memory, and /dev holds
null, zero, urandom and full alone, created anew, so that no call can write to the machine.
Elsewhere a temporary folder, and paths of devices are not tried; the result states which of the two it was.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

DEVICES = {"null": (1, 3), "zero": (1, 5), "full": (1, 7), "urandom": (1, 9)}
LARGEST = "3g"  # of the file system in memory
NOT_PERMITTED = "a temporary folder; no namespace of mounts was permitted, and paths of devices were not tried"
PRIVATE = "a separate namespace: all file systems read-only but one in memory, private devices"
MOMENT = 2.0  # seconds
CAPABILITY_VERSION = 0x20080522  # of Linux


def command(inner: list[str]) -> list[str]:
    """The command in a separate namespace if that is permitted, else unchanged."""
    outer = ["unshare", "--mount", "--pid", "--fork", "--mount-proc", "--kill-child"]
    try:
        permitted = (
            os.geteuid() == 0
            and not subprocess.run([*outer, "true"], capture_output=True, timeout=20, check=False).returncode
        )
    except OSError:
        permitted = False
    return [*outer, *inner, "--private"] if permitted else inner


def enter(folder: Path, private: bool) -> str:
    """Make `folder` the only place where anything can be written, with an environment inside it; its description.

    Raises `OSError` or `subprocess.CalledProcessError` if a namespace was created and does not hold.
    """
    if private:
        _mount("-t", "tmpfs", "-o", f"size={LARGEST},mode=755", "tmpfs", str(folder))
        _devices()
        for line in Path("/proc/self/mountinfo").read_text(encoding="utf-8").splitlines():
            place = line.split()[4].encode().decode("unicode_escape")
            if Path(place) != folder and not place.startswith("/dev"):
                _mount("-o", "remount,bind,ro", place, check=place == "/")
        _require_read_only(folder)
    home = folder / "home"
    for name in ("home", "cache", "tmp", "cases"):
        (folder / name).mkdir(exist_ok=True)
    caches = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for fonts in Path(os.environ.get("MPLCONFIGDIR") or caches / "matplotlib").glob("fontlist-*.json"):
        shutil.copy(fonts, home)  # Matplotlib would look for them again in each trial
    cache = folder / "cache"
    folders: dict[str, object] = {"HOME": home, "KREISEL_CACHE": cache}
    folders |= {"XDG_CACHE_HOME": home, "XDG_CONFIG_HOME": home, "MPLCONFIGDIR": home, "TMPDIR": folder / "tmp"}
    folders |= dict.fromkeys(("KREISEL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), 1)
    os.environ.update({name: str(value) for name, value in folders.items()})
    cache.chmod(0o700)
    tempfile.tempdir = None
    os.environ.update(MPLBACKEND="agg", PYTHONDONTWRITEBYTECODE="1", JAX_PLATFORMS="cpu")
    sys.dont_write_bytecode = True
    return PRIVATE if private else NOT_PERMITTED


def _mount(*options: str, check: bool = True) -> None:
    subprocess.run(["mount", *options], check=check, capture_output=True, timeout=20)


def _devices() -> None:
    """An empty /dev with four devices, and the shared memory that semaphores need."""
    _mount("-t", "tmpfs", "-o", "size=64m,mode=755", "tmpfs", "/dev")
    for name, numbers in DEVICES.items():
        os.mknod(f"/dev/{name}", 0o666 | stat.S_IFCHR, os.makedev(*numbers))
        os.chmod(f"/dev/{name}", 0o666)
    os.mkdir("/dev/shm", 0o1777)
    os.symlink("/proc/self/fd", "/dev/fd")


def _require_read_only(folder: Path) -> None:
    for place in (folder.parent, Path(__file__).parent, Path("/")):
        try:
            with tempfile.TemporaryFile(dir=place):
                pass
        except OSError:
            continue
        raise OSError(f"{place} can be written from the namespace of the trial")


def die_with_parent() -> None:
    """Ask the kernel to end this process when its parent ends; Linux only."""
    ctypes.CDLL(None).prctl(1, 9, 0, 0, 0)


def sentinel(folder: Path) -> Path:
    """Files next to the cases that must never change."""
    place = folder / "sentinel"
    (place / "thesis" / "figures").mkdir(parents=True)
    for name in ("thesis/chapter.tex", "thesis/figures/one.csv", "run.zarr", "data.csv"):
        (place / name).write_text(f"{name}: years of work\n", encoding="utf-8")
    return place


def listing(place: Path) -> list[tuple[str, int, int, int]]:
    """Names, kinds, sizes and times of all below a folder, links not followed."""
    out = []
    for where, folders, files in os.walk(place):
        for name in (*folders, *files):
            status = os.lstat(os.path.join(where, name))
            size = 0 if stat.S_ISDIR(status.st_mode) else status.st_size
            out.append((os.path.join(where, name), stat.S_IFMT(status.st_mode), size, status.st_mtime_ns))
    return sorted(out)


def stays(place: Path, before: list[tuple[str, int, int, int]]) -> bool:
    """Whether a listing is unchanged, apart from a momentary lock of another worker, who writes there too."""
    end = time.monotonic() + MOMENT
    while listing(place) != before:
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def drop() -> None:
    """Give up every capability: modes of files count then, also for root, who still owns them."""
    header, nothing = (ctypes.c_uint32 * 2)(CAPABILITY_VERSION, 0), (ctypes.c_uint32 * 6)()
    if os.geteuid() == 0 and ctypes.CDLL(None, use_errno=True).capset(header, nothing):
        raise OSError(ctypes.get_errno(), "capabilities cannot be given up")
