"""The array w of a kernel of large n: rows of entries, which one loop leaves to the next."""

from __future__ import annotations

from collections.abc import Mapping

SUMMED = 16  # entries that a sum takes at a time: rows are filled with zeros, or what is left over costs most of it
# Rows of 4096 bytes fall on the same places of the first cache: at n = 1000 a step took three times as long.
ALIASED = 64


class Workspace:
    """Rows of h entries; `stay` has the row of each name that stays."""

    def __init__(self, h: int):
        self.h = h
        self.length = -(-h // SUMMED) * SUMMED  # of a row: beyond h stands 0
        if self.length > ALIASED and self.length % ALIASED == 0:
            self.length += SUMMED
        self.stay: dict[str, int] = {}
        self.count = 0

    @property
    def size(self) -> int:
        """Numbers in all rows."""
        return self.count * self.length

    def new(self) -> int:
        """A row more."""
        self.count += 1
        return self.count - 1

    def keep(self, name: str) -> int:
        """A row more, for a name that stays."""
        self.stay[name] = self.new()
        return self.stay[name]

    def entry(self, row: int) -> str:
        """Its entry k."""
        return f"w[{row * self.length} + k]"

    def vector(self, row: int) -> str:
        """Its h entries."""
        return f"w[{row * self.length}:{row * self.length + self.h}]"


class WorkspaceRows:
    """The rows of one function: of names that stay, and of others up to the last level at which they are `used`."""

    def __init__(self, work: Workspace, used: Mapping[str, float]):
        self.work, self._used = work, used
        self._held: dict[str, int] = {}
        self._free: list[int] = []

    def of(self, name: str) -> int:
        """The row of a name."""
        return self._held[name] if name in self._held else self.work.stay[name]

    def take(self, name: str) -> int:
        """A row for a name."""
        self._held[name] = self._free.pop() if self._free else self.work.new()
        return self._held[name]

    def release(self, level: int) -> None:
        """Rows of names that are not used from this level on are free again."""
        for name in [n for n in self._held if self._used.get(n, 0) < level]:
            self._free.append(self._held.pop(name))

    def entry(self, name: str) -> str:
        """Entry k of a name."""
        return self.work.entry(self.of(name))

    def vector(self, name: str) -> str:
        """All entries of a name."""
        return self.work.vector(self.of(name))
