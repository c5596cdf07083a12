"""Bodies from files: what is read is what is drawn; what is no mesh is refused."""

from __future__ import annotations

import numpy as np
import pytest

import kreisel as kr
from kreisel.viewer.bodies import marked_axis, read_mesh
from kreisel.viewer.scene import scene
from scenes import IDENTITY, points

CORNERS = [(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)]
SIDES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]


def stl(binary: bool) -> bytes:
    facets = [[CORNERS[k] for k in side] for side in SIDES]
    if binary:
        record = np.zeros(4, dtype=[("n", "<f4", 3), ("v", "<f4", (3, 3)), ("e", "<u2")])
        record["v"] = facets
        return b"solid looks like text".ljust(80) + np.uint32(4).tobytes() + record.tobytes()
    lines = ["solid x"]
    for facet in facets:
        lines += [
            "facet normal 0 0 0",
            "outer loop",
            *(f"vertex {x} {y} {z}" for x, y, z in facet),
            "endloop",
            "endfacet",
        ]
    return "\n".join([*lines, "endsolid x"]).encode()


OBJ = "\n".join(
    [*(f"v {x} {y} {z}" for x, y, z in CORNERS), "f 1/1 3 2", "f 1 2 4 # a comment", "f -3 -2 -1", "f 1 4 3"]
)


@pytest.mark.parametrize(("name", "raw"), [("a.stl", stl(True)), ("b.STL", stl(False)), ("c.obj", OBJ.encode())])
def test_a_mesh_is_read_and_shown(name, raw, tmp_path, oriented):
    (tmp_path / name).write_bytes(raw)
    found = read_mesh(tmp_path / name)
    seen = {frozenset(map(tuple, found.points[face].tolist())) for face in found.faces}
    assert seen == {frozenset(CORNERS[k] for k in side) for side in SIDES}
    data = scene(oriented, body=found)
    assert np.allclose(sorted(np.linalg.norm(points(data), axis=-1)), 0.94 / 3 * np.arange(4), atol=1e-6)
    kr.view(oriented, mesh=tmp_path / name)
    cut = (
        raw.replace(b"vertex", b"vertex 1", 1) if b"vertex" in raw else raw + b"\nf 1 2 9" if b"f " in raw else raw[:-1]
    )
    for broken in (cut, b"", b"v 1 2\nf 1 2 3"):
        (tmp_path / name).write_bytes(broken)
        with pytest.raises(kr.InputError, match="mesh: "):
            kr.view(oriented, mesh=tmp_path / name)


@pytest.mark.parametrize(
    "text", ["v 0 0 0\nv 1 0 0\nf 1 2 3", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3", "f 0 0 0", "v 1 1 1"]
)
def test_a_bad_mesh_is_refused(text, tmp_path, oriented):
    (tmp_path / "x.obj").write_text(text)
    with pytest.raises(kr.InputError, match="mesh: "):
        kr.view(oriented, mesh=tmp_path / "x.obj")
    with pytest.raises(kr.InputError, match=r"ends in \.stl or \.obj.* export glTF"):
        kr.view(oriented, mesh=tmp_path / "x.glb")
    with pytest.raises(kr.InputError, match="cannot be read"):
        kr.view(oriented, mesh=tmp_path / "none.obj")


@pytest.fixture
def oriented(top, x0):
    return kr.simulate(top, x0, dt=0.05, steps=400, orientation=IDENTITY, progress=False)


def test_the_axis_of_a_disc_is_its_axis_of_symmetry() -> None:
    e = np.eye(3)
    flat, long = "axis of symmetry", "long axis"
    cases = [((5, 5, 0.5), 2, flat), ((0.5, 5, 5), 0, flat), ((3, 1, 1), 0, long), ((1, 3, 2), 1, long)]
    for half, place, name in [*cases, ((1, 1, 1), 2, long)]:
        axis, word = marked_axis(None, np.array(half, dtype=float))
        assert np.array_equal(axis, e[place]) and word == name
        axis, word = marked_axis(np.diag(np.square(half).astype(float)))
        assert abs(axis @ e[place]) > 1 - 1e-12 or len(set(half)) == 1
        assert word == name
