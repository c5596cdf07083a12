"""Bodies from files: STL, binary or as text, and OBJ.  Read as numbers, checked, never as code."""

from __future__ import annotations

import os
from itertools import pairwise

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError
from kreisel.files import place
from kreisel.viewer.bodies import FIRST, SECOND, Body

MOST_FACES = 200_000
LARGEST = 1e9
SUFFIXES = (".stl", ".obj")
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])  # a facet of binary STL


def read_mesh(path: str | os.PathLike[str]) -> Body:
    """The triangles of a file.  Raises `InputError` for another format, a damaged file or too many triangles."""
    file = place(path, "mesh: expected the name of a file")
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(
            f"mesh: expected a file that ends in {' or '.join(SUFFIXES)}, got {file.name!r}. Programs that draw "
            "bodies, such as Blender, export glTF, PLY and others as STL."
        )
    try:
        if file.stat().st_size > 400 * MOST_FACES:
            raise InputError(f"mesh: {file.name} is too large; expected at most {MOST_FACES:,} triangles.")
        raw = file.read_bytes()
    except OSError as error:
        raise InputError(f"mesh: {file} cannot be read: {error.strerror or error}.") from error
    try:
        points, faces = _obj(raw) if file.suffix.lower() == ".obj" else _stl(raw)
    except (ValueError, IndexError, UnicodeDecodeError) as error:
        raise InputError(f"mesh: {file.name} is no whole {file.suffix[1:].upper()} file: {error}.") from error
    if not 1 <= len(faces) <= MOST_FACES:
        raise InputError(f"mesh: expected 1 to {MOST_FACES:,} triangles in {file.name}, got {len(faces):,}.")
    if not (np.isfinite(points).all() and (abs(points) < LARGEST).all() and abs(points).max() > 0):
        raise InputError(f"mesh: expected finite points below {LARGEST:g}, not all 0, in {file.name}.")
    octant = (points[faces].mean(1) > 0).sum(1) % 2
    return Body(points, faces, np.where(octant, FIRST, SECOND))


def _stl(raw: bytes) -> tuple[Array, Array]:
    count = int(np.frombuffer(raw[80:84], "<u4")[0]) if len(raw) >= 84 else -1
    if len(raw) == 84 + RECORD.itemsize * count:
        corners = np.frombuffer(raw, RECORD, count, 84)["corners"].astype(np.float64)
    elif raw.lstrip()[:5].lower() == b"solid":
        lines = [line.split() for line in raw.decode("ascii", "strict").splitlines()]
        numbers = [line[1:] for line in lines if line[:1] == ["vertex"]]
        if len(numbers) % 3 or any(len(line) != 3 for line in numbers):
            raise ValueError("a facet is not of three points")
        corners = np.array(numbers, dtype=np.float64).reshape(-1, 3, 3)
    else:
        raise ValueError("its length is not that of its facets")
    points, places = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    return points, places.reshape(-1, 3)


def _obj(raw: bytes) -> tuple[Array, Array]:
    points: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for line in raw.decode("utf-8").splitlines():
        word, *rest = line.split("#")[0].split() or [""]
        if word == "v":
            x, y, z, *_ = map(float, rest)
            points.append([x, y, z])
        elif word == "f":
            corners = [_place(int(each.split("/")[0]), len(points)) for each in rest]
            if len(corners) < 3:
                raise ValueError("a face has fewer than three corners")
            faces += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
    return np.array(points, dtype=np.float64).reshape(-1, 3), np.array(faces, dtype=int).reshape(-1, 3)


def _place(number: int, count: int) -> int:
    """From 1 on; a negative one counts from the end."""
    place = number - 1 if number > 0 else count + number
    if number == 0 or not 0 <= place < count:
        raise ValueError(f"a face names the point {number} of {count}")
    return place
